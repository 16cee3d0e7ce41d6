"""From a correction to what the estimator sees of it, with everything that is uncertain in it.

The response per event of the estimate to a correction is taken from full plants, each where its
own adaptation settles: the estimate, not the charge, meets the demand. A few real parameters
act along directions of their own, and what is left of all samples is a complex weight,

    E(z) = E_c(z) + sum_k d_k H_k(z) + W(z) D,    -1 <= d_k <= 1 real, |D| <= 1 complex,

with ``d_k`` the parameter between its bounds. So the remainder of the linearisation in the
parameters, and all parameters that have no direction, are in the weight.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from plant import CrankAnglePlant, ParameterError, PulseResponse
from plant._checks import positive, whole
from plant.air_path import ComplexArray
from plant.kinematics import FloatArray
from plant.sensors import MapSensor
from uncertainty.coverage import FreshCheck, bound_from_scores, check_fresh, samples_needed
from uncertainty.parameters import UncertainParameter, UncertaintySet
from uncertainty.quantification import default_set
from uncertainty.sampling import Sample, draw, nominal_sample, one_at_a_time
from uncertainty.weight_result import OverboundingWeight
from uncertainty.weights import fit_weight

from ._sampled_estimates import TRIMMED, WindowLoops
from ._sampled_loops import ModelLoops, SampledLoops
from .controller_parts import ChargeModel, Estimator
from .estimator import ChargeEstimator
from .estimator_response import LatentEstimator
from .feedforward import Feedforward
from .linearise import LocalResponse
from .pulse_bank import PulseSum

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# A gain error of the sensor is not in the loop gain. What is left of it is that the plant settles
# at another charge, where the slopes differ a little: no direction of its own is worth that.
MODELLED = ("temperature", "flow coefficient", "MAF time constant", "MAF delay")
_POINTS = 97  # frequencies from 0 to the Nyquist frequency of an event
_FINER = 4

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class UncertainMeasurement:
    """Response of the estimate to a correction at one speed, with its uncertainty.

    Attributes
    ----------
    local : LocalResponse
        Nominal full plant at the operating point.
    demand : float
        Charge that the estimate of every plant meets at rest, kg.
    estimator : LatentEstimator
        The estimator: `ChargeEstimator`, or an `AnalysedEstimator` of the controller's.
    uncertain : UncertaintySet
        What varies.
    nominal : PulseSum
        Response of the nominal plant and sensor.
    centre : PulseSum
        ``E_c``, the middle of the parameters' ranges.
    directions : dict of str to PulseSum
        ``H_k`` of each modelled parameter.
    weight : OverboundingWeight
        ``W`` per event.
    coverage : FreshCheck or None
        Share of the set that the description covers, claimed and checked.
    beyond_reach : int
        Plants, of all that were followed, that meet the demand only with a duration (or a flow
        gain, for a charge model) beyond the controller's. They are described as if the map went
        on with the slope of its end (or a charge factor explained the rest).
    limits : str
        Name of what they would need more of.
    """

    local: LocalResponse = field(repr=False)
    demand: float
    estimator: LatentEstimator
    uncertain: UncertaintySet = field(repr=False)
    nominal: PulseSum = field(repr=False)
    centre: PulseSum = field(repr=False)
    directions: Mapping[str, PulseSum] = field(repr=False)
    weight: OverboundingWeight = field(repr=False)
    coverage: FreshCheck | None = None
    beyond_reach: int = 0
    limits: str = "duration"

    @property
    def speed_rpm(self) -> float:
        """Speed."""
        return self.local.speed_rpm

    @property
    def n_cylinders(self) -> int:
        """Number of cylinders."""
        return self.local.n_cylinders

    @property
    def event_time(self) -> float:
        """Event time, s."""
        return self.centre.event_time

    @property
    def latency(self) -> int:
        """Events from an IVO to the first one at which its estimate is used."""
        return self.estimator.latency_events(self.event_time)

    def deltas(self, values: Mapping[str, float]) -> dict[str, float]:
        """Normalised values of the modelled parameters; nominal where none is given."""
        found = {}
        for name in self.directions:
            p = self.uncertain[name]
            value = values.get(name, p.nominal)
            found[name] = (2.0 * value - p.low - p.high) / (p.high - p.low)
        return found

    def values(self, deltas: Mapping[str, float]) -> dict[str, float]:
        """Values of the modelled parameters from normalised ones; may lie beyond their bounds."""
        found = {}
        for name, delta in deltas.items():
            p = self.uncertain[name]
            found[name] = 0.5 * (p.low + p.high) + 0.5 * delta * (p.high - p.low)
        return found

    def response(self, z: ArrayLike, deltas: Mapping[str, float] | None = None) -> ComplexArray:
        """Response at points `z` per event for normalised parameters (the middle by default)."""
        found = self.centre(z)
        for name, delta in (deltas or {}).items():
            found = found + delta * self.directions[name](z)
        return np.asarray(found)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the sizes of the directions and of the weight over the angle per event."""
        from plant._plotting import COLOURS, axes, styled

        angle = np.linspace(0.0, np.pi, 181)
        z = np.exp(1j * angle)
        styles = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)))
        with styled():
            ax = axes(ax)
            for k, (name, direction) in enumerate(self.directions.items()):
                ax.plot(
                    np.degrees(angle),
                    np.abs(direction(z)),
                    ls=styles[k % len(styles)],
                    c=COLOURS[k % len(COLOURS)],
                    label=name,
                )
            magnitude = self.weight.magnitude(angle / self.event_time)
            ax.plot(np.degrees(angle), magnitude, c="0.2", lw=2.4, label="all else (complex)")
            ax.set_xlim(0.0, 180.0)
            ax.set_xticks(
                np.degrees(2.0 * np.pi * np.arange(self.n_cylinders // 2 + 1) / self.n_cylinders)
            )
            ax.set_ylim(bottom=0.0)
            ax.set_xlabel("angle per event (deg)")
            ax.set_ylabel("change of the estimate (1)")
            ax.set_title(f"Uncertainty of the measurement at {self.speed_rpm:g} rpm")
            ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        return ax

    def __str__(self) -> str:
        """Return operating point, size of the weight and coverage."""
        size = float(self.weight.magnitude(self.weight.omega).max())
        covered = "" if self.coverage is None else f" {self.coverage}"
        if self.beyond_reach:
            covered += (
                f" {self.beyond_reach} of the plants would need a {self.limits} beyond the "
                "controller's."
            )
        return (
            f"{self.speed_rpm:g} rpm, {1e6 * self.demand:.0f} mg: {len(self.directions)} real "
            f"parameters, and a complex remainder of up to {100.0 * size:.1f} % (order "
            f"{self.weight.order}).{covered}"
        )


def sampled_loops(
    plant: CrankAnglePlant,
    feedforward: Feedforward | ChargeModel,
    demand: float,
    speed_rpm: float,
    estimator: ChargeEstimator | Estimator | None = None,
) -> SampledLoops:
    """Return the loops of sampled plants that a controller of these parts has.

    Parameters
    ----------
    plant, feedforward, demand, speed_rpm, estimator
        As for `uncertain_measurement`.

    Raises
    ------
    ParameterError
        If map and estimator are not parts of one controller.
    """
    if isinstance(feedforward, Feedforward):
        window = ChargeEstimator() if estimator is None else estimator
        if isinstance(window, ChargeEstimator):
            return WindowLoops(plant, feedforward, window, demand, speed_rpm)
    elif estimator is not None and not isinstance(estimator, ChargeEstimator):
        return ModelLoops(plant, feedforward, estimator, demand, speed_rpm)
    raise ParameterError(
        f"the map is a {type(feedforward).__name__} and the estimator a "
        f"{type(estimator).__name__}, but a Feedforward goes with a ChargeEstimator, and a charge "
        "model with an estimator that a controller can use: give both of one kind"
    )


def uncertain_measurement(
    plant: CrankAnglePlant,
    feedforward: Feedforward | ChargeModel,
    demand: float,
    speed_rpm: float,
    *,
    estimator: ChargeEstimator | Estimator | None = None,
    uncertain: UncertaintySet | None = None,
    modelled: tuple[str, ...] = MODELLED,
    share: float = 0.99,
    confidence: float = 0.95,
    design: int = 64,
    fresh: int = 200,
    seed: int = 0,
    progress: Progress | None = None,
) -> UncertainMeasurement:
    """Describe the measurement of sampled full plants at one operating point.

    Parameters
    ----------
    plant : CrankAnglePlant
        Nominal full plant; its cylinders are equal.
    feedforward : Feedforward or ChargeModel
        What the controller believes.
    demand, speed_rpm : float
        Operating point: kg, rpm.
    estimator : ChargeEstimator or Estimator, optional
        The estimator: for a `Feedforward` a `ChargeEstimator`, the default one if not given; for
        a `ChargeModel` that of the controller, such as `KalmanEstimator`.
    uncertain : UncertaintySet, optional
        What is uncertain; by default `uncertainty.default_set`, and for a charge model
        `all_sensors_set`.
    modelled : tuple of str
        Parameters with a direction of their own.
    share, confidence : float
        Claim of the description. They say how many calibration samples are drawn.
    design, fresh : int
        Sobol' points of the design sample, and samples of the check.
    seed : int
        Seed of all samples.
    progress : callable, optional
        Called with the number of plants followed and the number in all.

    Raises
    ------
    ParameterError
        For an unknown parameter or one without a range, or a plant, nominal or sampled, whose
        estimate does not meet the demand with any duration.

    Notes
    -----
    With few design plants, what the other parameters do goes into the directions in part: the
    description covers its share all the same, but a direction then is less that of its name.

    Sensor and estimator are taken as continuous. That the controller reads samples of the flow
    is not in the description; it shows where the air of a correction passes the sensor at the
    edge of a window, as with a long delay at high speed.
    """
    positive("demand", demand, "kg")
    whole("design", design, 2, 100_000)
    whole("fresh", fresh, 1, 10_000_000)
    loops = sampled_loops(plant, feedforward, demand, speed_rpm, estimator)
    if uncertain is None:
        uncertain = default_set() if isinstance(loops, WindowLoops) else all_sensors_set()
    of_model = _modelled(uncertain, modelled)
    seeds = [int(s) for s in np.random.SeedSequence(seed).generate_state(3)]
    local = loops.local
    if abs(local.charge / demand - 1.0) > TRIMMED:
        raise ParameterError(
            f"demand is {1e6 * demand:.0f} mg, but the nominal plant takes in "
            f"{1e6 * local.charge:.0f} mg with {local.command.duration_deg:.0f} deg, the nearest "
            f"duration at {speed_rpm:g} rpm: choose a demand within its reach"
        )

    bounds = one_at_a_time(of_model)
    design_sample = _extended(uncertain, bounds).joined(nominal_sample(uncertain))
    shaped = design_sample.joined(one_at_a_time(uncertain))
    shaped = shaped.joined(draw(uncertain, design, seeds[0], "sobol"))
    calibration = draw(uncertain, samples_needed(share, confidence), seeds[1])
    unseen = draw(uncertain, fresh, seeds[2])
    total = len(shaped) + len(calibration) + len(unseen)
    done = beyond = 0

    def follow(sample: Sample) -> list[PulseResponse]:
        nonlocal done, beyond

        def report(count: int, _: int) -> None:
            if progress is not None:
                progress(done + count, total)

        found, short = loops.follow(sample, report)
        beyond += short
        done += len(sample)
        return found

    found = follow(shaped)
    low, high = found[0 : 2 * len(modelled) : 2], found[1 : 2 * len(modelled) : 2]
    nominal = found[2 * len(modelled)]
    centre, directions = _fitted(uncertain, modelled, shaped, found, basis=[nominal, *low, *high])
    T = centre.event_time

    def left(responses: list[PulseResponse], sample: Sample, omega: FloatArray) -> FloatArray:
        """What the directions leave of each sample (samples, frequencies)."""
        z = np.exp(1j * omega * T)
        columns = np.stack([directions[name](z) for name in modelled])
        middle = centre(z)
        scaled = np.stack([_normalised(uncertain[name], sample.column(name)) for name in modelled])
        each = np.stack([response(z) for response in responses])
        return np.asarray(np.abs(each - middle - scaled.T @ columns))

    weight = fit_weight(
        np.linspace(0.0, np.pi, _POINTS) / T,
        left(found, shaped, np.linspace(0.0, np.pi, _POINTS) / T).max(axis=0),
        dt=T,
        orders=(0, 1, 2),
        floor=0.05,
        finer=lambda omega: left(found, shaped, omega).max(axis=0),
        name=f"remainder at {speed_rpm:g} rpm",
    )
    omega = np.linspace(0.0, np.pi, _FINER * (_POINTS - 1) + 1) / T
    size = weight.magnitude(omega)
    scores = [
        (left(follow(sample), sample, omega) / size).max(axis=1) for sample in (calibration, unseen)
    ]
    bound = bound_from_scores(scores[0], confidence=confidence, share=share)
    factor = max(bound.value, 1.0)
    return UncertainMeasurement(
        local=local,
        demand=float(demand),
        estimator=loops.estimator,
        uncertain=uncertain,
        nominal=PulseSum(((1.0, nominal),)),
        centre=centre,
        directions=directions,
        weight=weight.scaled(factor),
        coverage=check_fresh(replace(bound, value=factor), scores[1]),
        beyond_reach=beyond,
        limits=loops.limits,
    )


def all_sensors_set() -> UncertaintySet:
    """Return all that is uncertain of equal cylinders and of the MAF and the MAP sensor.

    The lag of the MAP sensor is assumed to lie between half and twice its nominal value.
    """
    nominal = MapSensor().time_constant
    lag = UncertainParameter(
        "MAP time constant",
        0.5 * nominal,
        2.0 * nominal,
        nominal,
        ("map.time_constant",),
        relative=False,
        unit="s",
        source="assumed sensor tolerance",
    )
    offset = UncertaintySet.sensors().only(["MAP offset"])
    return default_set() + offset + UncertaintySet((lag,))


def _modelled(uncertain: UncertaintySet, names: tuple[str, ...]) -> UncertaintySet:
    """Return the parameters with a direction after checks."""
    if not names:
        raise ParameterError("no parameter is modelled: name one or more of the set")
    found = uncertain.only(names)
    for p in found:
        if p.low == p.high:
            raise ParameterError(
                f"parameter {p} has no range, and so no direction: leave it out of modelled"
            )
    return found


def _fitted(
    uncertain: UncertaintySet,
    modelled: tuple[str, ...],
    sample: Sample,
    found: list[PulseResponse],
    *,
    basis: list[PulseResponse],
) -> tuple[PulseSum, dict[str, PulseSum]]:
    """Centre and directions of the affine model nearest to the sample, in least squares.

    They are combinations of the nominal response and those with one parameter at a bound.
    """
    z = np.exp(1j * np.linspace(0.0, np.pi, _POINTS))
    functions = np.stack([response(z) for response in basis])  # (basis, f)
    each = np.stack([response(z) for response in found])  # (samples, f)
    factors = np.column_stack(
        [
            np.ones(len(sample)),
            *(_normalised(uncertain[name], sample.column(name)) for name in modelled),
        ]
    )
    # each = factors @ coefficients @ functions, real coefficients: project from both sides.
    stacked = np.hstack((functions.real, functions.imag))
    wanted = np.hstack((each.real, each.imag))
    projection = np.linalg.pinv(stacked, rcond=1e-8)
    coefficients = np.linalg.pinv(factors) @ wanted @ projection
    sums = [PulseSum(tuple(zip(row.tolist(), basis, strict=True))) for row in coefficients]
    return sums[0], dict(zip(modelled, sums[1:], strict=True))


def _extended(uncertain: UncertaintySet, part: Sample) -> Sample:
    """A sample of some parameters as one of the whole set, the others nominal."""
    values = np.tile(uncertain.nominal, (len(part), 1))
    for name in part.uncertain.names:
        values[:, uncertain.names.index(name)] = part.column(name)
    return Sample(uncertain, values)


def _normalised(parameter: UncertainParameter, values: FloatArray) -> FloatArray:
    span = parameter.high - parameter.low
    return (2.0 * values - parameter.low - parameter.high) / span
