from dataclasses import replace

import control
import numpy as np
import pytest

from camless_ctrl.adaptation import AdaptationGains
from camless_ctrl.event_loop import EventLoop
from camless_ctrl.feedforward import Feedforward
from camless_ctrl.measurement_response import MeasurementResponse
from camless_ctrl.mu import lft, mu_upper, robust_stability
from camless_ctrl.nominal_loop import NominalLoop
from camless_ctrl.pulse_bank import PulseSum
from camless_ctrl.uncertain_loop import REMAINDER, UncertainLoop, adaptation_law
from camless_ctrl.uncertain_measurement import uncertain_measurement
from plant import CrankAnglePlant, MeanValuePlant, ParameterError

GAINS = AdaptationGains(0.4, 0.25)
SOME = {"MAF time constant": 0.8, "MAF delay": -0.6, "temperature": 1.0, "flow coefficient": -0.5}


@pytest.fixture(scope="module")
def measurement():
    plant = CrankAnglePlant(runner=True, oscillation=True)
    maps = MeanValuePlant.fit(CrankAnglePlant(), tolerance=0.05, most_points=512)
    return uncertain_measurement(
        plant, Feedforward(maps), 250e-6, 1500.0, share=0.8, confidence=0.8, design=8, fresh=20
    )


@pytest.fixture(scope="module")
def loop(measurement):
    return UncertainLoop.adaptive(measurement, GAINS)


def law(z, gains=GAINS, n=4, latency=2):
    """Adaptation by hand: what arrives is added to the cylinder's own factor and to all."""
    own = gains.imbalance * z ** -(-latency % n) / (1.0 - z**-n)
    return own + (gains.mean - gains.imbalance) / n / (1.0 - 1.0 / z)


def assert_same_poles(some, others):
    """Compare all poles but those at 0 by their characteristic polynomials on two circles.

    Delay chains make 0 a defective pole. Rounding scatters it far around 0, but not the
    polynomial: its coefficients are as good as the matrix.
    """
    turns = np.exp(1j * np.linspace(0.05, np.pi, 60))
    for z in (turns, 0.7 * turns):
        first, second = (np.prod(1.0 - poles / z[:, None], axis=1) for poles in (some, others))
        np.testing.assert_allclose(first, second, rtol=1e-9, atol=1e-9)


def weight_poles(measurement):
    return np.linalg.eigvals(np.asarray(measurement.weight.system().A))


def without_weight(poles, measurement):
    """Poles of the loop itself: the weight hangs on it and feeds nothing back by itself."""
    for own in weight_poles(measurement):
        nearest = int(np.argmin(np.abs(poles - own)))
        assert abs(poles[nearest] - own) < 1e-8
        poles = np.delete(poles, nearest)
    return poles


def test_comparison_of_poles_tells_them_apart():
    some, chain = np.array([0.5, 0.2 + 0.1j, 0.2 - 0.1j]), np.diag(np.ones(9), 1)
    # A defective zero that a change of the last digit spreads to a circle of radius 0.03.
    spread = np.linalg.eigvals(chain + 1e-15 * np.eye(10)[9][:, None] * np.eye(10)[0])
    assert np.all(np.abs(spread) > 0.03)
    assert_same_poles(some, np.concatenate((some, spread)))
    for wrong in (some[:2], np.append(some, 0.01), some + np.array([1e-6, 0.0, 0.0])):
        with pytest.raises(AssertionError):
            assert_same_poles(some, wrong)


def known_sensor(measurement, **sensor):
    """Response of the nominal plant through a sensor that is known, as `EventLoop` has it."""
    return MeasurementResponse.of_maf(
        measurement.estimator,
        measurement.event_time,
        shape=measurement.local.shape,
        **{"time_constant": 15e-3, "delay": 1e-3, **sensor},
    )


def event_loop(measurement, **sensor):
    return EventLoop.at_speed(
        1500.0,
        measurement.estimator,
        GAINS,
        shape=measurement.local.shape,
        sensitivity=measurement.local.sensitivity,
        **sensor,
    )


def test_without_uncertainty_it_is_the_event_loop(measurement):
    known = PulseSum(((measurement.local.sensitivity, known_sensor(measurement)),))
    sure = replace(measurement, nominal=known, centre=known, directions={})
    found = UncertainLoop.adaptive(sure, GAINS)
    theirs = event_loop(measurement).poles()
    assert_same_poles(found.poles, np.concatenate((theirs, weight_poles(measurement))))
    z = 1.05 * np.exp(1j * np.linspace(0.05, np.pi, 20))
    np.testing.assert_allclose(found.loop_response(z), event_loop(measurement)(z), rtol=1e-10)


def test_poles_of_a_perturbation_solve_its_equation(measurement, loop):
    # 1 + C(z) z^-latency (E_c + sum d_k H_k)(z) = 0, from taps and tails alone.
    assert measurement.latency == 2
    poles = without_weight(control.poles(loop.perturbed(SOME)), measurement)
    assert np.count_nonzero(np.abs(poles) > 0.4) >= 4
    for pole in poles[np.abs(poles) > 0.4]:
        seen = measurement.centre(pole)
        for name, delta in SOME.items():
            seen = seen + delta * measurement.directions[name](pole)
        assert abs(1.0 + law(pole) * pole**-2 * seen) < 1e-8


def test_perturbed_loop_is_the_loop_of_the_perturbed_sum(measurement, loop):
    # No transformation: the sum is built as one system, and the loop closed around it.
    total = measurement.centre
    for name, delta in SOME.items():
        total = total + measurement.directions[name].scaled(delta)
    parts = [f * r.system(measurement.latency) for f, r in total.terms]
    seen = parts[0]
    for part in parts[1:]:
        seen = control.parallel(seen, part)
    direct = control.feedback(
        control.ss([], [], [], [[1.0]], measurement.event_time),
        control.series(seen, adaptation_law(measurement, GAINS)),
    )
    z = np.exp(1j * np.linspace(0.05, np.pi, 40))
    found = loop.perturbed(SOME)(z)
    np.testing.assert_allclose(found, 0.5 * direct(z), atol=1e-10)  # W_p = 1/2
    reachable = without_weight(control.poles(loop.perturbed(SOME)), measurement)
    theirs = control.poles(direct)  # its single systems have tails that cancel
    for pole in reachable[np.abs(reachable) > 0.4]:
        assert np.min(np.abs(theirs - pole)) < 1e-6


def test_nominal_loop_of_the_middle_and_of_a_perturbation(measurement, loop):
    for deltas in ({}, SOME):
        direct = NominalLoop.of_uncertain_loop(loop, deltas)
        theirs = without_weight(control.poles(loop.perturbed(deltas)), measurement)
        assert_same_poles(direct.poles, theirs)
    with pytest.raises(ParameterError, match="no parameter is named 'viscosity'"):
        NominalLoop.of_uncertain_loop(loop, {"viscosity": 1.0})


@pytest.mark.parametrize(("lag", "delay"), [(10e-3, 1e-3), (20e-3, 1e-3), (12e-3, 2.5e-3)])
def test_sensor_change_is_that_of_the_event_loop_up_to_the_remainder(measurement, loop, lag, delay):
    deltas = measurement.deltas({"MAF time constant": lag, "MAF delay": delay})
    z = np.exp(1j * np.linspace(0.0, np.pi, 200))
    exact = measurement.local.sensitivity * known_sensor(
        measurement, time_constant=lag, delay=delay
    )(z)
    size = measurement.weight.magnitude(np.angle(z) / measurement.event_time)
    gap = np.abs(exact - measurement.response(z, deltas))
    assert np.all(gap <= size)  # some |D| <= 1 makes up for it at each frequency
    # Each pole moves by what the gap does to 1 + L, in first order dL/(dL/dz): by some per cent.
    there = event_loop(measurement, time_constant=lag, delay=delay).poles()
    ours = control.poles(loop.perturbed(deltas))
    for pole in there[np.abs(there) > 0.7]:
        nearest = ours[np.argmin(np.abs(ours - pole))]
        h = 1e-5

        def gain(at):
            return law(at) * at**-2 * measurement.response(at, deltas)

        slope = (gain(nearest + h) - gain(nearest - h)) / (2.0 * h)
        change = (
            law(nearest)
            * nearest**-2
            * (
                measurement.local.sensitivity
                * known_sensor(measurement, time_constant=lag, delay=delay)(nearest)
                - measurement.response(nearest, deltas)
            )
        )
        assert abs(pole - nearest) < 0.05
        assert abs(pole - (nearest - change / slope)) < 0.3 * abs(change / slope) + 1e-6


def test_signals_of_the_system(measurement, loop):
    names = [*measurement.directions, REMAINDER]
    assert loop.system.input_labels == [*(f"w[{n}]" for n in names), "disturbance"]
    assert loop.system.output_labels == [*(f"z[{n}]" for n in names), "error"]
    assert loop.structure.names == tuple(names)
    # M from its definition at points off the circle
    z = 1.2 * np.exp(0.7j)
    K, seen = law(z), z**-2 * measurement.centre(z)
    h = np.array([z**-2 * d(z) for d in measurement.directions.values()])
    omega = -1j * np.log(z) / measurement.event_time
    weight = measurement.weight.system()(z)
    assert omega.imag != 0.0
    rows = np.append(h, weight)
    expected = np.empty((len(names) + 1, len(names) + 1), dtype=complex)
    expected[:-1, :-1] = -rows[:, None] * K / (1.0 + K * seen)
    expected[:-1, -1] = rows / (1.0 + K * seen)
    expected[-1, :-1] = -0.5 * K / (1.0 + K * seen)
    expected[-1, -1] = 0.5 / (1.0 + K * seen)
    np.testing.assert_allclose(loop.system(z), expected, atol=1e-10)


@pytest.mark.parametrize("theta", [0.3, -1.1, 2.9])
def test_lifted_system_has_the_singular_values_of_the_modes(loop, theta):
    n = 4
    lifted = loop.lifted()(np.exp(1j * theta))
    modal = [loop.system(np.exp(1j * (theta + 2.0 * np.pi * q) / n)) for q in range(n)]
    expected = np.sort(np.concatenate([np.linalg.svd(m, compute_uv=False) for m in modal]))
    found = np.sort(np.linalg.svd(lifted, compute_uv=False))
    np.testing.assert_allclose(found, expected, atol=1e-10 * expected.max())


def test_lifted_system_has_the_poles_per_cycle(loop):
    lifted = loop.lifted()
    assert lifted.dt == pytest.approx(0.08)
    assert lifted.input_labels[loop.system.ninputs] == "w[temperature](2)"
    assert lifted.input_labels[-1] == "disturbance(4)"
    assert_same_poles(control.poles(lifted), loop.poles**4)
    radius = float(np.max(np.abs(control.poles(lifted))))
    assert loop.spectral_radius({}) == pytest.approx(radius, rel=1e-9)


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 6])
def test_bands_of_the_modes_cover_the_circle(measurement, n):
    # Of a measurement with another number of cylinders nothing but the number matters here.
    local = replace(measurement.local, n_cylinders=n)
    of_n = replace(measurement, local=local)
    loop = UncertainLoop(of_n, control.ss([], [], [], [[0.1]], measurement.event_time))
    bands = [loop.band(q) * measurement.event_time for q in range(n // 2 + 1)]
    assert bands[0][0] == 0.0
    assert bands[-1][-1] == pytest.approx(np.pi, abs=1e-12)
    for q, band in enumerate(bands):
        assert band[0] - 1e-12 <= 2.0 * np.pi * q / n <= band[-1] + 1e-12
        if q:
            assert band[0] == pytest.approx(bands[q - 1][-1], abs=1e-12)
    with pytest.raises(ParameterError, match="q is"):
        loop.band(n // 2 + 1)


def mu_of_rank_one(reals, disk):
    """Mu where all perturbations add at one point: closed form.

    The loop breaks if 1 lies in ``k (sum of segments [-1, 1] c_k + disk of radius r)``, a
    convex set. The point 1/k is inside as long as no half plane parts it from the set, that is
    ``cos(phi)/k <= sum |Re(c_k exp(-j phi))| + r`` for all phi: the smallest of
    ``(sum |Re(...)| + r)/cos(phi)`` is mu.
    """
    phi = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 40001)[1:-1]
    support = np.abs((np.asarray(reals)[:, None] * np.exp(-1j * phi)).real).sum(axis=0) + disk
    return float((support / np.cos(phi)).min())


def closed_form(measurement, angle):
    z = np.exp(1j * angle)
    K = law(z)
    factor = -K / (1.0 + K * z**-2 * measurement.centre(z))
    reals = [factor * z**-2 * d(z) for d in measurement.directions.values()]
    disk = abs(factor) * float(measurement.weight.magnitude(angle / measurement.event_time))
    return mu_of_rank_one(reals, disk)


def test_closed_form_of_mu_is_right_where_it_is_plain():
    assert mu_of_rank_one([0.5 + 0.0j], 0.0) == pytest.approx(0.5)
    assert mu_of_rank_one([0.5j], 0.0) == pytest.approx(0.0, abs=1e-4)  # never reaches 1
    assert mu_of_rank_one([], 0.4) == pytest.approx(0.4)
    # Diamond of corners +-c, +-c j with |c| = 0.5 at 45 deg: a square of half side 0.5 sqrt 2.
    tilted = 0.5 * np.exp(0.25j * np.pi)
    assert mu_of_rank_one([tilted, 1j * tilted], 0.0) == pytest.approx(0.5 * np.sqrt(2.0))


@pytest.mark.parametrize("angle", [0.2, 0.5 * np.pi, 2.0, 3.0])
def test_mu_is_the_closed_form_of_rank_one(measurement, loop, angle):
    M = loop.system(np.exp(1j * angle))[:-1, :-1]
    assert float(mu_upper(M, loop.structure)) == pytest.approx(
        closed_form(measurement, angle), rel=0.01
    )


def test_peak_of_robust_stability_is_the_closed_form(measurement, loop):
    T = measurement.event_time
    angles = np.linspace(0.01, np.pi, 400)
    expected = max(closed_form(measurement, angle) for angle in angles)
    found = robust_stability(loop.system, loop.structure)
    assert found.guaranteed
    assert found.peak_upper == pytest.approx(expected, rel=0.01)
    assert found.peak_lower == pytest.approx(expected, rel=0.01)
    assert closed_form(measurement, found.frequency * T) == pytest.approx(expected, rel=0.01)


def test_remainder_that_destabilises_is_found_by_the_poles(measurement, loop):
    # The worst perturbation, realised as a system in time, puts a pole on the circle.
    found = robust_stability(loop.system, loop.structure)
    worst = found.worst.realise(found.worst_frequency, measurement.event_time)
    radius = np.max(np.abs(control.poles(lft(loop.system, worst))))
    assert radius == pytest.approx(1.0, abs=1e-6)


def test_gain_that_is_too_high_is_unstable(measurement):
    unstable = UncertainLoop.adaptive(measurement, AdaptationGains(3.0, 3.0))
    assert not unstable.stable
    direct = replace(event_loop(measurement), gains=AdaptationGains(3.0, 3.0)).poles()
    radius = unstable.spectral_radius(measurement.deltas({}))
    assert radius == pytest.approx(float(np.max(np.abs(direct))) ** 4, rel=0.05)
    assert radius > 1.0


def test_law_that_does_not_fit_is_refused(measurement):
    fits = adaptation_law(measurement, GAINS)
    wrong = control.ss(fits.A, fits.B, fits.C, fits.D, 0.01)
    with pytest.raises(ParameterError, match=r"0\.01 s, but must be the event time of 0\.02 s"):
        UncertainLoop(measurement, wrong)
    for dt in (None, True):
        untimed = control.ss(fits.A, fits.B, fits.C, fits.D, dt)
        with pytest.raises(ParameterError, match="sampling time is not given"):
            UncertainLoop(measurement, untimed)
    double = control.ss([], [], [], np.eye(2), 0.02)
    with pytest.raises(ParameterError, match="2 inputs and 2 outputs"):
        UncertainLoop(measurement, double)
    with pytest.raises(ParameterError, match="sensitivity_bound"):
        UncertainLoop(measurement, fits, 0.0)


def test_unknown_delta_is_refused(loop):
    with pytest.raises(ParameterError, match="no block is named 'viscosity'"):
        loop.perturbed({"viscosity": 1.0})
