"""Chapter: what the controller's loop withstands of its uncertainty, confirmed on full plants."""

from __future__ import annotations

import numpy as np

from camless_ctrl.assessment import assess_robustness, assess_structured
from camless_ctrl.delay_boundary import delay_boundary
from camless_ctrl.feedforward import Feedforward
from camless_ctrl.loop_verdict import LoopVerdict, loop_verdicts
from camless_ctrl.robust_analysis import RobustAnalysis, analyse_robustness
from plant import CrankAnglePlant

from ..chapter import Context
from ..content import Block, Cell, ChapterResult, Column, Figure, Heading, Number, Table, Text
from .feedforward import controller_design
from .maps import mean_value_plant
from .other_laws import other_laws
from .structured_confirmation import sound, sound_figure, tight

PLANTS = 4  # full plants at each speed; `camless analyse` runs twenty
COMPARED_RPM = 1500.0  # speed at which the laws are compared


class StructuredRobustnessChapter:
    """Structured singular value, worst case, confirmation, and the laws that could be used."""

    id = "structured-robustness"
    title = "Robustness of the controller, confirmed on the full plant"
    concludes = False

    def compute(self, context: Context) -> ChapterResult:
        """Analyse the designed controller at all speeds, confirm it, and compare laws."""
        found = context.shared(
            "structured",
            lambda: analyse_robustness(
                controller_design(context), samples=PLANTS, seed=context.seed
            ),
        )
        verdicts = loop_verdicts(found)
        robust = [s for s in found.speeds if s.structured.robust_performance]
        worst = max(found.speeds, key=lambda s: s.structured.worst_sensitivity[1])
        least = min(found.speeds, key=lambda s: s.structured.margin)
        numbers = {
            "robust_speeds": Number(len(robust)),
            "speeds": Number(len(found.speeds)),
            "margin": Number(least.structured.margin),
            "margin_speed": Number(least.speed_rpm, "rpm"),
            "worst_gain": Number(worst.structured.worst_sensitivity[1]),
            "plants": Number(sum(len(s.plants) for s in found.speeds)),
            "plant_violations": Number(sum(s.plant_violations for s in found.speeds)),
            "members": Number(sum(s.lti.samples for s in found.speeds if s.lti)),
            "member_violations": Number(sum(s.lti.violations for s in found.speeds if s.lti)),
        }
        return ChapterResult(
            finding=Text(
                "At {robust_speeds:.0f} of {speeds:.0f} speeds it is proved that nothing in the "
                "linear description of the assumed set amplifies a charge error more than twice, "
                "all cylinders balanced; the smallest margin is {margin:.2f} times the set, at "
                "{margin_speed:.0f}. Of {plants:.0f} sampled full plants in closed loop "
                "{plant_violations:.0f} are unstable or beyond the bound of their speed.",
                **numbers,
            ),
            blocks=[
                Text(
                    "This is the loop of the controller itself: motions of least pumping loss, "
                    "the Kalman filter on the samples of air flow and manifold pressure inside "
                    "the event, which learns lag and delay of the air-flow sensor, and the "
                    "adaptation law. Once it has converged, the law is an integral correction "
                    "with small gains, one for the mean and one for the differences, adapted at "
                    "every speed. The filter has no closed form: full plants are shown to it, "
                    "and its response to a changed motion is what the loop is made of."
                ),
                _gains_text(found),
                Text(
                    "That is done for plants sampled from the whole set, each settled as its own "
                    "adaptation would settle it. Temperature, flow coefficient, lag and delay of "
                    "the air-flow sensor are real parameters with a direction of their own; what "
                    "is left of all samples, offset and lag of the pressure sensor included, is a "
                    "complex remainder, sized to cover a claimed share of the set, which fresh "
                    "plants check. The structured singular value (mu) tells how many times that "
                    "set is withstood; its upper bound is proved between the frequencies too, its "
                    "lower bound comes with the perturbation that destabilises. Performance asks "
                    "that no disturbance of the charge is amplified more than twice."
                ),
                _verdicts(found),
                _mu_figure(context, found),
                _step_figure(context, found),
                _margins(found, verdicts),
                Heading("Confirmed on the full plant"),
                sound(found, numbers),
                sound_figure(context, found),
                *tight(found),
                Heading("Why the estimator looks inside the event"),
                *_delay_boundary(context),
                Heading("Other laws"),
                *other_laws(context, found, COMPARED_RPM),
            ],
            numbers=numbers,
            requirements=[*assess_robustness(verdicts), *assess_structured(found)],
        )


def _gains_text(found: RobustAnalysis) -> Text:
    beyond = max(found.speeds, key=lambda s: s.measurement.beyond_reach)
    gains = [found.schedule.at(s.speed_rpm) for s in found.speeds]
    told = {
        "mean_low": Number(min(g.mean for g in gains)),
        "mean_high": Number(max(g.mean for g in gains)),
        "differences_low": Number(min(g.imbalance for g in gains)),
        "differences_high": Number(max(g.imbalance for g in gains)),
    }
    return Text(
        "The gains per cycle follow from the law's covariances at rest: {mean_low:.3f} to "
        "{mean_high:.3f} for the mean, {differences_low:.3f} to {differences_high:.3f} for the "
        "differences. At the start, when little is known, they are larger. With the valve wide "
        "open the charge hardly follows the flow: at {beyond_speed:.0f} {beyond:.0f} sampled "
        "plants, the most of all speeds, would need a flow gain beyond the law's bounds. The "
        "charge factor that all cylinders share makes up for that, since the sampled cylinders "
        "are alike.",
        beyond=Number(beyond.measurement.beyond_reach),
        beyond_speed=Number(beyond.speed_rpm, "rpm"),
        **told,
    )


def _delay_boundary(context: Context) -> list[Block]:
    boundary = delay_boundary(
        Feedforward(mean_value_plant(context), valvetrain=context.engine.valvetrain),
        plant=CrankAnglePlant(context.engine, oscillation=True),
    )
    return [
        Text(
            "This section is not about the controller's loop. It shows, on two simple estimators "
            "that do not learn the sensor and are known in closed form, why averages over events "
            "do not do: delay and lag of the air-flow sensor carry the share of one cylinder into "
            "the next event's average, until the alternating mode is seen with the wrong sign. "
            "Samples inside the event bear several times more delay; the filter bears the rest by "
            "learning it, and by the manifold pressure."
        ),
        Figure(
            "delay-boundary",
            Text(
                "Simple estimators: delay of the air-flow sensor up to which the imbalance modes "
                "are stable, were they adapted at every speed, with event averages and with "
                "samples inside the event; {agreeing:.0f} of {runs:.0f} runs of the full plant on "
                "either side of the limits come out as predicted.",
                agreeing=Number(boundary.agreeing),
                runs=Number(len(boundary.runs)),
            ),
            "Largest sensor delay against speed for modes q = 1 and q = 2, predicted lines and "
            "simulated marks, for two estimators.",
            context.draw(boundary.plot()),
        ),
    ]


def _verdicts(found: RobustAnalysis) -> Table:
    rows: list[list[Cell]] = []
    for s in found.speeds:
        r = s.structured
        rs, rp = r.stability, r.performance
        rows.append(
            [
                s.speed_rpm,
                r.robust_performance,
                r.margin,
                rs.peak_lower if rs else None,
                rs.peak_upper if rs else None,
                rp.peak_upper if rp else None,
                r.nominal_peak,
                r.worst_sensitivity[1] if np.isfinite(r.worst_sensitivity[1]) else None,
                "none" if r.breaking_mode is None else f"q={r.breaking_mode}",
                ", ".join(
                    f"{name} {1e3 * value:.1f} ms" if "MAF" in name else f"{name} x {value:.2f}"
                    for name, value in r.breaking_values.items()
                ),
            ]
        )
    return Table(
        "structured-verdicts",
        Text(
            "Structured robustness: set that is withstood, mu for stability (both bounds) and for "
            "performance, largest sensitivity in the middle of the set and in the worst case, and "
            "where it breaks first (parameters there may lie outside of what a sensor can be)."
        ),
        [
            Column("speed", "rpm", ".0f"),
            Column("robust", words=("yes", "no")),
            Column("withstood", "sets", ".2f"),
            Column("mu lower", "1", ".3f"),
            Column("mu upper", "1", ".3f"),
            Column("mu performance", "1", ".3f"),
            Column("|S| middle", "1", ".2f"),
            Column("|S| worst", "1", ".2f"),
            Column("breaks in"),
            Column("towards"),
        ],
        rows,
    )


def _mu_figure(context: Context, found: RobustAnalysis) -> Figure:
    import matplotlib.pyplot as plt

    from plant._plotting import styled

    with styled():
        figure, row = plt.subplots(1, len(found.speeds), figsize=(11.0, 2.9), sharey=True)
        for k, (ax, s) in enumerate(zip(np.atleast_1d(row), found.speeds, strict=True)):
            s.structured.plot(ax)
            legend = ax.get_legend()
            if legend is not None:
                legend.remove()
            ax.set_xlabel("angle per event (deg)")
            if k:
                ax.set_ylabel("")
        handles, labels = np.atleast_1d(row)[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=3)
    return Figure(
        "structured-mu",
        Text(
            "Structured singular value over the frequencies of an event, which hold all modes: the "
            "mean at 0, the imbalances where the grey lines are. Below 1 the whole set is "
            "withstood. Stability is weakest at the steady patterns themselves."
        ),
        "Upper bounds of mu for stability and performance against angle per event, one panel a "
        "speed.",
        context.draw(figure),
    )


def _step_figure(context: Context, found: RobustAnalysis) -> Figure:
    s = min(found.speeds, key=lambda s: abs(s.speed_rpm - COMPARED_RPM))
    return Figure(
        "structured-step",
        Text(
            "Charge error after a step of all cylinders' charge at {step_speed:.0f}, in the middle "
            "of the set and with the perturbation of the largest sensitivity.",
            step_speed=Number(s.speed_rpm, "rpm"),
        ),
        "Charge error against cycles after a step, nominal and worst case.",
        context.draw(s.structured.plot_step()),
    )


def _margins(found: RobustAnalysis, verdicts: list[LoopVerdict]) -> Table:
    rows: list[list[Cell]] = []
    for s, v in zip(found.speeds, verdicts, strict=True):
        m = s.margins
        rows.append(
            [
                s.speed_rpm,
                v.gains.mean,
                v.gains.imbalance,
                max(mode.spectral_radius for mode in v.modes),
                v.worst[0],
                *(s.gang.peak(f).value for f in ("S", "T", "CS", "PS")),
                v.gain_margin,
                min((c.alpha for c in m.one_at_a_time), default=float("nan")),
                m.all_loops.alpha,
                v.small_gain,
            ]
        )
    return Table(
        "structured-margins",
        Text(
            "The loop of the nominal plant: gains per cycle with which the converged law moves "
            "mean and differences, largest pole radius per cycle (nominal, and at the worst corner "
            "of the set), peaks of the gang of four over all modes, gain margin, disk margin of "
            "one cylinder at a time and of all at once; and |wT| with the whole set taken as one "
            "complex number, which mu refines."
        ),
        [
            Column("speed", "rpm", ".0f"),
            Column("gain, mean", "per cycle", ".3f"),
            Column("gain, imbalance", "per cycle", ".3f"),
            Column("radius", "per cycle", ".3f"),
            Column("radius, corners", "per cycle", ".3f"),
            Column("|S|", "1", ".2f"),
            Column("|T|", "1", ".2f"),
            Column("|CS|", "1", ".2f"),
            Column("|PS|", "1", ".2f"),
            Column("gain margin", "ratio", ".1f"),
            Column("disk, one cylinder", "1", ".2f"),
            Column("disk, all cylinders", "1", ".2f"),
            Column("|wT|", "1", ".2f"),
        ],
        rows,
    )
