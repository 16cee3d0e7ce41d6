"""What the plant hands to the compiled kernel, and what it makes of the kernel's status."""

from __future__ import annotations

import math

from . import _layout as layout
from .errors import SimulationError
from .orifice import REFERENCE_PRESSURE, REFERENCE_TEMPERATURE
from .parameters import Engine
from .runner import forcing_amplitude, runner_gain


def kernel_engine(
    engine: Engine, runner: bool, oscillation: bool, profile: str, orifice: str
) -> layout.KernelEngine:
    """Gather what the kernel needs of an engine."""
    gas = engine.gas_constant * engine.temperature
    v = engine.valvetrain
    return layout.KernelEngine(
        n_cylinders=int(engine.n_cylinders),
        capacity=float(engine.manifold_volume / gas),
        gas=float(gas),
        half_stroke_volume=0.5 * engine.displaced_volume,
        clearance_volume=float(engine.clearance_volume),
        ambient_pressure=float(engine.ambient_pressure),
        exhaust_pressure=float(engine.exhaust_pressure),
        runner_gain=float(runner_gain(engine)) if runner else 0.0,
        # per crank speed in rad/s: 30/pi rpm
        runner_forcing=float(forcing_amplitude(engine, 30.0 / math.pi)),
        opening_slope=float(v.opening_slope_mm_s),
        closing_slope=float(v.closing_slope_mm_s),
        seating_slope=float(v.seating_slope_mm_s),
        seating_duration=float(v.seating_duration),
        roundness=float(v.roundness),
        oscillation_amplitude=float(v.oscillation_amplitude) if oscillation else 0.0,
        oscillation_frequency=2.0 * math.pi / v.oscillation_period,
        oscillation_decay=float(v.oscillation_decay_rate),
        cam=profile == "conventional",
        exact_orifice=orifice == "exact",
        exact_scale=math.sqrt(REFERENCE_TEMPERATURE / engine.temperature) / REFERENCE_PRESSURE,
    )


def check_status(status: int, speed_rpm: float) -> None:
    if status == layout.RUNNER_COLLAPSED:
        raise SimulationError(
            f"the runner pressure of Eq. 5 fell below zero at {speed_rpm:g} rpm: the runner's "
            "acceleration term is too strong for this model (check runner_area, m2; the printed "
            "1.43e-4 does this) or switch it off with runner=False"
        )
    if status == layout.OPEN_AT_COMPRESSION_TDC:
        raise SimulationError(
            f"a valve that opened at a lower speed is still open at the compression TDC at "
            f"{speed_rpm:g} rpm: a camless valve moves in time, so raise the speed in smaller "
            "steps or shorten duration_deg before it rises"
        )
    if status == layout.NO_STAGE_SOLUTION:
        raise SimulationError(
            f"the manifold pressure of an implicit step did not settle at {speed_rpm:g} rpm: "
            "raise the plant's resolution"
        )
