import numpy as np
import pytest

from camless_ctrl import mu_optimal
from camless_ctrl.adaptation import AdaptationGains
from camless_ctrl.lti_synthesis import MU_LIMIT
from camless_ctrl.mu import robust_performance
from camless_ctrl.mu_optimal import mu_optimal_law
from camless_ctrl.synthesis.errors import SynthesisError
from camless_ctrl.uncertain_loop import UncertainLoop
from camless_ctrl.uncertain_measurement import uncertain_measurement

QUICK = {"share": 0.8, "confidence": 0.8, "design": 8, "fresh": 8}


@pytest.fixture(scope="module")
def measurement(high_lift):
    return uncertain_measurement(
        high_lift.plant,
        high_lift.model,
        250e-6,
        high_lift.speed_rpm,
        estimator=high_lift.estimator,
        **QUICK,
    )


@pytest.fixture(scope="module")
def law(measurement):
    return mu_optimal_law(measurement, AdaptationGains(0.3, 0.3), confirm=False)


def test_law_is_robust_with_the_new_estimator(law, measurement):
    assert law.mu_performance <= MU_LIMIT
    loop = UncertainLoop(measurement, law.system)
    proof = robust_performance(loop.system, loop.structure)
    assert proof.robust
    assert np.abs(law.system.poles()).max() < 1.0
    assert all(np.isfinite(law.settling_cycles))


def test_slower_paces_are_tried_until_there_is_a_law(monkeypatch, measurement, law):
    asked = []

    def fails(_, paces, **__):
        asked.append(("hinf", paces.mean))
        raise SynthesisError("none")

    def late(_, paces, **__):
        asked.append(("dk", paces.mean))
        if paces.mean > 0.3:
            raise SynthesisError("too fast")
        return law

    monkeypatch.setattr(mu_optimal, "hinf_law", fails)
    monkeypatch.setattr(mu_optimal, "dk_law", late)
    assert mu_optimal_law(measurement, AdaptationGains(0.5, 0.5)) is law
    assert asked == [("dk", 0.5), ("hinf", 0.5), ("dk", 0.25), ("hinf", 0.25)]
    with pytest.raises(SynthesisError, match=r"no synthesis found a law: too fast .* none"):
        mu_optimal_law(measurement, AdaptationGains(50.0, 50.0))
