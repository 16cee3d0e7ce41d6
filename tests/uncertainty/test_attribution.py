import json

import numpy as np
import pytest
from scipy.stats import sobol_indices

from plant import CrankAnglePlant, Engine, InfeasibleProfileError, OperatingPoint, ParameterError
from uncertainty._sobol import sobol
from uncertainty.attribution import attribute
from uncertainty.parameters import UncertaintySet
from uncertainty.perturbed import PerturbedPlants
from uncertainty.sampling import draw

POINT = OperatingPoint(1500.0, 3.0, 120.0)


def within(indices, first, total):
    rounding = 1e-12
    for kind, truth in (("first", first), ("total", total)):
        low, high = (getattr(indices, f"{kind}_{end}")[0] for end in ("low", "high"))
        assert (low - rounding <= truth).all(), kind
        assert (truth <= high + rounding).all(), kind


def ishigami(x, a=7.0, b=0.1):
    return np.sin(x[:, :1]) * (1.0 + b * x[:, 2:] ** 4) + a * np.sin(x[:, 1:2]) ** 2


def ishigami_indices(a=7.0, b=0.1):
    v1, v2 = 0.5 * (1.0 + b * np.pi**4 / 5.0) ** 2, a**2 / 8.0
    v13 = b**2 * np.pi**8 * (1.0 / 18.0 - 1.0 / 50.0)
    v = v1 + v2 + v13
    return np.array([v1, v2, 0.0]) / v, np.array([v1 + v13, v2, v13]) / v


def test_ishigami_formulas_give_the_published_indices():
    first, total = ishigami_indices()
    assert first == pytest.approx([0.3139, 0.4424, 0.0], abs=5e-5)
    assert total == pytest.approx([0.5576, 0.4424, 0.2437], abs=1e-4)


def test_ishigami_indices_lie_in_their_intervals():
    first, total = ishigami_indices()
    found = sobol(ishigami, [-np.pi] * 3, [np.pi] * 3, 2048)
    within(found, first, total)
    assert found.first[0] == pytest.approx(first, abs=0.03)
    assert found.total[0] == pytest.approx(total, abs=0.03)
    assert found.mean[0] == pytest.approx(3.5, abs=0.02)  # a/2
    variance = 0.5 + 0.1 * np.pi**4 / 5 + 0.01 * np.pi**8 / 18 + 49.0 / 8.0
    assert found.std[0] == pytest.approx(np.sqrt(variance), rel=0.01)
    assert found.evaluations == 2048 * 5


@pytest.mark.parametrize("base", ["sobol", "latin-hypercube"])
def test_intervals_cover_as_often_as_they_say(base):
    truth = np.stack(ishigami_indices())
    covered = []
    for seed in range(60):
        r = sobol(ishigami, [-np.pi] * 3, [np.pi] * 3, 256, base=base, confidence=0.9, seed=seed)
        low = np.stack((r.first_low[0], r.total_low[0]))
        high = np.stack((r.first_high[0], r.total_high[0]))
        covered.append((low <= truth) & (truth <= high))
    assert np.mean(covered) > 0.9 - 4.0 * np.sqrt(0.1 * 0.9 / 360)


def test_intervals_agree_with_those_of_scipy():
    from scipy.stats import uniform

    found = sobol(ishigami, [-np.pi] * 3, [np.pi] * 3, 512)
    other = sobol_indices(
        func=lambda x: ishigami(x.T).T,
        n=512,
        dists=[uniform(-np.pi, 2.0 * np.pi)] * 3,
        rng=np.random.default_rng(0),
    )
    # the same base points, so the same indices; intervals by another kind of bootstrap
    assert found.first[0] == pytest.approx(other.first_order, abs=1e-12)
    assert found.total[0] == pytest.approx(other.total_order, abs=1e-12)
    intervals = other.bootstrap(0.95, 500)
    for kind, theirs in (("first", intervals.first_order), ("total", intervals.total_order)):
        width = getattr(found, f"{kind}_high")[0] - getattr(found, f"{kind}_low")[0]
        their_width = theirs.confidence_interval.high - theirs.confidence_interval.low
        assert width == pytest.approx(their_width, rel=0.25)


def test_shares_of_an_additive_model_are_those_of_its_variances():
    slopes, low, high = np.array([3.0, -2.0, 1.0, 0.0]), np.zeros(4), np.array([1.0, 2.0, 1, 5])
    shares = (slopes * (high - low)) ** 2
    shares /= shares.sum()
    found = sobol(lambda x: x @ slopes[:, None] + 7.0, low, high, 512)
    within(found, shares, shares)
    assert found.first[0] == pytest.approx(shares, abs=0.02)
    assert found.total[0] == pytest.approx(shares, abs=0.02)
    # no effect: exactly none, with certainty
    for field in ("first", "first_low", "first_high", "total", "total_low", "total_high"):
        assert getattr(found, field)[0, 3] == 0.0


def test_a_product_has_interactions():
    # y = x1 x2, means m and variances v: V = (m1^2 + v1)(m2^2 + v2) - m1^2 m2^2
    low, high = np.array([0.0, 1.0]), np.array([2.0, 2.0])
    m, v = 0.5 * (low + high), (high - low) ** 2 / 12.0
    variance = np.prod(m**2 + v) - np.prod(m**2)
    first = v * m[::-1] ** 2 / variance
    total = 1.0 - first[::-1]
    found = sobol(lambda x: x[:, :1] * x[:, 1:], low, high, 1024)
    within(found, first, total)
    assert found.total[0] - found.first[0] == pytest.approx(total - first, abs=0.01)
    assert (total - first > 0.02).all()


def test_a_group_has_the_joint_index():
    # y = x1 x2 + x3 on [-1, 1]: V = 1/9 + 1/3; the product belongs to the group alone
    found = sobol(
        lambda x: x[:, :1] * x[:, 1:2] + x[:, 2:],
        [-1.0] * 3,
        [1.0] * 3,
        1024,
        groups=[(0, 1), (2,)],
    )
    within(found, np.array([0.25, 0.75]), np.array([0.25, 0.75]))
    assert found.first[0] == pytest.approx([0.25, 0.75], abs=0.02)
    single = sobol(lambda x: x[:, :1] * x[:, 1:2] + x[:, 2:], [-1.0] * 3, [1.0] * 3, 1024)
    assert single.total[0, 0] + single.total[0, 1] == pytest.approx(0.5, abs=0.03)  # not 0.25


def test_a_model_that_fails_is_named_by_its_sample():
    def fails(x):
        y = x.sum(axis=1, keepdims=True)
        y[70] = np.nan
        return y

    with pytest.raises(ParameterError, match=r"output 0 of sample 70 is nan.*1 of 256 samples"):
        sobol(fails, [0.0] * 2, [1.0] * 2, 64)
    with pytest.raises(ParameterError, match="output 1 is 4 at every sample"):
        sobol(lambda x: np.column_stack((x[:, 0], 4.0 + 0.0 * x[:, 0])), [0.0] * 2, [1.0] * 2, 64)
    with pytest.raises(ParameterError, match="a row for each sample"):
        sobol(lambda x: x[:, 0], [0.0] * 2, [1.0] * 2, 64)
    with pytest.raises(ParameterError, match=r"power of two.*take 256"):
        sobol(ishigami, [0.0] * 3, [1.0] * 3, 300)
    with pytest.raises(ParameterError, match="did you mean 'sobol'"):
        sobol(ishigami, [0.0] * 3, [1.0] * 3, 64, base="sobl")
    with pytest.raises(ParameterError, match="must be 2 or more"):
        sobol(lambda x: x, [0.0], [1.0], 64)


@pytest.fixture(scope="module")
def result():
    return attribute(points=(POINT, OperatingPoint(6000.0, 5.0, 220.0)), samples=256)


def test_the_plant_is_sampled_as_it_says(result):
    data = result.dataset
    assert data["total"].dims == ("quantity", "point", "parameter")
    assert result.quantities == ("charge", "loss", "loop_gain", "imbalance")
    d = len(UncertaintySet.plant())
    assert result.evaluations == 2 * 256 * (3 * (d + 2) + d + 4)
    # mean and standard deviation against an independent random sample
    sample = draw(UncertaintySet.plant(), 2000, seed=5)
    cycles = PerturbedPlants(CrankAnglePlant(oscillation=True), sample).steady_cycles(*POINT)
    for quantity, name in (("charge", "air_charge"), ("loss", "pumping_loss")):
        values = cycles[name].mean("cylinder").to_numpy()
        own = data.sel(quantity=quantity).isel(point=0)
        error = values.std() / np.sqrt(2000)
        assert float(own["mean"]) == pytest.approx(values.mean(), abs=8.0 * error)
        assert float(own["std"]) == pytest.approx(values.std(), rel=0.1)


def test_slope_of_the_charge_is_an_index(result):
    # To first order the charge's variance is the sum of (range x slope)^2/12.
    from uncertainty.local_attribution import tornado

    bars = {bar.parameter: bar for bar in tornado(points=(POINT,)).bars("charge")}
    part = {name: (bar.high - bar.low) ** 2 for name, bar in bars.items()}
    for index in result.largest("charge", 0, 4):
        assert index.total == pytest.approx(part[index.parameter] / sum(part.values()), abs=0.05)


def test_cylinders_are_compared_by_groups(result):
    data = result.dataset
    groups = ["flow factors of the cylinders", "duration offsets of the cylinders"]
    assert data["parameter"].to_numpy().tolist()[-2:] == groups
    assert np.isnan(data["total"].sel(quantity="charge", parameter=groups)).all()
    first = data["first"].sel(quantity="imbalance", parameter=groups).sum("parameter")
    total = data["total"].sel(quantity="imbalance", parameter=groups)
    assert (first > 0.5).all()
    assert (total.sum("parameter") > 0.9).all()
    assert {index.parameter for index in result.largest("imbalance", 0, 2)} == set(groups)
    # equal cylinders have no imbalance, so the common parameters hardly matter
    assert result.largest("imbalance", 0, 3)[2].total < 0.1


def test_the_result_is_reproducible_and_the_seed_matters():
    def again(seed):
        few = UncertaintySet.plant().only(["temperature", "flow coefficient"])
        return attribute(uncertain=few, points=(POINT,), samples=64, seed=seed)

    assert again(1).dataset.identical(again(1).dataset)
    assert not again(1).dataset.equals(again(2).dataset)


def test_records_are_plain(result):
    records = json.loads(json.dumps(result.records(), allow_nan=False))
    d = len(UncertaintySet.plant())
    assert len(records) == 2 * (3 * d + d + 2)
    row = records[0]
    assert (row["quantity"], row["speed_rpm"], row["lift_mm"]) == ("charge", 1500.0, 3.0)
    assert row["total_low"] <= row["total_high"]
    assert result.points[1] == OperatingPoint(6000.0, 5.0, 220.0)


def test_the_sentence_names_the_largest_and_its_interval(result):
    first, second = result.largest("charge", 0, 2)
    assert first.total >= second.total
    text = str(result)
    assert f"At {POINT} the air charge varies by" in text
    assert f"{first.parameter} {100 * first.total:.0f} %" in text
    assert f"+-{result.half_width('total'):.2f}" in text
    with pytest.raises(ParameterError, match="did you mean 'charge'"):
        result.largest("charg")
    with pytest.raises(ParameterError, match="point is 2"):
        result.sentence("charge", 2)


def test_what_does_not_vary_cannot_be_attributed():
    oscillation = UncertaintySet.oscillation()
    with pytest.raises(ParameterError, match=r"the air charge at 1500 rpm.* does not vary"):
        attribute(CrankAnglePlant(), oscillation, (POINT,), samples=64)
    with pytest.raises(ParameterError, match="must hold 2 or more"):
        attribute(uncertain=oscillation.only(["oscillation decay"]), points=(POINT,), samples=64)
    with pytest.raises(ParameterError, match="no operating point"):
        attribute(points=())
    with pytest.raises(ParameterError, match="speed_rpm of point 0"):
        attribute(points=(OperatingPoint(-1.0, 3.0, 100.0),))
    with pytest.raises(InfeasibleProfileError, match="cannot reach 7 mm"):
        attribute(points=(POINT, OperatingPoint(6000.0, 7.0, 60.0)), samples=64)


def test_one_cylinder_has_no_imbalance_and_progress_ends_full():
    calls = []
    single = CrankAnglePlant(Engine.paper().replace(n_cylinders=1))
    few = UncertaintySet.plant().only(["temperature", "flow coefficient"])
    result = attribute(single, few, (POINT,), samples=64, progress=lambda *call: calls.append(call))
    assert result.quantities == ("charge", "loss", "loop_gain")
    assert calls[-1] == (result.evaluations, result.evaluations) == (64 * 4 * 3, 64 * 4 * 3)


def test_the_plot_has_a_panel_for_each_point(result):
    import matplotlib

    matplotlib.use("agg")
    figure = result.plot("imbalance", count=3)
    assert len(figure.axes) == 2
    names = [label.get_text() for label in figure.axes[0].get_yticklabels()]
    assert len(names) == 3
    assert set(names[:2]) == {index.parameter for index in result.largest("imbalance", 0, 2)}
    widths = [bar.get_width() for bar in figure.axes[1].patches]
    assert max(widths) == pytest.approx(result.largest("imbalance", 1, 1)[0].total)
    matplotlib.pyplot.close(figure)
