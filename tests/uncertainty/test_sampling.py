import math

import numpy as np
import pytest
from scipy.stats import kstest, qmc

from plant import ParameterError
from uncertainty.parameters import UncertaintySet
from uncertainty.sampling import Sample, corners, draw, nominal_sample, one_at_a_time

RUNNER = UncertaintySet.runner()
METHODS = ("random", "sobol", "latin-hypercube")


def unit(sample):
    low, high = sample.uncertain.low, sample.uncertain.high
    return (sample.values - low) / (high - low)


@pytest.mark.parametrize("method", METHODS)
def test_the_seed_reproduces_the_sample(method):
    one, same, other = (draw(RUNNER, 50, seed, method) for seed in (3, 3, 4))
    assert np.array_equal(one.values, same.values)
    assert not np.isclose(one.values, other.values).any()
    assert (one.method, one.seed, len(one)) == (method, 3, 50)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("count", [1, 7, 64, 1000])
def test_samples_are_uniform_within_the_bounds(method, count):
    values = unit(draw(RUNNER, count, 0, method))
    assert values.shape == (count, len(RUNNER))
    assert ((values >= 0.0) & (values <= 1.0)).all()
    for column in values.T:
        assert kstest(column, "uniform").pvalue > 1e-4


def test_even_samples_fill_the_box_more_evenly_than_random_ones():
    for seed in range(5):
        random, sobol, hypercube = (
            qmc.discrepancy(unit(draw(RUNNER, 128, seed, method))) for method in METHODS
        )
        assert sobol < 0.5 * random
        assert hypercube < random


def test_a_latin_hypercube_has_one_value_in_each_stratum():
    values = unit(draw(RUNNER, 40, 0, "latin-hypercube"))
    assert (np.sort(np.floor(40 * values), axis=0) == np.arange(40)[:, None]).all()


def test_sobol_points_are_balanced_in_halves_also_as_the_head_of_more():
    # each of the first 2^k scrambled points has one value in each 2^-k interval
    values = unit(draw(RUNNER, 100, 0, "sobol"))
    assert (np.sort(np.floor(64 * values[:64]), axis=0) == np.arange(64)[:, None]).all()


def test_random_samples_are_independent():
    values = unit(draw(RUNNER, 4000, 1))
    correlation = np.corrcoef(np.hstack((values[1:], values[:-1])), rowvar=False)
    assert np.abs(correlation - np.eye(len(correlation))).max() < 5.0 / math.sqrt(4000)


def test_columns_and_rows_by_name():
    sample = draw(RUNNER, 5, 0)
    k = RUNNER.names.index("runner area")
    assert np.array_equal(sample.column("runner area"), sample.values[:, k])
    assert sample.at(2)["runner area"] == sample.values[2, k]
    assert list(sample.at(0)) == list(RUNNER.names)
    data = sample.to_xarray()
    assert np.array_equal(data["runner area"], sample.values[:, k])
    assert data.attrs == {"method": "random", "seed": 0}
    assert UncertaintySet.sensors()["MAP offset"].unit == "Pa"
    assert draw(UncertaintySet.sensors(), 2, 0).to_xarray()["MAP offset"].attrs["units"] == "Pa"
    with pytest.raises(ParameterError, match="did you mean 'runner area'"):
        sample.column("runer area")


def test_samples_join_and_are_read_only():
    one, other = draw(RUNNER, 3, 0), draw(RUNNER, 2, 1)
    both = one.joined(other)
    assert np.array_equal(both.values, np.vstack((one.values, other.values)))
    assert both.method == "given"
    with pytest.raises(ValueError, match="read-only"):
        both.values[0, 0] = 1.0
    with pytest.raises(ParameterError, match="different sets"):
        one.joined(draw(UncertaintySet.oscillation(), 2, 1))
    source = np.ones((1, len(RUNNER)))
    kept = Sample(RUNNER, source)
    source[:] = 1.01
    assert (kept.values == 1.0).all()


def test_one_at_a_time_moves_one_parameter_to_each_bound():
    sample = one_at_a_time(RUNNER)
    assert len(sample) == 2 * len(RUNNER)
    assert np.array_equal(nominal_sample(RUNNER).values, RUNNER.nominal[None])
    for k, parameter in enumerate(RUNNER):
        for row, value in ((2 * k, parameter.low), (2 * k + 1, parameter.high)):
            expected = RUNNER.nominal
            expected[k] = value
            assert np.array_equal(sample.values[row], expected)


def test_corners_are_all_combinations_of_bounds():
    box = UncertaintySet.oscillation()
    values = corners(box).values
    assert len(values) == 8 == len(np.unique(values, axis=0))
    assert ((values == box.low) | (values == box.high)).all()
    with pytest.raises(ParameterError, match="17 parameters has 131072 corners, but at most 4096"):
        corners(UncertaintySet.plant())
    assert len(corners(RUNNER, most=32)) == 32
    with pytest.raises(ParameterError, match="at most 31"):
        corners(RUNNER, most=31)


def test_bad_draws_and_samples_are_refused():
    with pytest.raises(ParameterError, match="count is 0"):
        draw(RUNNER, 0, 0)
    with pytest.raises(ParameterError, match="seed is -1"):
        draw(RUNNER, 1, -1)
    with pytest.raises(ParameterError, match="did you mean 'sobol'"):
        draw(RUNNER, 1, 0, "sobl")
    with pytest.raises(ParameterError, match="method is 'given'"):
        draw(RUNNER, 1, 0, "given")
    with pytest.raises(ParameterError, match="the uncertainty set is empty"):
        draw(UncertaintySet(()), 1, 0)
    with pytest.raises(ParameterError, match=r"shape \(5,\), but must be \(samples, 5\)"):
        Sample(RUNNER, np.ones(5))
    with pytest.raises(ParameterError, match=r"shape \(0, 5\)"):
        Sample(RUNNER, np.ones((0, 5)))
    for bad in (3.0, math.nan):
        values = np.ones((2, 5))
        values[1, 1] = bad
        with pytest.raises(ParameterError, match=r"sample 1 has the value .* runner damping 0.5"):
            Sample(RUNNER, values)
