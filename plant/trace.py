"""Crank-resolved signals of the plant."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from . import _layout as layout
from .errors import ParameterError
from .kinematics import FloatArray, cylinder_volume
from .parameters import Engine

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Trace:
    """Signals over a stretch of crank angle, `m` samples of `n` cylinders.

    Cylinder pressure is NaN where the model says nothing: from the compression TDC to the
    next IVO. The runner pressure of a shut cylinder is that of the manifold.

    Attributes
    ----------
    crank_angle_deg : ndarray (m,)
        Crank angle after the intake TDC of the first cylinder, rising (not wrapped), deg.
    time : ndarray (m,)
        Time since the first sample, s.
    manifold_pressure : ndarray (m,)
        Pa.
    throttle_flow : ndarray (m,)
        Flow through the throttle into the manifold, kg/s.
    runner_pressure, cylinder_pressure : ndarray (m, n)
        Pa.
    port_flow : ndarray (m, n)
        Flow through the intake valve into the cylinder, kg/s.
    lift_mm : ndarray (m, n)
        Valve lift, mm.
    volume : ndarray (m, n)
        Cylinder volume, m3.
    engine : Engine
        The engine.
    """

    crank_angle_deg: FloatArray
    time: FloatArray
    manifold_pressure: FloatArray
    throttle_flow: FloatArray
    runner_pressure: FloatArray
    cylinder_pressure: FloatArray
    port_flow: FloatArray
    lift_mm: FloatArray
    volume: FloatArray
    engine: Engine

    @classmethod
    def from_kernel(
        cls, raw: FloatArray, first_angle_deg: float, step_deg: float, speed_rpm: float, e: Engine
    ) -> Trace:
        """Make a trace of the kernel's rows (masses, flows, runner factors, lifts)."""
        n, m = e.n_cylinders, raw.shape[1]
        angle = first_angle_deg + step_deg * np.arange(m, dtype=np.float64)
        offset = e.event_angle_deg * np.arange(n)
        volume = cylinder_volume(
            angle[:, None] - offset[None, :], e.displaced_volume, e.clearance_volume
        )
        blocks = raw[layout.TRACE_FIRST :].reshape(n, layout.TRACE_STRIDE, m).transpose(1, 2, 0)
        p_m = raw[layout.TRACE_PRESSURE]
        factor = blocks[layout.TRACE_RUNNER]
        return cls(
            crank_angle_deg=angle,
            time=(angle - first_angle_deg) / (6.0 * speed_rpm),
            manifold_pressure=p_m.copy(),
            throttle_flow=raw[layout.TRACE_THROTTLE].copy(),
            runner_pressure=p_m[:, None] * np.where(np.isnan(factor), 1.0, factor),
            cylinder_pressure=blocks[layout.TRACE_MASS] * e.gas_constant * e.temperature / volume,
            port_flow=blocks[layout.TRACE_FLOW].copy(),
            lift_mm=blocks[layout.TRACE_LIFT].copy(),
            volume=volume,
            engine=e,
        )

    def to_dataset(self) -> xr.Dataset:
        """Return the signals as an `xarray.Dataset` with units in the attributes."""
        import xarray as xr

        one, each = ("crank_angle",), ("crank_angle", "cylinder")
        signals = {
            "time": (one, self.time, "s"),
            "manifold_pressure": (one, self.manifold_pressure, "Pa"),
            "throttle_flow": (one, self.throttle_flow, "kg/s"),
            "runner_pressure": (each, self.runner_pressure, "Pa"),
            "cylinder_pressure": (each, self.cylinder_pressure, "Pa"),
            "port_flow": (each, self.port_flow, "kg/s"),
            "lift": (each, self.lift_mm, "mm"),
            "volume": (each, self.volume, "m3"),
        }
        return xr.Dataset(
            {name: (dims, data, {"units": unit}) for name, (dims, data, unit) in signals.items()},
            coords={
                "crank_angle": ("crank_angle", self.crank_angle_deg, {"units": "deg"}),
                "cylinder": np.arange(1, self.volume.shape[1] + 1),
            },
        )

    def plot(self, cylinder: int = 1) -> Figure:
        """Draw lift, pressures and flows of one cylinder (from 1) against crank angle."""
        import matplotlib.pyplot as plt

        from ._plotting import styled

        j = self._column(cylinder)
        angle = self.crank_angle_deg
        with styled():
            figure, (top, middle, bottom) = plt.subplots(3, 1, sharex=True, figsize=(6.6, 6.6))
            top.plot(angle, self.lift_mm[:, j])
            top.set_ylabel("lift (mm)")
            middle.plot(
                angle, self.runner_pressure[:, j] / 1e5, c="#E69F00", label="runner", lw=1.1
            )
            middle.plot(angle, self.manifold_pressure / 1e5, "--", c="#009E73", label="manifold")
            middle.plot(angle, self.cylinder_pressure[:, j] / 1e5, c="#0072B2", label="cylinder")
            open_or_near = self.cylinder_pressure[:, j][self.volume[:, j] > 0.2 * self._top]
            if np.isfinite(open_or_near).any():
                low, high = np.nanmin(open_or_near) / 1e5, np.nanmax(open_or_near) / 1e5
                middle.set_ylim(low - 0.05, min(high, 1.6) + 0.05)
            middle.set_ylabel("pressure (bar)")
            bottom.plot(angle, 1e3 * self.port_flow[:, j], label="intake port")
            bottom.plot(angle, 1e3 * self.throttle_flow, "--", label="throttle")
            bottom.set_ylabel("air flow (g/s)")
            bottom.set_xlabel(f"crank angle after intake TDC of cylinder {cylinder} (deg)")
            for ax in (middle, bottom):
                ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
            offset = self.engine.event_angle_deg * (cylinder - 1)
            if j == 0:
                bottom.set_xlim(angle[0], min(angle[-1], angle[0] + 360.0))
            else:
                bottom.set_xlim(offset - 20.0, offset + 340.0)
        return figure

    def plot_pv(
        self, cylinder: int = 1, ax: Axes | None = None, *, label: str | None = None
    ) -> Axes:
        """Draw the pumping loop of one cylinder (from 1): pressure against volume."""
        from ._plotting import axes, styled

        j = self._column(cylinder)
        shown = self.cylinder_pressure[:, j] <= 1.3 * self.engine.exhaust_pressure
        # NaN breaks the line where the model says nothing or compression has left the loop.
        pressure = np.where(shown, self.cylinder_pressure[:, j], np.nan)
        with styled():
            ax = axes(ax)
            ax.plot(1e6 * self.volume[:, j], pressure / 1e5, label=label)
            ax.set_xlabel("cylinder volume (cm³)")
            ax.set_ylabel("cylinder pressure (bar)")
        return ax

    @property
    def _top(self) -> float:
        return self.engine.displaced_volume + self.engine.clearance_volume

    def _column(self, cylinder: int) -> int:
        n = self.volume.shape[1]
        if not 1 <= cylinder <= n:
            raise ParameterError(f"cylinder is {cylinder}, but must be from 1 to {n}")
        return cylinder - 1
