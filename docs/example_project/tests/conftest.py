"""The plugin's fixtures, for our engine."""

import pytest
from my_engine import ENGINE, SPEED_RANGE_RPM

from camless_ctrl import stored_design


@pytest.fixture(scope="session")
def camless_engine():
    """Our engine: `camless_plant` is its plant from now on."""
    return ENGINE


@pytest.fixture(scope="session")
def camless_design(camless_engine):
    """Controller for few speeds: `camless_maps` are its maps from now on."""
    return stored_design(camless_engine, speed_range_rpm=SPEED_RANGE_RPM)
