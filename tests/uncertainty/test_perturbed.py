import numpy as np
import pytest

from plant import CrankAnglePlant, Engine, ParameterError, ValveCommand
from plant.sensors import MafSensor, MapSensor
from uncertainty.parameters import UncertainParameter, UncertaintySet
from uncertainty.perturbed import PerturbedPlants, duration_offsets, perturbed_fields
from uncertainty.sampling import Sample, draw, nominal_sample, one_at_a_time

POINTS = np.array([(1500.0, 3.0, 120.0), (6000.0, 5.0, 220.0)])


@pytest.mark.parametrize(
    ("uncertain", "count"),
    [
        (UncertaintySet.plant(), 4),
        (UncertaintySet.plant() + UncertaintySet.cylinders(4), 4),
        (UncertaintySet.delivered_duration(), 2),
        (UncertaintySet.cylinders(4), 3),
    ],
    ids=["plant", "plant and cylinders", "common offset", "cylinders"],
)
def test_the_batch_equals_single_runs(uncertain, count):
    nominal = CrankAnglePlant(oscillation=True)
    plants = PerturbedPlants(nominal, draw(uncertain, count, seed=2))
    batch = plants.steady_cycles(*POINTS.T)
    assert batch["air_charge"].dims[:2] == ("sample", "point")
    for i in range(count):
        plant = plants.plant_at(i)
        assert (plant.runner, plant.oscillation) == (True, True)
        for j, (speed, lift, duration) in enumerate(POINTS):
            commands = plants.commands_at(i, ValveCommand(lift, duration), speed)
            cycle = plant.steady_cycle(speed, commands, on_infeasible="limit")
            for name, values in (
                ("air_charge", cycle.air_charge),
                ("pumping_loss", cycle.pumping_loss),
            ):
                # four equal commands are compared cycle by cycle, one command event by event
                own = np.broadcast_to(batch[name].isel(sample=i, point=j).to_numpy(), 4)
                assert own == pytest.approx(values, rel=1e-5), (name, i, j)


def test_fields_are_the_engine_times_the_factors():
    engine = Engine.paper()
    uncertain = UncertaintySet.plant()
    sample = draw(uncertain, 3, seed=0)
    plants = PerturbedPlants(CrankAnglePlant(engine), sample)
    for i in range(3):
        own, at = plants.plant_at(i).engine, sample.at(i)
        assert own.temperature == pytest.approx(290.0 * at["temperature"], rel=1e-14)
        for name, nominal in (("low_speed_damping", 0.005), ("high_speed_damping", 0.15)):
            damping = getattr(own.helmholtz, name)
            assert damping == pytest.approx(nominal * at["runner damping"], rel=1e-14)
        assert own.valvetrain.oscillation_period == pytest.approx(
            2.5e-3 * at["oscillation period"], rel=1e-14
        )
        assert own.bore == engine.bore
    assert "duration_offset" not in plants.fields()


def test_the_nominal_sample_is_the_nominal_plant():
    plant = CrankAnglePlant()
    plants = PerturbedPlants(plant, nominal_sample(UncertaintySet.plant()))
    assert plants.plant_at(0).engine == plant.engine
    own = plants.steady_cycles(*POINTS.T)
    reference = plant.steady_cycles(*POINTS.T)
    assert np.array_equal(own["air_charge"].isel(sample=0), reference["air_charge"])


def test_a_flow_factor_acts_on_its_cylinder_alone():
    sample = one_at_a_time(UncertaintySet.cylinders(4))  # row 0: first cylinder, 3 % less
    plants = PerturbedPlants(CrankAnglePlant(), sample)
    assert plants.plant_at(0).engine.flow_coefficients == pytest.approx(
        [0.97 * 0.0175, 0.0175, 0.0175, 0.0175]
    )
    charge = plants.steady_cycles(1500.0, 3.0, 120.0)["air_charge"].isel(point=0).to_numpy()
    nominal = CrankAnglePlant().steady_cycle(1500.0, ValveCommand(3.0, 120.0)).air_charge[0]
    change = charge[0] / nominal - 1.0
    assert change[0] < -0.002
    assert np.abs(change[1:]).max() < 0.2 * abs(change[0])


def test_offsets_are_time_and_add():
    whole = UncertaintySet.delivered_duration() + UncertaintySet.cylinders(4)
    values = whole.nominal[None]
    values[0, 0] = 1e-4
    values[0, whole.names.index("duration offset 2")] = -2e-4
    expected = [1e-4, -1e-4, 1e-4, 1e-4]
    assert duration_offsets(whole, values, 4) == pytest.approx(np.array([expected]))
    plants = PerturbedPlants(CrankAnglePlant(), Sample(whole, values))
    commands = plants.commands_at(0, ValveCommand(3.0, 120.0, -5.0), 1500.0)
    # 0.1 ms at 1500 rpm (9 deg a ms) is 0.9 deg
    assert [c.duration_deg for c in commands] == pytest.approx([120.9, 119.1, 120.9, 120.9])
    assert {(c.lift_mm, c.opening_deg) for c in commands} == {(3.0, -5.0)}
    common = UncertaintySet.delivered_duration()
    assert duration_offsets(common, np.array([[1e-4], [-2e-4]]), 4).tolist() == [[1e-4], [-2e-4]]


def test_factors_on_one_field_multiply_and_apply_to_a_given_value():
    def factor(name):
        return UncertainParameter(name, 0.9, 1.1, 1.0, ("temperature",))

    value = UncertainParameter("air", 280.0, 310.0, 290.0, ("temperature",), False, "K")
    values = np.array([[1.1, 0.9]])
    both = UncertaintySet((factor("one"), factor("two")))
    fields = perturbed_fields(Engine.paper(), both, values)
    assert fields["temperature"] == pytest.approx([290.0 * 0.99], rel=1e-14)
    for order in ((value, factor("one")), (factor("one"), value)):
        own = UncertaintySet(order)
        row = np.array([[300.0 if p.name == "air" else 1.1 for p in order]])
        assert perturbed_fields(Engine.paper(), own, row)["temperature"] == pytest.approx([330.0])


def test_sensors_of_a_sample():
    uncertain = UncertaintySet.sensors()
    plants = PerturbedPlants(CrankAnglePlant(), draw(uncertain, 2, seed=1))
    at = plants.sample.at(1)
    maf = plants.maf_at(1, MafSensor(relative_noise=0.02))
    assert (maf.gain_error, maf.time_constant, maf.delay, maf.relative_noise) == (
        at["MAF gain error"],
        at["MAF time constant"],
        at["MAF delay"],
        0.02,
    )
    assert plants.map_at(1, MapSensor()).offset == at["MAP offset"]
    assert plants.plant_at(1) is plants.plant
    other = PerturbedPlants(CrankAnglePlant(), draw(UncertaintySet.runner(), 1, seed=1))
    assert other.maf_at(0, MafSensor()) == MafSensor()


def test_a_valve_that_can_no_longer_reach_its_lift_turns_round_early():
    slow = UncertaintySet.engine().only(["opening slope", "closing slope"])
    plants = PerturbedPlants(CrankAnglePlant(), Sample(slow, [[0.9, 0.9], [1.0, 1.0]]))
    lift = plants.steady_cycles(6000.0, 7.0, 135.0)["delivered_lift_mm"].to_numpy().reshape(2, -1)
    assert lift[1] == pytest.approx(7.0)  # 7 mm needs 134.7 deg
    assert (lift[0] < 6.5).all()


def test_options_and_progress_are_passed_on():
    calls = []
    plants = PerturbedPlants(CrankAnglePlant(), draw(UncertaintySet.plant(), 3, seed=0))
    mean = plants.steady_cycles(
        *POINTS.T, per_cylinder=False, progress=lambda *call: calls.append(call)
    )
    assert mean["air_charge"].shape == (3, 2)
    assert calls[-1] == (6, 6)
    assert len(plants) == 3


def test_an_engine_that_the_set_does_not_suit_is_refused():
    with pytest.raises(ParameterError, match=r"flow factor 4 is 'cylinder_flow_factors\[3\]'"):
        PerturbedPlants(
            CrankAnglePlant(Engine.paper().replace(n_cylinders=3)),
            nominal_sample(UncertaintySet.cylinders(4)),
        )
