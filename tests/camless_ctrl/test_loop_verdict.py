import math
from types import SimpleNamespace

import numpy as np
import pytest

from camless_ctrl._rank_one import RankOneLoop, UncertainValues
from camless_ctrl.adaptation import AdaptationGains, GainSchedule
from camless_ctrl.disk_margins import disk_margins
from camless_ctrl.estimator_response import AnalysedEstimator
from camless_ctrl.gang_of_four import gang_of_four
from camless_ctrl.loop_verdict import loop_verdicts, small_gain, worst_radius
from camless_ctrl.nominal_loop import NominalLoop
from camless_ctrl.pulse_bank import PulseSum
from camless_ctrl.robust_analysis import RobustAnalysis, SpeedAnalysis
from camless_ctrl.uncertain_loop import UncertainLoop
from camless_ctrl.uncertain_measurement import UncertainMeasurement
from plant import PulseResponse
from uncertainty.parameters import UncertaintySet
from uncertainty.weights import fit_weight

T, SIZE, REST = 0.02, 0.25, 1e-3


def ideal():
    """Estimate that is the charge times ``1 + 0.25 d``, used after three events."""
    charge = PulseSum(((1.0, PulseResponse(T, 0, np.ones(1), 0.0)),))
    omega = np.linspace(0.0, np.pi, 9) / T
    return UncertainMeasurement(
        local=SimpleNamespace(speed_rpm=1500.0, n_cylinders=4),
        demand=2.5e-4,
        estimator=AnalysedEstimator(None, 3),
        uncertain=UncertaintySet.sensors().only(["MAF gain error"]),
        nominal=charge,
        centre=charge,
        directions={"MAF gain error": charge.scaled(SIZE)},
        weight=fit_weight(omega, np.full(9, REST), dt=T, orders=(0,)),
    )


def verdict(measurement, gains):
    loop = UncertainLoop.adaptive(measurement, gains)
    nominal = NominalLoop.of_uncertain_loop(loop)
    structured = SimpleNamespace(
        loop=loop, speed_rpm=measurement.speed_rpm, stable=loop.stable, robustly_stable=loop.stable
    )
    speed = SpeedAnalysis(structured, gang_of_four(nominal), disk_margins(nominal))
    schedule = GainSchedule.constant(gains.mean, gains.imbalance)
    (found,) = loop_verdicts(RobustAnalysis((speed,), schedule, None, 0))
    return found


def test_figures_are_those_of_integrators():
    # Each cylinder: z^4 = 1 - k, T = k/(z^4 - 1 + k), which is 1 at the steady patterns.
    k = 0.4
    found = verdict(ideal(), AdaptationGains(k, k))
    assert found.stable
    assert [mode.q for mode in found.modes] == [0, 1, 2]
    for mode in found.modes:
        assert mode.spectral_radius == pytest.approx(1.0 - k, rel=1e-6)
        assert mode.margins.gain_margin == pytest.approx(2.0 / k, rel=1e-3)
        assert mode.small_gain == pytest.approx(SIZE + REST, rel=1e-3)
        assert not mode.held
    assert found.gain_margin == pytest.approx(2.0 / k, rel=1e-3)
    assert found.sensitivity_error == pytest.approx(SIZE + REST, rel=1e-3)
    assert found.small_gain == max(mode.small_gain for mode in found.modes)
    # |S - 1/2| is 1/2 at the patterns and (z^4 = -1) 2/(2 - k) - 1/2 in between.
    assert found.disk_margin == pytest.approx(1.0 / (2.0 / (2.0 - k) - 0.5), rel=1e-3)
    assert found.worst[0] == pytest.approx(1.0 - k * (1.0 - SIZE), abs=2.0 * k * REST)
    assert math.isnan(found.worst[1])  # the set has no lag
    assert math.isnan(found.delay_limit)
    assert "stable; gains 0.400" in str(found)


def test_unstable_loop_has_no_margin():
    found = verdict(ideal(), AdaptationGains(2.5, 2.5))
    assert not found.stable
    assert max(mode.spectral_radius for mode in found.modes) == pytest.approx(1.5, rel=1e-6)
    for value in (found.gain_margin, found.disk_margin, found.small_gain, found.sensitivity_peak):
        assert math.isnan(value)
    assert "unstable" in str(found)


def test_small_gain_bounds_mu_and_the_worst_corner_is_one(measured):
    measurement = measured(1500.0)
    loop = UncertainLoop.adaptive(measurement, AdaptationGains(0.4, 0.4))
    angle, size = small_gain(loop)
    mu = RankOneLoop.of_law(UncertainValues.of(measurement, angle), loop.law).mu_stability()
    assert np.all(size >= mu * (1.0 - 1e-9))
    assert np.max(size) < 3.0 * np.max(mu)
    radius, at = worst_radius(loop)
    for name, value in at.items():
        p = measurement.uncertain[name]
        assert value == pytest.approx(p.low) or value == pytest.approx(p.high)
    corners = [
        loop.spectral_radius(dict(zip(at, signs, strict=True)))
        for signs in np.stack(np.meshgrid(*3 * [[-1.0, 1.0]]), axis=-1).reshape(-1, 3).tolist()
    ]
    assert max(corners) <= radius < 1.0
