import json

import numpy as np
import pytest

from plant import CrankAnglePlant, Engine, ParameterError, ValveCommand
from uncertainty.delta_result import QUANTITIES
from uncertainty.deltas import (
    ActuatorOscillationDelta,
    HelmholtzDelta,
    JointDelta,
    ParametricDelta,
    SensorDelta,
    SumDelta,
    default_deltas,
    evaluate_all,
)
from uncertainty.parameters import UncertainParameter, UncertaintySet

NOTHING = UncertaintySet(())
GRID = {"speeds_rpm": (1500.0, 6000.0), "lifts_mm": (3.0,), "durations_deg": (120.0, 180.0, 260.0)}
GAIN = SensorDelta(UncertaintySet.sensors().only(["MAF gain error"]))
# Pressures and areas together: the charge scales with them, which is known without a simulation.
DENSITY = ParametricDelta(
    UncertaintySet(
        (
            UncertainParameter(
                "density",
                0.9,
                1.2,
                1.0,
                ("ambient_pressure", "exhaust_pressure", "flow_coefficient", "throttle.scale"),
            ),
        )
    ),
    NOTHING,
)


def test_the_sum_of_known_factors_is_their_sum():
    result = (DENSITY + GAIN).evaluate(**GRID)
    charge, loss = result.changes("charge"), result.changes("loss")
    # 0.02 % and 0.1 % is what the plant claims of its charge and loss
    assert charge[0] == pytest.approx(-0.1 - 0.03, abs=2e-4)
    assert charge[1] == pytest.approx(0.2 + 0.03, abs=2e-4)
    assert loss[0] == pytest.approx(-0.1, abs=1e-3)
    assert loss[1] == pytest.approx(0.2, abs=1e-3)
    assert "sum" in result.worst_charge.case


def test_known_factors_at_once_multiply_and_the_interaction_is_their_product():
    result = JointDelta((DENSITY, GAIN)).evaluate(**GRID)
    assert len(result.cases) == 4
    for case, k, g in (
        ("density low + MAF gain error low", 0.9, -0.03),
        ("density high + MAF gain error high", 1.2, 0.03),
    ):
        data = result.dataset.sel(case=case)
        assert data.charge.values == pytest.approx(k * (1.0 + g) - 1.0, abs=2e-4)
        assert data.interaction_charge.values == pytest.approx((k - 1.0) * g, abs=2e-5)
        assert data.interaction_loss.values == pytest.approx(0.0, abs=1e-12)
    assert result.interaction("charge").value == pytest.approx(0.2 * 0.03, abs=2e-5)


@pytest.mark.parametrize(
    "delta", [HelmholtzDelta(), ActuatorOscillationDelta(), ParametricDelta(), GAIN]
)
def test_a_joint_delta_of_one_is_that_delta(delta):
    alone, joint = delta.evaluate(**GRID), JointDelta((delta,)).evaluate(**GRID)
    assert joint.cases == alone.cases
    for quantity in QUANTITIES:
        np.testing.assert_array_equal(joint.changes(quantity), alone.changes(quantity))
        assert joint.interaction(quantity).value == 0.0


def test_a_sum_of_one_is_its_envelope():
    delta = ActuatorOscillationDelta()
    alone, total = delta.evaluate(**GRID), SumDelta((delta,)).evaluate(**GRID)
    for quantity in QUANTITIES:
        low, high = total.changes(quantity)
        np.testing.assert_array_equal(low, alone.lower(quantity))
        np.testing.assert_array_equal(high, alone.upper(quantity))


def test_both_effects_of_section_6_at_once_are_one_full_plant():
    runner = HelmholtzDelta(NOTHING)
    motion = ActuatorOscillationDelta(NOTHING, NOTHING, 0.0)
    command = ValveCommand(3.0, 180.0)
    neither, first, second, both = (
        CrankAnglePlant(runner=r, oscillation=o).steady_cycle(6000.0, command).air_charge[0]
        for r, o in ((False, False), (True, False), (False, True), (True, True))
    )
    result = JointDelta((runner, motion)).evaluate(**GRID)
    assert result.cases == ("runner + oscillation",)
    assert "without runner" in result.against
    data = result.dataset.isel(case=0).sel(speed=6000.0, lift=3.0, duration=180.0)
    assert float(data.charge) == pytest.approx(both / neither - 1.0, rel=1e-8)
    expected = (both - first - second + neither) / neither
    assert float(data.interaction_charge) == pytest.approx(expected, rel=1e-6)
    # The members of a sum are seen from the same nominal plant.
    total = (runner + motion).evaluate(**GRID)
    added = total.dataset.charge.isel(case=0).sel(speed=6000.0, lift=3.0, duration=180.0)
    assert float(added) == pytest.approx((first + second - 2.0 * neither) / neither, rel=1e-8)


def test_of_too_many_cases_the_worst_of_each_member_take_part():
    members = ActuatorOscillationDelta(), ParametricDelta()
    result = JointDelta(members, most_cases=8).evaluate(**GRID)
    first, second = result.members
    for end in ("lowest", "highest"):
        case = " + ".join(getattr(r, end)("charge").case for r in (first, second))
        assert case in result.cases
        assert " + ".join(getattr(r, end)("loss").case for r in (first, second)) in result.cases
    assert len(result.cases) <= 6


def test_a_joint_case_is_one_plant_with_all_parameters():
    pressure = ParametricDelta(UncertaintySet.engine().only(["temperature"]), NOTHING)
    offset = ActuatorOscillationDelta(NOTHING, jitter=0.0)
    result = JointDelta((pressure, offset)).evaluate(**GRID)
    engine = Engine.paper()
    hot = engine.replace(temperature=1.1 * engine.temperature)
    before = CrankAnglePlant(engine).steady_cycle(6000.0, ValveCommand(3.0, 180.0))
    after = CrankAnglePlant(hot).steady_cycle(6000.0, ValveCommand(3.0, 187.2))
    change = result.dataset.sel(
        case="temperature high + duration offset high", speed=6000.0, lift=3.0, duration=180.0
    )
    assert float(change.charge) == pytest.approx(
        after.air_charge[0] / before.air_charge[0] - 1.0, rel=1e-8
    )


def test_sums_are_flat_and_members_may_not_count_twice():
    total = HelmholtzDelta() + ActuatorOscillationDelta() + GAIN
    assert [type(d) for d in total.deltas] == [
        HelmholtzDelta,
        ActuatorOscillationDelta,
        SensorDelta,
    ]
    with pytest.raises(ParameterError, match="count twice"):
        (GAIN + SensorDelta()).evaluate(**GRID)
    with pytest.raises(ParameterError, match="one delta or more"):
        SumDelta(())
    with pytest.raises(ParameterError, match="full plants"):
        SumDelta((JointDelta((GAIN,)),))
    with pytest.raises(TypeError):
        GAIN + 1.0


def test_all_deltas_tell_their_progress_and_their_records():
    calls = []
    found = evaluate_all(
        speeds_rpm=(1500.0, 3000.0, 6000.0),
        lifts_mm=(3.0,),
        durations_deg=(120.0, 180.0, 260.0),
        progress=lambda *call: calls.append(call),
    )
    assert [result.name for result in found.results] == [d.name for d in default_deltas()]
    assert calls[-1][0] == calls[-1][1]
    assert calls == sorted(calls)
    assert len({total for _, total in calls}) == 1
    records = json.loads(json.dumps(found.records(), allow_nan=False))
    assert len(records) == 6
    assert all(set(r) == {"name", "worst_charge", "worst_loss", "at", "loss_at"} for r in records)
    assert found.total.dataset.speed.values.tolist() == [1500.0, 6000.0]
    assert found["sensors"].worst_charge.value == pytest.approx(0.03, abs=2e-3)
    assert json.loads(json.dumps(found.joint.to_dict(), allow_nan=False))["interaction"]
    assert str(found).count("\n") == 5
    # Joint cases are made of the members' cases, so those added up lie in the sum's envelope.
    joint, total = found.joint.dataset, found.total
    low, high = total.lower("charge"), total.upper("charge")
    added = joint.charge - joint.interaction_charge
    assert bool(((added >= low - 1e-12) & (added <= high + 1e-12)).all())
