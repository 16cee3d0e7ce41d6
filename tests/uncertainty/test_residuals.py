import dataclasses

import matplotlib.pyplot as plt
import numpy as np
import pytest

from plant import CrankAnglePlant, Engine, MafSensor, MeanValuePlant, ParameterError, ValveCommand
from uncertainty.frequency import LiftedResponse
from uncertainty.lifted_full_plant import full_plant_response
from uncertainty.lifted_mean_value import mean_value_response
from uncertainty.residuals import residual

PLANT = CrankAnglePlant()
COMMAND = ValveCommand(3.0, 120.0)
SPEED = 1500.0
OMEGA = np.linspace(0.0, np.pi * SPEED / 120.0, 5)
KINDS = ("additive", "input-multiplicative", "output-multiplicative")


def full(plant=PLANT, **options):
    return full_plant_response(plant, COMMAND, SPEED, omega=OMEGA, **options)


def some_response(seed, **changes):
    """A response with any numbers."""
    random = np.random.default_rng(seed)
    numbers = random.normal(size=(2, OMEGA.size, 4, 4))
    given = {
        "omega": OMEGA,
        "response": numbers[0] + 1j * numbers[1],
        "inputs": tuple(f"duration_deg[{k}]" for k in range(1, 5)),
        "outputs": tuple(f"maf[{k}]" for k in range(1, 5)),
        "cycle_time": 0.08,
        "source": "some plant",
        "speed_rpm": SPEED,
        "commands": (COMMAND,) * 4,
        "input_values": np.full(4, 120.0),
        "output_values": np.full(4, 1e-2),
    }
    return LiftedResponse(**{**given, **changes})


@pytest.fixture(scope="module")
def charge():
    return full()


@pytest.mark.parametrize("kind", KINDS)
def test_a_response_has_no_residual_against_itself(charge, kind):
    again = full()
    assert residual(again, charge, kind).peak == 0.0


@pytest.mark.parametrize("kind", KINDS)
def test_a_plant_has_next_to_no_residual_against_itself(kind):
    # Other amplitudes differ by the third derivative and by jumps of 1e-6 of a charge, which are
    # 4e-4 of the smaller change.
    for output in ("air_charge", "maf"):
        one, other = (full(output=output, amplitude=a) for a in (0.01, 0.0025))
        size = 2.0 if kind == "additive" else np.linalg.cond(other.response).max()
        assert 0.0 < residual(one, other, kind).peak < 5e-4 * size


@pytest.mark.parametrize("kind", KINDS)
def test_the_nominal_response_with_its_residual_is_the_perturbed_one(kind):
    G, G0 = some_response(1), some_response(2)
    found = residual(G, G0, kind)
    D, identity = found.response, np.eye(4)
    back = {
        "additive": G0.response + D,
        "input-multiplicative": G0.response @ (identity + D),
        "output-multiplicative": (identity + D) @ G0.response,
    }[kind]
    np.testing.assert_allclose(back, G.response, rtol=1e-10, atol=1e-12)
    singular = [np.sqrt(np.linalg.eigvalsh(d.conj().T @ d).max()) for d in D]
    np.testing.assert_allclose(found.largest_singular_value, singular, rtol=1e-10)
    assert found.peak == pytest.approx(max(singular))
    assert found.peak_omega == OMEGA[int(np.argmax(singular))]
    assert found.condition == pytest.approx(max(np.linalg.cond(g) for g in G0.response))


def test_a_gain_error_of_three_percent_is_a_residual_of_three_percent():
    true, high = (
        full(output="maf", maf=MafSensor(gain_error=g), relative=False) for g in (0.0, 0.03)
    )
    for kind in KINDS[1:]:
        found = residual(high, true, kind)
        np.testing.assert_allclose(
            found.response, 0.03 * np.eye(4) + np.zeros((5, 1, 1)), atol=1e-13
        )
        assert found.peak == pytest.approx(0.03, abs=1e-13)
    # Relative to its own reading, the change of a reading does not tell the gain.
    own = full(output="maf", maf=MafSensor(gain_error=0.03))
    nominal = full(output="maf")
    assert residual(own, nominal).peak < 1e-13
    assert residual(own.scaled_as(nominal), nominal).peak == pytest.approx(0.03, rel=1e-9)


def test_residuals_of_modes_of_equal_cylinders():
    # A longer lag, on the same plant: circulant, so that (g - g0)/g0 of each mode is all.
    nominal, slow = (full(output="maf", maf=MafSensor(time_constant=t)) for t in (0.015, 0.02))
    for kind in KINDS[1:]:
        found = residual(slow, nominal, kind)
        modes = [(slow.mode(q) - nominal.mode(q)) / nominal.mode(q) for q in range(4)]
        for q in range(4):
            np.testing.assert_allclose(found.mode(q), modes[q], rtol=1e-8, atol=1e-10)
        np.testing.assert_allclose(
            found.largest_singular_value, np.abs(modes).max(axis=0), rtol=1e-8
        )
        assert found.leakage[1:].max() < 1e-8


def test_residual_of_a_cylinder_that_takes_less():
    # Wide open, the charge of a shut-early valve hangs on its own flow coefficient and command.
    weak = CrankAnglePlant(Engine.paper().replace(cylinder_flow_factors=(1.0, 0.9, 1.0, 1.0)))
    one = CrankAnglePlant(Engine.paper().replace(cylinder_flow_factors=(0.9,) * 4))
    found = residual(full(weak, relative=False), full(relative=False))
    alone = residual(full(one, relative=False), full(relative=False))
    expected = np.zeros((4, 4))
    expected[1, 1] = alone.mode(0)[0].real
    assert abs(expected[1, 1]) > 0.02
    np.testing.assert_allclose(found.response, expected + np.zeros((5, 1, 1)), atol=5e-4)


def test_the_mean_value_plant_has_the_charge_but_not_the_shape_of_the_flow():
    maps = MeanValuePlant.fit(PLANT, tolerance=0.05, most_points=512)
    nominal = {
        output: mean_value_response(maps.dynamics(), COMMAND, SPEED, output=output, omega=OMEGA)
        for output in ("air_charge", "maf")
    }
    charge, flow = (residual(full(output=name), nominal[name]) for name in nominal)
    # The slope of maps whose charge is good to 5 % is off by some 5 %.
    assert charge.peak < 0.1
    # Modes 1 and 2: an even flow is an early one.
    assert np.abs(flow.mode(1)).max() > 0.2
    assert np.abs(flow.mode(2)).max() > 1.0
    frd = flow.frd()
    assert frd.input_labels == frd.output_labels == [f"maf[{k}]" for k in (1, 2, 3, 4)]
    np.testing.assert_array_equal(frd.frdata, flow.response.transpose(1, 2, 0))
    text = str(flow)
    assert text.startswith(
        "output-multiplicative residual, duration_deg to maf, full plant against"
    )
    assert f"at most {flow.peak:.3g}, at {flow.peak_omega:.3g} rad/s" in text
    figure = flow.plot()
    assert figure.axes[0].get_title(loc="left") == flow.title
    plt.close(figure)


def test_labels_of_residuals(charge):
    other = full(amplitude=0.005)
    inputs = [f"duration_deg[{k}]" for k in (1, 2, 3, 4)]
    outputs = [f"air_charge[{k}]" for k in (1, 2, 3, 4)]
    for kind, names in zip(
        KINDS, ((inputs, outputs), (inputs, inputs), (outputs, outputs)), strict=True
    ):
        frd = residual(other, charge, kind).frd()
        assert (frd.input_labels, frd.output_labels) == names


def test_a_singular_nominal_response_is_refused(charge):
    sick = charge.response.copy()
    sick[2, :, 3] = sick[2, :, 1] * (1.0 + 1e-9)
    nominal = dataclasses.replace(charge, response=sick)
    told = rf"condition number .* at {OMEGA[2]:.4g} rad/s, but at most 1e\+06"
    for kind in KINDS[1:]:
        with pytest.raises(ParameterError, match=told):
            residual(charge, nominal, kind)
    assert residual(charge, nominal, "additive").condition > 1e8
    sick[2] = 0.0
    with pytest.raises(ParameterError, match="condition number inf"):
        residual(charge, dataclasses.replace(charge, response=sick))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"omega": OMEGA * 0.9}, "5 frequencies from 0 to 39.27 rad/s, the nominal one 5 .*35.34"),
        ({"omega": OMEGA[:4], "response": np.ones((4, 4, 4))}, "the nominal one 4 frequencies"),
        ({"cycle_time": 0.04, "speed_rpm": 3000.0}, "at 1500 rpm, the nominal one at 3000 rpm"),
        ({"relative": False}, "one response is relative"),
        ({"outputs": tuple(f"air_charge[{k}]" for k in range(1, 5))}, "duration_deg to air_charge"),
        (
            {
                "inputs": ("duration_deg[1]",),
                "outputs": ("maf[1]",),
                "response": np.ones((5, 1, 1)),
            },
            "from 4 duration_deg to maf, the nominal one from 1 duration_deg",
        ),
    ],
)
def test_responses_that_do_not_fit_are_refused(changes, message):
    with pytest.raises(ParameterError, match=message):
        residual(some_response(1), some_response(2, **changes))


def test_bad_options_are_refused(charge):
    with pytest.raises(ParameterError, match="did you mean 'additive'"):
        residual(charge, charge, "additiv")
    with pytest.raises(ParameterError, match="the response has shape"):
        some_response(1, response=np.ones((5, 4, 3)))
    with pytest.raises(ParameterError, match="both must be relative"):
        charge.scaled_as(full(relative=False))
    with pytest.raises(ParameterError, match="must have the same inputs and outputs"):
        charge.scaled_as(some_response(1))
