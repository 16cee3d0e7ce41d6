import json
from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest

from plant import (
    CrankAnglePlant,
    Engine,
    MafSensor,
    MeanValuePlant,
    ParameterError,
    PulseResponse,
    SimulationError,
    ValveCommand,
)
from plant.air_path import event_time
from plant.region import OperatingPoint
from uncertainty import quantification
from uncertainty.channels import folded_envelope
from uncertainty.lifted_full_plant import full_plant_response
from uncertainty.lifted_mean_value import mean_value_modes
from uncertainty.parameters import UncertaintySet
from uncertainty.perturbed import PerturbedPlants
from uncertainty.pulse_sampling import sampled_pulses
from uncertainty.quantification import default_set, quantify
from uncertainty.sampling import nominal_sample, one_at_a_time

PLANT = CrankAnglePlant(oscillation=True)
POINT = OperatingPoint(1500.0, 3.0, 120.0)
COMMAND = ValveCommand(3.0, 120.0)
SMALL = {"points": (POINT,), "design": 8, "share": 0.8, "confidence": 0.8, "fresh": 30}
CALIBRATION = 8  # 0.8^8 is at most 1 - 0.8, 0.8^7 is not
GAIN_ERROR = UncertaintySet.sensors().only(["MAF gain error"])
FEW = UncertaintySet.plant().only(["flow coefficient", "temperature", "duration offset"])


@pytest.fixture(scope="module")
def maps():
    return MeanValuePlant.fit(
        CrankAnglePlant(),
        speed_range_rpm=(1400.0, 3100.0),
        lift_range_mm=(2.4, 3.2),
        tolerance=0.02,
        most_points=800,
    )


@pytest.fixture(scope="module")
def recorded(maps):
    """Quantification with the default set, the samples that it drew and what it told."""
    samples, told = [], []
    draw = quantification.draw

    def noted(*arguments):
        samples.append(draw(*arguments))
        return samples[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(quantification, "draw", noted)
        found = quantify(
            PLANT, maps, seed=4, progress=lambda done, of: told.append((done, of)), **SMALL
        )
    return found, samples, told


@pytest.fixture(scope="module")
def found(recorded):
    return recorded[0]


def residuals(maps, channel, sample, theta):
    """``(g - g0)/m`` of a sample (samples, f), from its own pulses."""
    pulses = sampled_pulses(PerturbedPlants(PLANT, sample), COMMAND, 1500.0)
    output, q = channel.channel.output, channel.channel.mode
    gain = float(maps.charge_gradient(3.0, 120.0, 1500.0).duration) * 120.0
    unit = pulses.reference_charge / gain
    nominal = np.interp(theta, channel.theta, channel.nominal.real) + 1j * np.interp(
        theta, channel.theta, channel.nominal.imag
    )
    return unit * pulses.responses(output, modes=[q], theta=theta).mode(q) - nominal


def test_every_plant_of_the_design_sample_lies_within_the_weights(maps, recorded):
    # Each plant simulated anew by the lifted response in units of its own, at phases between
    # those of the fit. g0/m is what the nominal full plant reads for each kg that it takes in.
    found, samples, _ = recorded
    uncertain = default_set()
    design = samples[0].joined(one_at_a_time(uncertain)).joined(nominal_sample(uncertain))
    assert len(design) == found.design == 8 + 2 * len(uncertain) + 1
    T = event_time(1500.0, 4)
    theta = (np.arange(0, 20, 3) + 0.5) * np.pi / 20.0
    gain = float(maps.charge_gradient(3.0, 120.0, 1500.0).duration)

    def response(plants, i, output):
        lifted = full_plant_response(
            plants.plant_at(i),
            plants.commands_at(i, COMMAND, 1500.0),
            1500.0,
            output=output,
            maf=plants.maf_at(i, MafSensor()),
            omega=theta / (4.0 * T),
            relative=False,
            on_infeasible="limit",
        )
        unit = T if output == "maf" else 1.0
        return np.array([unit * lifted.mode_band(q)[1] for q in range(3)])

    both = np.concatenate((theta[::-1], theta))  # sizes of the phases of `mode_band`
    nominal = PerturbedPlants(PLANT, nominal_sample(uncertain))
    charge = response(nominal, 0, "air_charge")
    plants = PerturbedPlants(PLANT, design)
    for output in ("air_charge", "maf"):
        measured = response(nominal, 0, output) / charge
        worst = np.max(
            [np.abs(response(plants, i, output) / gain - measured) for i in range(len(design))],
            axis=0,
        )
        for mode in range(3):
            channel = found.channel(POINT, output, mode)
            ratio = channel.weight.magnitude(both / (4.0 * T)) / worst[mode]
            assert (ratio >= 1.0).all()
            # As tight as the result says, but for the linearity of another step.
            assert ratio.min() == pytest.approx(found.scale * channel.check.min_ratio, rel=0.02)


def test_a_gain_error_of_the_sensor_is_a_residual_of_its_size(maps):
    found = quantify(PLANT, maps, uncertain=GAIN_ERROR, **SMALL)
    for channel in found.channels:
        own = channel.reduction_error
        assert own < 0.05
        size = 0.03 * np.abs(channel.nominal) if channel.channel.output == "maf" else 0.0
        # |(1 + e) g - g0| with |e| up to 3 %, g = g0 + own error: within the triangle.
        assert (channel.envelope <= size + 1.03 * channel.own_error + 1e-12).all()
        assert (channel.envelope >= size - 1.03 * channel.own_error - 1e-12).all()
        folded = folded_envelope(channel.theta, channel.envelope)
        phases = channel.theta[channel.theta >= 0.0]
        magnitude = channel.weight.magnitude(phases / channel.weight.dt)
        assert (magnitude >= folded).all()
        assert (magnitude <= 1.5 * folded).all()  # what a fit calls good
        if channel.channel.output == "air_charge":
            assert channel.disks.radii.max() < 1e-12  # all plants are the same one
    # The design sample holds both bounds, so that no other plant can be further out.
    assert found.coverage.bound.scores.max() <= 1.0
    assert found.scale == found.coverage.bound.value == 1.0
    assert found.coverage.fresh_inside == 30


def test_a_set_of_no_width_leaves_the_reduction_alone(maps):
    # Maps and full plant are one and the same at zero frequency, but for the map's fit; the
    # weights are as small as that, and all plants lie within them.
    plain = CrankAnglePlant()
    fine = MeanValuePlant.fit(
        plain, speed_range_rpm=(1400.0, 1600.0), lift_range_mm=(2.5, 3.5), tolerance=1e-3
    )
    one = (
        UncertaintySet.plant()
        .only(["manifold volume"])
        .replace("manifold volume", low=1.0, high=1.0)
    )
    found = quantify(plain, fine, uncertain=one, **SMALL)
    assert found.scale == pytest.approx(1.0, abs=1e-6)
    assert found.coverage.fresh_inside == 30
    for channel in found.channels:
        assert channel.recentred_radius < 1e-12
        np.testing.assert_allclose(channel.envelope, channel.own_error, atol=1e-12)
        assert channel.reduction_error < 0.005
        assert channel.peak < 0.01
        assert channel.check.holds


def test_a_weight_below_its_needed_size_fails_its_own_check(found):
    for channel in found.channels:
        assert channel.check.holds
        assert channel.check.min_ratio >= 1.0
        omega = channel.theta[channel.theta >= 0.0] / channel.weight.dt
        envelope = folded_envelope(channel.theta, channel.envelope)
        assert channel.weight.check(omega, envelope).holds
        least = channel.weight.check(omega, envelope).min_ratio
        small = replace(channel.weight, gain=0.9 / least * channel.weight.gain)
        assert not small.check(omega, envelope).holds
        with pytest.raises(ParameterError, match="bounds nothing for certain"):
            channel.weight.scaled(0.9)


def test_a_fit_that_falls_short_between_the_phases_is_lifted(maps, monkeypatch):
    # A fit that has not seen the finer grid, of half the size: the check finds it.
    fit = quantification.fit_weight

    def short(omega, envelope, **options):
        options.pop("finer")
        weight = fit(omega, envelope, **options)
        return replace(weight, gain=0.5 * weight.gain)

    monkeypatch.setattr(quantification, "fit_weight", short)
    found = quantify(PLANT, maps, uncertain=GAIN_ERROR, **SMALL)
    for channel in found.channels:
        assert channel.check.holds
        assert channel.check.min_ratio == pytest.approx(1.0 + quantification.LIFT, abs=1e-3)
    assert found.coverage.fresh_inside == 30


def test_the_check_can_fail(maps, monkeypatch):
    # A fit that sees the phases 0 and 180 deg alone; the lag's residual is larger between them.
    fit = quantification.fit_weight

    def blind(omega, envelope, **options):
        options.pop("finer")
        return fit(omega, envelope, **options)

    monkeypatch.setattr(quantification, "fit_weight", blind)
    monkeypatch.setattr(quantification, "PHASES", 3)
    monkeypatch.setattr(quantification, "FINER", 1)
    lag = UncertaintySet.sensors().only(["MAF time constant"])
    found = quantify(PLANT, maps, uncertain=lag, **SMALL)
    assert found.least_ratio < 1.0
    assert not all(channel.check.holds for channel in found.channels)


def test_residuals_about_given_dynamics_are_those_about_their_exact_response(maps):
    # The even flow of the default dynamics is further off than the measured one.
    dynamics = maps.dynamics()
    found = quantify(PLANT, maps, dynamics=dynamics, uncertain=GAIN_ERROR, **SMALL)
    for q in range(3):
        channel = found.channel(POINT, "maf", q)
        exact = mean_value_modes(
            dynamics, COMMAND, 1500.0, output="maf", modes=[q], theta=channel.theta
        ).mode(q)
        np.testing.assert_allclose(channel.nominal * channel.charge, exact, rtol=1e-9)
        assert channel.flow_shape is None
    measured = quantify(PLANT, maps, uncertain=GAIN_ERROR, **SMALL).channel(POINT, "maf", 1)
    assert measured.reduction_error < 0.5 * found.channel(POINT, "maf", 1).reduction_error
    T = event_time(1500.0, 4)
    rebuilt = PulseResponse.of_window(
        T, time_constant=15e-3, delay=1e-3, shape=measured.flow_shape
    )(np.exp(1j * (measured.theta + 2.0 * np.pi) / 4.0))
    np.testing.assert_allclose(measured.nominal, rebuilt, rtol=1e-9)


def test_maps_of_another_number_of_cylinders_are_refused(maps):
    six = CrankAnglePlant(Engine.paper().replace(n_cylinders=6))
    with pytest.raises(ParameterError, match="maps are those of 4 cylinders"):
        quantify(six, maps, **SMALL)


def test_fresh_samples_are_counted_as_by_hand(maps, recorded):
    found, samples, _ = recorded
    fresh = samples[2]
    theta = found.channels[0].theta
    outside = np.zeros(len(fresh), dtype=bool)
    for channel in found.channels:
        size = np.abs(residuals(maps, channel, fresh, theta))
        bound = channel.weight.magnitude(np.abs(theta) / channel.weight.dt)
        outside |= (size > bound).any(axis=1)
    assert found.coverage.fresh_samples == found.fresh == 30
    assert found.coverage.fresh_inside == 30 - outside.sum()


def test_the_calibration_sample_sets_the_scale(maps, recorded):
    # The scale is the largest residual of that sample over the weight before it was scaled.
    found, samples, _ = recorded
    calibration = samples[1]
    assert len(calibration) == found.calibration == CALIBRATION
    theta = found.channels[0].theta
    score = 0.0
    for channel in found.channels:
        size = np.abs(residuals(maps, channel, calibration, theta))
        bound = channel.weight.magnitude(np.abs(theta) / channel.weight.dt) / found.scale
        score = max(score, (size / bound).max())
    assert found.coverage.bound.scores[-1] == pytest.approx(score, rel=2e-3)
    assert found.scale == pytest.approx(max(score, 1.0), rel=2e-3)
    assert found.coverage.bound.value == found.scale


def test_the_three_samples_are_independent_draws(recorded):
    found, samples, _ = recorded
    assert [sample.method for sample in samples] == ["sobol", "random", "random"]
    assert [len(sample) for sample in samples] == [8, CALIBRATION, 30]
    rows = np.vstack([sample.values for sample in samples])
    assert len(np.unique(rows, axis=0)) == len(rows)
    assert len({sample.seed for sample in samples}) == 3
    assert found.seed == 4


def test_the_seed_alone_decides(maps):
    one, again, other = (
        quantify(PLANT, maps, uncertain=FEW, seed=seed, **SMALL) for seed in (1, 1, 2)
    )
    assert one.records() == again.records()
    np.testing.assert_array_equal(one.coverage.scores, again.coverage.scores)
    np.testing.assert_array_equal(one.coverage.bound.scores, again.coverage.bound.scores)
    assert not np.isin(other.coverage.scores, one.coverage.scores).any()
    assert not np.isin(other.coverage.bound.scores, one.coverage.bound.scores).any()


def test_a_larger_claim_takes_more_samples_and_no_smaller_weights(maps):
    # With one seed the longer sample begins with the shorter one.
    claims = ((0.5, 0.8), (0.8, 0.8), (0.9, 0.9))
    found = [
        quantify(
            PLANT, maps, uncertain=FEW, seed=3, **{**SMALL, "share": share, "confidence": sure}
        )
        for share, sure in claims
    ]
    # Least N with share^N at most 1 - confidence.
    assert [f.calibration for f in found] == [3, 8, 22]
    scores = [f.coverage.bound.scores for f in found]
    assert np.isin(scores[0], scores[1]).all()
    assert np.isin(scores[1], scores[2]).all()
    scales = [f.scale for f in found]
    assert scales == sorted(scales)
    assert [f.coverage.bound.share for f in found] == [0.5, 0.8, 0.9]
    insides = [f.coverage.fresh_inside for f in found]
    assert insides == sorted(insides)


def fail_at(monkeypatch, count, number):
    """Let one plant of the sample of `count` plants fail."""
    plant_at = PerturbedPlants.plant_at

    def failing(self, i):
        if len(self) == count and i == number:
            raise SimulationError("pressure is gone")
        return plant_at(self, i)

    monkeypatch.setattr(PerturbedPlants, "plant_at", failing)


def test_a_fresh_plant_that_fails_is_outside(maps, monkeypatch):
    options = {**SMALL, "uncertain": GAIN_ERROR, "points": (POINT, POINT._replace(lift_mm=2.5))}
    assert quantify(PLANT, maps, **options).coverage.fresh_inside == 30
    fail_at(monkeypatch, 30, 7)
    found = quantify(PLANT, maps, **options)
    # It fails at both points, and is one plant all the same.
    assert found.coverage.fresh_inside == 29
    assert np.isinf(found.coverage.scores).sum() == 1
    assert len(found.failures) == 2
    assert found.failures[0].startswith("1500 rpm, 3.00 mm, 120.0 deg: sample 7 (")
    assert "2 fresh simulations failed: 1500 rpm" in str(found)


@pytest.mark.parametrize(
    ("count", "sample"), [(CALIBRATION, "calibration"), (8 + 2 * len(GAIN_ERROR) + 1, "design")]
)
def test_no_other_plant_may_fail(maps, monkeypatch, count, sample):
    fail_at(monkeypatch, count, 5)
    with pytest.raises(
        SimulationError, match=rf"^{sample} plants at 1500 rpm.*sample 5 .*gone; .* narrow the set"
    ):
        quantify(PLANT, maps, uncertain=GAIN_ERROR, **SMALL)


def test_progress_counts_to_the_total(recorded):
    found, _, told = recorded
    total = len(found.points) * (found.design + found.calibration + found.fresh)
    assert told == [(k + 1, total) for k in range(total)]


def test_progress_goes_on_over_points(maps):
    told = []
    quantify(
        PLANT,
        maps,
        uncertain=GAIN_ERROR,
        progress=lambda done, of: told.append((done, of)),
        **{**SMALL, "points": (POINT, POINT._replace(speed_rpm=3000.0)), "fresh": 5},
    )
    total = 2 * (8 + 3 + CALIBRATION + 5)
    assert told == [(k + 1, total) for k in range(total)]


def test_records_are_plain_and_complete(found):
    records = json.loads(json.dumps(found.records()))
    assert [r["channel"] for r in records] == [
        f"{output} q={q} at 1500 rpm, 3 mm, 120 deg"
        for output in ("charge", "MAF")
        for q in range(3)
    ]
    for record, channel in zip(records, found.channels, strict=True):
        assert record["order"] == channel.weight.order
        assert record["min_ratio"] >= 1.0
        assert record["max_ratio"] >= record["min_ratio"]
    assert found.least_ratio == min(r["min_ratio"] for r in records)
    assert found.largest_ratio == max(r["max_ratio"] for r in records)


def test_the_result_tells_its_claim(found):
    text = str(found)
    assert text.startswith("6 weights over 1 operating point cover at least 80 % of the set with")
    assert "fresh samples" in text
    assert "flow shape of the nominal full plant" in text.splitlines()[0]
    first = found.channels[0]
    assert f"{first.disks.radii.max():.3g} instead of {first.envelope.max():.3g}" in str(first)
    assert len(text.splitlines()) == 2 + 6


def test_an_unknown_channel_is_refused(found):
    assert found.channel(POINT, "maf", 1).channel.name == "MAF q=1 at 1500 rpm, 3 mm, 120 deg"
    with pytest.raises(ParameterError, match=r"no channel of maf in mode 3 at 1500 rpm.*MAF q=2"):
        found.channel(POINT, "maf", 3)


@pytest.mark.parametrize("output", ["air_charge", "maf"])
def test_the_picture(found, output):
    figure = found.plot(output)
    assert [ax.get_title("left") for ax in figure.axes] == [f"1500 rpm, q = {q}" for q in range(3)]
    for q, ax in enumerate(figure.axes):
        channel = found.channel(POINT, output, q)
        envelope = ax.get_lines()[1].get_ydata()
        np.testing.assert_array_equal(envelope, folded_envelope(channel.theta, channel.envelope))
        assert ax.get_legend() is None
    plt.close(figure)


@pytest.mark.parametrize(("n", "modes"), [(1, [0]), (3, [0, 1]), (6, [0, 1, 2, 3])])
def test_other_numbers_of_cylinders(n, modes):
    plant = CrankAnglePlant(Engine.paper().replace(n_cylinders=n))
    maps = MeanValuePlant.fit(
        plant,
        speed_range_rpm=(1400.0, 1600.0),
        lift_range_mm=(2.5, 3.5),
        tolerance=0.02,
        most_points=800,
    )
    found = quantify(plant, maps, uncertain=FEW, **{**SMALL, "fresh": 5})
    assert [c.channel.mode for c in found.channels] == 2 * modes
    assert found.channels[0].weight.dt == pytest.approx(0.08)  # a cycle at 1500 rpm
    for channel in found.channels:
        assert channel.check.holds
        assert channel.reduction_error < 0.05


def test_the_default_set_is_of_equal_cylinders_and_the_flow_sensor():
    found = default_set()
    targets = {target for p in found for target in p.acts_on}
    assert {"maf.gain_error", "maf.time_constant", "maf.delay"} <= targets
    assert not any(target.startswith("map.") for target in targets)
    assert not any("[" in target for target in targets)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"design": 1}, "design is 1, but must be from 2"),
        ({"fresh": 0}, "fresh is 0, but must be from 1"),
        ({"share": 1.0}, "share is 1"),
        ({"confidence": 0.0}, "confidence is 0"),
        ({"seed": -1}, "seed is -1, but must be from 0"),
        ({"points": ()}, "there is no operating point"),
        ({"points": (POINT, POINT)}, "point 1 is 1500 rpm.*, as point 0: give it once"),
        ({"points": tuple(POINT)}, "point 0 is 1500.0, but must be speed_rpm"),
        ({"points": (OperatingPoint(9000.0, 3.0, 120.0),)}, "speed_rpm is 9000 rpm"),
        ({"uncertain": UncertaintySet.cylinders(4)}, "use full_plant_response"),
    ],
)
def test_bad_arguments_are_refused(maps, options, message):
    with pytest.raises(ParameterError, match=message):
        quantify(PLANT, maps, **{**SMALL, **options})


def test_points_are_checked_before_any_plant_is_followed(maps):
    told = []
    points = (POINT, OperatingPoint(9000.0, 3.0, 120.0))
    with pytest.raises(ParameterError, match="speed_rpm is 9000 rpm"):
        quantify(
            PLANT, maps, progress=lambda *done: told.append(done), **{**SMALL, "points": points}
        )
    assert not told


def test_where_charge_does_not_follow_duration_nothing_is_certain(maps):
    # Beyond the duration of the largest charge the gain is negative, and about it near zero.
    def gain(duration):
        return float(maps.charge_gradient(3.0, duration, 1500.0).duration)

    low, high = 170.0, 240.0
    assert gain(low) > 0.0 > gain(high)
    for _ in range(12):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if gain(middle) > 0.0 else (low, middle)
    points = (POINT._replace(duration_deg=high), POINT._replace(duration_deg=240.0))
    found = quantify(PLANT, maps, uncertain=FEW, **{**SMALL, "points": points})
    at_top, beyond = (found.channel(point, "air_charge", 0) for point in points)
    assert at_top.peak > 1.0
    assert beyond.charge.real.max() < 0.0
    assert beyond.peak < 1.0


def test_maps_of_a_cam_are_refused():
    with pytest.raises(ParameterError, match="must be 'camless'"):
        quantify(CrankAnglePlant(profile="conventional"), **SMALL)
