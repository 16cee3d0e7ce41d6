import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import plant

CHARGE = (
    "from plant import *; "
    "print(CrankAnglePlant().steady_cycle(1500.0, ValveCommand(3.0, 99.0)).air_charge[0])"
)


def charge(folder, **environment):
    done = subprocess.run(
        [sys.executable, "-c", CHARGE],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(folder), **environment},
        capture_output=True,
        text=True,
        check=True,
    )
    return float(done.stdout)


@pytest.mark.slow
def test_a_change_of_a_function_in_another_file_is_never_served_stale(tmp_path):
    source = Path(plant.__file__).parent
    shutil.copytree(source, tmp_path / "plant", ignore=shutil.ignore_patterns("__pycache__"))
    cache = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    whole = charge(tmp_path, **cache)
    forcing = tmp_path / "plant" / "_forcing.py"
    kept = forcing.stat()
    text = forcing.read_text()
    assert "return lift + work" in text
    forcing.write_text(text.replace("return lift + work", "return 0.50 * lift + 0 * work"))
    os.utime(forcing, ns=(kept.st_atime_ns, kept.st_mtime_ns))  # as an installer might
    assert charge(tmp_path, **cache) < 0.9 * whole  # half the lift takes in less


def test_cache_lies_where_it_can_be_written(tmp_path, monkeypatch):
    from plant import _compile

    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "mine"))
    assert _compile._cache_folder().startswith(str(tmp_path / "mine"))
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "user"))

    def refuse_beside_the_package(folder, *args, **kwargs):
        if "__pycache__" in folder.parts:
            raise PermissionError(13, "read-only")
        os.makedirs(folder, exist_ok=True)

    monkeypatch.setattr(Path, "mkdir", refuse_beside_the_package)
    assert _compile._cache_folder().startswith(str(tmp_path / "user" / "camless-ctrl"))

    def refuse(folder, *args, **kwargs):
        raise PermissionError(13, "read-only")

    monkeypatch.setattr(Path, "mkdir", refuse)
    assert _compile._cache_folder() == ""
