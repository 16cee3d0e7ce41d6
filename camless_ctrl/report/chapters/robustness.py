"""Chapter: a simple air-charge loop known in closed form, mode by mode, and its confirmation."""

from __future__ import annotations

import math

from camless_ctrl.assessment import least
from camless_ctrl.confirmation import PlantCheck, check_plants
from camless_ctrl.robustness import RobustnessResult, analyse
from plant.sensors import MAF_DELAYS, MAF_TIME_CONSTANTS

from ..chapter import Context
from ..content import Cell, ChapterResult, Column, Figure, Heading, Number, Table, Text
from .held_differences import grow_beyond, growth_table, held_texts, try_held
from .maps import mean_value_plant

SAMPLES = 2  # full plants per speed
_STABLE = ("stable", "unstable")
_WITHSTOOD = ("withstood", "not withstood")


class RobustnessChapter:
    """Margins per speed and mode, gated on poles; sensor sweep; confirmation on full plants."""

    id = "robustness"
    title = "A simple loop in closed form"
    concludes = False

    def compute(self, context: Context) -> ChapterResult:
        """Analyse the simple loop at all speeds and run sampled full plants against the verdict."""
        results = context.shared(
            "robustness", lambda: analyse(mean_value_plant(context), engine=context.engine)
        )
        checks = check_plants(
            results,
            mean_value_plant(context),
            samples=SAMPLES,
            engine=context.engine,
            seed=context.seed,
        )
        tried = try_held(results)
        held = [r for r in results if r.gains.imbalance == 0.0]
        grown = grow_beyond(context, tried)
        broken = [r for r in results if not r.robustly_stable]
        numbers = {
            "least_disk": Number(least(r.disk_margin for r in results)),
            "least_gain": Number(least(r.gain_margin for r in results)),
            "peak": Number(max(r.sensitivity_peak for r in results)),
            "speeds": Number(len(results)),
            "robust_speeds": Number(len(results) - len(broken)),
        }
        return ChapterResult(
            finding=Text(
                "A simple loop, which the controller does not use, is robustly stable at "
                "{robust_speeds:.0f} of {speeds:.0f} speeds{exceptions}; its smallest nominal disk "
                "margin is {least_disk:.2f}.{held}",
                held=" It does not balance the cylinders at "
                + " and ".join(f"{r.speed_rpm:.0f} rpm" for r in held)
                + ": there their differences are held as learnt."
                if held
                else "",
                exceptions="".join(
                    f"{' (not at ' if k == 0 else ', '}{r.speed_rpm:.0f} rpm"
                    for k, r in enumerate(broken)
                )
                + (")" if broken else ""),
                **numbers,
            ),
            blocks=[
                Text(
                    "The controller's own loop is analysed in the next chapter; its estimator has "
                    "no closed form. This one has: a window on the air flow of each event, a "
                    "scheduled lift, integral correction with scheduled gains, known from the "
                    "sensor's formula to the last pole. It is kept beside the controller's for "
                    "insight: what delay does to the imbalance modes can be read off here, and "
                    "why the controller looks at the manifold pressure and learns the delay. No "
                    "requirement rests on it."
                ),
                Text(
                    "The loop lives in the domain of intake events: each cylinder returns once per "
                    "cycle, and for equal cylinders the loop splits into circulant modes, the mean "
                    "(q = 0) and the imbalances between cylinders (q = 1 once per cycle, q = 2 "
                    "alternating). Every margin is gated on the closed-loop poles: an unstable "
                    "mode has none. The gain error is the largest relative error of the loop gain "
                    "over full plants with and without runner and oscillation and with flow "
                    "coefficients 15 % low to 5 % high; the loop withstands it if the peak of "
                    "|wT| is below 1. Lag and delay of the air-flow sensor are swept over "
                    "{lag_low:.0f} to {lag_high:.0f} and {delay_low:.0f} to {delay_high:.0f}, "
                    "because delay turns the phase of the imbalance modes.",
                    lag_low=Number(1e3 * MAF_TIME_CONSTANTS[0], "ms"),
                    lag_high=Number(1e3 * MAF_TIME_CONSTANTS[-1], "ms"),
                    delay_low=Number(1e3 * MAF_DELAYS[0], "ms"),
                    delay_high=Number(1e3 * MAF_DELAYS[-1], "ms"),
                ),
                _verdict(results),
                *held_texts(tried),
                _speeds(results),
                _figure(context, results, tried),
                _modes(results),
                Heading("Confirmation on the full plant"),
                _confirmation_text(checks),
                _confirmation(checks),
                *growth_table(grown),
            ],
            numbers=numbers,
        )


def _verdict(results: list[RobustnessResult]) -> Text:
    broken = [r for r in results if not r.robustly_stable]
    if not broken:
        return Text("Verdict: robustly stable at every speed.")
    reasons = []
    for r in broken:
        radius, lag, delay = r.worst
        at = f"at {r.speed_rpm:.0f} rpm"
        if not r.stable:
            reasons.append(f"{at} the nominal loop is unstable")
        elif not r.withstands_gain_error:
            reasons.append(f"{at} the gain error is not withstood")
        else:
            reasons.append(
                f"{at} the spectral radius reaches {radius:.3f} with a sensor lag of "
                f"{1e3 * lag:.0f} ms and a delay of {1e3 * delay:.1f} ms"
            )
    return Text("Verdict: not robustly stable at every speed; {why}.", why="; ".join(reasons))


def _speeds(results: list[RobustnessResult]) -> Table:
    rows: list[list[Cell]] = [
        [
            r.speed_rpm,
            1e6 * r.demand,
            r.stable,
            r.gain_margin,
            r.disk_margin,
            r.sensitivity_peak,
            100.0 * r.sensitivity_error,
            r.small_gain,
            r.withstands_gain_error,
            r.worst[0],
            r.withstands_sensor,
            1e3 * r.delay_limit,
        ]
        for r in results
    ]
    return Table(
        "speeds",
        Text(
            "The loop per speed: smallest margins of any mode with the nominal sensor, gain error, "
            "sensor sweep, and the delay at which the loop breaks (∞: above the range sought)."
        ),
        [
            Column("speed", "rpm", ".0f"),
            Column("charge", "mg", ".0f"),
            Column("nominal", words=_STABLE),
            Column("gain margin", "ratio", ".1f"),
            Column("disk margin", "1", ".2f"),
            Column("peak |S|", "1", ".2f"),
            Column("gain error", "%", ".0f"),
            Column("peak |wT|", "1", ".2f"),
            Column("gain error", words=_WITHSTOOD),
            Column("worst radius", "per cycle", ".3f"),
            Column("sensor range", words=_WITHSTOOD),
            Column("delay limit", "ms", ".1f"),
        ],
        rows,
    )


def _modes(results: list[RobustnessResult]) -> Table:
    return Table(
        "modes",
        Text("The modes of the nominal loop. A held mode is not adapted: it has no pole to move."),
        [
            Column("speed", "rpm", ".0f"),
            Column("mode"),
            Column("spectral radius", "per cycle", ".3f"),
            Column("verdict", words=_STABLE),
            Column("gain margin", "ratio", ".1f"),
            Column("phase margin", "deg", ".0f"),
            Column("disk margin", "1", ".2f"),
            Column("peak |S|", "1", ".2f"),
            Column("peak |wT|", "1", ".2f"),
        ],
        [
            [
                result.speed_rpm,
                mode.name,
                None if mode.held else mode.spectral_radius,
                "held" if mode.held else mode.margins.stable,
                mode.margins.gain_margin,
                mode.margins.phase_margin_deg,
                mode.margins.disk_margin,
                mode.margins.sensitivity_peak,
                mode.small_gain,
            ]
            for result in results
            for mode in result.modes
        ],
    )


def _figure(
    context: Context, results: list[RobustnessResult], trials: list[RobustnessResult]
) -> Figure:
    from ..figures import one_legend, side_by_side

    adapting = [r for r in results if r.gains.imbalance > 0.0] or results
    shown = [(adapting[-1], f"{adapting[-1].speed_rpm:.0f} rpm")]
    if trials:
        shown.append((trials[-1], f"{trials[-1].speed_rpm:.0f} rpm, if imbalance were adapted"))
    else:
        shown.insert(0, (adapting[0], f"{adapting[0].speed_rpm:.0f} rpm"))
    figure, row = side_by_side(len(shown))
    for ax, (result, title) in zip(row, shown, strict=True):
        result.plot(ax)
        ax.set_title(title, loc="left")
    one_legend(figure, 5)
    return Figure(
        "delay",
        Text(
            "Spectral radius of each mode against the delay of the air-flow sensor, at the "
            "shortest (dotted), the nominal and the longest lag (dashed). With the nominal lag the "
            "loops break at {breaks}: the alternating mode first, never the mean."
            if all(r.delay_limit_mode for r, _ in shown)
            else "Spectral radius of each mode against the delay of the air-flow sensor, at the "
            "shortest (dotted), the nominal and the longest lag (dashed). With the nominal lag the "
            "loops break at {breaks}.",
            breaks=" and ".join(f"{_limit(r)} ({title})" for r, title in shown),
        ),
        "Spectral radius of the mean mode and the imbalance modes against sensor delay at two "
        "speeds, with the stability limit at one and the assumed range of delay shaded.",
        context.draw(figure),
    )


def _limit(result: RobustnessResult) -> str:
    if math.isinf(result.delay_limit):
        return "no delay in the range"
    return f"{1e3 * result.delay_limit:.1f} ms"


def _confirmation_text(checks: list[PlantCheck]) -> Text:
    agree = sum(check.agrees for check in checks)
    return Text(
        "{count:.0f} full plants were drawn at random (flow factor of each cylinder, lag, delay "
        "and gain of the sensor), runner and actuator oscillation on, and run in closed loop. For "
        "{agree:.0f} of them the outcome is the predicted one.",
        count=Number(len(checks)),
        agree=Number(agree),
    )


def _confirmation(checks: list[PlantCheck]) -> Table:
    return Table(
        "confirmation",
        Text("Sampled full plants in closed loop: predicted spectral radius and what happened."),
        [
            Column("speed", "rpm", ".0f"),
            Column("weakest cylinder", "1", ".2f"),
            Column("lag", "ms", ".1f"),
            Column("delay", "ms", ".2f"),
            Column("predicted radius", "per cycle", ".3f"),
            Column("remaining drift", "%", ".2f"),
            Column("outcome", words=("settled", "not settled")),
            Column("prediction", words=("agrees", "disagrees")),
        ],
        [
            [
                check.speed_rpm,
                min(check.flow_factors),
                1e3 * check.time_constant,
                1e3 * check.delay,
                check.predicted_radius,
                100.0 * check.drift,
                check.settled,
                check.agrees,
            ]
            for check in checks
        ],
    )
