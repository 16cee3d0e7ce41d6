import math
from types import SimpleNamespace

import numpy as np
import pytest

from camless_ctrl.adaptation import AdaptationGains
from camless_ctrl.estimator_response import AnalysedEstimator
from camless_ctrl.gain_break import WITHIN, GainBreak, _simulated, check_gain_break
from camless_ctrl.pulse_bank import PulseSum
from camless_ctrl.uncertain_loop import UncertainLoop
from camless_ctrl.uncertain_measurement import UncertainMeasurement, uncertain_measurement
from plant import ParameterError, PulseResponse
from uncertainty.parameters import UncertaintySet
from uncertainty.weights import fit_weight

T, NAME = 0.02, "MAF gain error"
QUICK = {"share": 0.8, "confidence": 0.8, "design": 8, "fresh": 8}


def ideal(size):
    """Estimate that is the charge times ``1 + size d``, used after three events."""
    charge = PulseSum(((1.0, PulseResponse(T, 0, np.ones(1), 0.0)),))
    omega = np.linspace(0.0, np.pi, 9) / T
    weight = fit_weight(omega, np.full(9, 1e-3), dt=T, orders=(0,))
    return UncertainMeasurement(
        local=SimpleNamespace(speed_rpm=1500.0, n_cylinders=4),
        demand=2.5e-4,
        estimator=AnalysedEstimator(None, 3),
        uncertain=UncertaintySet.sensors().only([NAME]),
        nominal=charge,
        centre=charge,
        directions={NAME: charge.scaled(size)},
        weight=weight,
    )


@pytest.mark.parametrize(("value", "gain"), [(0.0, 1.0), (0.03, 1.25)])
def test_prediction_is_that_of_the_closed_form(monkeypatch, value, gain):
    # z^4 = 1 - k: each cylinder is an integrator, which breaks at k = 2.
    monkeypatch.setattr("camless_ctrl.gain_break._simulated", lambda breaks, predicted: predicted)
    found = check_gain_break(ideal(0.25), None, AdaptationGains(0.4, 0.4), values={NAME: value})
    assert found.predicted == pytest.approx(2.0 / 0.4 / gain, rel=2e-3)
    assert found.predicted_turns % 1.0 == pytest.approx(0.5)
    loop = UncertainLoop.adaptive(ideal(0.25), AdaptationGains(0.4, 0.4))
    assert loop.spectral_radius({}) == pytest.approx(0.6, rel=1e-6)


def test_full_plant_breaks_as_predicted(high_lift):
    measurement = uncertain_measurement(
        high_lift.plant,
        high_lift.model,
        250e-6,
        high_lift.speed_rpm,
        estimator=high_lift.estimator,
        **QUICK,
    )
    found = check_gain_break(
        measurement, high_lift.model, AdaptationGains(0.4, 0.4), plant=high_lift.plant
    )
    assert found.tight
    assert found.ratio == pytest.approx(1.0, abs=0.05)
    assert found.simulated_turns % 1.0 == pytest.approx(0.5, abs=0.05)
    assert "the full plant with" in str(found)


@pytest.mark.parametrize(
    ("at", "found"), [(1.3, 1.3), (0.8, 0.8), (3.0, math.inf), (0.1, 0.0), (1.0, 1.0)]
)
def test_search_finds_the_break(at, found):
    assert _simulated(lambda factor: factor >= at, 1.0) == pytest.approx(found, rel=0.006)


def test_what_is_far_off_is_not_tight():
    for simulated in (math.inf, 0.0, 1.2):
        found = GainBreak(1500.0, AdaptationGains(0.1, 0.1), {}, 1.0, simulated, 0.5, 0.5)
        assert not found.tight
    assert WITHIN < 0.2


def test_unknown_parameters_and_loops_without_break_are_refused():
    with pytest.raises(ParameterError, match="the directions are MAF gain error"):
        check_gain_break(ideal(0.1), None, AdaptationGains(0.4, 0.4), values={"viscosity": 1.0})
    with pytest.raises(ParameterError, match="unstable with the lowest gains"):
        check_gain_break(ideal(-1.5), None, AdaptationGains(0.4, 0.4), values={NAME: 0.03})
