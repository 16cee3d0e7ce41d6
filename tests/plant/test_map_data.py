import dataclasses
import json
import os

import numpy as np
import pytest
import xarray as xr

from plant import CrankAnglePlant, Engine, ParameterError
from plant.boundary import BoundaryConditions
from plant.mean_value import MeanValuePlant

ENGINE = Engine.paper().replace(temperature=291.0 + 1.0 / 3.0)  # no short decimal
PLANT = CrankAnglePlant(ENGINE, runner=False)


@pytest.fixture(scope="module")
def maps():
    fitted = MeanValuePlant.fit(
        PLANT, speed_range_rpm=(1000.0, 1700.0), lift_range_mm=(2.0, 4.0), most_points=600
    )
    return fitted.with_boundary_conditions(PLANT, samples=50)


@pytest.fixture(scope="module")
def saved(maps, tmp_path_factory):
    path = tmp_path_factory.mktemp("maps") / "maps.nc"
    maps.save(path)
    return path


def test_a_saved_map_is_read_back_bit_by_bit(maps, saved):
    found = MeanValuePlant.load(saved, PLANT)
    for name in ("speeds_rpm", "lifts_mm", "shares", "charge", "loss"):
        before, after = getattr(maps, name), getattr(found, name)
        assert before.tobytes() == after.tobytes()
        assert before.shape == after.shape
    assert found.engine == ENGINE
    assert found.region == maps.region
    x = maps.region.sample(50, seed=1)
    for name in ("air_charge", "pumping_loss"):
        np.testing.assert_array_equal(getattr(found, name)(*x), getattr(maps, name)(*x))


def test_the_boundary_correction_is_kept(maps, saved):
    before, after = maps.boundary, MeanValuePlant.load(saved).boundary
    for a, b in zip(
        (before.charge, before.loss, *before.nodes),
        (after.charge, after.loss, *after.nodes),
        strict=True,
    ):
        assert a.tobytes() == b.tobytes()
    assert after.ranges == before.ranges
    assert after.error == before.error
    assert after.engine == ENGINE
    conditions = BoundaryConditions(0.8e5, 300.0, 1.2e5)
    value = MeanValuePlant.load(saved).air_charge(3.0, 150.0, 1500.0, conditions=conditions)
    assert value == maps.air_charge(3.0, 150.0, 1500.0, conditions=conditions)


def test_maps_without_a_boundary_correction(maps, tmp_path):
    dataclasses.replace(maps, boundary=None).save(tmp_path / "maps.nc")
    assert MeanValuePlant.load(str(tmp_path / "maps.nc")).boundary is None


def test_provenance_is_kept_with_its_types(maps, saved):
    found = MeanValuePlant.load(saved).provenance
    assert found == maps.provenance
    assert {k: type(v) for k, v in found.items()} == {
        k: type(v) for k, v in maps.provenance.items()
    }
    assert found["plant_fingerprint"] == PLANT.fingerprint
    assert found["package"] == "camless-ctrl"


def test_any_netcdf_reader_finds_units_and_the_engine(saved):
    data = xr.load_dataset(saved, engine="scipy")
    for name, variable in data.variables.items():
        assert variable.attrs["units"], name
        assert variable.attrs["long_name"], name
    units = {name: data[name].attrs["units"] for name in ("air_charge", "pumping_loss", "speed")}
    assert units == {"air_charge": "kg", "pumping_loss": "J", "speed": "rpm"}
    assert json.loads(data.attrs["engine"])["temperature"] == ENGINE.temperature
    # The durations beside the shares are those at which the plant was simulated.
    node = data.isel(speed=2, lift=1, share=3)
    cycle = PLANT.steady_cycles(float(node.speed), float(node.lift), float(node.duration))
    assert float(node.air_charge) == pytest.approx(float(cycle["air_charge"].mean()), rel=1e-9)


def test_maps_of_another_plant_are_refused_by_what_differs(saved):
    valvetrain = ENGINE.valvetrain.replace(opening_slope_mm_s=3000.0)
    other = ENGINE.replace(temperature=316.0, valvetrain=valvetrain, manifold_volume=2e-3)
    with pytest.raises(ParameterError) as error:
        MeanValuePlant.load(saved, CrankAnglePlant(other, resolution=2.0))
    for part in (
        "temperature is 291.333 K in the file, 316 K here",
        "valvetrain.opening_slope_mm_s is 3500 mm/s in the file, 3000 mm/s here",
        "manifold_volume is 0.001 m3 in the file, 0.002 m3 here",
        "runner is False in the file, True here",
        "resolution is 1.0 in the file, 2.0 here",
    ):
        assert part in str(error.value)
    assert "lift_mm" not in str(error.value)
    assert "bore" not in str(error.value)


def test_an_engine_alone_is_compared_as_well(saved):
    assert MeanValuePlant.load(saved, ENGINE).engine == ENGINE
    factors = ENGINE.replace(cylinder_flow_factors=(1.0, 1.0, 0.9, 1.0))
    with pytest.raises(ParameterError, match=r"factors\[2\] is 1 in the file, 0\.9 here"):
        MeanValuePlant.load(saved, factors)
    with pytest.raises(ParameterError, match="n_cylinders is 4 in the file, 6 here"):
        MeanValuePlant.load(saved, ENGINE.replace(n_cylinders=6))
    with pytest.raises(ParameterError, match="profile is camless in the file, conventional here"):
        MeanValuePlant.load(saved, CrankAnglePlant(ENGINE, runner=False, profile="conventional"))


def test_a_difference_in_the_last_digits_can_be_read(saved):
    close = ENGINE.replace(temperature=ENGINE.temperature * (1.0 + 1e-12))
    with pytest.raises(ParameterError) as error:
        MeanValuePlant.load(saved, close)
    told = [float(words.split()[0]) for words in str(error.value).split(" is ")[1].split("file, ")]
    assert told == [ENGINE.temperature, close.temperature]


def test_a_missing_file_is_told_as_such(tmp_path):
    with pytest.raises(FileNotFoundError):
        MeanValuePlant.load(tmp_path / "none.nc")
    with pytest.raises(OSError, match="directory"):
        MeanValuePlant.load(tmp_path)


def test_files_that_hold_no_maps_are_refused(tmp_path):
    text = tmp_path / "text.nc"
    text.write_text("speed,lift,charge\n1500,3,4.7e-4\n")
    empty = tmp_path / "empty.nc"
    empty.write_bytes(b"")
    other = tmp_path / "other.nc"
    xr.Dataset({"air_charge": ("speed", [1.0, 2.0])}).to_netcdf(other, engine="scipy")
    for path in (text, empty, other):
        with pytest.raises(ParameterError, match=f"{path.name} does not hold mean-value maps"):
            MeanValuePlant.load(path)


def test_another_format_is_refused_by_name(saved, tmp_path):
    data = xr.load_dataset(saved, engine="scipy")
    data.attrs["format"] = "camless-ctrl mean-value maps 99"
    data.to_netcdf(tmp_path / "later.nc", engine="scipy")
    with pytest.raises(ParameterError, match="maps 99"):
        MeanValuePlant.load(tmp_path / "later.nc")


def test_a_truncated_or_damaged_file_is_refused(saved, tmp_path):
    whole, path = saved.read_bytes(), tmp_path / "part.nc"
    for share in (*np.linspace(0.0, 0.999, 40), 1.0 - 1.0 / len(whole)):
        path.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(ParameterError, match=r"part\.nc"):
            MeanValuePlant.load(path)
    data = xr.load_dataset(saved, engine="scipy")
    data["air_charge"][2, 1, 3] = np.nan
    data.to_netcdf(path, engine="scipy")
    with pytest.raises(ParameterError, match=r"part\.nc: air_charge .* damaged"):
        MeanValuePlant.load(path)


def test_a_save_that_fails_leaves_nothing_behind(maps, tmp_path, monkeypatch):
    with pytest.raises(FileNotFoundError):
        maps.save(tmp_path / "no folder" / "maps.nc")
    (tmp_path / "folder.nc").mkdir()
    with pytest.raises(OSError, match=r"folder\.nc"):
        maps.save(tmp_path / "folder.nc")
    assert os.listdir(tmp_path) == ["folder.nc"]
    assert os.listdir(tmp_path / "folder.nc") == []
    kept = tmp_path / "maps.nc"
    kept.write_text("an earlier file")

    def full(self, path, **options):
        with open(path, "wb") as file:
            file.write(b"CDF half of it")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(xr.Dataset, "to_netcdf", full)
    with pytest.raises(OSError, match="No space left"):
        maps.save(kept)
    with pytest.raises(OSError, match="No space left"):
        maps.save(tmp_path / "new.nc")
    assert kept.read_text() == "an earlier file"
    assert sorted(os.listdir(tmp_path)) == ["folder.nc", "maps.nc"]


def test_a_saved_file_replaces_the_old_one_and_may_be_read_by_others(maps, tmp_path):
    path = tmp_path / "maps.nc"
    path.write_text("an earlier file")
    mask = os.umask(0o022)
    try:
        maps.save(path)
    finally:
        os.umask(mask)
    assert MeanValuePlant.load(path).engine == ENGINE
    assert path.stat().st_mode & 0o777 == 0o644
    assert os.listdir(tmp_path) == ["maps.nc"]


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda d: d.assign_coords(share=0.5 * d["share"]), "share goes from 0 to 0.5"),
        (lambda d: d.assign_coords(speed=d["speed"].values[::-1].copy()), "speed holds"),
        (lambda d: d.isel(lift=slice(0, 3)), "lift holds .* at least 4 rising"),
        (lambda d: d.assign(charge_change=d["charge_change"] * np.nan), "not all finite"),
        (lambda d: d.assign(air_charge=d["air_charge"] * np.nan), "air_charge"),
        (
            lambda d: xr.Dataset(
                d.data_vars, d.coords, {k: v for k, v in d.attrs.items() if k != "runner"}
            ),
            "attributes runner are missing",
        ),
    ],
)
def test_a_damaged_file_is_refused_when_it_is_read(saved, tmp_path, damage, said):
    with xr.open_dataset(saved, engine="scipy") as data:
        damage(data.load()).to_netcdf(tmp_path / "damaged.nc", engine="scipy")
    with pytest.raises(ParameterError, match=said):
        MeanValuePlant.load(tmp_path / "damaged.nc")
