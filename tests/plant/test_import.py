import ast
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

from plant import _compile, _entries, _native

PACKAGES = ("plant", "uncertainty", "camless_ctrl")
SLOW_TO_IMPORT = ["numba", "scipy", "xarray", "matplotlib", "pandas", "casadi", "control"]


def imported_by(statement):
    """Return those of the slow packages that a statement imports in a fresh process."""
    code = f"import sys; {statement}; print(*(set({SLOW_TO_IMPORT}) & sys.modules.keys()))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.split()


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_is_imported_without_what_is_slow(package):
    assert imported_by(f"import {package}") == []


def test_the_plant_is_made_without_what_is_slow():
    made = "from plant import CrankAnglePlant, ValveCommand; CrankAnglePlant()"
    assert imported_by(f"{made}; ValveCommand(3.0, 99.0)") == []


@pytest.mark.parametrize("name", PACKAGES)
def test_names_loaded_on_first_use_are_those_that_type_checkers_see(name):
    package = importlib.import_module(name)
    tree = ast.parse(Path(package.__file__).read_text())
    seen = {
        alias.name: statement.module
        for block in tree.body
        if isinstance(block, ast.If)
        for statement in block.body
        for alias in statement.names
    }
    assert seen == package._HOME
    assert sorted(package.__all__) == sorted(seen) == dir(package)
    for public in seen:
        assert getattr(package, public) is vars(
            importlib.import_module(f"{name}.{seen[public]}")
        ).get(public)


@pytest.mark.parametrize("name", PACKAGES)
def test_a_name_that_does_not_exist_is_refused(name):
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        importlib.import_module(name).nothing  # noqa: B018


def test_every_file_that_the_kernel_uses_is_in_the_name_of_its_cache():
    python_only = {"_checks", "errors", "kinematics"}  # no compiled code calls them
    libraries = [item for item in vars(_entries).values() if isinstance(item, _native.Library)]
    used = {entry.module for library in libraries for entry in library.entries}
    assert used
    todo = list(used)
    while todo:
        source = Path(_entries.__file__).with_name(f"{todo.pop()}.py")
        for statement in ast.walk(ast.parse(source.read_text())):
            if isinstance(statement, ast.ImportFrom) and statement.level == 1:
                names = [alias.name for alias in statement.names]
                modules = {statement.module} if statement.module else set(names)
                todo += modules - used - python_only
                used |= modules - python_only
    assert {f"{module}.py" for module in used} <= set(_compile._SOURCES)
