"""Chapter: what the loop withstands of its structured uncertainty, confirmed on full plants."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from camless_ctrl.assessment import assess_structured
from camless_ctrl.delay_boundary import delay_boundary
from camless_ctrl.feedforward import Feedforward
from camless_ctrl.gain_synthesis import design_schedule
from camless_ctrl.law_comparison import LawComparison, compare_laws, standard_laws
from camless_ctrl.robust_analysis import RobustAnalysis, analyse_robustness
from camless_ctrl.synthesis import SynthesisError
from camless_ctrl.tightness import TightnessCheck
from plant import CrankAnglePlant

from ..chapter import Context
from ..content import Block, Cell, ChapterResult, Column, Figure, Heading, Number, Table, Text
from .maps import mean_value_plant

COMPARED_RPM = 1500.0  # speed at which the laws are compared


class StructuredRobustnessChapter:
    """Structured singular value, worst case, confirmation, and the laws that could be used."""

    id = "structured-robustness"
    title = "Structured robustness, confirmed on the full plant"
    concludes = False

    def compute(self, context: Context) -> ChapterResult:
        """Analyse the loop at all speeds, confirm it, and compare laws."""
        maps = mean_value_plant(context)
        found = context.shared(
            "structured",
            lambda: analyse_robustness(maps, engine=context.engine, seed=context.seed),
        )
        boundary = delay_boundary(
            Feedforward(maps, valvetrain=context.engine.valvetrain),
            plant=CrankAnglePlant(context.engine, oscillation=True),
        )
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
        tight = [s.tightness for s in found.speeds if s.tightness is not None]
        return ChapterResult(
            finding=Text(
                "At {robust_speeds:.0f} of {speeds:.0f} speeds it is proved that nothing in the "
                "linear description of the assumed set amplifies an error more than twice; the "
                "smallest margin is {margin:.2f} times the set, at {margin_speed:.0f}. Of "
                "{plants:.0f} sampled full plants in closed loop {plant_violations:.0f} are "
                "unstable or beyond the bound of their speed.",
                **numbers,
            ),
            blocks=[
                Text(
                    "What the estimator sees of a correction is taken from sampled full plants, "
                    "each settled as its own adaptation would settle it. Temperature, flow "
                    "coefficient, lag and delay of the air-flow sensor are real parameters with a "
                    "direction of their own; what is left of all samples is a complex remainder, "
                    "sized to cover a claimed share of the set, which fresh plants check. "
                    "The structured singular value (mu) tells how many times that set is "
                    "withstood; its upper bound is proved between the frequencies too, its lower "
                    "bound comes with the perturbation that destabilises. Performance asks that "
                    "no disturbance of the charge is amplified more than twice."
                ),
                _verdicts(found),
                _mu_figure(context, found),
                _step_figure(context, found),
                _margins(found),
                Heading("Confirmed on the full plant"),
                _sound(found, numbers),
                _sound_figure(context, found),
                *_tight(context, tight),
                Heading("Where delay breaks the imbalance modes"),
                Figure(
                    "delay-boundary",
                    Text(
                        "Delay of the air-flow sensor up to which the imbalance modes are stable, "
                        "were they adapted at every speed, with event averages and with samples "
                        "inside the event; {agreeing:.0f} of {runs:.0f} runs of the full plant on "
                        "either side of the limits come out as predicted. Inside the event the "
                        "modes bear several times more delay.",
                        agreeing=Number(boundary.agreeing),
                        runs=Number(len(boundary.runs)),
                    ),
                    "Largest sensor delay against speed for modes q = 1 and q = 2, predicted lines "
                    "and simulated marks, for two estimators.",
                    context.draw(boundary.plot()),
                ),
                Heading("Other laws"),
                *_other_laws(context, found),
            ],
            numbers=numbers,
            requirements=assess_structured(found),
        )


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


def _margins(found: RobustAnalysis) -> Table:
    rows: list[list[Cell]] = []
    for s in found.speeds:
        m = s.margins
        one = min((c.alpha for c in m.one_at_a_time), default=float("nan"))
        delay = m.delay.sensor_delay
        rows.append(
            [
                s.speed_rpm,
                *(s.gang.peak(f).value for f in ("S", "T", "CS", "PS")),
                one,
                m.all_loops.alpha,
                1e3 * delay if np.isfinite(delay) else None,
            ]
        )
    return Table(
        "structured-margins",
        Text(
            "The nominal loop: peaks of the gang of four over all modes, disk margin of one "
            "cylinder at a time and of all at once, and the delay of the air-flow sensor at which "
            "it breaks (none: not up to 20 ms)."
        ),
        [
            Column("speed", "rpm", ".0f"),
            Column("|S|", "1", ".2f"),
            Column("|T|", "1", ".2f"),
            Column("|CS|", "1", ".2f"),
            Column("|PS|", "1", ".2f"),
            Column("disk, one cylinder", "1", ".2f"),
            Column("disk, all cylinders", "1", ".2f"),
            Column("delay limit", "ms", ".1f"),
        ],
        rows,
    )


def _sound(found: RobustAnalysis, numbers: dict[str, Number]) -> Text:
    return Text(
        "Sound: {members:.0f} linear members of the sets, half of them at corners, and "
        "{plants:.0f} full plants drawn from the whole set run in closed loop from their own "
        "equilibrium. {member_violations:.0f} and {plant_violations:.0f} are unstable or amplify "
        "an error more than was proved at their speed.",
        **{
            name: numbers[name]
            for name in ("members", "plants", "member_violations", "plant_violations")
        },
    )


def _sound_figure(context: Context, found: RobustAnalysis) -> Figure:
    if found.plants is None:
        raise ValueError("the analysis was not confirmed")
    growth = max(s.worst_growth for s in found.plants.runs)
    return Figure(
        "structured-sound",
        Text(
            "Growth per cycle of a small disturbance on the sampled full plants against the radius "
            "that the description predicts for their parameters; the slowest decays with "
            "{growth:.2f} per cycle.",
            growth=Number(growth),
        ),
        "Growth on the full plant against predicted spectral radius, one mark a plant.",
        context.draw(found.plants.plot()),
    )


def _tight(context: Context, checks: list[TightnessCheck]) -> list[Block]:
    if not checks:
        return []
    rows: list[list[Cell]] = [
        [t.speed_rpm, t.gain_factor, t.predicted, t.simulated, t.ratio, bool(t.tight)]
        for t in checks
    ]
    return [
        Table(
            "structured-tight",
            Text(
                "Tight: with gains raised until the worst corner of the parameters breaks within "
                "reach, the full plant is driven along the predicted worst direction until its "
                "closed loop loses stability. Distances are multiples of the assumed bounds, "
                "without the remainder, which no plant can be given."
            ),
            [
                Column("speed", "rpm", ".0f"),
                Column("gains x", "1", ".2f"),
                Column("predicted", "sets", ".3f"),
                Column("full plant", "sets", ".3f"),
                Column("ratio", "1", ".3f"),
                Column("within 25 %", words=("yes", "no")),
            ],
            rows,
        ),
        Figure(
            "structured-tight-growth",
            Text(
                "Growth per cycle of the modes along the worst direction at {tight_speed:.0f}: "
                "lines as predicted, marks on the full plant.",
                tight_speed=Number(checks[0].speed_rpm, "rpm"),
            ),
            "Growth per cycle against distance along the worst direction.",
            context.draw(checks[0].plot()),
        ),
    ]


def _other_laws(context: Context, found: RobustAnalysis) -> list[Block]:
    """Designed gains, and the laws compared; or why there is none."""
    compared = [m for m in found.measurements if m.speed_rpm == COMPARED_RPM]
    measurement = compared[0] if compared else found.measurements[0]
    try:
        design = design_schedule(found.measurements, confirm=False)
        laws = compare_laws(measurement, standard_laws(measurement), worst_case=False)
    except SynthesisError as error:
        return [Text("No other law was found: {reason}", reason=str(error))]
    return [
        Figure(
            "designed-gains",
            Text(
                "Fastest gains with robust performance at each speed, beside those in use. Those "
                "in use are lower on purpose: noise of the estimate grows with the gain. Where "
                "the measurement of an imbalance mode vanishes for an engine of the set, no gain "
                "is robust and the differences are held."
            ),
            "Gains of mean and imbalance against speed, designed and in use.",
            context.draw(design.plot()),
        ),
        _laws(laws),
        Figure(
            "laws",
            Text(
                "Sensitivity of the four laws at {laws_speed:.0f}, in the middle of the set and at "
                "its worst.",
                laws_speed=Number(measurement.speed_rpm, "rpm"),
            ),
            "Size of the sensitivity function over the angle per event for each law.",
            context.draw(laws.plot()),
        ),
    ]


def _laws(laws: LawComparison) -> Table:
    rows: list[list[Cell]] = [
        [
            law.name,
            float(law.order),
            law.robust,
            law.mu_performance if np.isfinite(law.mu_performance) else None,
            law.peak,
            law.worst_peak if np.isfinite(law.worst_peak) else None,
            law.disk_margin,
            law.noise,
            _slowest(law.settling_cycles, law.held),
            _slowest(law.worst_settling_cycles, law.held),
        ]
        for law in laws.laws
    ]
    return Table(
        "laws-table",
        Text(
            "Laws at {table_speed:.0f}: the adaptation with the gains in use and with designed "
            "ones, an H-infinity and a D-K law (orders reduced). Mu and the worst case are exact "
            "on a fine grid of angles, not proved between them. Noise is the standard deviation "
            "of the correction for white noise of the estimate; settling is to 2 % of the slowest "
            "adapted mode, in the middle of the set and at the slowest corner.",
            table_speed=Number(laws.measurement.speed_rpm, "rpm"),
        ),
        [
            Column("law"),
            Column("order", "1", ".0f"),
            Column("mu below 1", words=("yes", "no")),
            Column("mu performance", "1", ".3f"),
            Column("|S| middle", "1", ".2f"),
            Column("|S| worst", "1", ".2f"),
            Column("disk margin", "1", ".2f"),
            Column("noise", "1", ".2f"),
            Column("settling", "cycles", ".1f"),
            Column("settling, slowest", "cycles", ".1f"),
        ],
        rows,
    )


def _slowest(cycles: Sequence[float], held: Sequence[bool]) -> float | None:
    """Slowest mode of those that are adapted; None if it never settles."""
    found = max(c for c, kept in zip(cycles, held, strict=True) if not kept)
    return found if np.isfinite(found) else None
