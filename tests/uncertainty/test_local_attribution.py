import json

import numpy as np
import pytest

from plant import (
    CrankAnglePlant,
    InfeasibleProfileError,
    OperatingPoint,
    ParameterError,
    ValveCommand,
)
from uncertainty.local_attribution import TornadoBar, _result, tornado
from uncertainty.parameters import UncertainParameter, UncertaintySet
from uncertainty.perturbed import PerturbedPlants
from uncertainty.sampling import one_at_a_time

POINTS = (OperatingPoint(1500.0, 3.0, 120.0), OperatingPoint(6000.0, 5.0, 220.0))


@pytest.fixture(scope="module")
def result():
    return tornado(points=POINTS)


def test_changes_are_those_of_single_runs(result):
    nominal_plant = CrankAnglePlant(oscillation=True)
    uncertain = UncertaintySet.plant()
    plants = PerturbedPlants(nominal_plant, one_at_a_time(uncertain))

    def values(plant, offset, point):
        speed, lift, duration = point
        runs = [
            plant.steady_cycle(
                speed,
                ValveCommand(lift, duration + 6.0 * speed * offset + step),
                on_infeasible="limit",
            )
            for step in (-0.5, 0.0, 0.5)
        ]
        before, at, after = (float(run.air_charge[0]) for run in runs)
        return np.array([at, float(runs[1].pumping_loss[0]), after - before])

    for j, point in enumerate(POINTS):
        nominal = values(nominal_plant, 0.0, point)
        own = result.dataset["nominal"].isel(point=j).to_numpy()
        assert own == pytest.approx(nominal, rel=1e-9)
        for name in ("flow coefficient", "runner damping", "duration offset"):
            k = uncertain.names.index(name)
            for side in (0, 1):
                offset = float(plants.duration_offsets()[2 * k + side, 0])
                moved = values(plants.plant_at(2 * k + side), offset, point)
                change = result.dataset["change"].sel(parameter=name).isel(point=j, side=side)
                assert change.to_numpy() == pytest.approx(moved / nominal - 1.0, abs=1e-9)


def test_changes_of_an_additive_model_are_its_slopes():
    # y = 100 mg + 20 mg (x1 - 1) - 40 mg (x2 - 1), and a loss below the floor of 0.5 J
    uncertain = UncertaintySet(
        (
            UncertainParameter("one", 0.5, 1.5, 1.0, ("temperature",)),
            UncertainParameter("two", 0.75, 1.5, 1.0, ("bore",)),
        )
    )
    rows = np.vstack((uncertain.nominal, one_at_a_time(uncertain).values))
    charge = 1e-4 + (rows - 1.0) @ np.array([[2e-5], [-4e-5]])
    found = {"charge": charge, "loss": 1e3 * charge, "loop_gain": -charge}
    result = _result(found, uncertain, POINTS[:1], "synthetic")
    two, one = result.bars("charge")
    assert (two.parameter, one.parameter) == ("two", "one")
    assert (two.low, two.high) == pytest.approx((0.1, -0.2))
    assert (one.low, one.high) == pytest.approx((-0.1, 0.1))
    assert (two.swing, one.swing) == pytest.approx((0.3, 0.2))
    assert result.bars("loss")[0].high == pytest.approx(-0.2 * 0.1 / 0.5)  # of 0.5 J
    # a negative nominal: relative to its magnitude, so the sign is that of the change
    assert result.bars("loop_gain")[0].high == pytest.approx(0.2)
    assert result.dataset["bound"].sel(parameter="two").to_numpy().tolist() == [0.75, 1.5]


def test_air_of_another_pressure_scales_charge_and_loss():
    # All pressures and flows by one factor: the equations scale, so charge, loss and slope do.
    targets = ("ambient_pressure", "exhaust_pressure", "flow_coefficient", "throttle.scale")
    weather = UncertainParameter("weather", 0.9, 1.1, 1.0, targets)
    result = tornado(CrankAnglePlant(), UncertaintySet((weather,)), POINTS)
    change = result.dataset["change"].sel(parameter="weather")
    # the kernel keeps charge within 0.02 % and loss within 0.1 %; a slope is a small difference
    for quantity, accuracy in (("charge", 2e-4), ("loss", 1e-3), ("loop_gain", 1e-3)):
        own = change.sel(quantity=quantity)
        assert own.sel(side="low").to_numpy() == pytest.approx(-0.1, abs=accuracy)
        assert own.sel(side="high").to_numpy() == pytest.approx(0.1, abs=accuracy)


def test_bars_fall_by_swing(result):
    for quantity in result.quantities:
        swings = [bar.swing for bar in result.bars(quantity, 1)]
        assert swings == sorted(swings, reverse=True)
        assert len(swings) == len(UncertaintySet.plant())
    assert len(result.bars("charge", 0, 4)) == 4
    assert TornadoBar("x", 0.1, 0.3).swing == 0.3  # from the nominal value on
    assert TornadoBar("x", -0.1, -0.3).swing == 0.3
    assert TornadoBar("x", -0.1, 0.3).swing == pytest.approx(0.4)


def test_signs_are_those_of_physics(result):
    bars = {bar.parameter: bar for bar in result.bars("charge", 0)}
    assert bars["temperature"].low > 0.0 > bars["temperature"].high  # warm air is thin
    assert bars["flow coefficient"].low < 0.0 < bars["flow coefficient"].high
    assert bars["duration offset"].low < 0.0 < bars["duration offset"].high  # early closing
    assert bars["ambient pressure"].low < 0.0 < bars["ambient pressure"].high


def test_records_and_sentences(result):
    records = json.loads(json.dumps(result.records(), allow_nan=False))
    assert len(records) == 3 * 2 * len(UncertaintySet.plant())
    first = records[0]
    assert (first["quantity"], first["speed_rpm"]) == ("charge", 1500.0)
    assert first["parameter"] == result.bars("charge", 0, 1)[0].parameter
    assert f"At {POINTS[1]} the air charge changes most with" in str(result)
    assert str(result.bars("charge", 0, 1)[0]) in str(result)
    assert result.points == POINTS


def test_bad_requests_are_refused(result):
    with pytest.raises(ParameterError, match="did you mean 'charge'"):
        result.bars("charges")
    with pytest.raises(ParameterError, match="point is 2, but must be from 0 to 1"):
        result.bars("charge", 2)
    with pytest.raises(ParameterError, match="no operating point"):
        tornado(points=())
    with pytest.raises(InfeasibleProfileError, match="cannot reach 7 mm"):
        tornado(points=(OperatingPoint(6000.0, 7.0, 60.0),))


def test_progress_ends_full():
    calls = []
    tornado(
        uncertain=UncertaintySet.delivered_duration(),
        points=POINTS,
        progress=lambda *call: calls.append(call),
    )
    assert calls[-1] == (18, 18)  # nominal, low and high, at two points, with three durations


def test_the_plot_has_the_bounds_at_the_ends(result):
    import matplotlib

    matplotlib.use("agg")
    ax = result.plot("charge", 1, count=3)
    bars = result.bars("charge", 1, 3)
    assert [t.get_text() for t in ax.get_yticklabels()] == [bar.parameter for bar in bars]
    widths = [patch.get_width() for patch in ax.patches]
    assert widths == pytest.approx(
        [100.0 * v for s in ("low", "high") for v in (getattr(b, s) for b in bars)]
    )
    texts = {text.get_text() for text in ax.texts}
    assert {"0.85", "1.05", "-0.2 ms", "0.2 ms"} <= texts
    assert ax.get_legend_handles_labels()[1] == ["lower bound", "upper bound"]
    matplotlib.pyplot.close(ax.figure)
