import numpy as np
import pytest

from camless_ctrl.pulse_bank import PulseSum, pulse_bank
from plant import FlowShape, ParameterError, PulseResponse

T = 0.02
LATENCY = 3


def window(lag: float, delay: float, begin: float = 0.0) -> PulseResponse:
    """Response with a flow that starts at a share of the event."""
    shares = np.zeros(10)
    shares[int(10 * begin) :] = 1.0
    return PulseResponse.of_window(
        T,
        time_constant=lag,
        delay=delay,
        shape=FlowShape(shares / shares.sum(), 10),
        shift=1e-3,
        taper=2e-3,
        correction=15e-3,
    )


NOMINAL, SLOW, LATE = window(15e-3, 1e-3), window(20e-3, 1e-3), window(15e-3, 25e-3, 0.5)
SUMS = (
    PulseSum(((0.7, NOMINAL), (0.4, SLOW), (-0.2, LATE))),
    PulseSum(((-1.0, NOMINAL), (1.0, SLOW))),
    PulseSum(((2.5, LATE),)),
)
Z = 1.1 * np.exp(1j * np.linspace(0.0, np.pi, 23))


def bank(sums=SUMS, latency=LATENCY, outputs=("a", "b", "c")):
    return pulse_bank(sums, latency, input="charge", outputs=outputs, name="bank")


def test_bank_equals_the_sum_of_single_systems():
    # Each response alone as a system of the plant's package, added up by hand.
    system = bank()
    for k, each in enumerate(SUMS):
        expected = sum(factor * response.system(LATENCY)(Z) for factor, response in each.terms)
        np.testing.assert_allclose(system(Z)[k, 0], expected, rtol=0.0, atol=1e-13)
        np.testing.assert_allclose(Z**-LATENCY * each(Z), expected, rtol=0.0, atol=1e-13)


def test_bank_answers_a_pulse_with_taps_and_tail():
    # The definition in time: h_j = c_j up to the last tap, then c_J a^(j-J).
    import control

    steps = np.arange(40) * T
    found = control.impulse_response(bank(), steps).outputs.reshape(3, -1) * T
    expected = np.zeros(40)
    for factor, r in SUMS[0].terms:
        start = LATENCY + r.first
        expected[start : start + r.taps.size] += factor * r.taps
        rest = np.arange(start + r.taps.size, 40)
        expected[rest] += factor * r.taps[-1] * r.pole ** (rest - (start + r.taps.size - 1))
    scale = found[0, np.argmax(np.abs(expected))] / expected[np.argmax(np.abs(expected))]
    assert min(abs(scale - 1.0), abs(scale - T)) < 1e-9  # a pulse of height 1 or of area 1
    np.testing.assert_allclose(found[0] / scale, expected, atol=1e-13)


def test_states_are_shared():
    # One shift register, as long as the longest one needs, and one state for each tail.
    single = [r.system(LATENCY).nstates for r in (NOMINAL, SLOW, LATE)]
    tails = {(r.first + r.taps.size, r.pole) for r in (NOMINAL, SLOW, LATE)}
    assert len(tails) == 3  # two lags, and one window that ends later
    assert bank().nstates == max(single) - 1 + len(tails)
    assert bank().nstates < sum(single)
    # Sums of the same responses cost nothing.
    twice = bank((*SUMS, *SUMS), outputs=("a", "b", "c", "d", "e", "f"))
    assert twice.nstates == bank().nstates


def test_sums_add_and_scale():
    total = SUMS[0] + SUMS[1].scaled(-0.5)
    np.testing.assert_allclose(total(Z), SUMS[0](Z) - 0.5 * SUMS[1](Z), atol=1e-14)
    assert total.event_time == T
    assert SUMS[0](1.0 + 0.0j).shape == ()


def test_too_short_latency_is_refused():
    least = 1 - min(r.first for r in (NOMINAL, SLOW, LATE))
    assert bank(latency=least).nstates > 0
    with pytest.raises(ParameterError, match=f"must be at least {least}: the window"):
        bank(latency=least - 1)


def test_what_does_not_fit_is_refused():
    other = PulseResponse.of_window(0.01, time_constant=15e-3, delay=1e-3)
    with pytest.raises(ParameterError, match=r"event times \[0.01, 0.02\] s"):
        PulseSum(((1.0, NOMINAL), (1.0, other)))
    with pytest.raises(ParameterError, match="no term"):
        PulseSum(())
    with pytest.raises(ParameterError, match=r"event times \[0.01, 0.02\] s"):
        bank((SUMS[0], PulseSum(((1.0, other),))), outputs=("a", "b"))
    with pytest.raises(ParameterError, match="3 sums for 2 outputs"):
        bank(outputs=("a", "b"))
