import importlib
import pkgutil

import pytest

PACKAGES = ("plant", "uncertainty", "camless_ctrl")


@pytest.mark.parametrize("name", PACKAGES)
def test_every_public_name_exists_once_and_has_a_docstring(name):
    package = importlib.import_module(name)
    assert len(set(package.__all__)) == len(package.__all__)
    for public in package.__all__:
        found = getattr(package, public)
        if callable(found):
            assert found.__doc__, f"{name}.{public} has no docstring"


def test_unknown_name_is_refused():
    with pytest.raises(AttributeError, match="no attribute 'analyze'"):
        importlib.import_module("camless_ctrl").analyze  # noqa: B018


@pytest.mark.parametrize("name", PACKAGES)
def test_no_public_name_is_hidden_by_a_submodule(name):
    package = importlib.import_module(name)
    modules = {module.name for module in pkgutil.iter_modules(package.__path__)}
    assert not modules & set(package.__all__)
