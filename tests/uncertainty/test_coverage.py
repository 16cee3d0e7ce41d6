import json
import math

import numpy as np
import pytest
from scipy.stats import binomtest

from plant import ParameterError
from uncertainty.coverage import (
    bound_from_scores,
    check_fresh,
    confidence_of,
    covered_share,
    samples_needed,
)


def test_published_sample_sizes():
    # 95 %/95 %: 59, 93, 124, 153 and 181 are Wilks' sizes for one-sided limits of order 1 to 5
    assert [samples_needed(0.95, 0.95, k) for k in range(5)] == [59, 93, 124, 153, 181]
    assert samples_needed(0.99, 0.99) == 459
    assert samples_needed(0.5, 0.5) == 1
    assert covered_share(459, 0.99) >= 0.99 > covered_share(458, 0.99)


@pytest.mark.parametrize(("samples", "confidence"), [(1, 0.9), (59, 0.95), (459, 0.99)])
def test_closed_forms_without_left_out_samples(samples, confidence):
    # the share is at least p unless all samples fall into it: p^N
    assert covered_share(samples, confidence) == pytest.approx((1 - confidence) ** (1 / samples))
    assert confidence_of(0.97, samples) == pytest.approx(1.0 - 0.97**samples)


@pytest.mark.parametrize(
    ("share", "samples", "left_out"), [(0.9, 40, 0), (0.9, 60, 3), (0.6, 9, 8)]
)
def test_confidence_is_a_sum_of_binomial_terms(share, samples, left_out):
    few = sum(
        math.comb(samples, j) * (1 - share) ** j * share ** (samples - j)
        for j in range(left_out + 1)
    )
    confidence = confidence_of(share, samples, left_out)
    assert confidence == pytest.approx(1.0 - few, rel=1e-12)
    assert covered_share(samples, confidence, left_out) == pytest.approx(share, rel=1e-9)


@pytest.mark.parametrize("left_out", [0, 2, 20])
def test_samples_needed_is_the_least(left_out):
    n = samples_needed(0.93, 0.9, left_out)
    assert confidence_of(0.93, n, left_out) >= 0.9 > confidence_of(0.93, n - 1, left_out)


@pytest.mark.parametrize(("samples", "share", "confidence"), [(120, None, 0.9), (150, 0.95, 0.9)])
def test_the_claim_holds_as_often_as_it_says(samples, share, confidence):
    # Uniform scores: the share that a bound covers is the bound itself.
    experiments = 4000
    scores = np.random.default_rng(1).random((experiments, samples))
    bounds = [bound_from_scores(row, confidence=confidence, share=share) for row in scores]
    holds = sum(bound.value >= bound.share for bound in bounds)
    exact = confidence_of(bounds[0].share, samples, bounds[0].left_out)
    assert exact >= confidence - 1e-12
    error = math.sqrt(exact * (1.0 - exact) / experiments)
    assert abs(holds / experiments - exact) < 4.0 * error
    assert holds / experiments > confidence - 4.0 * error


def test_a_claim_leaves_out_as_many_samples_as_it_may():
    scores = np.random.default_rng(2).permutation(1000.0 + np.arange(1000))
    bound = bound_from_scores(scores, confidence=0.95, share=0.98)
    k = bound.left_out
    assert confidence_of(0.98, 1000, k) >= 0.95 > confidence_of(0.98, 1000, k + 1)
    assert bound.value == 1999.0 - k
    assert (bound.scores > bound.value).sum() == k
    # at the smallest sample that supports the claim, none may be left out
    few = bound_from_scores(scores[:59], confidence=0.95, share=0.95)
    assert (few.left_out, few.value) == (0, scores[:59].max())
    assert bound_from_scores(scores[:93], confidence=0.95, share=0.95).left_out == 1
    # a tiny confidence lets all but one go: one sample sets the bound
    loose = bound_from_scores([1.0, 2.0, 3.0], confidence=1e-6, share=0.01)
    assert (loose.left_out, loose.value) == (2, 1.0)


def test_without_a_share_all_scores_are_within_the_bound():
    bound = bound_from_scores([3.0, 1.0, 2.0], confidence=0.5)
    assert bound.value == 3.0
    assert bound.share == pytest.approx(0.5 ** (1 / 3))
    assert "3 independent samples, 0 left out" in str(bound)
    assert json.loads(json.dumps(bound.to_dict()))["left_out"] == 0


def test_a_score_equal_to_the_bound_is_inside():
    bound = bound_from_scores(np.repeat([1.0, 2.0], [60, 40]), confidence=0.9, share=0.5)
    assert bound.left_out > 0
    assert bound.value == 1.0 if bound.left_out >= 40 else bound.value == 2.0
    assert check_fresh(bound, [bound.value] * 5).fresh_inside == 5


def test_a_failed_plant_counts_as_outside():
    scores = np.append(np.arange(199.0), math.inf)
    with pytest.raises(
        ParameterError, match=r"1 of 200 plants failed .* at most 0 may be left out"
    ):
        bound_from_scores(scores, confidence=0.95)
    bound = bound_from_scores(scores, confidence=0.95, share=0.95)
    reference = bound_from_scores(np.arange(200.0), confidence=0.95, share=0.95)
    assert bound.left_out == reference.left_out == 4
    assert bound.value == reference.value == 195.0
    check = check_fresh(bound, [1.0, math.inf, 2.0])
    assert (check.fresh_samples, check.fresh_inside) == (3, 2)


def test_fresh_samples_give_the_exact_interval_and_p_value():
    bound = bound_from_scores(np.arange(459.0), confidence=0.99, share=0.99)
    for inside, consistent in ((1000, True), (989, True), (970, False), (0, False)):
        fresh = np.repeat([0.0, 1e9], [inside, 1000 - inside])
        check = check_fresh(bound, fresh)
        test = binomtest(inside, 1000, 0.99, alternative="less")
        interval = binomtest(inside, 1000).proportion_ci(0.99, method="exact")
        assert check.p_value == pytest.approx(test.pvalue, rel=1e-9)
        assert (check.low, check.high) == pytest.approx((interval.low, interval.high), rel=1e-9)
        assert check.consistent is consistent
        assert ("contradicts" in str(check)) is not consistent
        assert check.observed == inside / 1000


def test_a_true_claim_is_seldom_contradicted():
    random = np.random.default_rng(3)
    bound = bound_from_scores(random.random(300), confidence=0.9, share=0.95)
    exact = bound.__class__(0.95, 0.95, 0.9, 300, bound.left_out, bound.scores)
    alarms = sum(not check_fresh(exact, random.random(200)).consistent for _ in range(1000))
    assert alarms / 1000 < 0.1 + 4.0 * math.sqrt(0.1 * 0.9 / 1000)
    assert alarms > 0


def test_the_dictionary_holds_the_claim_and_the_count():
    check = check_fresh(bound_from_scores(np.arange(100.0), confidence=0.9), [1.0, 2.0, 200.0])
    plain = json.loads(json.dumps(check.to_dict()))
    assert plain["claimed"] == pytest.approx(0.1**0.01)
    assert (plain["confidence"], plain["fresh_samples"], plain["fresh_inside"]) == (0.9, 3, 2)
    assert plain["consistent"] == check.consistent


def test_bad_input_is_refused_and_says_what_helps():
    with pytest.raises(ParameterError, match=r"458 samples are too few .* at least 459"):
        bound_from_scores(np.arange(458.0), confidence=0.99, share=0.99)
    with pytest.raises(ParameterError, match="score 1 is nan"):
        bound_from_scores([1.0, math.nan], confidence=0.9)
    with pytest.raises(ParameterError, match="score 0 is -inf"):
        check_fresh(bound_from_scores([1.0], confidence=0.9), [-math.inf])
    with pytest.raises(ParameterError, match="one for each sample"):
        bound_from_scores([], confidence=0.9)
    with pytest.raises(ParameterError, match="one for each sample"):
        bound_from_scores([[1.0]], confidence=0.9)
    for confidence in (0.0, 1.0, math.nan):
        with pytest.raises(ParameterError, match="confidence is"):
            bound_from_scores([1.0], confidence=confidence)
    with pytest.raises(ParameterError, match="share is 1"):
        samples_needed(1.0, 0.9)
    with pytest.raises(ParameterError, match="left_out is 5, but must be from 0 to 4"):
        covered_share(5, 0.9, 5)
    with pytest.raises(ParameterError, match="claim a smaller share"):
        samples_needed(1.0 - 1e-12, 0.99)


def test_the_plot_shows_both_samples_the_bound_and_failed_plants():
    import matplotlib

    matplotlib.use("agg")
    bound = bound_from_scores(np.arange(1.0, 101.0), confidence=0.9)
    ax = check_fresh(bound, [5.0, 7.0, math.inf, 250.0]).plot()
    labels = ax.get_legend_handles_labels()[1]
    assert labels == ["calibration, 100 samples", "fresh, 4 samples", "bound", "claimed share"]
    calibration, fresh, line, _ = ax.get_lines()
    assert calibration.get_ydata()[-1] == 1.0
    assert fresh.get_ydata()[-1] == 0.75  # the failed plant is within no score
    assert set(line.get_xdata()) == {100.0}
    matplotlib.pyplot.close(ax.figure)
