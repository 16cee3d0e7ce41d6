import numpy as np
import pytest
from scipy import stats

from plant import (
    CrankAnglePlant,
    Engine,
    HelmholtzRunner,
    InfeasibleProfileError,
    ParameterError,
    ValveCommand,
)
from plant._engine_fields import engine_fields, field_unit, get_field, replace_engine_fields
from plant.identification import FreeParameter, identify
from plant.observations import (
    RESOLUTION,
    ChargeObservation,
    Experiment,
    TraceObservation,
    charge_observation,
)

CAM = ValveCommand.conventional()
SLOPE = "valvetrain.slope_mm_s"
RUNNER = ("flow_coefficient", "helmholtz.frequency_hz", "helmholtz.damping")

# Part I, sections 3.1, 3.2 and 4: the nine printed charges (mg) and losses (J) of the model
PRINTED = (
    ("conventional", 1500.0, CAM, 477.4, 5.2),
    ("conventional", 3000.0, CAM, 503.3, 8.9),
    ("conventional", 4000.0, CAM, 493.0, 12.3),
    ("simplified", 1500.0, ValveCommand(3.0, 189.0), 473.0, None),
    ("simplified", 1500.0, ValveCommand(2.0, 99.0), 171.0, 3.55),
)


@pytest.fixture(scope="module")
def printed():
    return [
        charge_observation(profile, speed, command, 90.0, 1e-6 * charge, loss)
        for profile, speed, command, charge, loss in PRINTED
    ]


@pytest.fixture(scope="module")
def published_fit(printed):
    return identify(
        Engine.paper(),
        printed,
        ("temperature", SLOPE),
        initial={"temperature": 316.0, SLOPE: 3000.0},
    )


def test_published_figures_give_the_temperature_and_slope_known_of_them(published_fit):
    # Fitted with two programs of other making: 290.7 K and 3502 mm/s, 0.62 % rms, 1.7 % at worst
    assert published_fit.values["temperature"] == pytest.approx(290.7, abs=0.1)
    assert published_fit.values[SLOPE] == pytest.approx(3502.0, abs=20.0)
    assert published_fit.rms * 0.01 == pytest.approx(0.0062, abs=1e-4)
    assert np.abs(published_fit.residuals).max() < 1.7
    valvetrain = published_fit.engine.valvetrain
    assert valvetrain.opening_slope_mm_s == valvetrain.closing_slope_mm_s
    assert published_fit.engine.temperature == published_fit.values["temperature"]


def test_printed_temperature_is_refuted_and_the_engine_of_the_package_is_not(published_fit):
    low, high = published_fit.confidence_intervals["temperature"]
    assert low < Engine.paper().temperature < high < 316.0
    low, high = published_fit.confidence_intervals[SLOPE]
    assert low < 3500.0 < high


def test_the_fit_does_not_depend_on_where_it_starts(printed, published_fit):
    other = identify(
        Engine.paper(),
        printed,
        (SLOPE, "temperature"),
        initial={"temperature": 270.0, SLOPE: 4500.0},
    )
    assert other.values["temperature"] == pytest.approx(
        published_fit.values["temperature"], rel=1e-6
    )
    assert other.values[SLOPE] == pytest.approx(published_fit.values[SLOPE], rel=1e-5)
    np.testing.assert_allclose(other.correlation[0, 1], published_fit.correlation[0, 1], rtol=1e-3)


def test_the_fit_is_a_minimum_of_the_relative_error(printed, published_fit):
    # independent sum of squares, straight from the plant
    def cost(temperature, slope):
        engine = Engine.paper().replace(
            temperature=temperature,
            valvetrain=Engine.paper().valvetrain.replace(
                opening_slope_mm_s=slope, closing_slope_mm_s=slope
            ),
        )
        total = 0.0
        for profile, speed, command, charge, loss in PRINTED:
            kind = "conventional" if profile == "conventional" else "camless"
            cycle = CrankAnglePlant(engine, profile=kind, resolution=RESOLUTION).steady_cycle(
                speed, command
            )
            total += (1e6 * cycle.air_charge[0] / charge - 1.0) ** 2
            if loss is not None:
                total += (cycle.pumping_loss[0] / loss - 1.0) ** 2
        return total

    best = published_fit.values["temperature"], published_fit.values[SLOPE]
    least = cost(*best)
    assert least == pytest.approx(9.0 * (0.01 * published_fit.rms) ** 2, rel=1e-9)
    for change in ((1.0, 0.0), (-1.0, 0.0), (0.0, 100.0), (0.0, -100.0)):
        assert cost(best[0] + change[0], best[1] + change[1]) > least


def test_intervals_are_those_of_linear_regression():
    # With a small spread the model is linear, and the fit of one parameter to repeated values is
    # their mean, whose t interval is in every textbook.
    experiment = Experiment(1500.0, ValveCommand(3.0, 120.0))
    charge = experiment.simulate(Engine.paper()).air_charge[0]
    step = 1e-3
    higher = experiment.simulate(Engine.paper().replace(temperature=290.0 * (1.0 + step)))
    sensitivity = (higher.air_charge[0] / charge - 1.0) / (290.0 * step)  # 1/K
    scatter = 1e-4 * np.random.default_rng(3).standard_normal(12)
    observations = [ChargeObservation(experiment, charge * (1.0 + e)) for e in scatter]
    result = identify(Engine.paper(), observations, ("temperature",), confidence=0.9)
    mean, error = scatter.mean(), scatter.std(ddof=1) / np.sqrt(12)
    assert result.values["temperature"] - 290.0 == pytest.approx(mean / sensitivity, rel=5e-3)
    assert result.standard_errors["temperature"] == pytest.approx(
        error / abs(sensitivity), rel=5e-3
    )
    low, high = result.confidence_intervals["temperature"]
    expected = 2.0 * stats.t.ppf(0.95, 11) * error / abs(sensitivity)
    assert high - low == pytest.approx(expected, rel=5e-3)
    assert result.degrees_of_freedom == 11


TRUE = {"flow_coefficient": 0.0183, "helmholtz.frequency_hz": 182.0, "helmholtz.damping": 0.06}
PRESSURES = Experiment(3600.0, ValveCommand(5.0, 190.0, -5.0))


@pytest.fixture(scope="module")
def clean_traces():
    """Pressures of a finer plant than the one that is fitted: (signal, noise, angle, pressure)."""
    engine = Engine.paper().replace(
        flow_coefficient=TRUE["flow_coefficient"],
        helmholtz=HelmholtzRunner.constant(182.0, TRUE["helmholtz.damping"]),
    )
    plant = CrankAnglePlant(engine, resolution=8.0)
    trace = plant.steady_cycle(PRESSURES.speed_rpm, PRESSURES.command).trace_at(1.0)
    angle = trace.crank_angle_deg
    inside = (angle >= 0.0) & (angle < 240.0)
    return (
        ("cylinder_pressure", 500.0, angle[inside], trace.cylinder_pressure[inside, 0]),
        ("manifold_pressure", 100.0, angle, trace.manifold_pressure),
    )


def noisy(clean_traces, seed):
    random = np.random.default_rng(seed)
    return [
        TraceObservation(
            PRESSURES, angle, p + noise * random.standard_normal(p.size), noise, signal=signal
        )
        for signal, noise, angle, p in clean_traces
    ]


@pytest.mark.parametrize("used", [slice(0, 1), slice(0, 2)], ids=["cylinder", "both"])
def test_flow_coefficient_and_runner_are_recovered_from_noisy_pressures(clean_traces, used):
    result = identify(
        Engine.paper(),
        noisy(clean_traces, 5)[used],
        RUNNER,
        initial={"helmholtz.damping": 0.1},
        confidence=0.999,
    )
    for name, true in TRUE.items():
        low, high = result.confidence_intervals[name]
        assert low < true < high
        assert high - low < {"helmholtz.damping": 0.8}.get(name, 0.06) * true
    k = result.residuals.size
    low, high = stats.chi2.ppf([0.0005, 0.9995], k - 3)
    assert low < k * result.rms**2 < high  # the stated noise is what is left
    assert result.at_bound == ()


def test_intervals_cover_the_truth_about_as_often_as_they_say(clean_traces):
    # Each parameter is covered in 20 independent trials of probability 0.9: below 13 has a
    # chance of 0.2 %.
    covered = dict.fromkeys(TRUE, 0)
    for seed in range(100, 120):
        result = identify(
            Engine.paper(),
            noisy(clean_traces, seed),
            RUNNER,
            initial=TRUE,
            confidence=0.9,
        )
        for name, (low, high) in result.confidence_intervals.items():
            covered[name] += low < TRUE[name] < high
    assert all(count >= 13 for count in covered.values())
    assert sum(covered.values()) < 60  # nor do they cover everything


def test_trace_of_another_cylinder_is_compared_at_its_own_angles():
    # Cylinder 3 of four opens 360 deg after the first; its pressure is the first one's, later.
    experiment = Experiment(1500.0, ValveCommand(3.0, 120.0))
    trace = experiment.simulate(Engine.paper()).trace_at(1.0)
    angle = np.arange(2.0, 200.0, 2.0)
    own = np.interp(angle, trace.crank_angle_deg, trace.cylinder_pressure[:, 0])
    later = TraceObservation(experiment, angle + 360.0 + 720.0, own, 100.0, cylinder=3)
    modelled = later.predict(experiment.simulate(Engine.paper()))
    np.testing.assert_allclose(modelled, own, rtol=1e-7)


def test_weak_cylinder_is_found():
    engine = Engine.paper()
    weak = engine.replace(cylinder_flow_factors=(1.0, 1.0, 0.9, 1.0))
    experiment = Experiment(3000.0, ValveCommand(4.0, 150.0))
    charge = CrankAnglePlant(weak, resolution=4.0).steady_cycle(3000.0, ValveCommand(4.0, 150.0))
    observations = [
        ChargeObservation(experiment, charge.air_charge[j], cylinder=j + 1) for j in range(4)
    ]
    result = identify(engine, observations, ("cylinder_flow_factors[2]",))
    assert result.values["cylinder_flow_factors[2]"] == pytest.approx(0.9, abs=2e-3)
    assert result.engine.cylinder_flow_factors[0] == 1.0


def test_weights_are_relative(printed):
    # A figure of tiny stated error is met, whatever the others say.
    experiment = Experiment(1500.0, CAM, profile="conventional")
    exact = ChargeObservation(experiment, 520e-6, relative_error=1e-6)
    result = identify(Engine.paper(), [*printed, exact], ("temperature",))
    assert result.engine.temperature < 280.0
    charge = experiment.simulate(result.engine).air_charge[0]
    assert charge == pytest.approx(520e-6, rel=1e-6)


def test_only_the_ratio_of_the_weights_matters(printed, published_fit):
    heavy = [
        ChargeObservation(o.experiment, o.air_charge, o.pumping_loss, relative_error=30.0)
        for o in printed
    ]
    other = identify(Engine.paper(), heavy, ("temperature", SLOPE))
    assert other.values == pytest.approx(published_fit.values, rel=1e-4)
    assert other.standard_errors == pytest.approx(published_fit.standard_errors, rel=1e-3)


def test_bounds_hold_and_are_told(printed):
    result = identify(
        Engine.paper(),
        printed,
        ("temperature",),
        initial={"temperature": 310.0},
        bounds={"temperature": (300.0, 320.0)},
    )
    assert result.values["temperature"] == pytest.approx(300.0, abs=1e-3)
    assert result.at_bound == ("temperature",)
    assert "(on its bound)" in str(result)


def test_result_prints_a_table_and_reports_progress(printed, published_fit):
    text = str(published_fit)
    assert "95 % confidence interval" in text
    assert "largest correlation" in text
    assert text.count("conventional, 1500 rpm, 8.1 mm/234 deg from -8 deg") == 2
    assert "K" in text.splitlines()[2]
    seen = []
    result = identify(
        Engine.paper(), printed, ("temperature",), progress=lambda *step: seen.append(step)
    )
    assert [count for count, _ in seen] == list(range(1, len(seen) + 1))
    assert result.evaluations == len(seen) + 1
    assert min(rms for _, rms in seen) == pytest.approx(result.rms, rel=1e-6)


def test_residuals_can_be_plotted(published_fit):
    import matplotlib

    matplotlib.use("Agg")
    ax = published_fit.plot()
    np.testing.assert_allclose(ax.lines[-1].get_ydata(), published_fit.residuals)
    matplotlib.pyplot.close(ax.figure)


def test_every_field_can_be_read_and_replaced():
    engine = Engine.paper()
    for name in engine_fields(engine):
        value = get_field(engine, name)
        changed = replace_engine_fields(engine, {name: value * 0.999})
        assert get_field(changed, name) == pytest.approx(value * 0.999, rel=1e-12)
        others = [n for n in engine_fields(engine) if n != name]
        assert all(get_field(changed, n) == get_field(engine, n) for n in others)
        assert field_unit(name)
    assert "valvetrain.roundness" in engine_fields(engine)
    assert field_unit("valvetrain.opening_slope_mm_s") == "mm/s"


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        (("temprature",), "parameter is 'temprature'.*did you mean 'temperature'"),
        (("valvetrain.slope",), "did you mean 'valvetrain.slope_mm_s'"),
        ((FreeParameter("both", ("bore", "strok")),), "engine field is 'strok'.*'stroke'"),
        (("n_cylinders",), "parameter is 'n_cylinders'"),
        ((), "at least one name"),
        ("temperature", "must be a sequence"),
        (("temperature", "temperature"), "field 'temperature' is fitted twice"),
        (
            (SLOPE, "valvetrain.closing_slope_mm_s"),
            "field 'valvetrain.closing_slope_mm_s' is fitted twice",
        ),
        (("cylinder_flow_factors[4]",), r"did you mean 'cylinder_flow_factors\["),
        (("gas_constant", "temperature"), "do not tell .* apart"),
        (("valvetrain.oscillation_period",), "do not depend on valvetrain.oscillation_period"),
    ],
)
def test_bad_parameters_are_refused(printed, parameters, message):
    with pytest.raises(ParameterError, match=message):
        identify(Engine.paper(), printed, parameters)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"initial": {"temperatur": 300.0}}, "did you mean 'temperature'"),
        ({"initial": {"temperature": float("nan")}}, "temperature"),
        ({"initial": {"temperature": 0.0}}, "starts at 0 and has no bounds"),
        ({"bounds": {"temperature": (300.0, 320.0)}}, "initial temperature is 290 K"),
        ({"bounds": {"temperature": (320.0, 300.0)}}, "finite and in order"),
        ({"confidence": 1.0}, "confidence is 1"),
    ],
)
def test_bad_options_are_refused(printed, options, message):
    with pytest.raises(ParameterError, match=message):
        identify(Engine.paper(), printed, ("temperature",), **options)


def test_too_few_values_are_refused(printed):
    with pytest.raises(ParameterError, match=r"2 parameters cannot be fitted to 2 values"):
        identify(Engine.paper(), printed[:1], ("temperature", "flow_coefficient"))
    with pytest.raises(ParameterError, match="there is no observation"):
        identify(Engine.paper(), [], ("temperature",))


def test_missing_cylinder_is_refused():
    observation = ChargeObservation(Experiment(1500.0, CAM), 5e-4, 5.0, cylinder=5)
    with pytest.raises(ParameterError, match=r"observation 0 is of cylinder 5.* cylinders 1 to 4"):
        identify(Engine.paper(), [observation], ("temperature",))


def test_bad_observations_are_refused():
    experiment = Experiment(1500.0, CAM)
    with pytest.raises(ParameterError, match="air_charge is nan kg"):
        ChargeObservation(experiment, float("nan"))
    with pytest.raises(ParameterError, match="pumping_loss is -1 J"):
        ChargeObservation(experiment, 5e-4, -1.0)
    with pytest.raises(ParameterError, match="the observation is empty"):
        ChargeObservation(experiment)
    with pytest.raises(ParameterError, match=r"point 1 of the trace is nan Pa at 20 deg"):
        TraceObservation(experiment, [10.0, 20.0], [1e5, np.nan], 100.0)
    with pytest.raises(ParameterError, match="one-dimensional"):
        TraceObservation(experiment, [10.0, 20.0], [1e5], 100.0)
    with pytest.raises(ParameterError, match="noise is 0 Pa"):
        TraceObservation(experiment, [10.0, 20.0], [1e5, 1e5], 0.0)
    with pytest.raises(ParameterError, match="did you mean 'manifold_pressure'"):
        TraceObservation(experiment, [10.0, 20.0], [1e5, 1e5], 9.0, signal="manifold")
    with pytest.raises(ParameterError, match="profile is 'cam'"):
        charge_observation("cam", 1500.0, CAM, 90.0, 5e-4, None)


def test_pressure_where_the_model_says_nothing_is_refused():
    observation = TraceObservation(
        Experiment(1500.0, ValveCommand(3.0, 120.0)), [100.0, 400.0], [9e4, 9e4], 100.0
    )
    with pytest.raises(ParameterError, match="nothing of the pressure in cylinder 1 at 400 deg"):
        identify(Engine.paper(), [observation], ("temperature",))


def test_fit_that_ends_on_an_impossible_profile_is_refused():
    # 5 mm in 60 deg at 3000 rpm cannot be driven at the lowest slope allowed here.
    experiment = Experiment(3000.0, ValveCommand(5.0, 60.0))
    slow = [ChargeObservation(experiment, charge) for charge in (20e-6, 21e-6)]
    with pytest.raises(InfeasibleProfileError, match="the fit settles where"):
        identify(
            Engine.paper(),
            slow,
            (SLOPE,),
            bounds={SLOPE: (1500.0, 6000.0)},
        )
