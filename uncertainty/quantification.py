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
from dataclasses import dataclass, replace

import numpy as np

from plant import CrankAnglePlant, MafSensor, MeanValuePlant, PulseResponse, ValveCommand
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
from .parameters import UncertaintySet
from .perturbed import PerturbedPlants
from .pulse_sampling import SampledPulses, sampled_pulses
from .quantification_result import Quantification
from .sampling import Sample, draw, nominal_sample, one_at_a_time
from .weights import fit_weight

MOST_PHASES = 41  # cycle phases from -pi to pi
FINER = 8
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
    """
    plant = full_plant(plant)
    if maps is None:
        maps = MeanValuePlant.fit(
            CrankAnglePlant(plant.engine, runner=plant.runner, orifice=plant.orifice)
        )
    uncertain = default_set() if uncertain is None else uncertain
    points = checked_points(points)
    whole("design", design, 2, 100_000)
    whole("fresh", fresh, 1, 10_000_000)
    seeds = [int(s) for s in np.random.SeedSequence(seed).generate_state(3)]
    shape = _design_sample(uncertain, design, seeds[0])
    calibration = draw(uncertain, samples_needed(share, confidence), seeds[1])
    unseen = draw(uncertain, fresh, seeds[2])

    each = len(shape) + len(calibration) + len(unseen)
    scores = np.zeros(len(calibration)), np.zeros(len(unseen))
    channels: list[ChannelUncertainty] = []
    failures: list[str] = []
    for k, point in enumerate(points):
        follow = _Follower(plant, maps, point, k * each, len(points) * each, progress)
        designed = follow(shape, keep_going=False)
        own = [
            _channel(follow, designed, output, q)
            for output in OUTPUTS
            for q in range(plant.engine.n_cylinders // 2 + 1)
        ]
        for sample, found in ((calibration, scores[0]), (unseen, scores[1])):
            pulses = follow(sample, keep_going=True)
            failures += [f"{point}: {why}" for why in pulses.failures.values()]
            np.maximum(found, _scores(follow, pulses, own), out=found)
        channels += own

    bound = bound_from_scores(scores[0], confidence=confidence, share=share)
    # Where the calibration sample asks for less than the design sample, the latter rules.
    scale = max(bound.value, 1.0)
    bound = replace(bound, value=scale)
    return Quantification(
        uncertain=uncertain,
        input="duration_deg",
        channels=tuple(_scaled(channel, scale) for channel in channels),
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
    point: OperatingPoint
    done: int
    total: int
    progress: Progress | None

    @property
    def command(self) -> ValveCommand:
        """Nominal command."""
        return ValveCommand(self.point.lift_mm, self.point.duration_deg)

    @property
    def gain(self) -> float:
        """Relative change of the mean-value plant's charge by that of duration, of the charge."""
        speed, lift, duration = self.point
        slope = self.maps.charge_gradient(lift, duration, speed).duration
        return float(slope) * duration / self.charge

    @property
    def charge(self) -> float:
        """Charge of the mean-value plant, kg."""
        speed, lift, duration = self.point
        return float(self.maps.air_charge(lift, duration, speed))

    def __call__(self, sample: Sample, *, keep_going: bool) -> SampledPulses:
        """Follow a sample."""

        def report(done: int, _: int) -> None:
            if self.progress is not None:
                self.progress(self.done + done, self.total)

        pulses = sampled_pulses(
            PerturbedPlants(self.plant, sample),
            self.command,
            self.point.speed_rpm,
            reference_charge=self.charge,
            keep_going=keep_going,
            progress=report,
        )
        self.done += len(sample)
        return pulses

    def measured(
        self, pulses: SampledPulses, output: Output, q: int, theta: FloatArray
    ) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Responses over that of the nominal charge: nominal, nominal full plant, samples."""
        found = pulses.responses(output, modes=[q], theta=theta)
        z = mode_points(theta, q, pulses.n_cylinders)
        nominal = np.ones_like(z)
        if output == "maf":
            nominal = _measurement(pulses)(z)
        return nominal, found.nominal.mode(q) / self.gain, found.mode(q) / self.gain


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
    theta = np.linspace(-np.pi, np.pi, MOST_PHASES)

    def envelope(phases: FloatArray) -> FloatArray:
        nominal, _, samples = follow.measured(pulses, output, q, phases)
        return np.asarray(np.abs(samples - nominal).max(axis=0))

    def folded(omega: FloatArray) -> FloatArray:
        phases = np.concatenate((-omega[::-1], omega)) * cycle
        both = envelope(np.clip(phases, -np.pi, np.pi))  # pi, but for rounding
        return np.maximum(both[: omega.size][::-1], both[omega.size :])

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
    fine = np.linspace(0.0, np.pi, FINER * (omega.size - 1) + 1) / cycle
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
        check=weight.check(fine, folded(fine)),
    )


def _scores(
    follow: _Follower, pulses: SampledPulses, channels: Sequence[ChannelUncertainty]
) -> FloatArray:
    """Largest residual over the weight of each plant; infinite for one that failed."""
    worst = np.zeros(len(pulses))
    for found in channels:
        theta = found.theta
        nominal, _, samples = follow.measured(
            pulses, found.channel.output, found.channel.mode, theta
        )
        size = found.weight.magnitude(np.abs(theta) / found.weight.dt)
        np.maximum(worst, (np.abs(samples - nominal) / size).max(axis=1), out=worst)
    worst[list(pulses.failures)] = np.inf
    return worst


def _scaled(channel: ChannelUncertainty, factor: float) -> ChannelUncertainty:
    check = channel.check
    return replace(
        channel,
        weight=channel.weight.scaled(factor),
        check=replace(
            check, min_ratio=factor * check.min_ratio, max_ratio=factor * check.max_ratio
        ),
    )
