import math
from types import SimpleNamespace

import pytest

from camless_ctrl.assessment import (
    as_dict,
    assess_load_step,
    assess_maps,
    assess_robustness,
    assess_validation,
    least,
    sentence,
)
from camless_ctrl.requirements import REQUIREMENTS, evaluate


def by_name(found):
    return {row.requirement.name: row for row in found}


def speed(rpm, radius, worst, gain_margin=3.0, disk=1.0, small_gain=0.5):
    return SimpleNamespace(
        speed_rpm=rpm,
        modes=[SimpleNamespace(spectral_radius=0.1), SimpleNamespace(spectral_radius=radius)],
        worst=(worst, 0.02, 0.003),
        gain_margin=gain_margin,
        disk_margin=disk,
        small_gain=small_gain,
    )


def test_loop_is_judged_by_its_worst_speed():
    found = by_name(assess_robustness([speed(750, 0.5, 0.6), speed(6000, 0.9, 1.1, 1.5, 0.7, 1.2)]))
    assert found["loop-spectral-radius"].value == 0.9
    assert found["loop-worst-spectral-radius"].note == "at 6000 rpm, lag 20 ms, delay 3.0 ms"
    assert found["loop-gain-margin"].value == 1.5
    assert found["loop-small-gain"].value == 1.2
    met = {name: row.met for name, row in found.items()}
    assert met == {
        "loop-spectral-radius": True,
        "loop-worst-spectral-radius": False,
        "loop-gain-margin": False,
        "loop-disk-margin": True,
        "loop-small-gain": False,
    }


def test_speed_without_margins_meets_none_of_them():
    unstable = speed(3000, 1.2, 1.3, math.nan, math.nan, math.nan)
    found = assess_robustness([speed(750, 0.5, 0.6), unstable, speed(6000, 0.5, 0.6)])
    assert not any(row.met for row in found)


def test_known_exceptions_do_not_count_as_figures_that_can_be_met():
    rows = [
        SimpleNamespace(relative_error=-0.019, known_exception=""),
        SimpleNamespace(relative_error=0.6, known_exception="cannot be met"),
    ]
    found = by_name(assess_validation(SimpleNamespace(figures=rows, rms=0.008)))
    assert found["published-worst"].value == pytest.approx(1.9)
    assert found["published-worst"].met
    assert not found["published-rms"].met


def test_every_requirement_is_assessed_by_one_function():
    error = SimpleNamespace(charge_rms=0.0, charge_max=0.0, loss_rms=0.0, loss_max=0.0,
                            worst_charge="here", worst_loss="there")  # fmt: skip
    lifts = SimpleNamespace(min=lambda: 1.0, max=lambda: 2.0)
    run = SimpleNamespace(worst_error=lambda n: 0.0, worst_imbalance=lambda n: 0.0, lift_mm=lifts)
    figures = [SimpleNamespace(relative_error=0.0, known_exception="")]
    found = [
        *assess_validation(SimpleNamespace(figures=figures, rms=0.0)),
        *assess_maps(error),
        *assess_robustness([speed(750, 0.5, 0.6)]),
        *assess_load_step(run),
    ]
    assert sorted(row.requirement.name for row in found) == sorted(REQUIREMENTS)


def test_least_keeps_nan():
    assert least([3.0, 1.0, 2.0]) == 1.0
    assert math.isnan(least([3.0, math.nan, 1.0]))


def test_sentence_and_json_name_value_bound_and_unit():
    found = evaluate("imbalance", 0.75, "at the last step")
    assert sentence(found) == "imbalance is 0.75 %, but must be at most 0.5 % (at the last step)"
    assert sentence(evaluate("imbalance", math.nan)) == (
        "imbalance was not found, but must be at most 0.5 %"
    )
    assert as_dict(found)["margin"] == pytest.approx(-0.25)
    assert as_dict(found) | {"margin": 0} == {
        "name": "imbalance",
        "description": REQUIREMENTS["imbalance"].description,
        "sense": "at most",
        "bound": 0.5,
        "value": 0.75,
        "margin": 0,
        "unit": "%",
        "met": False,
        "note": "at the last step",
        "source": REQUIREMENTS["imbalance"].source,
    }
