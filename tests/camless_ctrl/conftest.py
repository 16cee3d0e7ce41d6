import functools
import itertools
from types import MappingProxyType

import numpy as np
import pytest

from camless_ctrl.estimator import ChargeEstimator
from camless_ctrl.linearise import LocalResponse
from camless_ctrl.measurement_response import FlowShape, MeasurementResponse, event_time
from camless_ctrl.pulse_bank import PulseSum
from camless_ctrl.uncertain_measurement import UncertainMeasurement
from plant import CrankAnglePlant, ValveCommand
from plant.valve import shortest_duration
from uncertainty.parameters import UncertaintySet
from uncertainty.weights import fit_weight


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


@pytest.fixture(scope="session")
def measured():
    """Measurement at a speed through a MAF sensor of uncertain gain, lag and delay.

    It comes from the sensor's formula alone, no plant behind it.
    """
    return functools.cache(_measured)


def _measured(speed_rpm):
    estimator, T = ChargeEstimator(), event_time(speed_rpm, 4)
    uncertain = UncertaintySet.sensors().only(["MAF gain error", "MAF time constant", "MAF delay"])

    def seen(gain_error, time_constant, delay):
        response = MeasurementResponse.of_maf(
            estimator, T, time_constant=time_constant, delay=delay
        )
        return PulseSum(((1.0 + gain_error, response),))

    bounds = [(p.low, p.high) for p in uncertain]
    middle = [0.5 * (low + high) for low, high in bounds]
    centre, directions = seen(*middle), {}
    for k, p in enumerate(uncertain):
        ends = [seen(*middle[:k], end, *middle[k + 1 :]) for end in (p.high, p.low)]
        directions[p.name] = ends[0].scaled(0.5) + ends[1].scaled(-0.5)

    def left(omega):
        z = np.exp(1j * np.asarray(omega) * T)
        found = []
        for d in itertools.product((-1.0, 0.0, 1.0), repeat=3):
            values = [
                0.5 * (a + b) + 0.5 * x * (b - a) for x, (a, b) in zip(d, bounds, strict=True)
            ]
            affine = sum(x * h(z) for x, h in zip(d, directions.values(), strict=True))
            found.append(np.abs(seen(*values)(z) - centre(z) - affine))
        return np.max(found, axis=0)

    omega = np.linspace(0.0, np.pi, 49) / T
    weight = fit_weight(omega, left(omega), dt=T, orders=(0, 1), floor=0.2, finer=left)
    local = LocalResponse(
        speed_rpm, 4, ValveCommand(5.0, 150.0), 250e-6, 1.0, 1.0, FlowShape.even()
    )
    return UncertainMeasurement(
        local, 250e-6, estimator, uncertain, centre, centre, directions, weight
    )
