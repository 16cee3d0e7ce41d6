"""Range of charges that the optimal path covers at each speed."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from plant.errors import ParameterError
from plant.kinematics import FloatArray

from ._path_problem import ambient_charge
from ._path_scan import Branches, branches, scanned_lifts

if TYPE_CHECKING:
    from plant import MeanValuePlant

    from .least_loss_motion import FeedforwardOptions

_NEARLY = 0.03  # 1, share of the largest charge that the highest lift may fall short by
_FINER = 6  # speeds per node at which the limits are checked


@dataclass(frozen=True, eq=False)
class ChargeLimits:
    """Lowest and highest charge of the path, smooth over speed.

    The highest charge is that of the highest lift whose branch reaches nearly (3 %) as far as any.
    Where runner waves end the branch of the highest lift a little earlier than that of another,
    the path does not change lift for the last per cent of charge.
    """

    speeds_rpm: FloatArray  # (s,) rpm
    low: FloatArray  # (s,) kg per event
    high: FloatArray  # (s,) kg per event

    @classmethod
    def of(
        cls,
        maps: MeanValuePlant,
        options: FeedforwardOptions,
        speeds_rpm: FloatArray,
        dwell_margin: float,
        charge_margin: float,
    ) -> Self:
        """Find the limits at nodes of speed, such that they can be reached between them too.

        Parameters
        ----------
        dwell_margin, charge_margin : float
            By which they keep off the least dwell, s, and the ends of the branches, 1.

        Raises
        ------
        ParameterError
            If at a speed no charge can be reached.
        """
        lifts = scanned_lifts(options)
        inner = [
            np.geomspace(a, b, _FINER + 1)[:-1] for a, b in itertools.pairwise(speeds_rpm.tolist())
        ]
        fine = np.concatenate((*inner, speeds_rpm[-1:]))
        found = branches(maps, options, fine, lifts, dwell_margin)
        low, high = _reach(found, options.lowest_charge_share * ambient_charge(maps), charge_margin)
        if not np.all(high > 0.0):
            raise ParameterError(
                f"at {fine[np.argmin(high)]:g} rpm no motion within the limits gives "
                f"{1e6 * options.lowest_charge_share * ambient_charge(maps):.1f} mg: widen the "
                "options' limits, or lower lowest_charge_share"
            )
        limits = cls(speeds_rpm, low[::_FINER], high[::_FINER])
        for _ in range(3):
            found_low, found_high = limits.at(fine)
            above = np.maximum(found_high / high - 1.0, 0.0)
            below = np.maximum(1.0 - found_low / low, 0.0)
            if not (above.any() or below.any()):
                break
            limits = cls(
                speeds_rpm,
                limits.low * (1.0 + _around(below)),
                limits.high * (1.0 - _around(above)),
            )
        if np.any(limits.low >= limits.high):
            worst = int(np.argmin(limits.high - limits.low))
            raise ParameterError(
                f"at {speeds_rpm[worst]:g} rpm the path would go from {1e6 * limits.low[worst]:.1f}"
                f" to {1e6 * limits.high[worst]:.1f} mg: widen the options' limits, or lower "
                "lowest_charge_share"
            )
        return limits

    def at(self, speed_rpm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Lowest and highest charge in kg at speeds inside the nodes."""
        both = np.asarray(self._curves(np.log(speed_rpm)), dtype=float)
        return both[..., 0], both[..., 1]

    @cached_property
    def _curves(self) -> Any:
        from scipy.interpolate import PchipInterpolator

        return PchipInterpolator(
            np.log(self.speeds_rpm), np.stack((self.low, self.high), axis=-1), axis=0
        )


def _reach(found: Branches, lowest: float, margin: float) -> tuple[FloatArray, FloatArray]:
    ends = found.end
    enough = ends >= (1.0 - _NEARLY) * ends.max(axis=1, keepdims=True)
    highest = ends.shape[1] - 1 - np.argmax(enough[:, ::-1], axis=1)
    high = (1.0 - margin) * ends[np.arange(ends.shape[0]), highest]
    return np.maximum((1.0 + margin) * found.begin.min(axis=1), lowest), high


def _around(error: FloatArray) -> FloatArray:
    """Largest error in the cells on both sides of each node, of errors at the finer speeds."""
    cells = error[:-1].reshape(-1, _FINER).max(axis=1)
    return np.maximum(np.append(cells, error[-1]), np.concatenate(([error[0]], cells)))
