import functools
import itertools
from types import MappingProxyType, SimpleNamespace

import numpy as np
import pytest

from camless_ctrl.charge_model import ChargeModel
from camless_ctrl.controller_design import design_controller
from camless_ctrl.estimator import ChargeEstimator
from camless_ctrl.kalman_estimator import KalmanEstimator
from camless_ctrl.linearise import LocalResponse
from camless_ctrl.measurement_response import FlowShape, MeasurementResponse, event_time
from camless_ctrl.optimal_path import OptimalPath
from camless_ctrl.pulse_bank import PulseSum
from camless_ctrl.uncertain_measurement import UncertainMeasurement
from plant import CrankAnglePlant, Engine, MeanValuePlant, ValveCommand
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


class HighLiftPath:
    """Highest lift, closed the later the more charge is wanted: early closing, unthrottled."""

    positions = np.array([0.0, 1.0])
    speeds_rpm = np.array([1450.0, 1550.0])

    def at(self, position, speed_rpm, /):
        q, speed = np.broadcast_arrays(position, speed_rpm)
        shortest = 6.0 * speed * shortest_duration(8.0, Engine.paper().valvetrain) * (1.0 + 1e-8)
        lift, duration = np.full(q.shape, 8.0), shortest * (1.0 - q) + 165.0 * q
        return SimpleNamespace(lift_mm=lift, duration_deg=duration)


@pytest.fixture(scope="session")
def high_lift():
    """Full plant, and a charge model of it around 1500 rpm on a path of the highest lift."""
    plant = CrankAnglePlant(runner=True, oscillation=True)
    model = ChargeModel.fit(HighLiftPath(), plant, speeds=5, positions=25)
    return SimpleNamespace(
        plant=plant, model=model, estimator=KalmanEstimator.of(plant.engine), speed_rpm=1500.0
    )


@pytest.fixture(scope="session")
def narrow_design():
    """Controller of the paper's engine, known from 1300 to 1700 rpm on coarse grids."""
    plant = CrankAnglePlant(runner=True, oscillation=True)
    maps = MeanValuePlant.fit(
        plant, speed_range_rpm=(1300.0, 1700.0), tolerance=0.02, most_points=2000
    )
    path = OptimalPath.fit(maps, speeds_rpm=np.linspace(1300.0, 1700.0, 5), nodes=17)
    model = ChargeModel.fit(path, plant, speeds=15, positions=41)
    return design_controller(path=path, model=model)
