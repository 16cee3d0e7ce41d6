"""A closed-loop result as data sets with units."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from plant import ParameterError

if TYPE_CHECKING:
    import xarray as xr

    from .closed_loop_result import ClosedLoopResult


def event_dataset(result: ClosedLoopResult) -> xr.Dataset:
    """Return the signals over events."""
    import xarray as xr

    signals: dict[str, tuple[np.ndarray, str]] = {
        "time": (result.time, "s"),
        "cylinder": (result.cylinder, "1"),
        "speed": (result.speed_rpm, "rpm"),
        "told_speed": (result.told_speed_rpm, "rpm"),
        "throttle": (result.throttle_deg, "deg"),
        "demand": (result.demand, "kg"),
        "charge": (result.charge, "kg"),
        "estimate": (result.estimate, "kg"),
        "estimate_sigma": (result.estimate_sigma, "kg"),
        "pumping_loss": (result.pumping_loss, "J"),
        "lift": (result.lift_mm, "mm"),
        "duration": (result.duration_deg, "deg"),
        "delivered_lift": (result.delivered_lift_mm, "mm"),
        "delivered_duration": (result.delivered_duration_deg, "deg"),
        "flow_gain": (result.flow_gain, "1"),
        "duration_offset": (result.duration_offset, "s"),
        "charge_factor": (result.charge_factor, "1"),
        "limited": (result.limited, "1"),
        "rate_limited": (result.rate_limited, "1"),
        "adapted": (result.adapted, "1"),
        "mode": (result.mode, "1"),
        "alarms": (result.alarms, "1"),
    }
    return xr.Dataset(
        {name: ("event", data, {"units": unit}) for name, (data, unit) in signals.items()},
        coords={"event": np.arange(result.time.size)},
        attrs={
            "name": result.name,
            "n_cylinders": result.n_cylinders,
            "seed": result.seed,
            "faults": "; ".join(str(fault) for fault in result.faults),
        },
    )


def crank_dataset(result: ClosedLoopResult) -> xr.Dataset:
    """Return the crank-level signals, their time from the first IVO on."""
    if result.trace is None:
        raise ParameterError(
            "the run kept no crank-level signals: give simulate(...) a record_deg, such as 5"
        )
    data = result.trace.to_dataset()
    # The first window starts before its IVO, which stands at 0 deg.
    lead = result.trace.crank_angle_deg[0] / (6.0 * result.speed_rpm[0])
    data["time"] = data["time"].copy(data=result.trace.time + lead)
    data.attrs.update(name=result.name, n_cylinders=result.n_cylinders, seed=result.seed)
    return data
