from dataclasses import dataclass, field

import matplotlib
import numpy as np
import pytest
from scipy.optimize import brentq

from plant import CrankAnglePlant, ParameterError, ValveCommand, Valvetrain
from plant._map_regions import lift_saturation
from plant.map_regions import map_regions
from plant.mean_value import MeanValuePlant
from plant.region import OperatingRegion
from plant.sweep import sweep

matplotlib.use("agg")

PLANT = CrankAnglePlant()


@pytest.fixture(scope="module")
def maps():
    return MeanValuePlant.fit(PLANT)


@pytest.fixture(scope="module")
def regions(maps):
    return map_regions(maps, [750.0, 1500.0, 3000.0, 4500.0, 5500.0, 6000.0], lift_mm=[3.0])


@dataclass
class KnownCharge:
    """Stands in for a map: charge is a given function of lift and duration."""

    charge: object
    region: OperatingRegion = field(
        default_factory=lambda: OperatingRegion(750.0, 6000.0, 0.5, 8.0, 280.0, Valvetrain())
    )

    def air_charge(self, lift_mm, duration_deg, speed_rpm):
        return self.charge(lift_mm, duration_deg)


# -- lift saturation ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("speed", "duration"), [(750.0, 120.0), (1500.0, 180.0), (3000.0, 220.0), (6000.0, 200.0)]
)
def test_at_the_saturation_lift_the_full_plant_takes_in_the_share(maps, speed, duration):
    lift = lift_saturation(maps, speed, duration)
    charge = [
        PLANT.steady_cycle(speed, ValveCommand(u, duration)).air_charge.mean() for u in (lift, 8.0)
    ]
    assert charge[0] / charge[1] == pytest.approx(0.98, abs=0.002)


def test_at_the_largest_charge_too(maps):
    lift = lift_saturation(maps, 3000.0, None)
    durations = np.linspace(190.0, 280.0, 91)
    charge = [sweep(PLANT, 3000.0, u, durations).air_charge.max() for u in (lift, 8.0)]
    assert charge[0] / charge[1] == pytest.approx(0.98, abs=0.002)


def test_saturation_is_the_exact_root_of_the_map(maps):
    speeds = np.linspace(750.0, 6000.0, 20)
    durations = np.array([40.0, 100.0, 180.0, 230.0])
    found = lift_saturation(maps, speeds, durations[:, None])
    assert found.shape == (4, 20)
    lifts = np.geomspace(0.5, 8.0, 2001)
    for (i, k), lift in np.ndenumerate(found):
        if not np.isfinite(lift):
            assert not maps.region.feasible(8.0, durations[i], speeds[k])
            continue
        full = maps.air_charge(8.0, durations[i], speeds[k])

        def excess(u, i=i, k=k, full=full):
            return maps.air_charge(u, durations[i], speeds[k]) - 0.98 * full

        below = np.flatnonzero(excess(lifts) < 0.0)
        last = below[-1]
        root = brentq(excess, lifts[last], lifts[last + 1], xtol=1e-13)
        assert lift == pytest.approx(root, abs=1e-10)


@pytest.mark.parametrize("duration", [180.0, None])
def test_saturation_has_the_share_of_the_charge(maps, duration):
    speeds = np.linspace(750.0, 6000.0, 20)
    lift = lift_saturation(maps, speeds, duration, 0.9)
    if duration is None:
        charge, full = (maps.charge_lines(u, speeds).peak().value for u in (lift, np.full(20, 8.0)))
    else:
        charge, full = (maps.air_charge(u, duration, speeds) for u in (lift, 8.0))
    np.testing.assert_allclose(charge, 0.9 * full, rtol=1e-10)


def test_the_last_of_several_crossings_counts():
    # 0.98 is crossed at 1, 3 and 6 mm; the charge at 8 mm is 1.
    three = KnownCharge(lambda u, d: 0.98 + 0.02 / 70.0 * (u - 1.0) * (u - 3.0) * (u - 6.0) + 0 * d)
    assert lift_saturation(three, 750.0, 180.0) == pytest.approx(6.0, abs=1e-11)


def test_saturated_throughout_gives_the_lowest_lift_and_no_charge_gives_nan():
    falling = KnownCharge(lambda u, d: 2.0 - 0.1 * u + 0 * d)
    assert lift_saturation(falling, 750.0, 180.0) == 0.5
    # Charge is u (d - 100): nothing at 100 deg, backflow before.
    signed = KnownCharge(lambda u, d: u * (d - 100.0))
    found = lift_saturation(signed, 750.0, [90.0, 100.0, 110.0])
    assert np.isnan(found).tolist() == [True, True, False]
    assert found[2] == pytest.approx(0.98 * 8.0, abs=1e-11)


def test_saturation_is_nan_where_the_highest_lift_cannot_be_driven(maps):
    # Eq. 20 with no dwell: 1.4 * 8 mm / 3500 mm/s + 1 ms (1 - 200/3500) at 36 deg/ms.
    shortest = 36e3 * (1.4 * 8.0 / 3500.0 + 1e-3 * (1.0 - 200.0 / 3500.0))
    found = lift_saturation(maps, 6000.0, [shortest - 0.01, shortest + 0.01])
    assert np.isnan(found).tolist() == [True, False]
    assert np.isnan(lift_saturation(maps, 6000.0, 100.0))


@pytest.mark.parametrize(
    ("speed", "duration", "share", "words"),
    [
        (7000.0, 180.0, 0.98, "speed_rpm is 7000 rpm"),
        (1500.0, 281.0, 0.98, "duration_deg is 281 deg"),
        (1500.0, [180.0, 0.0], 0.98, "duration_deg is 0 deg"),
        (1500.0, np.nan, 0.98, "duration_deg is nan"),
        (1500.0, None, 1.0, "share is 1"),
    ],
)
def test_saturation_refuses_what_is_out_of_range(maps, speed, duration, share, words):
    with pytest.raises(ParameterError, match=words):
        lift_saturation(maps, speed, duration, share)


# -- regions against speed ---------------------------------------------------------------------


def test_published_saturation_lifts(regions):
    # "about", read off a figure; the tolerance is that of the maps' own test.
    assert regions.printed_mm == {750.0: 1.5, 1500.0: 3.0, 5500.0: 5.0}
    found = dict(zip(regions.speeds_rpm, regions.saturation_mm[0], strict=True))
    for speed in (750.0, 1500.0):
        assert found[speed] == pytest.approx(regions.printed_mm[speed], rel=0.15)


def test_the_published_lift_at_5500_rpm_is_not_reproduced_by_the_full_plant_either(regions):
    at_5500 = regions.saturation_mm[0, 4]
    charge = sweep(PLANT, 5500.0, [5.0, at_5500, 8.0], 180.0).air_charge
    assert charge[0] < 0.95 * charge[2]
    assert charge[1] == pytest.approx(0.98 * charge[2], rel=0.002)


def test_flow_reversal_is_where_the_full_plant_has_its_largest_charge(regions):
    durations = np.arange(180.0, 281.0)
    for k in (1, 2, 3):
        for row, lift in enumerate(regions.lifts_mm):
            charge = sweep(PLANT, regions.speeds_rpm[k], lift, durations).air_charge
            reversal = regions.reversal_deg[row, k]
            if np.isnan(reversal):
                assert np.argmax(charge) == len(durations) - 1
            else:
                assert reversal == pytest.approx(durations[np.argmax(charge)], abs=2.0)
    # Section 5: at higher values of duration for faster speeds.
    assert (np.diff(regions.reversal_deg[0, :3]) > 0.0).all()


def test_feasibility_limits_are_those_of_eq_20(maps):
    regions = map_regions(maps, [750.0, 3000.0, 6000.0], lift_mm=5.0, duration_deg=[30.0, 90.0])
    seating = 1e-3 * (1.0 - 200.0 / 3500.0)
    for k, speed in enumerate(regions.speeds_rpm):
        for row, lift in enumerate((5.0, 8.0)):
            shortest = 6.0 * speed * (1.4 * lift / 3500.0 + seating)
            assert regions.shortest_deg[row, k] == pytest.approx(shortest, rel=1e-8)
        for row, duration in enumerate((30.0, 90.0)):
            lift = (duration / (6.0 * speed) - seating) * 3500.0 / 1.4
            got = regions.highest_lift_mm[row, k]
            assert np.isnan(got) if lift < 0.5 else got == pytest.approx(min(lift, 8.0))
    assert np.isnan(regions.highest_lift_mm[0, 2])
    assert np.isnan(regions.saturation_mm[0, 2])


def test_default_speeds_and_lifts_cover_the_map(maps):
    regions = map_regions(maps)
    assert regions.speeds_rpm[[0, -1]].tolist() == [750.0, 6000.0]
    assert {1500.0, 5500.0} < set(regions.speeds_rpm)
    assert regions.lifts_mm.tolist() == [1.0, 3.0, 5.0, 8.0]
    text = str(regions)
    assert "one speed in 5 of 106 is shown" in text
    assert max(map(len, text.splitlines())) < 150


def test_the_table_shows_units_the_printed_lifts_and_what_was_not_found(regions):
    lines = str(regions).splitlines()
    assert lines[1].split()[:3] == ["speed", "180", "deg"]
    assert set(lines[2].split()) == {"rpm", "mm", "deg"}
    row = next(line for line in lines if line.split()[0] == "5500").split()
    assert row[1] == f"{regions.saturation_mm[0, 4]:.2f}"
    assert row[3:6] == ["5", "-", "-"]
    assert row[-1] == "all"
    assert "98 % of that at 8 mm" in lines[-3]
    assert "-: not up to 280 deg" in lines[-2]


def test_the_dataset_carries_units_and_provenance(regions):
    data = regions.to_dataset()
    units = {name: data[name].attrs["units"] for name in data.variables}
    assert units == {
        "saturation_lift": "mm",
        "saturation_lift_at_peak": "mm",
        "reversal_duration": "deg",
        "shortest_duration": "deg",
        "highest_lift": "mm",
        "speed": "rpm",
        "lift": "mm",
        "duration": "deg",
    }
    assert data.attrs["plant_fingerprint"] == PLANT.fingerprint
    assert data.attrs["saturation_share"] == 0.98
    at = data.sel(speed=1500.0, duration=180.0, lift=3.0)
    assert float(at.saturation_lift) == regions.saturation_mm[0, 1]
    assert float(at.reversal_duration) == regions.reversal_deg[0, 1]


def test_the_plot_has_two_panels_with_units_and_the_points_of_part_i(regions):
    figure = regions.plot()
    top, bottom = figure.axes
    assert top.get_ylabel() == "saturation lift (mm)"
    assert bottom.get_ylabel() == "duration (deg)"
    assert bottom.get_xlabel() == "speed (rpm)"
    points = next(line for line in top.lines if line.get_label() == "Part I")
    assert points.get_xydata().tolist() == [[750.0, 1.5], [1500.0, 3.0], [5500.0, 5.0]]
    labels = bottom.get_legend_handles_labels()[1]
    assert "reversal at 8 mm (where below 280 deg)" in labels
    assert "shortest at 3 mm" in labels
    matplotlib.pyplot.close(figure)


def test_the_plot_shows_the_highest_lift_where_a_duration_limits_it(maps):
    figure = map_regions(maps, [1500.0, 3000.0, 6000.0], duration_deg=60.0).plot()
    limit = next(
        line for line in figure.axes[0].lines if line.get_label() == "highest lift in 60 deg"
    )
    assert np.isnan(limit.get_ydata()).tolist() == [True, False, False]
    matplotlib.pyplot.close(figure)


@pytest.mark.parametrize(
    ("speeds", "options", "words"),
    [
        ([1500.0, 1000.0], {}, "must rise"),
        ([], {}, r"speeds_rpm has the shape \(0,\)"),
        ([500.0], {}, "speed_rpm is 500 rpm"),
        ([1500.0], {"lift_mm": 9.0}, r"lift_mm .*is 9 mm"),
        ([1500.0], {"duration_deg": 300.0}, "duration_deg is 300 deg"),
        ([1500.0], {"share": 0.0}, "share is 0"),
    ],
)
def test_regions_refuse_what_is_out_of_range(maps, speeds, options, words):
    with pytest.raises(ParameterError, match=words):
        map_regions(maps, speeds, **options)
