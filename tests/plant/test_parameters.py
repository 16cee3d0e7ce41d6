from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from plant import CrankAnglePlant, Engine, HelmholtzRunner, ParameterError, Throttle, Valvetrain
from plant.parameters import PRINTED_RUNNER_AREA, PRINTED_TEMPERATURE

SI_FIELDS = [
    ("manifold_volume", "m3"),
    ("runner_area", "m2"),
    ("runner_volume", "m3"),
    ("displaced_volume", "m3"),
    ("clearance_volume", "m3"),
    ("bore", "m"),
    ("stroke", "m"),
    ("flow_coefficient", "kg/s/mm"),
    ("ambient_pressure", "Pa"),
    ("exhaust_pressure", "Pa"),
    ("gas_constant", "J/(kg K)"),
    ("temperature", "K"),
]


def test_paper_engine_has_the_values_of_appendix_a():
    e = Engine.paper()
    assert (e.n_cylinders, e.manifold_volume, e.runner_volume) == (4, 1e-3, 5e-4)
    assert (e.displaced_volume, e.clearance_volume) == (4e-4, 4e-5)
    assert (e.bore, e.stroke, e.runner_constant) == (0.0806, 0.088, 1.288)
    assert (e.ambient_pressure, e.exhaust_pressure, e.gas_constant) == (1e5, 1.1e5, 287.0)
    assert e.flow_coefficient == 0.0175
    assert e.event_angle_deg == 180.0
    # corrected and identified, with the printed values kept by name
    assert (e.runner_area, PRINTED_RUNNER_AREA) == (1.43e-3, 1.43e-4)
    assert (e.temperature, PRINTED_TEMPERATURE) == (290.0, 316.0)


def test_resonator_is_that_of_section_4():
    h = HelmholtzRunner()
    for speed, hertz, damping in (
        (750, 176, 0.005),
        (1500, 176, 0.005),
        (2250, 183, 0.0775),
        (3000, 190, 0.15),
        (6000, 190, 0.15),
    ):
        assert h.natural_frequency(speed) == pytest.approx(2.0 * math.pi * hertz, rel=1e-12)
        assert h.damping_ratio(speed) == pytest.approx(damping, rel=1e-12)
    constant = HelmholtzRunner.constant(180.0, 0.1)
    assert constant.natural_frequency(5000.0) == constant.natural_frequency(800.0)


def test_valvetrain_oscillation_decays_as_appendix_b_says():
    v = Valvetrain()
    assert math.exp(-v.oscillation_decay_rate * 2.5e-3 / 4.0) == pytest.approx(0.17 / 0.21)
    assert v.lowest_lift_mm == pytest.approx(0.2 / 0.7, rel=1e-12)


def test_replace_makes_a_variant_and_leaves_the_original():
    e = Engine.paper()
    warm = e.replace(temperature=316.0, cylinder_flow_factors=[1, 0.9, 1, 1])
    assert (e.temperature, warm.temperature) == (290.0, 316.0)
    assert warm.flow_coefficients == pytest.approx((0.0175, 0.01575, 0.0175, 0.0175))
    assert e.flow_coefficients == (0.0175,) * 4
    with pytest.raises(dataclasses.FrozenInstanceError):
        e.temperature = 300.0


@pytest.mark.parametrize(("name", "unit"), SI_FIELDS)
@pytest.mark.parametrize("value", [math.nan, math.inf, -1.0, 0.0])
def test_engine_refuses_impossible_values(name, unit, value):
    with pytest.raises(ParameterError) as e:
        Engine(**{name: value})
    assert f"{name} is {value:g} {unit}, but must be finite and above 0 {unit}" in str(e.value)


@pytest.mark.parametrize("value", ["290", None, True, [290.0], 290j])
def test_engine_refuses_what_is_no_number(value):
    with pytest.raises(ParameterError, match="but must be a number in K"):
        Engine(temperature=value)


@pytest.mark.parametrize(
    ("build", "fragments"),
    [
        (lambda: Engine(n_cylinders=0), ("n_cylinders is 0", "from 1 to 24")),
        (lambda: Engine(n_cylinders=4.0), ("n_cylinders", "whole number", "4.0")),
        (
            lambda: Engine.paper().replace(temprature=316.0),
            ("no field 'temprature'", "did you mean 'temperature'", "manifold_volume"),
        ),
        (lambda: Engine(valvetrain=None), ("valvetrain is None", "Valvetrain")),
        (lambda: Engine(helmholtz=1.0), ("helmholtz is 1.0", "HelmholtzRunner")),
        (
            lambda: Engine(cylinder_flow_factors=(1.0, 0.9)),
            ("2 values", "4 cylinders", "one value per cylinder"),
        ),
        (
            lambda: Engine(cylinder_flow_factors=(1.0, 0.9, -1.0, 1.0)),
            ("cylinder_flow_factors[2] is -1", "above 0"),
        ),
        (
            lambda: Valvetrain(opening_slope_mm_s=-3500.0),
            ("opening_slope_mm_s is -3500 mm/s", "above 0 mm/s"),
        ),
        (lambda: Valvetrain(roundness=1.0), ("roundness is 1", "(0, 1)")),
        (lambda: Valvetrain(seating_duration=math.nan), ("seating_duration is nan s", "above 0 s")),
        (
            lambda: Valvetrain(oscillation_decay_ratio=1.2),
            ("oscillation_decay_ratio is 1.2", "(0, 1]"),
        ),
        (lambda: Valvetrain().replace(slope=1.0), ("no field 'slope'",)),
        (
            lambda: HelmholtzRunner(low_speed_damping=1.0),
            ("low_speed_damping is 1", "(0, 1)", "underdamped"),
        ),
        (
            lambda: HelmholtzRunner(low_speed_rpm=3000.0),
            ("high_speed_rpm is 3000 rpm", "above low_speed_rpm = 3000 rpm"),
        ),
        (
            lambda: HelmholtzRunner.constant(-1.0, 0.1),
            ("low_speed_frequency_hz is -1 Hz", "above 0 Hz"),
        ),
        (
            lambda: Throttle(wide_open_deg=5.0),
            ("throttle area at 5 deg", "kg/s", "above 0", "Eq. 19"),
        ),
        (lambda: Throttle(scale=0.0), ("scale is 0 kg/s", "above 0 kg/s")),
    ],
)
def test_parameters_are_refused_with_value_bound_and_unit(build, fragments):
    with pytest.raises(ParameterError) as e:
        build()
    for fragment in fragments:
        assert fragment in str(e.value)


def test_numpy_scalars_are_stored_as_plain_numbers():
    engine = Engine(n_cylinders=np.int64(4), temperature=np.float32(290.0))
    assert type(engine.n_cylinders) is int
    assert type(engine.temperature) is float
    assert CrankAnglePlant(engine).fingerprint == CrankAnglePlant(Engine()).fingerprint


@pytest.mark.parametrize("factors", [None, 1.0, "1111", ("a", 1, 1, 1), (1, 1, 1, -1)])
def test_impossible_flow_factors_are_refused(factors):
    with pytest.raises(ParameterError, match="cylinder_flow_factors"):
        Engine(cylinder_flow_factors=factors)
