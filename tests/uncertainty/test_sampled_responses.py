import matplotlib.pyplot as plt
import numpy as np
import pytest

from plant import CrankAnglePlant, Engine, MafSensor, MeanValuePlant, ParameterError, ValveCommand
from plant.air_path import event_time
from uncertainty.frequency import ModeResponses
from uncertainty.lifted_full_plant import full_plant_response
from uncertainty.lifted_mean_value import mean_value_modes
from uncertainty.parameters import UncertaintySet
from uncertainty.perturbed import PerturbedPlants
from uncertainty.sampled_responses import sampled_mode_responses
from uncertainty.sampling import Sample, draw, nominal_sample, one_at_a_time

PLANT = CrankAnglePlant(oscillation=True)
COMMAND = ValveCommand(4.0, 150.0)
SPEED = 3000.0
THETA = np.linspace(-np.pi, np.pi, 9)
ALL = UncertaintySet.plant() + UncertaintySet.sensors()


def sampled(plants, **options):
    return sampled_mode_responses(plants, COMMAND, SPEED, **{"theta": THETA, **options})


def only(name, *values):
    """Plants in which one parameter has given values."""
    uncertain = ALL.only([name])
    return PerturbedPlants(PLANT, Sample(uncertain, np.array(values)[:, None]))


@pytest.mark.parametrize("output", ["air_charge", "maf"])
def test_the_nominal_plant_has_no_residual(output):
    result = sampled(PerturbedPlants(PLANT, nominal_sample(ALL)), output=output)
    assert np.abs(result.relative_to().response).max() == 0.0
    assert result.charge[0] == result.reference_charge


@pytest.mark.parametrize("output", ["air_charge", "maf"])
@pytest.mark.parametrize(("command", "speed_rpm"), [(COMMAND, SPEED), (ValveCommand(5, 220), 6000)])
def test_samples_against_the_lifted_response_of_each_plant(output, command, speed_rpm):
    plants = PerturbedPlants(PLANT, draw(ALL, 5, seed=3))
    result = sampled_mode_responses(
        plants, command, speed_rpm, output=output, theta=THETA, modes=(0, 1, 2, 3)
    )
    T = event_time(speed_rpm, 4)
    omega = THETA[4:] / (4 * T)
    steady = PLANT.steady_cycle(speed_rpm, command).air_charge[0]
    assert result.reference_charge == pytest.approx(steady, rel=1e-9)
    for i in range(5):
        lifted = full_plant_response(
            plants.plant_at(i),
            plants.commands_at(i, command, speed_rpm),
            speed_rpm,
            output=output,
            maf=plants.maf_at(i, MafSensor()),
            omega=omega,
            relative=False,
            on_infeasible="limit",
        )
        unit = command.duration_deg / steady * (T if output == "maf" else 1.0)
        largest = np.abs(result.response[i]).max()
        for q in range(4):
            truth = unit * lifted.mode_band(q)[1]
            np.testing.assert_allclose(result.mode(q)[i], truth, atol=3e-3 * largest)


def test_a_gain_error_of_three_percent_is_a_residual_of_three_percent():
    plants = only("MAF gain error", 0.03, -0.01)
    found = sampled(plants, output="maf").relative_to()
    np.testing.assert_allclose(found.response[0], 0.03, atol=1e-12)
    np.testing.assert_allclose(found.response[1], -0.01, atol=1e-12)
    np.testing.assert_array_equal(sampled(plants).relative_to().response, 0.0)
    assert found.worst == 0
    np.testing.assert_allclose(found.envelope, 0.03, atol=1e-12)


def test_a_delay_turns_each_mode_by_its_angle():
    # A delay by one event is one shift, exactly.
    T = event_time(SPEED, 4)
    plants = only("MAF gain error", 0.0)
    prompt, late = (
        sampled(plants, output="maf", maf=MafSensor(delay=d)).response[0] for d in (0.0, T)
    )
    z = np.exp(1j * (THETA + 2.0 * np.pi * np.arange(3)[:, None]) / 4)
    np.testing.assert_allclose(late, prompt / z, rtol=1e-9)


def test_the_gain_is_relative_to_the_nominal_charge():
    # Thinner air: charge and change of charge fall alike, which a response relative to the own
    # charge would hide.
    values = np.array([[0.97, 0.97]])
    plants = PerturbedPlants(
        PLANT, Sample(ALL.only(["ambient pressure", "exhaust pressure"]), values)
    )
    engine = Engine.paper()
    thin = engine.replace(
        ambient_pressure=0.97 * engine.ambient_pressure,
        exhaust_pressure=0.97 * engine.exhaust_pressure,
    )
    step = np.array([-0.5, 0.0, 0.5])
    before, after = (
        CrankAnglePlant(e, oscillation=True)
        .steady_cycles(SPEED, 4.0, 150.0 + step)
        .air_charge.values.mean(axis=-1)
        for e in (engine, thin)
    )
    result = sampled(plants)
    truth = (after[2] - after[0]) / (before[2] - before[0]) - 1.0
    assert -0.04 < truth < -0.005
    np.testing.assert_allclose(result.relative_to().mode(0)[0, 4], truth, atol=1e-3)
    assert result.charge[0] == pytest.approx(after[1], rel=1e-6)
    gain = (before[2] - before[0]) / before[1] * 150.0
    assert result.nominal.mode(0)[4] == pytest.approx(gain, rel=2e-3)
    # To another reference the gains are others, the residuals are the same.
    twice = sampled(plants, reference_charge=2.0 * result.reference_charge)
    np.testing.assert_allclose(2.0 * twice.response, result.response, rtol=1e-12)
    np.testing.assert_allclose(
        twice.relative_to().response, result.relative_to().response, atol=1e-12
    )


def test_a_duration_offset_moves_the_operating_point():
    offset = 1.5e-4  # s, 2.7 deg at 3000 rpm
    result = sampled(only("duration offset", offset))
    moved = 150.0 + 6.0 * SPEED * offset + np.array([-0.5, 0.0, 0.5])
    charge = PLANT.steady_cycles(SPEED, 4.0, moved).air_charge.values.mean(axis=-1)
    assert result.charge[0] == pytest.approx(charge[1], rel=1e-6)
    truth = (charge[2] - charge[0]) / result.reference_charge * 150.0
    assert result.mode(0)[0, 4] == pytest.approx(truth, rel=2e-3)


def test_residuals_against_the_mean_value_plant():
    plain = CrankAnglePlant()
    maps = MeanValuePlant.fit(plain, tolerance=0.05, most_points=512)
    modes = mean_value_modes(maps.dynamics(), COMMAND, SPEED, output="maf", theta=THETA)
    plants = PerturbedPlants(plain, nominal_sample(UncertaintySet.sensors()))
    result = sampled(plants, output="maf")
    found = result.relative_to(modes)
    truth = (result.response[0] - modes.response) / modes.response
    np.testing.assert_array_equal(found.response[0], truth)
    # An even flow is an early one: hardly seen in the mean, but in the alternating mode.
    assert np.abs(found.mode(0)[0, 4]) < 0.05
    assert np.abs(found.mode(2)[0, 4]) > 1.0
    assert str(found).startswith(
        "duration_deg to maf at 3000 rpm against mean-value plant: at most"
    )


def test_six_cylinders_and_lift():
    six = CrankAnglePlant(Engine.paper().replace(n_cylinders=6))
    plants = PerturbedPlants(six, draw(UncertaintySet.engine(), 2, seed=1))
    result = sampled_mode_responses(
        plants, COMMAND, SPEED, input="lift_mm", theta=THETA, throttle_deg=45.0, tolerance=1e-6
    )
    assert result.response.shape == (2, 4, 9)
    step = np.array([-0.02, 0.0, 0.02])
    for i in range(2):
        cycles = plants.plant_at(i).steady_cycles(
            SPEED, 4.0 + step, 150.0, throttle_deg=45.0, on_infeasible="limit"
        )
        charge = cycles.air_charge.values.mean(axis=-1)
        truth = (charge[2] - charge[0]) / 0.04 * 4.0 / result.reference_charge
        assert result.mode(0)[i, 4] == pytest.approx(truth, abs=5e-3)


def test_progress_is_told():
    seen = []
    plants = PerturbedPlants(PLANT, one_at_a_time(UncertaintySet.delivered_duration()))
    result = sampled(plants, progress=lambda done, of: seen.append((done, of)))
    assert seen == [(1, 2), (2, 2)]
    assert len(result) == 2
    assert str(result).startswith("2 plants at 3000 rpm, duration_deg to air_charge: relative gain")


def test_the_picture():
    plants = PerturbedPlants(PLANT, draw(ALL, 3, seed=1))
    ax = sampled(plants, output="maf").relative_to().plot()
    assert ax.get_ylabel() == "relative residual (1)"
    assert len(ax.get_legend().get_texts()) == 6
    plt.close(ax.figure)


def test_unequal_cylinders_are_refused():
    plants = PerturbedPlants(PLANT, draw(UncertaintySet.cylinders(4), 2, seed=1))
    with pytest.raises(ParameterError, match=r"sample 0 differ .* use full_plant_response"):
        sampled(plants)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"modes": (0, 4)}, "4 cylinders have 4 modes"),
        ({"theta": [0.0, 4.0]}, "theta is 4 rad, but must be in"),
        ({"theta": []}, "must be a list of cycle phases"),
        ({"output": "map"}, "output is 'map'"),
        ({"input": "opening_deg"}, "input is 'opening_deg'"),
        ({"reference_charge": 0.0}, "reference_charge is 0 kg"),
    ],
)
def test_bad_options_are_refused(options, message):
    with pytest.raises(ParameterError, match=message):
        sampled(only("MAF gain error", 0.0), **options)


def test_nominal_responses_that_do_not_fit_are_refused():
    result = sampled(only("MAF gain error", 0.0))
    other = ModeResponses((0, 1), THETA, np.ones((2, 9)), 4, "another plant")
    with pytest.raises(ParameterError, match=r"another plant has modes \(0, 1\) of 4 cylinders"):
        result.relative_to(other)
    dead = ModeResponses((0, 1, 2), THETA, np.ones((3, 9)) * [[1], [1], [0]], 4, "another plant")
    with pytest.raises(ParameterError, match="has the gain 0 in mode 2"):
        result.relative_to(dead)
    with pytest.raises(ParameterError, match="the response has shape"):
        ModeResponses((0, 1), THETA, np.ones((3, 9)), 4, "another plant")
