"""The public face of the package, and that importing it costs next to nothing."""

from __future__ import annotations

import subprocess
import sys

import pytest

import camless_ctrl.synthesis as synthesis


def test_every_public_name_loads():
    for name in synthesis.__all__:
        assert getattr(synthesis, name) is not None
    assert dir(synthesis) == sorted(synthesis.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = synthesis.nothing


def test_import_leaves_heavy_libraries_alone():
    code = (
        "import sys; import camless_ctrl.synthesis as s; [getattr(s, n) for n in s.__all__]; "
        "heavy = {'scipy', 'control', 'slycot', 'matplotlib', 'pandas', 'numba', 'xarray'}; "
        "print(sorted(heavy & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_child_that_solves_loads_no_control_library():
    code = (
        "import sys; import camless_ctrl.synthesis._solver, camless_ctrl.synthesis._truncation; "
        "print(sorted({'scipy', 'control', 'matplotlib'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
