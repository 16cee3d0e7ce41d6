import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest

from camless_ctrl.adaptation import GainSchedule
from camless_ctrl.alarms import Mode
from camless_ctrl.assessment import (
    as_dict,
    assess_boundary,
    assess_estimation,
    assess_false_alarms,
    assess_faults,
    assess_feedforward,
    assess_load_step,
    assess_maps,
    assess_performance,
    assess_robustness,
    assess_scenarios,
    assess_structured,
    assess_throttle_steps,
    assess_uncertainty,
    assess_validation,
    least,
    sentence,
)
from camless_ctrl.closed_loop_result import ClosedLoopResult
from camless_ctrl.false_alarms import FalseAlarmCount
from camless_ctrl.fault_check import FaultRow, FaultTable
from camless_ctrl.faults import Fault
from camless_ctrl.requirements import REQUIREMENTS, evaluate
from plant import ParameterError


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


def quantified(ratio, p_value):
    channels = [
        SimpleNamespace(
            channel=SimpleNamespace(name=f"charge q={q}"), check=SimpleNamespace(min_ratio=r)
        )
        for q, r in enumerate((ratio + 0.3, ratio))
    ]
    coverage = SimpleNamespace(
        p_value=p_value, fresh_inside=981, fresh_samples=1000, bound=SimpleNamespace(share=0.99)
    )
    return SimpleNamespace(channels=channels, least_ratio=ratio, coverage=coverage)


def analysed_speed(rpm, ceiling=0.8, linear=0, plants=0, ratio=0.9, p_value=0.5, gain=None):
    return SimpleNamespace(
        speed_rpm=rpm,
        structured=SimpleNamespace(
            performance=None if ceiling is None else SimpleNamespace(ceiling=ceiling),
            robust_performance=ceiling is not None and ceiling < 1.0,
        ),
        measurement=SimpleNamespace(coverage=SimpleNamespace(p_value=p_value)),
        lti=SimpleNamespace(violations=linear, samples=1000),
        plants=(None,) * 20,
        plant_violations=plants,
        tightness=None if ratio is None else SimpleNamespace(ratio=ratio, speed_rpm=rpm),
        gain_break=None if gain is None else SimpleNamespace(ratio=gain, speed_rpm=rpm),
    )


def analysed(*speeds):
    return SimpleNamespace(speeds=speeds, schedule=GainSchedule())


def run_of(error, seed=0):
    """Twelve cycles of two cylinders, with the given relative errors repeated over the run."""
    m = 24
    charge = 1e-4 * (1.0 + np.resize(error, m))
    flat = np.ones(m)
    return ClosedLoopResult("run", 2, seed, flat, np.arange(m) % 2 + 1, 1500 * flat, 1e-4 * flat,
                            charge, charge, 1e-6 * flat, flat, 3 * flat, 100 * flat, flat,
                            0 * flat, flat, flat > 2, flat > 2)  # fmt: skip


def fault_row(kind, *, events=5.0, during=0.02, adapted=0.0, recovered=0.001):
    return FaultRow(Fault(kind, 1.0), 1500.0, "maf", events, Mode.DEGRADED, 0.02, during, 0.02,
                    adapted, recovered, 20.0)  # fmt: skip


def fault_free(cycles=10_000, alarms=0):
    return FalseAlarmCount(cycles, 4 * cycles, 40, alarms, {"maf": alarms} if alarms else {}, ())


def suite_of(*checks):
    """Suite of pairs of whether a check is met and whether it is missed by jitter alone."""
    made = [
        SimpleNamespace(
            result=SimpleNamespace(scenario=SimpleNamespace(name=f"s{k}")),
            verdict=SimpleNamespace(met=met, requirement=SimpleNamespace(name="error")),
            jitter_alone=by_jitter,
            counts=not (met or by_jitter),
        )
        for k, (met, by_jitter) in enumerate(checks)
    ]
    return SimpleNamespace(checks=made, missed=[c for c in made if not c.verdict.met])


def test_faults_are_judged_by_the_worst_of_the_sensors_and_by_what_any_leaves_behind():
    rows = (
        fault_row("maf-drift", events=61.0),
        fault_row("speed-spike", during=0.16),
        fault_row("duration-missing", events=math.nan),  # harmless: no detection is asked for
        # Valves cost charge, and are not held to the bounds of sensors; what is left after is.
        fault_row("valve-stuck", events=90.0, during=1.0, adapted=1.0, recovered=0.011),
        fault_row("missed-computation", events=80.0, during=0.5, adapted=math.nan),
    )
    found = by_name(assess_faults(FaultTable(rows)))
    assert {n: (r.value, r.note) for n, r in found.items()} == {
        "faults-missed": (0, ""),
        "fault-detection": (61.0, "maf-drift"),
        "fault-charge-error": (pytest.approx(16.0), "speed-spike"),
        "fault-recovery": (pytest.approx(1.1), "valve-stuck"),
    }
    assert [row.met for row in found.values()] == [True, False, False, False]


def test_a_fault_that_is_neither_found_nor_harmless_is_missed():
    hidden = fault_row("map-offset", events=math.nan, adapted=0.021)
    found = by_name(assess_faults(FaultTable((fault_row("maf-nan"), hidden))))
    assert (found["faults-missed"].value, found["faults-missed"].note) == (1, "map-offset")
    assert not found["faults-missed"].met


def test_faults_that_were_not_tried_meet_nothing():
    assert not any(row.met for row in assess_faults(FaultTable(())))
    # A computation that is missed is no sensor's fault.
    found = by_name(assess_faults(FaultTable((fault_row("missed-computation"),))))
    assert math.isnan(found["fault-detection"].value)
    assert math.isnan(found["fault-charge-error"].value)
    assert found["fault-recovery"].met


@pytest.mark.parametrize(
    ("run", "value", "met"),
    [
        (fault_free(), 0.0, True),
        (fault_free(alarms=3), 3.0, False),
        (fault_free(cycles=9_999), math.nan, False),  # too few to say
    ],
)
def test_false_alarms_count_events_of_ten_thousand_cycles(run, value, met):
    (found,) = assess_false_alarms(run)
    assert found.value == pytest.approx(value, nan_ok=True)
    assert found.met == met


def test_scenarios_are_judged_by_misses_that_count_and_tell_the_others():
    (found,) = assess_scenarios(suite_of((True, False), (False, True), (False, False)))
    assert found.value == 1
    assert found.note == "s1: error (jitter, not counted); s2: error"
    assert assess_scenarios(suite_of((True, False), (False, True)))[0].met
    assert not assess_scenarios(suite_of())[0].met


def test_load_step_is_judged_by_the_mean_over_seeds():
    found = by_name(assess_load_step([run_of([0.008, 0.0]), run_of([0.0, 0.008], seed=1)]))
    assert found["imbalance"].value == pytest.approx(0.0, abs=1e-9)  # each alone: 0.797 %
    assert found["cylinder-error"].value == pytest.approx(0.4)
    assert found["imbalance"].note == "2 seeds; one by one 0.80 % median, 0.80 % worst"
    assert not by_name(assess_load_step([run_of([0.008, 0.0])]))["imbalance"].met


def test_runs_of_different_demands_are_not_averaged():
    other = dataclasses.replace(run_of([0.0]), demand=np.full(24, 2e-4))
    with pytest.raises(ParameterError, match="differ in demand"):
        assess_load_step([run_of([0.0]), other])


def test_uncertainty_is_judged_by_its_weakest_weight_and_by_the_fresh_plants():
    found = by_name(assess_uncertainty(quantified(0.999, 0.004)))
    assert not any(row.met for row in found.values())
    assert found["uncertainty-weights"].note == "charge q=1"
    assert found["uncertainty-coverage"].note == "981 of 1000 inside, 99 % claimed"
    assert all(row.met for row in assess_uncertainty(quantified(1.0, 0.01)))


def test_structured_robustness_is_judged_by_its_worst_speed_and_by_all_that_was_sampled():
    found = by_name(
        assess_structured(
            analysed(
                analysed_speed(1500.0),
                analysed_speed(3000.0, 0.9, linear=2, plants=1, ratio=1.3, p_value=0.002),
                analysed_speed(4500.0, ceiling=1.02, linear=7, ratio=1.5),
            )
        )
    )
    assert found["loop-robust-performance"].value == 1.02
    assert found["loop-robust-performance"].note == "at 4500 rpm"
    # What was not called robust cannot be contradicted: 4500 rpm does not count.
    assert found["loop-sound"].value == 3
    assert found["loop-sound"].note == "2 of 2000 linear members, 1 of 40 full plants"
    assert found["loop-coverage"].value == 0.002
    # At 4500 rpm the differences are held: told, but not counted.
    assert found["loop-tight"].value == pytest.approx(30.0 / 25.0)
    assert found["loop-tight"].note == (
        "distance 30.0 % off at 3000 rpm, of 2 speeds; the mean alone, not counted: 4500 rpm 50.0 %"
    )
    assert not any(row.met for row in found.values())
    assert all(row.met for row in assess_structured(analysed(analysed_speed(1500.0))))


@pytest.mark.parametrize(("gains", "met"), [((1.09, 0.91), True), ((0.95, 1.11), False)])
def test_break_by_gain_counts_at_every_speed(gains, met):
    # At 6000 rpm the default schedule holds the differences, which says nothing of a design.
    speeds = [
        analysed_speed(r, ratio=None, gain=g) for r, g in zip((750.0, 6000.0), gains, strict=True)
    ]
    row = by_name(assess_structured(analysed(*speeds)))["loop-tight"]
    assert row.met == met
    assert row.value == pytest.approx(max(abs(g - 1.0) for g in gains) / 0.1)
    assert row.note.endswith("of 2 speeds")


def test_break_by_gain_must_be_tried_everywhere_and_be_found():
    untried = [analysed_speed(750.0, ratio=None, gain=1.0), analysed_speed(6000.0, ratio=None)]
    assert math.isnan(by_name(assess_structured(analysed(*untried)))["loop-tight"].value)
    endless = analysed(analysed_speed(750.0, ratio=None, gain=math.inf))
    assert not by_name(assess_structured(endless))["loop-tight"].met


def test_structured_robustness_without_mu_or_break_is_not_met():
    found = by_name(
        assess_structured(
            analysed(analysed_speed(1500.0, ratio=None), analysed_speed(750.0, None, ratio=0.9))
        )
    )
    assert math.isnan(found["loop-robust-performance"].value)
    assert math.isnan(found["loop-tight"].value)
    assert found["loop-sound"].met


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
    claims = [
        SimpleNamespace(id="held", reproduced=True, known_exception=""),
        SimpleNamespace(id="excused", reproduced=False, known_exception="as explained"),
        SimpleNamespace(id="lost", reproduced=False, known_exception=""),
    ]
    found = by_name(assess_validation(SimpleNamespace(figures=rows, claims=claims, rms=0.008)))
    assert found["published-claims"].note == "lost"
    assert not found["published-claims"].met
    assert found["published-worst"].value == pytest.approx(1.9)
    assert found["published-worst"].met
    assert not found["published-rms"].met


def test_every_requirement_is_assessed_by_one_function():
    error = SimpleNamespace(charge_rms=0.0, charge_max=0.0, loss_rms=0.0, loss_max=0.0,
                            worst_charge="here", worst_loss="there")  # fmt: skip
    figures = [SimpleNamespace(relative_error=0.0, known_exception="")]
    step = SimpleNamespace(rms_each=np.array([0.01]), throttles_deg=(20.0, 40.0), speed_rpm=1500.0)
    one = np.zeros(1)
    path = SimpleNamespace(excess=one, charge=one, speed_rpm=one, worst=0.0)
    estimate = SimpleNamespace(cylinder_errors=one, consistency=1.0, innovation_ratio=1.0,
                               n_cylinders=4, point=SimpleNamespace(speed_rpm=1500.0))  # fmt: skip
    found = [
        *assess_validation(SimpleNamespace(figures=figures, claims=[], rms=0.0)),
        *assess_maps(error),
        *assess_boundary(error),
        *assess_throttle_steps([step]),
        *assess_uncertainty(quantified(1.1, 0.5)),
        *assess_robustness([speed(750, 0.5, 0.6)]),
        *assess_structured(analysed(analysed_speed(1500.0))),
        *assess_load_step([run_of([0.0] * 8)]),
        *assess_feedforward(path),
        *assess_estimation(SimpleNamespace(results=[estimate], worst_cylinder_error=0.0)),
        *assess_performance(SimpleNamespace(of=lambda law: []), "law"),
        *assess_faults(FaultTable((fault_row("maf-nan"),))),
        *assess_false_alarms(fault_free()),
        *assess_scenarios(suite_of((True, False))),
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
