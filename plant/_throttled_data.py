"""The throttled mean-value plant as labelled data."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import xarray as xr

    from .throttled import ThrottledMeanValuePlant


def to_dataset(plant: ThrottledMeanValuePlant) -> xr.Dataset:
    """See `ThrottledMeanValuePlant.to_dataset`."""
    import xarray as xr

    quantities = {
        "manifold_pressure": (plant.pressure, "Pa", "mean manifold pressure"),
        "throttle_deg": (plant.throttle_deg, "deg", "throttle angle that holds the pressure"),
        "air_charge": (plant.charge, "kg", "air charge per event"),
        "pumping_loss": (plant.loss, "J", "pumping loss per event"),
        "flow_factor": (plant.flow_factor, "1", "mean throttle flow over that of Eq. 15"),
        "storage_volume": (plant.storage_volume, "m3", "volume added by the open cylinders"),
    }
    return xr.Dataset(
        {
            name: (("speed", "share"), values, {"units": units, "long_name": long_name})
            for name, (values, units, long_name) in quantities.items()
        },
        coords={
            "speed": ("speed", plant.speeds_rpm, {"units": "rpm"}),
            "share": (
                "share",
                plant.shares,
                {"units": "1", "long_name": "share from the lowest to the highest pressure"},
            ),
        },
        attrs={
            **plant.provenance,
            "cam": json.dumps(asdict(plant.cam), sort_keys=True),
            "engine": json.dumps(asdict(plant.engine), sort_keys=True),
        },
    )
