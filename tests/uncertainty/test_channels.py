from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest

from plant import ParameterError
from plant.region import OperatingPoint
from uncertainty.channels import Channel, ChannelUncertainty, folded_envelope
from uncertainty.disks import smallest_disks
from uncertainty.weights import fit_weight

POINT = OperatingPoint(1500.0, 3.0, 120.0)
CYCLE = 0.08  # s
THETA = np.linspace(-np.pi, np.pi, 41)


def gain_channel(spread=0.2):
    """Channel of a gain between 1 - spread and 1 + spread, about a nominal of 1."""
    samples = np.array([1.0 - spread, 1.0, 1.0 + spread])[:, None] * np.ones(THETA.size)
    envelope = np.full(THETA.size, spread)
    omega = THETA[THETA >= 0.0] / CYCLE
    weight = fit_weight(omega, folded_envelope(THETA, envelope), dt=CYCLE)
    return ChannelUncertainty(
        channel=Channel(POINT, "air_charge", 0),
        theta=THETA,
        charge=np.full(THETA.size, 2.0 + 0j),
        nominal=np.ones(THETA.size, dtype=complex),
        full=np.full(THETA.size, 1.0 + 0.03j),
        envelope=envelope,
        disks=smallest_disks(samples),
        weight=weight,
        check=weight.check(omega, envelope[THETA >= 0.0]),
    )


def test_the_envelope_is_folded_onto_the_larger_side():
    # Of e^theta the positive side is the larger one, of e^-theta the other: both give e^|theta|.
    for sign in (1.0, -1.0):
        folded = folded_envelope(THETA, np.exp(sign * THETA))
        np.testing.assert_allclose(folded, np.exp(THETA[THETA >= 0.0]), rtol=1e-14)
    np.testing.assert_array_equal(
        folded_envelope(np.array([-1.0, 0, 1]), np.array([3, 7, 2])), [7, 3]
    )


@pytest.mark.parametrize(
    ("output", "mode", "name"),
    [
        ("air_charge", 0, "charge q=0 at 1500 rpm, 3 mm, 120 deg"),
        ("maf", 2, "MAF q=2 at 1500 rpm, 3 mm, 120 deg"),
    ],
)
def test_a_channel_is_named_by_output_mode_and_speed(output, mode, name):
    channel = Channel(POINT, output, mode)
    assert channel.name == str(channel) == name


def test_the_figures_of_a_known_gain():
    found = gain_channel(0.2)
    assert found.peak == pytest.approx(0.2, rel=1e-6)
    assert found.reduction_error == pytest.approx(0.03)
    np.testing.assert_allclose(found.own_error, 0.03)
    assert found.recentred_radius == pytest.approx(0.2)
    record = found.record()
    assert (record["channel"], record["output"], record["mode"]) == (
        "charge q=0 at 1500 rpm, 3 mm, 120 deg",
        "air_charge",
        0,
    )
    assert (record["speed_rpm"], record["lift_mm"], record["duration_deg"]) == POINT
    assert record["order"] == 0
    assert record["min_ratio"] == pytest.approx(1.0, rel=1e-6)
    assert record["max_ratio"] == pytest.approx(1.0, rel=1e-6)
    assert "|W| up to 0.2 (order 0" in str(found)


def test_the_peak_is_found_between_the_phases_of_the_fit():
    # W = z^2/((z - p)(z - p*)), whose resonance is in the middle of an interval of the grid.
    angle = 0.5 * (THETA[30] + THETA[31])
    pole = 0.98 * np.exp(1j * angle)
    flat = gain_channel().weight
    weight = replace(
        flat,
        order=2,
        zeros=np.zeros(2, dtype=complex),
        poles=np.array([pole, pole.conjugate()]),
        gain=1.0,
    )
    z = np.exp(1j * np.linspace(0.0, np.pi, 20001))
    truth = np.abs(z**2 / ((z - pole) * (z - pole.conjugate()))).max()
    found = replace(gain_channel(), weight=weight)
    assert found.peak == pytest.approx(truth, rel=0.02)
    assert np.abs(weight.magnitude(weight.omega)).max() < 0.5 * truth


def test_a_weight_that_is_too_small_fails_its_check_and_is_refused():
    found = gain_channel()
    half = THETA >= 0.0
    small = replace(found.weight, gain=0.9 * found.weight.gain)
    check = small.check(THETA[half] / CYCLE, found.envelope[half])
    assert not check.holds
    assert check.min_ratio == pytest.approx(0.9, rel=1e-6)
    with pytest.raises(ParameterError, match=r"factor is 0\.9, but must be in \[1"):
        found.weight.scaled(0.9)


def test_the_picture():
    ax = gain_channel().plot()
    own, envelope, weight = ax.get_lines()
    np.testing.assert_allclose(own.get_ydata(), 0.03)
    np.testing.assert_allclose(envelope.get_ydata(), 0.2)
    np.testing.assert_allclose(weight.get_ydata(), 0.2, rtol=1e-6)
    assert weight.get_xdata()[[0, -1]].tolist() == [0.0, 180.0]
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("cycle phase (deg)", "residual (1)")
    plt.close(ax.figure)
