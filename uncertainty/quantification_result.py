"""What the quantifier found: weights with a guarantee, and what it rests on."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from plant import ParameterError
from plant.region import OperatingPoint

from .channels import ChannelUncertainty
from .coverage import FreshCheck
from .frequency import Output
from .parameters import UncertaintySet

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_PANEL = 2.5  # inches


@dataclass(frozen=True)
class Quantification:
    """Uncertainty of the mean-value plant over operating points and modes.

    The nominal MAF average is that of the charge map, seen through the flow shape of the nominal
    full plant. The even flow that `MeanValueDynamics` assumes by default is further off than
    that, by up to 15 % of the gain of the charge: about it the weights of the MAF do not hold.

    Attributes
    ----------
    uncertain : UncertaintySet
        What was varied, uniformly and independently.
    input : str
        Command that the responses are to.
    channels : tuple of ChannelUncertainty
        Each with its weight.
    coverage : FreshCheck
        Claim and check: the score of a plant is its largest residual over the weight, over all
        channels at once and on a grid of phases eight times finer than theirs.
    scale : float
        Factor on all weights that the calibration sample asked for, at least 1.
    design, calibration, fresh : int
        Plants in each sample.
    seed : int
        Seed.
    failures : tuple of str
        Fresh plants that could not be simulated, at each operating point; each such plant
        counts as outside.
    """

    uncertain: UncertaintySet = field(repr=False)
    input: str
    channels: tuple[ChannelUncertainty, ...] = field(repr=False)
    coverage: FreshCheck
    scale: float
    design: int
    calibration: int
    fresh: int
    seed: int
    failures: tuple[str, ...] = ()

    @property
    def points(self) -> tuple[OperatingPoint, ...]:
        """Operating points, in order."""
        return tuple(dict.fromkeys(c.channel.point for c in self.channels))

    @property
    def least_ratio(self) -> float:
        """Least ``|W|`` over the residual of the design sample, over all channels."""
        return min(c.check.min_ratio for c in self.channels)

    @property
    def largest_ratio(self) -> float:
        """Largest ratio of ``|W|`` to that residual (or to its floor), over all channels."""
        return max(c.check.max_ratio for c in self.channels)

    def channel(self, point: OperatingPoint, output: Output, mode: int) -> ChannelUncertainty:
        """Return a channel.

        Raises
        ------
        ParameterError
            If there is none.
        """
        for found in self.channels:
            c = found.channel
            if (c.point, c.output, c.mode) == (point, output, mode):
                return found
        raise ParameterError(
            f"there is no channel of {output} in mode {mode} at {point}, but "
            f"{', '.join(c.channel.name for c in self.channels)}: quantify that point"
        )

    def records(self) -> list[dict[str, Any]]:
        """Return a record of each channel, for a JSON file."""
        return [channel.record() for channel in self.channels]

    def plot(self, output: Output = "maf") -> Figure:
        """Draw the residuals and weights of one output: a row an operating point."""
        import matplotlib.pyplot as plt

        from plant._plotting import styled

        rows = self.points
        modes = sorted({c.channel.mode for c in self.channels})
        with styled():
            figure, grid = plt.subplots(
                len(rows),
                len(modes),
                figsize=(9.0, 0.5 + _PANEL * len(rows)),
                sharex=True,
                squeeze=False,
            )
            for row, point in zip(grid, rows, strict=True):
                for ax, mode in zip(row, modes, strict=True):
                    found = self.channel(point, output, mode)
                    found.plot(ax)
                    legend = ax.get_legend()
                    if legend is not None:
                        legend.remove()
                    ax.set_title(f"{point.speed_rpm:g} rpm, q = {mode}")
                    if mode != modes[0]:
                        ax.set_ylabel("")
                    if point != rows[-1]:
                        ax.set_xlabel("")
            handles, labels = grid[0, 0].get_legend_handles_labels()
            labels = [label.split(",")[0] for label in labels]
            figure.legend(handles, labels, loc="outside lower center", ncols=3)
        return figure

    def __str__(self) -> str:
        """Return the claim, its check and a line for each channel."""
        claim = self.coverage.bound
        places = f"{len(self.points)} operating point{'s' if len(self.points) > 1 else ''}"
        lines = [
            f"{len(self.channels)} weights over {places} cover at "
            f"least {100.0 * claim.share:.4g} % of the set with {100.0 * claim.confidence:.4g} % "
            f"confidence (all scaled by {self.scale:.3g} for it). The nominal measurement has the "
            "flow shape of the nominal full plant; with another one, such as the even flow of "
            "MeanValueDynamics, nothing is claimed of the MAF.",
            str(self.coverage),
            *(f"  {channel}" for channel in self.channels),
        ]
        if self.failures:
            lines.append(f"{len(self.failures)} fresh simulations failed: {self.failures[0]}")
        return "\n".join(lines)
