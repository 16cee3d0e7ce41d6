from types import MappingProxyType

import numpy as np
import pytest

from plant import CrankAnglePlant, ValveCommand
from plant.valve import shortest_duration


class TabulatedCharge:
    """Charge map read from steady cycles of a plant, one table a lift and speed."""

    def __init__(self, plant: CrankAnglePlant) -> None:
        self.plant = plant
        self.tables: dict[tuple[float, float], tuple[np.ndarray, np.ndarray]] = {}

    def air_charge(self, lift_mm, duration_deg, speed_rpm, /):
        key = float(lift_mm), float(speed_rpm)
        if key not in self.tables:
            shortest = shortest_duration(key[0], self.plant.engine.valvetrain) * 6.0 * key[1]
            durations = np.linspace(shortest * (1.0 + 1e-6), 190.0, 40)
            charges = [
                self.plant.steady_cycle(key[1], ValveCommand(key[0], d)).air_charge[0]
                for d in durations
            ]
            self.tables[key] = durations, np.array(charges)
        return np.interp(duration_deg, *self.tables[key])


@pytest.fixture(scope="session")
def charge_map():
    """Design map without runner and oscillation: what a controller would believe."""
    return TabulatedCharge(CrankAnglePlant(runner=False))


@pytest.fixture(scope="session")
def linear_map():
    """Charge of 2 mg per degree above 20 deg, whatever the lift and speed."""

    class Linear:
        def air_charge(self, lift_mm, duration_deg, speed_rpm, /):
            return 2e-6 * (np.asarray(duration_deg) - 20.0)

    return Linear()


@pytest.fixture(scope="session")
def nominal():
    return MappingProxyType({"time_constant": 0.015, "delay": 1e-3})
