"""The mean-value maps as labelled data."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import xarray as xr

    from .mean_value import MeanValuePlant


def to_dataset(maps: MeanValuePlant) -> xr.Dataset:
    """See `MeanValuePlant.to_dataset`."""
    import xarray as xr

    dims = ("speed", "lift", "share")
    duration = maps.region.duration_deg(
        maps.lifts_mm[None, :, None], maps.shares, maps.speeds_rpm[:, None, None]
    )
    return xr.Dataset(
        {
            "air_charge": (
                dims,
                maps.charge,
                {"units": "kg", "long_name": "air charge per event"},
            ),
            "pumping_loss": (
                dims,
                maps.loss,
                {"units": "J", "long_name": "pumping loss per event"},
            ),
        },
        coords={
            "speed": ("speed", maps.speeds_rpm, {"units": "rpm"}),
            "lift": ("lift", maps.lifts_mm, {"units": "mm"}),
            "share": (
                "share",
                maps.shares,
                {"units": "1", "long_name": "share from the shortest to the longest duration"},
            ),
            "duration": (dims, duration, {"units": "deg"}),
        },
        attrs={
            **maps.provenance,
            "longest_duration_deg": maps.region.longest_deg,
            "engine": json.dumps(asdict(maps.engine), sort_keys=True),
        },
    )
