import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import plant
from plant import _compile

CHARGE = (
    "from plant import *; "
    "print(CrankAnglePlant().steady_cycle(1500.0, ValveCommand(3.0, 99.0)).air_charge[0])"
)
# A ramp behind a lag of 0.5 s, and whether Numba was needed: the smallest part of the kernel.
LAG = (
    "import sys, plant; print(plant.first_order_lag([0, 1, 2], [0, 1, 2], 0.5)[-1], "
    "'numba' in sys.modules)"
)
LAGGED = 2.0 - 0.5 * (1.0 - np.exp(-4.0))


def start(code, folder=None, **environment):
    paths = {} if folder is None else {"PYTHONPATH": str(folder)}
    return subprocess.Popen(
        [sys.executable, "-c", code],
        cwd=folder,
        env={**os.environ, **paths, **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def finish(process):
    out, errors = process.communicate()
    assert process.returncode == 0, errors
    return out.split(), errors


def charge(folder, **environment):
    (value,), _ = finish(start(CHARGE, folder, **environment))
    return float(value)


@pytest.mark.slow
def test_a_change_of_a_function_in_another_file_is_never_served_stale(tmp_path):
    source = Path(plant.__file__).parent
    shutil.copytree(source, tmp_path / "plant", ignore=shutil.ignore_patterns("__pycache__"))
    cache = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    whole = charge(tmp_path, **cache)
    forcing = tmp_path / "plant" / "_forcing.py"
    kept = forcing.stat()
    text = forcing.read_text()
    assert "area_step * max" in text
    forcing.write_text(text.replace("area_step * max", "0.5 * area_step * max"))
    os.utime(forcing, ns=(kept.st_atime_ns, kept.st_mtime_ns))  # as an installer might
    assert charge(tmp_path, **cache) < 0.9 * whole  # half the area takes in less


def test_a_second_process_needs_no_numba(tmp_path):
    for needed in ("True", "False"):
        (value, numba), errors = finish(start(LAG, NUMBA_CACHE_DIR=str(tmp_path)))
        assert float(value) == pytest.approx(LAGGED, rel=1e-12)
        assert numba == needed
        assert errors == ""


def test_a_second_process_simulates_without_numba():
    point = "1500, plant.ValveCommand(3.0, 99.0)"
    first = plant.CrankAnglePlant().steady_cycle(1500, plant.ValveCommand(3.0, 99.0))
    code = (
        f"import sys, plant; cycle = plant.CrankAnglePlant().steady_cycle({point}); "
        "print(cycle.air_charge[0], 'numba' in sys.modules)"
    )
    (value, numba), _ = finish(start(code))
    assert float(value) == first.air_charge[0]
    assert numba == "False"


def test_processes_that_compile_at_once_do_not_disturb_each_other(tmp_path):
    both = [start(LAG, NUMBA_CACHE_DIR=str(tmp_path)) for _ in range(2)]
    for process in both:
        (value, _), errors = finish(process)
        assert float(value) == pytest.approx(LAGGED, rel=1e-12)
        assert errors == ""
    (file,) = tmp_path.rglob("*.o*")  # nothing unfinished is left
    assert file.suffix == ".o"


def test_without_a_folder_to_write_in_the_code_is_compiled_with_one_hint(tmp_path):
    (tmp_path / "file").touch()
    for folder in (tmp_path / "file", Path("/proc/none")):
        (value, numba), errors = finish(start(LAG, NUMBA_CACHE_DIR=str(folder)))
        assert float(value) == pytest.approx(LAGGED, rel=1e-12)
        assert numba == "True"
        assert errors.count("RuntimeWarning") == 1
        assert f"cannot be kept in {folder} (" in errors
        assert "set NUMBA_CACHE_DIR to a folder" in errors


@pytest.fixture
def user_cache(tmp_path, monkeypatch):
    """Return the user's cache, after making the package's folder one that cannot be written."""
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "user"))
    _compile._name()  # reads the real folder
    (tmp_path / "package").mkdir()
    (tmp_path / "package" / "__pycache__").touch()
    monkeypatch.setattr(_compile, "_FOLDER", tmp_path / "package")
    return tmp_path / "user" / "camless-ctrl"


def test_the_users_cache_serves_where_the_package_cannot_be_written(user_cache):
    assert _compile.read("some.o") is None
    _compile.store("some.o", b"code")
    assert _compile.read("some.o") == b"code"
    assert [path.name for path in user_cache.rglob("*.o")] == ["some.o"]


def test_a_folder_that_can_only_be_read_is_read(user_cache, tmp_path, monkeypatch):
    _compile.store("some.o", b"code")

    def refuse(path, *args, **kwargs):
        raise PermissionError(13, "read-only")

    monkeypatch.setattr(os, "utime", refuse)
    assert _compile.read("some.o") == b"code"


def test_a_user_without_a_home_gets_no_cache_in_the_working_folder(monkeypatch):
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(os.path, "expanduser", lambda path: path)  # what Python does then
    assert _compile._homes() == [_compile._FOLDER / "__pycache__"]


def test_code_that_nobody_has_used_for_a_month_is_removed(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    days = {"kernel-" + 16 * "0": 31, "kernel-" + 16 * "1": 29, "kernel-of-someone-else": 99}
    for name, age in days.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "kernel.o").touch()
        os.utime(tmp_path / name, 2 * (time.time() - 86400 * age,))
    _compile.store("some.o", b"code")
    left = {path.name for path in tmp_path.iterdir()}
    assert left == {_compile._name(), "kernel-" + 16 * "1", "kernel-of-someone-else"}


def test_reading_counts_as_use(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    _compile.store("some.o", b"code")
    folder = tmp_path / _compile._name()
    os.utime(folder, (0.0, 0.0))
    assert _compile.read("some.o") == b"code"
    assert time.time() - folder.stat().st_mtime < 3600.0
