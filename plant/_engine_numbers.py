"""Compiled view of an engine: one row of numbers, and what the kernel needs of it.

The formulas are the package's own (`runner`, `valve`, `parameters`), compiled as they stand: a
formula reads its parameters by name, from an `Engine` or from the numbers here alike. So one
row an engine serves a batch in which any number of parameters vary.
"""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import numpy as np

from . import runner, valve
from ._compile import compiled
from ._layout import KernelEngine
from .kinematics import FloatArray
from .orifice import REFERENCE_PRESSURE, REFERENCE_TEMPERATURE
from .parameters import _POSITIVE_FIELDS, Engine, Throttle, Valvetrain, between_speeds


class ValvetrainNumbers(NamedTuple):
    """Numbers of a `Valvetrain`, in the order of its fields."""

    opening_slope_mm_s: float
    closing_slope_mm_s: float
    seating_slope_mm_s: float
    seating_duration: float
    roundness: float
    maximum_lift_mm: float
    oscillation_amplitude: float
    oscillation_period: float
    oscillation_decay_ratio: float


class HelmholtzNumbers(NamedTuple):
    """Numbers of a `HelmholtzRunner`, in the order of its fields."""

    low_speed_rpm: float
    high_speed_rpm: float
    low_speed_frequency_hz: float
    high_speed_frequency_hz: float
    low_speed_damping: float
    high_speed_damping: float


class ThrottleNumbers(NamedTuple):
    """Numbers of a `Throttle`, in the order of its fields."""

    scale: float
    constant: float
    linear: float
    quadratic: float
    wide_open_deg: float


class EngineNumbers(NamedTuple):
    """Numbers of an `Engine`, in the order of its fields, the factors of its cylinders apart."""

    manifold_volume: float
    runner_area: float
    runner_volume: float
    runner_constant: float
    displaced_volume: float
    clearance_volume: float
    bore: float
    stroke: float
    flow_coefficient: float
    ambient_pressure: float
    exhaust_pressure: float
    gas_constant: float
    temperature: float
    valvetrain: ValvetrainNumbers
    helmholtz: HelmholtzNumbers
    throttle: ThrottleNumbers


class Options(NamedTuple):
    """Options of a plant that the kernel knows."""

    n_cylinders: int
    runner: bool
    oscillation: bool
    cam: bool  # conventional profile
    exact_orifice: bool
    resolution: float


FACTORS = len(_POSITIVE_FIELDS) + sum(  # column of a row of numbers at which the factors start
    len(part._fields) for part in (ValvetrainNumbers, HelmholtzNumbers, ThrottleNumbers)
)


def engine_row(engine: Engine) -> FloatArray:
    """All numbers of an engine, in the order of `engine_fields`."""
    parts = (engine.valvetrain, engine.helmholtz, engine.throttle)
    values = [getattr(engine, name) for name in _POSITIVE_FIELDS]
    for part in parts:
        values += [getattr(part, field.name) for field in dataclasses.fields(part)]
    return np.array([*values, *(engine.cylinder_flow_factors or (1.0,) * engine.n_cylinders)])


_runner_gain = compiled(runner.runner_gain)
_forcing_length = compiled(runner.forcing_length)
_decay_rate = compiled(vars(Valvetrain)["oscillation_decay_rate"].fget)
_between_speeds = compiled(between_speeds)
lowest_lift_mm = compiled(vars(Valvetrain)["lowest_lift_mm"].fget)
highest_lift_mm = compiled(valve.highest_lift_mm)
throttle_area = compiled(Throttle.area)
throttle_closed_deg = compiled(vars(Throttle)["closed_deg"].fget)


@compiled
def engine_numbers(row: np.ndarray) -> EngineNumbers:
    """Name the numbers of a row."""
    valvetrain = ValvetrainNumbers(
        row[13], row[14], row[15], row[16], row[17], row[18], row[19], row[20], row[21]
    )
    helmholtz = HelmholtzNumbers(row[22], row[23], row[24], row[25], row[26], row[27])
    throttle = ThrottleNumbers(row[28], row[29], row[30], row[31], row[32])
    return EngineNumbers(
        row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7], row[8], row[9], row[10],
        row[11], row[12], valvetrain, helmholtz, throttle,
    )  # fmt: skip


@compiled
def kernel_engine(engine: EngineNumbers, options: Options) -> KernelEngine:
    """Gather what the kernel needs of an engine."""
    gas = engine.gas_constant * engine.temperature
    v = engine.valvetrain
    return KernelEngine(
        options.n_cylinders,
        engine.manifold_volume / gas,
        gas,
        0.5 * engine.displaced_volume,
        engine.clearance_volume,
        engine.ambient_pressure,
        engine.exhaust_pressure,
        _runner_gain(engine) if options.runner else 0.0,
        _forcing_length(engine),
        v.opening_slope_mm_s,
        v.closing_slope_mm_s,
        v.seating_slope_mm_s,
        v.seating_duration,
        v.roundness,
        v.oscillation_amplitude if options.oscillation else 0.0,
        2.0 * math.pi / v.oscillation_period,
        _decay_rate(v),
        options.cam,
        options.exact_orifice,
        math.sqrt(REFERENCE_TEMPERATURE / engine.temperature) / REFERENCE_PRESSURE,
    )


@compiled
def kernel_engine_of(row: np.ndarray, options: Options) -> KernelEngine:
    """Gather what the kernel needs of an engine given as a row of numbers."""
    return kernel_engine(engine_numbers(row), options)


@compiled
def natural_frequency(helmholtz: HelmholtzNumbers, speed_rpm: float) -> float:
    """Natural frequency of the runner, rad/s."""
    return (
        2.0
        * math.pi
        * _between_speeds(
            helmholtz.low_speed_frequency_hz,
            helmholtz.high_speed_frequency_hz,
            helmholtz.low_speed_rpm,
            helmholtz.high_speed_rpm,
            speed_rpm,
        )
    )


@compiled
def damping_ratio(helmholtz: HelmholtzNumbers, speed_rpm: float) -> float:
    """Damping ratio of the runner, 1."""
    return _between_speeds(
        helmholtz.low_speed_damping,
        helmholtz.high_speed_damping,
        helmholtz.low_speed_rpm,
        helmholtz.high_speed_rpm,
        speed_rpm,
    )
