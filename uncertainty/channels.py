"""Channels of uncertainty: one mode of one output at one operating point."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from plant.air_path import ComplexArray, FlowShape
from plant.kinematics import FloatArray
from plant.region import OperatingPoint

from .disks import CoveringDisks
from .frequency import Output
from .weight_result import OverboundingWeight, WeightCheck

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FINE = 361  # phases from 0 to pi on which a weight is drawn and its peak sought
OUTPUT_WORDS: dict[Output, str] = {"air_charge": "charge", "maf": "MAF"}


@dataclass(frozen=True)
class Channel:
    """One circulant mode of one output at one operating point.

    Attributes
    ----------
    point : OperatingPoint
        Operating point.
    output : {"air_charge", "maf"}
        True charge of each event, or the MAF sensor's average over it.
    mode : int
        Mode: 0 the mean, q an imbalance that repeats q times a cycle.
    """

    point: OperatingPoint
    output: Output
    mode: int

    @property
    def name(self) -> str:
        """Output, mode and operating point."""
        speed, lift, duration = self.point
        word = OUTPUT_WORDS[self.output]
        return f"{word} q={self.mode} at {speed:g} rpm, {lift:g} mm, {duration:g} deg"

    def __str__(self) -> str:
        """Return `name`."""
        return self.name


@dataclass(frozen=True)
class ChannelUncertainty:
    """Uncertainty of a channel: ``g = g0 + W m d``, ``|d| <= 1``, with ``m`` the nominal charge.

    ``g`` is what one command does to the output and ``m`` what it does to the charge of the
    mean-value plant. For the charge itself ``m = g0``: the uncertainty is multiplicative. For
    the MAF average it is that of the measurement ``g/m``, additive: the nominal measurement of
    an imbalance goes through zero somewhere, where nothing can be relative to it.

    Attributes
    ----------
    channel : Channel
        The channel.
    theta : ndarray (f,)
        Cycle phases, rad, from -pi to pi.
    charge : ndarray (f,)
        Response ``m`` of the mean-value plant's charge, relative.
    nominal : ndarray (f,)
        Response ``g0/m`` of the mean-value plant: 1 for the charge; for the MAF average that of
        the nominal sensor and the flow shape of the nominal full plant, which is not the even
        flow that `MeanValueDynamics` assumes by default.
    full : ndarray (f,)
        Response ``g/m`` of the nominal full plant.
    envelope : ndarray (f,)
        Largest residual ``|g - g0|/|m|`` over the design sample.
    disks : CoveringDisks
        Smallest disk over the design sample's ``g/m`` at each phase.
    weight : OverboundingWeight
        ``W`` per cycle, scaled to the guarantee.
    check : WeightCheck
        The weight before its factor against the design sample, at phases between those that the
        fit has seen.
    scale : float
        Factor of the guarantee in ``weight``.
    flow_shape : FlowShape or None
        Flow shape in ``nominal``; None for the charge, and for given dynamics.
    """

    channel: Channel
    theta: FloatArray = field(repr=False)
    charge: ComplexArray = field(repr=False)
    nominal: ComplexArray = field(repr=False)
    full: ComplexArray = field(repr=False)
    envelope: FloatArray = field(repr=False)
    disks: CoveringDisks = field(repr=False)
    weight: OverboundingWeight
    check: WeightCheck
    scale: float = 1.0
    flow_shape: FlowShape | None = field(default=None, repr=False)

    @property
    def reduction_error(self) -> float:
        """Largest error of the mean-value plant against the nominal full plant."""
        return float(self.own_error.max())

    @property
    def own_error(self) -> FloatArray:
        """Error ``|g - g0|/|m|`` of the nominal full plant (f,)."""
        return np.asarray(np.abs(self.full - self.nominal))

    @property
    def peak(self) -> float:
        """Largest ``|W|``, on a fine grid of phases from 0 to pi."""
        return float(self.weight.magnitude(np.linspace(0.0, np.pi, FINE) / self.weight.dt).max())

    @property
    def recentred_radius(self) -> float:
        """Largest radius of the design sample about the best centre; no guarantee is on it."""
        return float(self.disks.radii.max())

    def record(self) -> dict[str, Any]:
        """Return channel, order and tightness, for a JSON file."""
        point = self.channel.point
        return {
            "channel": self.channel.name,
            "output": self.channel.output,
            "mode": self.channel.mode,
            "speed_rpm": point.speed_rpm,
            "lift_mm": point.lift_mm,
            "duration_deg": point.duration_deg,
            "order": self.weight.order,
            "min_ratio": self.check.min_ratio,
            "max_ratio": self.check.max_ratio,
            "scale": self.scale,
            "peak": self.peak,
            "reduction_error": self.reduction_error,
            "recentred_radius": self.recentred_radius,
        }

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the residual's envelope, the mean-value plant's own error and the weight."""
        from plant._plotting import COLOURS, axes, styled

        theta = self.theta[self.theta >= 0.0]
        folded, own = (
            folded_envelope(self.theta, values) for values in (self.envelope, self.own_error)
        )
        fine = np.linspace(0.0, np.pi, FINE)
        cycle = self.weight.dt
        with styled():
            ax = axes(ax)
            for values, style, colour, label in (
                (own, ":", COLOURS[2], "nominal full plant"),
                (folded, "--", COLOURS[1], "largest of the design sample"),
            ):
                ax.plot(np.degrees(theta), values, style, c=colour, label=label)
            magnitude = self.weight.magnitude(fine / cycle)
            label = f"weight, order {self.weight.order}"
            ax.plot(np.degrees(fine), magnitude, c=COLOURS[0], label=label)
            ax.set_ylim(bottom=0.0)
            ax.set_xlim(0.0, 180.0)
            ax.set_xticks([0, 45, 90, 135, 180])
            ax.set_xlabel("cycle phase (deg)")
            ax.set_ylabel("residual (1)")
            ax.set_title(self.channel.name)
            ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        return ax

    def __str__(self) -> str:
        """Return what the weight allows and how tight it is."""
        return (
            f"{self.channel.name}: |W| up to {self.peak:.3g} (order {self.weight.order}, "
            f"{self.check.min_ratio:.3f} to {self.check.max_ratio:.2f} times the residual, then "
            f"scaled by {self.scale:.3g}); of it {self.reduction_error:.3g} is the reduction's "
            f"own; about the best centre the design sample reaches {self.recentred_radius:.3g} "
            f"instead of {self.envelope.max():.3g}"
        )


def folded_envelope(theta: FloatArray, envelope: FloatArray) -> FloatArray:
    """Largest of an envelope at ``theta`` and ``-theta``, for the phases from 0 to pi.

    The weight has real coefficients and so one magnitude for both; the residual of an
    imbalance mode has not.
    """
    return np.maximum(envelope, envelope[::-1])[theta >= 0.0]
