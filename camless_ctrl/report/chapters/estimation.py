"""Chapter: the charge estimator against the true charges of the full plant."""

from __future__ import annotations

from camless_ctrl.assessment import assess_estimation
from camless_ctrl.estimation_check import EstimationCheck, EstimationPoint, check_estimator
from camless_ctrl.kalman_estimator import KalmanEstimator
from plant import CrankAnglePlant, Engine
from plant.sensors import MAF_GAIN_TOLERANCE, MafSensor, SensorSet

from ..chapter import Context
from ..content import Cell, ChapterResult, Column, Figure, Number, Table, Text

POINTS = (
    EstimationPoint(750.0, 8.0, 100.0),
    EstimationPoint(1500.0, 8.0, 120.0),
    EstimationPoint(3000.0, 8.0, 140.0),
    EstimationPoint(4500.0, 8.0, 170.0),
    EstimationPoint(6000.0, 8.0, 190.0),
)
OTHER_CYLINDERS = (3, 6)
WEAK = 0.85  # true over nominal flow coefficient of the second cylinder


class EstimationChapter:
    """Estimates from 750 to 6000 rpm, for several numbers of cylinders."""

    id = "estimation"
    title = "The charge estimator"
    concludes = False

    def compute(self, context: Context) -> ChapterResult:
        """Run the estimator beside the full plant."""
        numbers_of = dict.fromkeys((context.engine.n_cylinders, *OTHER_CYLINDERS))
        found = EstimationCheck(
            tuple(r for n in numbers_of for r in _check(context, n, 0.0).results)
        )
        off = _check(context, context.engine.n_cylinders, MAF_GAIN_TOLERANCE)
        own = [r for r in found.results if r.n_cylinders == context.engine.n_cylinders]
        slow, fast = own[1], own[-1]
        numbers = {
            "cylinder": Number(100.0 * found.worst_cylinder_error, "%"),
            "slow": Number(100.0 * slow.spread, "%"),
            "fast": Number(100.0 * fast.spread, "%"),
            "slow_speed": Number(slow.point.speed_rpm, "rpm"),
            "fast_speed": Number(fast.point.speed_rpm, "rpm"),
            "gain": Number(100.0 * MAF_GAIN_TOLERANCE, "%"),
            "left": Number(100.0 * off.worst_cylinder_error, "%"),
        }
        return ChapterResult(
            finding=Text(
                "The charge of a single event is known to {slow:.2f} (1 sigma) at "
                "{slow_speed:.0f} and to {fast:.2f} at {fast_speed:.0f}; noise averaged out, every "
                "cylinder is within {cylinder:.2f} at all speeds and for all numbers of cylinders.",
                **numbers,
            ),
            blocks=[
                Text(
                    "An extended Kalman filter follows the manifold's air balance, the lag and "
                    "the delay of the air-flow sensor and the overlap of the cylinders through "
                    "one event, and takes in every sample of air flow and manifold pressure "
                    "inside it. At low speed the air flow tells the charges apart, at high speed "
                    "the dips of the manifold pressure do: the pressure sensor is fifteen times "
                    "as fast. The absolute level comes from the air flow alone. Here the full "
                    "plant is driven with charges that vary from event to event and step by a "
                    "quarter, with one weak cylinder ({weak:.0f} of the flow), and the filter is "
                    "told predictions that are off.",
                    weak=Number(100.0 * WEAK, "%"),
                ),
                _table(found),
                Figure(
                    "errors",
                    Text(
                        "Error of single events against what the filter itself believes, and the "
                        "mean error of each cylinder."
                    ),
                    "Errors in percent over engine speed, for several numbers of cylinders.",
                    context.draw(found.plot()),
                ),
                Text(
                    "A gain error of the air-flow sensor is the one thing that no estimator could "
                    "see: with {gain:.0f} all charges are estimated, and so delivered, wrong by "
                    "it. What is left beside it is at most {left:.2f} of a cylinder's mean.",
                    gain=numbers["gain"],
                    left=numbers["left"],
                ),
            ],
            numbers=numbers,
            requirements=assess_estimation(found),
        )


def _check(context: Context, n: int, gain_error: float) -> EstimationCheck:
    base = context.engine
    if n != base.n_cylinders:
        base = base.replace(n_cylinders=n, cylinder_flow_factors=())
    plant = CrankAnglePlant(_weak(base), runner=True, oscillation=True)
    return check_estimator(
        KalmanEstimator.of(base),
        plant,
        POINTS,
        sensors=SensorSet(maf=MafSensor(gain_error=gain_error)),
        seed=context.seed,
    )


def _weak(engine: Engine) -> Engine:
    factors = [1.0] * engine.n_cylinders
    factors[1 % engine.n_cylinders] = WEAK
    return engine.replace(cylinder_flow_factors=tuple(factors))


def _table(found: EstimationCheck) -> Table:
    rows: list[list[Cell]] = [
        [
            r.n_cylinders,
            r.point.speed_rpm,
            1e6 * float(r.charge.mean()),
            100.0 * r.bias,
            100.0 * r.spread,
            100.0 * r.sigma,
            r.consistency,
            r.innovation_ratio,
            100.0 * float(abs(r.cylinder_errors).max()),
            r.missing,
        ]
        for r in found.results
    ]
    return Table(
        "estimates",
        Text(
            "Estimated over true charge less 1, of the smoothed estimates. The ratio is the spread "
            "of the error over the filter's own standard deviation; the innovation is the mean "
            "normalised one, 1 for an honest filter."
        ),
        [
            Column("cylinders", "", ".0f"),
            Column("speed", "rpm", ".0f"),
            Column("charge", "mg", ".0f"),
            Column("bias", "%", "+.2f"),
            Column("one event", "%", ".2f"),
            Column("by the filter", "%", ".2f"),
            Column("ratio", "", ".2f"),
            Column("innovation", "", ".2f"),
            Column("worst cylinder", "%", ".2f"),
            Column("without estimate", "", ".0f"),
        ],
        rows,
    )
