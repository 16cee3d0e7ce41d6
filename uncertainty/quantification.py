"""How wrong the mean-value plant is, mode by mode and over frequency, with a guarantee.

Three samples of the uncertainty set, each with a task of its own:

1. The *design* sample (Sobol' points, and each parameter at both bounds) shapes a weight for
   each channel, which over-bounds the residual of every plant in it.
2. The *calibration* sample (independent) sets one factor on all weights, by order statistics:
   a stated share of the set is covered, in all channels at once, with a stated confidence.
3. The *fresh* sample (independent, seen by neither) checks the claim.

Every plant of every sample is the full crank-angle plant. The nominal response is that of the
mean-value plant: the slope of its charge map, seen by the nominal MAF sensor through the flow
shape that the nominal full plant has (the measurement model of the air-charge loop).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from plant import (
    CrankAnglePlant,
    MafSensor,
    MeanValueDynamics,
    MeanValuePlant,
    ParameterError,
    PulseResponse,
    SimulationError,
    ValveCommand,
)
from plant._checks import whole
from plant.air_path import ComplexArray, event_time
from plant.kinematics import FloatArray
from plant.region import OperatingPoint

from ._modes import mode_points
from ._quantities import DEFAULT_POINTS, checked_points, full_plant
from .channels import Channel, ChannelUncertainty, folded_envelope
from .coverage import bound_from_scores, check_fresh, samples_needed
from .disks import smallest_disks
from .frequency import OUTPUTS, Output
from .lifted_mean_value import mean_value_modes
from .parameters import UncertaintySet
from .perturbed import PerturbedPlants
from .pulse_sampling import SampledPulses, sampled_pulses
from .quantification_result import Quantification
from .sampling import Sample, draw, nominal_sample, one_at_a_time
from .weights import fit_weight

PHASES = 41  # cycle phases from -pi to pi
FINER = 8  # parts into which checks and scores cut each interval between them
LIFT = 1e-3  # relative: keeps a bound between the phases that the fit has seen
FLOOR = 0.02  # share of a channel's largest residual below which it need not be tight

Progress = Callable[[int, int], None]


def default_set() -> UncertaintySet:
    """Return all that is uncertain of equal cylinders and of the MAF sensor."""
    maf = [p.name for p in UncertaintySet.sensors() if p.acts_on[0].startswith("maf.")]
    return UncertaintySet.plant() + UncertaintySet.sensors().only(maf)


def quantify(
    plant: CrankAnglePlant | None = None,
    maps: MeanValuePlant | None = None,
    *,
    dynamics: MeanValueDynamics | None = None,
    uncertain: UncertaintySet | None = None,
    points: Sequence[OperatingPoint] = DEFAULT_POINTS,
    share: float = 0.99,
    confidence: float = 0.99,
    design: int = 128,
    fresh: int = 1000,
    seed: int = 0,
    progress: Progress | None = None,
) -> Quantification:
    """Bound the uncertainty of the mean-value plant in all modes, with a guarantee.

    Parameters
    ----------
    plant : CrankAnglePlant, optional
        Nominal full plant; the paper's with runner and oscillation by default.
    maps : MeanValuePlant, optional
        Mean-value plant; fitted to the full plant without oscillation by default (some
        seconds).
    dynamics : MeanValueDynamics, optional
        Dynamics of the maps, about whose MAF average the residuals are then taken, its flow shape
        and all. By default the nominal measurement has the flow shape of the nominal full plant,
        which each MAF channel keeps.
    uncertain : UncertaintySet, optional
        What is uncertain, equal for all cylinders; `default_set` by default.
    points : sequence of OperatingPoint
        Commanded operating points.
    share, confidence : float
        Claim: this share of the set is covered with this confidence. They say how many
        calibration samples are drawn.
    design, fresh : int
        Sobol' points of the design sample, and samples of the check.
    seed : int
        Seed of all samples.
    progress : callable, optional
        Called with the number of plants followed and the number in all.

    Raises
    ------
    ParameterError
        For an argument out of range, or cylinders that differ.
    SimulationError
        If a plant of the design or calibration sample cannot be simulated: none of them may be
        left out. A fresh plant that cannot is told in the result, and counts as outside.

    Notes
    -----
    Residuals are relative to the mean-value plant's change of charge. Where the charge hardly
    follows the duration (a valve that shuts about where the charge is largest), they go beyond
    1: there not even the sign of the gain is certain.
    """
    plant = full_plant(plant)
    uncertain = default_set() if uncertain is None else uncertain
    points = checked_points(points)
    whole("design", design, 2, 100_000)
    whole("fresh", fresh, 1, 10_000_000)
    whole("seed", seed, 0, 2**63 - 1)
    seeds = [int(s) for s in np.random.SeedSequence(seed).generate_state(3)]
    shape = _design_sample(uncertain, design, seeds[0])
    calibration = draw(uncertain, samples_needed(share, confidence), seeds[1])
    unseen = draw(uncertain, fresh, seeds[2])
    if maps is None:
        maps = (
            MeanValuePlant.fit(_without_oscillation(plant)) if dynamics is None else dynamics.maps
        )
    if maps.engine.n_cylinders != plant.engine.n_cylinders:
        raise ParameterError(
            f"the maps are those of {maps.engine.n_cylinders} cylinders, but the full plant has "
            f"{plant.engine.n_cylinders}: fit maps to a plant of that engine"
        )
    if dynamics is not None and dynamics.maps is not maps:
        raise ParameterError("the dynamics are those of other maps: give maps.dynamics(...)")

    each = len(shape) + len(calibration) + len(unseen)
    scores = np.zeros(len(calibration)), np.zeros(len(unseen))
    channels: list[ChannelUncertainty] = []
    failures: list[str] = []
    followers = [
        _Follower(plant, maps, dynamics, point, k * each, len(points) * each, progress)
        for k, point in enumerate(points)
    ]
    for follow in followers:
        designed = follow(shape, "design")
        own = [
            _channel(follow, designed, output, q)
            for output in OUTPUTS
            for q in range(plant.engine.n_cylinders // 2 + 1)
        ]
        # No calibration plant may be left out, so that one that fails ends all at once.
        followed = follow(calibration, "calibration"), follow(unseen, "fresh", keep_going=True)
        for found, pulses in zip(scores, followed, strict=True):
            np.maximum(found, _scores(follow, pulses, own), out=found)
        failures += [f"{follow.point}: {why}" for why in followed[1].failures.values()]
        channels += own

    bound = bound_from_scores(scores[0], confidence=confidence, share=share)
    # Where the calibration sample asks for less than the design sample, the latter rules.
    scale = max(bound.value, 1.0)
    bound = replace(bound, value=scale)
    return Quantification(
        uncertain=uncertain,
        input="duration_deg",
        channels=tuple(replace(c, weight=c.weight.scaled(scale), scale=scale) for c in channels),
        coverage=check_fresh(bound, scores[1]),
        scale=scale,
        design=len(shape),
        calibration=len(calibration),
        fresh=fresh,
        seed=seed,
        failures=tuple(failures),
    )


@dataclass
class _Follower:
    """Follows samples at one operating point, and tells how far it is."""

    plant: CrankAnglePlant
    maps: MeanValuePlant
    dynamics: MeanValueDynamics | None
    point: OperatingPoint
    done: int
    total: int
    progress: Progress | None

    command: ValveCommand = field(init=False)  # nominal
    charge: float = field(init=False)  # of the mean-value plant, kg
    gain: float = field(init=False)  # its change, of it, by that of duration, of duration

    def __post_init__(self) -> None:
        speed, lift, duration = self.point
        self.command = ValveCommand(lift, duration)
        self.charge = float(self.maps.air_charge(lift, duration, speed))
        slope = float(self.maps.charge_gradient(lift, duration, speed).duration)
        self.gain = slope * duration / self.charge
        if self.gain == 0.0:
            raise ParameterError(
                f"the mean-value plant's charge does not follow the duration at {self.point}, but "
                "must, to be what residuals are relative to: move the operating point"
            )

    def __call__(self, sample: Sample, name: str, *, keep_going: bool = False) -> SampledPulses:
        """Follow a sample."""

        def report(done: int, _: int) -> None:
            if self.progress is not None:
                self.progress(self.done + done, self.total)

        try:
            pulses = sampled_pulses(
                PerturbedPlants(self.plant, sample),
                self.command,
                self.point.speed_rpm,
                reference_charge=self.charge,
                keep_going=keep_going,
                progress=report,
            )
        except SimulationError as error:
            raise SimulationError(
                f"{name} plants at {self.point}: {error}; none may be left out: narrow the set, "
                "or leave out the operating point"
            ) from error
        self.done += len(sample)
        return pulses

    def measured(
        self, pulses: SampledPulses, output: Output, q: int, theta: FloatArray
    ) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Responses over that of the nominal charge: nominal, nominal full plant, samples."""
        found = pulses.responses(output, modes=[q], theta=theta)
        z = mode_points(theta, q, pulses.n_cylinders)
        nominal = np.ones_like(z)
        dynamics = self.dynamics
        if output == "maf" and dynamics is None:
            nominal = _measurement(pulses)(z)
        elif output == "maf" and dynamics is not None:
            own = mean_value_modes(
                dynamics,
                self.command,
                self.point.speed_rpm,
                output=output,
                modes=[q],
                theta=theta,
            )
            nominal = own.mode(q) / self.gain
        return nominal, found.nominal.mode(q) / self.gain, found.mode(q) / self.gain


def _without_oscillation(plant: CrankAnglePlant) -> CrankAnglePlant:
    return CrankAnglePlant(
        plant.engine,
        runner=plant.runner,
        profile=plant.profile,
        orifice=plant.orifice,
        resolution=plant.resolution,
    )


def _design_sample(uncertain: UncertaintySet, count: int, seed: int) -> Sample:
    spread = draw(uncertain, count, seed, "sobol")
    return spread.joined(one_at_a_time(uncertain)).joined(nominal_sample(uncertain))


def _measurement(pulses: SampledPulses) -> PulseResponse:
    """From a change of charge to the nominal sensor's event average, by the nominal flow."""
    T = event_time(pulses.speed_rpm, pulses.n_cylinders)
    maf: MafSensor = pulses.maf
    return PulseResponse.of_window(
        T, time_constant=maf.time_constant, delay=maf.delay, shape=pulses.flow_shape()
    )


def _channel(
    follow: _Follower, pulses: SampledPulses, output: Output, q: int
) -> ChannelUncertainty:
    """Fit the weight of a channel to the design sample."""
    cycle = pulses.n_cylinders * event_time(pulses.speed_rpm, pulses.n_cylinders)
    channel = Channel(follow.point, output, q)
    theta = np.linspace(-np.pi, np.pi, PHASES)

    def envelope(phases: FloatArray) -> FloatArray:
        nominal, _, samples = follow.measured(pulses, output, q, phases)
        return np.asarray(np.abs(samples - nominal).max(axis=0))

    def folded(omega: FloatArray) -> FloatArray:
        return np.maximum(envelope(-omega * cycle), envelope(omega * cycle))

    found = envelope(theta)
    omega = theta[theta >= 0.0] / cycle
    weight = fit_weight(
        omega,
        folded_envelope(theta, found),
        dt=cycle,
        floor=FLOOR,
        finer=folded,
        name=channel.name,
    )
    # What the fit has seen is lifted by a little; the check is made where it has not been.
    fine = np.linspace(0.0, np.pi, FINER * (omega.size - 1) + 1) / cycle
    least = weight.check(fine, folded(fine)).min_ratio
    weight = weight.scaled((1.0 + LIFT) / min(least, 1.0))
    between = 0.5 * (fine[1:] + fine[:-1])
    check = weight.check(between, folded(between))
    nominal, full, samples = follow.measured(pulses, output, q, theta)
    return ChannelUncertainty(
        channel=channel,
        theta=theta,
        charge=np.full(theta.shape, follow.gain, dtype=complex),
        nominal=nominal,
        full=full,
        envelope=found,
        disks=smallest_disks(samples),
        weight=weight,
        check=check,
        flow_shape=pulses.flow_shape() if output == "maf" and follow.dynamics is None else None,
    )


def _scores(
    follow: _Follower, pulses: SampledPulses, channels: Sequence[ChannelUncertainty]
) -> FloatArray:
    """Largest residual over the weight of each plant; infinite for one that failed."""
    worst = np.zeros(len(pulses))
    theta = np.linspace(-np.pi, np.pi, FINER * (PHASES - 1) + 1)
    for found in channels:
        channel = found.channel
        nominal, _, samples = follow.measured(pulses, channel.output, channel.mode, theta)
        size = found.weight.magnitude(np.abs(theta) / found.weight.dt)
        np.maximum(worst, (np.abs(samples - nominal) / size).max(axis=1), out=worst)
    worst[list(pulses.failures)] = np.inf
    return worst
