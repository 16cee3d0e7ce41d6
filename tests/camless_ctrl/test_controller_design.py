"""The controller as it is designed for the paper's engine, against the full plant."""

import dataclasses
import json
import math
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from camless_ctrl.closed_loop import ValveErrors, simulate
from camless_ctrl.closed_loop_result import averaged
from camless_ctrl.controller import AirChargeController
from camless_ctrl.controller_cases import JITTER, WEAK_CYLINDER
from camless_ctrl.controller_design import design_controller
from camless_ctrl.cylinder_parameters import ParameterSet
from camless_ctrl.event_data import Measurement
from camless_ctrl.gradient_adaptation import GradientAdaptation
from camless_ctrl.load_step import run_load_step
from camless_ctrl.requirements import evaluate
from plant import CrankAnglePlant, Engine, MafSensor, SensorSet
from plant.errors import ParameterError

N = 1500.0


def full_plant(**changes):
    return CrankAnglePlant(Engine.paper().replace(**changes), runner=True, oscillation=True)


def quiet(design):
    """Sensors without noise, but with lag, delay and sampling; the assumed noise stays."""
    return SensorSet(maf=design.controller.estimator.maf.replace(relative_noise=0.0, bits=None))


@pytest.fixture(scope="module")
def load_step(narrow_design):
    return [run_load_step(narrow_design.controller, seed=seed) for seed in range(4)]


def test_load_step_with_a_weak_cylinder(load_step):
    mean = averaged(load_step)
    assert evaluate("cylinder-error", 100.0 * mean.worst_error()).met
    assert evaluate("imbalance", 100.0 * mean.worst_imbalance()).met
    assert not mean.limited.any()


def test_first_event_of_a_new_demand_is_nearly_right(load_step):
    firsts = np.array([[r.relative_error[p.start, 0] for p in r.segments[1:]] for r in load_step])
    # jitter of 0.05 ms is 0.3 to 0.8 % of the charge
    assert np.abs(firsts.mean(axis=0)).max() < 0.01


def test_nominal_engine_needs_no_learning(narrow_design):
    run = simulate(full_plant(), narrow_design.feedforward_alone(), np.full(24, 2.5e-4), N, seed=1)
    assert np.nanmax(np.abs(run.relative_error[:-1])) < 4e-3


def test_estimates_tell_their_own_error(load_step):
    z = np.concatenate([(r.estimate - r.charge) / r.estimate_sigma for r in load_step])
    z = z[np.isfinite(z)]
    assert 0.5 < z.std() < 1.1
    assert abs(z.mean()) < 0.2


def test_late_valve_is_told_by_its_measured_duration(narrow_design):
    run = simulate(
        full_plant(),
        narrow_design.controller,
        np.full(160, 2.5e-4),
        N,
        valves=ValveErrors((0.0, 0.2e-3, 0.0, -0.1e-3), JITTER),
        seed=5,
    )
    learnt = run.final_state.adaptation.parameters.duration_offset
    np.testing.assert_allclose(learnt, (0.0, 0.2e-3, 0.0, -0.1e-3), atol=0.04e-3)
    assert np.abs(run.cylinder_errors(10)).max() < 0.01


def test_air_flow_gain_error_is_the_one_that_stays(narrow_design):
    run = simulate(
        full_plant(),
        narrow_design.controller,
        np.full(240, 2.5e-4),
        N,
        sensors=SensorSet(maf=MafSensor(gain_error=0.03)),
        seed=2,
    )
    np.testing.assert_allclose(run.cylinder_errors(30), 1.0 / 1.03 - 1.0, atol=5e-3)


def test_wrong_lag_and_delay_do_not_unbalance(narrow_design):
    run = simulate(
        full_plant(cylinder_flow_factors=WEAK_CYLINDER),
        narrow_design.controller,
        np.full(240, 3e-4),
        N,
        sensors=SensorSet(maf=MafSensor(time_constant=0.02, delay=3e-3)),
        seed=2,
    )
    assert np.abs(run.cylinder_errors(30)).max() < 0.01
    assert run.imbalance(30) < 0.005


def test_warm_start_is_right_from_the_first_cycle(narrow_design, load_step):
    controller = narrow_design.controller
    plant = full_plant(cylinder_flow_factors=WEAK_CYLINDER)
    kept = json.loads(json.dumps(controller.export_state(load_step[0].final_state)))
    runs = [
        simulate(plant, controller, np.full(8, 1.7e-4), N, state=state)
        for state in (controller.import_state(kept), None)
    ]
    warm, cold = (float(np.abs(run.relative_error[0]).max()) for run in runs)
    assert warm < 0.01
    assert cold > 2.0 * warm


def test_missing_samples_freeze_what_was_learnt(narrow_design):
    controller = narrow_design.controller.replace(faults=None)  # which would limit the demand
    plant, state = full_plant(), controller.initial_state()
    run = simulate(plant, controller, np.full(80, 2.5e-4), N, seed=3)
    state, before = run.final_state, run.final_state.adaptation.parameters
    for k in range(40):
        nothing = Measurement(state.time + 0.02, N, np.empty(0), np.empty(0))
        step = controller.step(state, nothing, 2.5e-4)
        state = step.state
        if k > 4:  # what had come in before has been used
            assert not step.diagnostics.adapted
    after = state.adaptation.parameters
    np.testing.assert_allclose(after.flow_gain, before.flow_gain, rtol=0.02)
    assert step.command.duration_deg == pytest.approx(run.duration_deg[-4:].mean(), abs=1.0)


def test_same_seed_same_run_and_a_copy_runs_alike(narrow_design):
    controller = narrow_design.controller
    copy = pickle.loads(pickle.dumps(controller))
    plant = full_plant(cylinder_flow_factors=WEAK_CYLINDER)
    options = {"valves": ValveErrors(0.0, JITTER), "seed": 7}
    a, b, c = (
        simulate(plant, which, np.full(60, 2.5e-4), N, **options)
        for which in (controller, controller, copy)
    )
    for name in ("charge", "estimate", "duration_deg", "flow_gain"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
        np.testing.assert_array_equal(getattr(a, name), getattr(c, name))


def test_permuted_parameters_give_permuted_commands(narrow_design):
    controller = narrow_design.controller
    random = np.random.default_rng(0)
    known = ParameterSet(random.uniform(0.8, 1.2, 4), random.uniform(-2e-4, 2e-4, 4), np.ones(4))

    def commands(parameters):
        state, found = controller.initial_state(parameters), []
        for k in range(4):
            told = Measurement(0.02 * (k + 1), N, np.empty(0), np.empty(0))
            step = controller.step(state, told, 2.5e-4)
            state = step.state
            found.append((step.lift_mm, step.duration_deg))
        return found

    order = (3, 1, 4, 2)
    plain = commands(known)
    assert commands(known.permuted(order)) == [plain[i - 1] for i in order]


ANY = st.floats(allow_nan=True, allow_infinity=True, width=64)
NEAR = st.one_of(ANY, st.floats(0.0, 2.0), st.floats(-0.1, 0.1), st.floats(5e4, 1.2e5))
ARRAY = hnp.arrays(np.float64, st.integers(0, 8), elements=NEAR)


@settings(max_examples=40, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.one_of(ANY, st.floats(0.0, 1.0)),
            st.one_of(ANY, st.floats(700.0, 7000.0)),
            st.tuples(ARRAY, ARRAY),
            st.tuples(ARRAY, ARRAY),
            ANY,
            st.floats(1e-6, 1e-3),
            st.booleans(),
        ),
        max_size=16,
    )
)
def test_whatever_is_measured_nothing_raises_and_limits_hold(narrow_design, steps):
    controller = narrow_design.controller
    limits, bounds = controller.limits, controller.adaptation.bounds
    state = controller.initial_state()
    for k, (time, speed, maf, map_, duration, demand, active) in enumerate(steps):
        m, p = min(map(len, maf)), min(map(len, map_))
        told = Measurement(
            time, speed, maf[0][:m], maf[1][:m], map_[0][:p], map_[1][:p], ((k - 2, duration),)
        )
        step = controller.step(state, told, demand, active=active)
        state = step.state
        assert limits.lift_mm[0] <= step.lift_mm <= limits.lift_mm[1]
        assert 0.0 < step.duration_deg <= limits.longest_duration_deg * (1.0 + 1e-12)
        assert bounds.contain(state.adaptation.parameters)
        assert math.isfinite(step.diagnostics.predicted)


@pytest.fixture(scope="module")
def record(narrow_design):
    """What the controller was told in a run of 60 events."""
    told = []

    class Recording(AirChargeController):
        def step(self, state, measurement, demand, *, active=True):
            told.append(measurement)
            return super().step(state, measurement, demand, active=active)

    design = narrow_design.controller
    recording = Recording(**{f.name: getattr(design, f.name) for f in dataclasses.fields(design)})
    simulate(full_plant(), recording, np.full(60, 2.5e-4), N, valves=ValveErrors(0.0, JITTER))
    return told


def corrupted(told, kind, value):
    """Measurement of which one kind of signal is wrong."""
    if kind in ("time", "speed_rpm"):
        return dataclasses.replace(told, **{kind: value})
    if kind == "durations":
        return dataclasses.replace(told, durations=tuple((k, value) for k, _ in told.durations))
    signal = getattr(told, kind).copy()
    signal[::2] = value
    return dataclasses.replace(told, **{kind: signal})


@settings(max_examples=40, deadline=None)
@given(
    st.dictionaries(
        st.integers(8, 50),
        st.tuples(
            st.sampled_from(
                ["time", "speed_rpm", "durations", "sample_time", "sample_flow", "pressure_time",
                 "pressure"]
            ),
            NEAR,
        ),
        max_size=12,
    )
)  # fmt: skip
def test_a_run_with_wrong_signals_keeps_limits_and_learns_again(narrow_design, record, wrong):
    controller = narrow_design.controller
    limits, bounds = controller.limits, controller.adaptation.bounds
    state, adapted = controller.initial_state(), []
    for k, told in enumerate(record):
        measurement = corrupted(told, *wrong[k]) if k in wrong else told
        step = controller.step(state, measurement, 2.5e-4)
        state = step.state
        adapted.append(step.diagnostics.adapted)
        assert limits.lift_mm[0] <= step.lift_mm <= limits.lift_mm[1]
        assert 0.0 < step.duration_deg <= limits.longest_duration_deg * (1.0 + 1e-12)
        assert bounds.contain(state.adaptation.parameters)
        assert math.isfinite(step.diagnostics.predicted)
    assert any(adapted[:8])  # windows are completed before anything goes wrong
    if not wrong:
        assert all(adapted[8:])


def test_another_law_shares_the_rest(narrow_design):
    controller = narrow_design.with_law(GradientAdaptation())
    assert controller.model is narrow_design.model
    run = simulate(
        full_plant(cylinder_flow_factors=WEAK_CYLINDER),
        controller,
        np.full(160, 2.5e-4),
        N,
        valves=ValveErrors(0.0, JITTER),
    )
    assert np.abs(run.cylinder_errors(20)).max() < 0.01


def test_model_of_another_engine_is_refused(narrow_design):
    other = Engine.paper().replace(temperature=316.0)
    with pytest.raises(ParameterError, match="the charge model is one of the full plant"):
        design_controller(other, path=narrow_design.path, model=narrow_design.model)
    unequal = Engine.paper().replace(cylinder_flow_factors=WEAK_CYLINDER)
    with pytest.raises(ParameterError, match="starts from equal cylinders"):
        design_controller(unequal)


@pytest.mark.parametrize("temperature", [260.0, 330.0])
def test_intake_temperature_is_followed_as_a_charge_factor(narrow_design, temperature):
    # With the valve wide open no flow gain within its bounds explains 10 % of density.
    run = simulate(
        full_plant(temperature=temperature),
        narrow_design.controller,
        np.concatenate((np.full(160, 2e-4), np.full(160, 2.8e-4))),
        N,
        valves=ValveErrors(0.0, JITTER),
        seed=4,
    )
    for first in (10, 43):  # cycles, the second ones after a step of the demand
        assert np.abs(np.nanmean(run.relative_error[first : first + 30], axis=0)).max() < 0.01
    learnt = run.final_state.adaptation.parameters
    # Truth: the density of an ideal gas; what the flow gain explains of it is a few per cent.
    density = Engine.paper().temperature / temperature
    assert learnt.charge_factor == pytest.approx([density] * 4, abs=0.05)
    low, high = narrow_design.controller.adaptation.bounds.flow_gain
    assert np.all((low < learnt.flow_gain) & (learnt.flow_gain < high))
