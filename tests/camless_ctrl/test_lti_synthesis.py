import numpy as np
import pytest

from camless_ctrl._law_weights import (
    control_weight,
    mixed_plant,
    nominal_plant,
    performance_weight,
    structured_plant,
)
from camless_ctrl.adaptation import AdaptationGains
from camless_ctrl.gain_synthesis import MU_LIMIT, design_gains
from camless_ctrl.lti_synthesis import EFFORT, dk_law, hinf_law
from camless_ctrl.mu import Delta, lft, robust_performance
from camless_ctrl.synthesis import SynthesisError, dk_synthesis, hinf_synthesis
from camless_ctrl.uncertain_loop import REMAINDER, UncertainLoop, adaptation_law
from plant import ParameterError


@pytest.fixture(scope="module")
def slow(measured):
    return measured(1500.0)


@pytest.fixture(scope="module")
def gains(slow):
    return design_gains(slow, confirm=False).gains


@pytest.fixture(scope="module", params=[hinf_law, dk_law])
def law(request, slow, gains):
    return request.param(slow, gains, shares=(0.2,), confirm=False)


@pytest.fixture(scope="module")
def parts(slow, gains):
    asked = gains.scaled(0.7)
    W1, W2 = performance_weight(slow, asked, 2.0), control_weight(slow, 0.4, EFFORT)
    return nominal_plant(slow), W1, W2


def dense(T):
    """Frequencies, rad/s, dense at the n-th roots of 1 as well."""
    near = np.concatenate((-np.geomspace(1e-6, 0.3, 150), np.geomspace(1e-6, 0.3, 150)))
    angle = np.concatenate((np.linspace(0.0, np.pi, 1500), near, 0.5 * np.pi + near, np.pi + near))
    return np.unique(angle[(angle > 0.0) & (angle < np.pi)]) / T


def weighted(parts, measurement, law):
    """``|W1 S|`` and ``|W2 K S|`` from responses alone, the plant from taps and tails."""
    _, W1, W2 = parts
    z = np.exp(1j * dense(measurement.event_time) * measurement.event_time)
    K = law(z)
    S = 1.0 / (1.0 + K * z**-measurement.latency * measurement.centre(z))
    return np.abs(W1(z) * S), np.abs(W2(z) * K * S)


def random_samples(loop, count, seed):
    """Members of the set: real parameters anywhere, the remainder an all-pass of size 1."""
    rng = np.random.default_rng(seed)
    T = loop.measurement.event_time
    for _ in range(count):
        values = dict(zip(loop.measurement.directions, rng.uniform(-1.0, 1.0, 3), strict=True))
        values[REMAINDER] = np.exp(1j * rng.uniform(0.0, 2.0 * np.pi))
        yield Delta(loop.structure, values).realise(float(rng.uniform(0.05, 3.1)) / T, T)


def test_nominal_plant_is_the_measurement_with_its_latency(slow):
    z = np.exp(1j * np.linspace(0.0, np.pi, 50))
    expected = z**-slow.latency * slow.centre(z)
    np.testing.assert_allclose(nominal_plant(slow)(z), expected, atol=1e-6)


def test_control_weight_bounds_every_member_of_the_set(slow):
    omega = dense(slow.event_time)
    z = np.exp(1j * omega * slow.event_time)
    bound = np.abs(control_weight(slow, 1.0, EFFORT)(z))
    rng = np.random.default_rng(5)
    largest = 0.0
    for _ in range(50):
        d = dict(zip(slow.directions, rng.choice((-1.0, 1.0), 3), strict=True))
        change = np.abs(slow.response(z, d) - slow.centre(z)) + slow.weight.magnitude(omega)
        assert np.all(change <= bound)
        largest = max(largest, float((change / bound).max()))
    assert largest > 0.7  # and not by much


def test_performance_weight_is_met_by_the_integrator_that_it_describes(slow):
    # Per cycle S = (zeta - 1)/(zeta - (1 - g)), so that W1 S is 1/bound but near the harmonics.
    W1 = performance_weight(slow, AdaptationGains(0.5, 0.5), 2.0)
    zeta = np.exp(4j * np.linspace(0.01, np.pi / 4 - 0.01, 50))
    S = (zeta - 1.0) / (zeta - 0.5)
    z = zeta**0.25
    np.testing.assert_allclose(np.abs(W1(z) * S), 0.5, rtol=5e-3)
    assert abs(W1(1.0)) > 50.0
    assert abs(W1(-1.0)) > 50.0
    assert abs(W1(1j)) > 50.0
    only_mean = performance_weight(slow, AdaptationGains(0.5, 0.0), 2.0)
    assert abs(only_mean(1.0)) > 50.0
    assert abs(only_mean(1j)) < 1.0


def test_hinf_norm_is_that_on_a_dense_grid_and_beats_the_integrators(slow, gains, parts):
    result = hinf_synthesis(mixed_plant(*parts), 1, 1)
    own = np.hypot(*weighted(parts, slow, result.controller)).max()
    assert own == pytest.approx(result.gamma, rel=1e-3)
    for scale in (0.3, 0.5, 0.7, 1.0):
        integrator = adaptation_law(slow, gains.scaled(scale))
        assert np.hypot(*weighted(parts, slow, integrator)).max() > own


def test_dk_peak_is_the_sum_of_both_gains_and_beats_the_integrators(slow, gains, parts):
    # With scalar blocks of rank one mu of the complex set is the sum of the moduli.
    result = dk_synthesis(structured_plant(*parts), [1, 1], 1, 1, iterations=2, order=1)
    own = np.add(*weighted(parts, slow, result.controller)).max()
    assert own == pytest.approx(result.peak_mu, rel=0.01)
    for scale in (0.3, 0.5, 0.7, 1.0):
        integrator = adaptation_law(slow, gains.scaled(scale))
        assert np.add(*weighted(parts, slow, integrator)).max() > own


def test_reduced_law_keeps_robust_performance(slow, law):
    assert law.order < law.reduction.full_order
    loop = UncertainLoop(slow, law.system)
    assert loop.stable
    assert np.abs(np.linalg.eigvals(law.system.A)).max() < 1.0
    found = robust_performance(loop.system, loop.structure)
    assert found.robust is True
    assert law.mu_performance == pytest.approx(found.peak_upper, rel=0.01)
    assert law.mu_performance <= MU_LIMIT
    # What the reduction may cost ends where mu or settling reach their limits.
    assert law.reduction.full_measure * (1.0 + law.reduction.tolerance) == pytest.approx(1.0)


def test_members_of_the_set_are_stable_and_within_the_bound(slow, law):
    loop = UncertainLoop(slow, law.system)
    z = np.exp(1j * dense(slow.event_time)[::10] * slow.event_time)
    for delta in random_samples(loop, 200, seed=7):
        closed = lft(loop.system, delta)
        assert np.abs(np.linalg.eigvals(closed.A)).max() < 1.0
        assert np.abs(closed(z)).max() * loop.sensitivity_bound < 2.0


def test_settling_is_that_of_a_simulation(slow, law):
    import control

    loop = UncertainLoop(slow, law.system)
    closed = loop.system["error", "disturbance"]
    k = np.arange(400)
    for q in (0, 2):
        wave = np.cos(0.5 * np.pi * q * k)
        y = 2.0 * control.forced_response(closed, k * slow.event_time, wave).outputs
        last = int(np.flatnonzero(np.abs(y) > 0.02)[-1])
        assert law.settling_cycles[q] == pytest.approx((last + 1) / 4)


def test_without_imbalance_pace_the_differences_are_held(measured):
    fast = measured(6000.0)
    law = hinf_law(fast, shares=(0.7,), confirm=False)
    assert law.paces.imbalance == 0.0
    assert np.isfinite(law.settling_cycles[0])
    assert law.settling_cycles[1:] == (np.inf, np.inf)
    assert "held" in str(law)
    assert law.plot().get_ylabel() == "correction over estimate (1)"


def test_failure_is_loud_and_says_what_was_tried(slow, gains):
    with pytest.raises(SynthesisError, match=r"no H-infinity law .* keeps mu below 0.3"):
        hinf_law(slow, gains, shares=(0.2,), mu_limit=0.3, confirm=False)
    with pytest.raises(SynthesisError, match="stopped at its time limit"):
        dk_law(slow, gains, shares=(0.2,), timeout_s=1e-3, confirm=False)
    with pytest.raises(ParameterError, match="effort"):
        hinf_law(slow, gains, effort=0.0)
    with pytest.raises(ParameterError, match="at least one share"):
        hinf_law(slow, gains, shares=())
