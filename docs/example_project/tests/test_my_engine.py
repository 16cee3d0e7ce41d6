"""Our engine and its controller against our own requirements."""

import pytest
from my_engine import DurationChange

from camless_ctrl import AlarmTime, ClosedLoopRequirement, Fault, WorstError, load_scenario
from plant import ValveCommand

EVEN = ClosedLoopRequirement(
    "even durations", DurationChange(), bound=15.0, unit="deg", source="our valve supplier"
)
SEEN = ClosedLoopRequirement(
    "flow sensor missed", AlarmTime("maf"), bound=12, unit="events", source="our specification, 5.2"
)
STILL_RUNS = ClosedLoopRequirement(
    "error without flow sensor",
    WorstError(mean_events=3, window="during"),
    bound=3.0,
    unit="%",
    source="our specification, 5.3",
)


@pytest.fixture(scope="module")
def tip_in(pytestconfig):
    """Our scenario, from its file."""
    return load_scenario(pytestconfig.rootpath / "scenarios" / "tip_in.toml")


def test_the_scenario_is_about_our_engine(tip_in, camless_engine):
    """The file repeats the engine, as TOML cannot import it."""
    assert tip_in.engine == camless_engine


@pytest.mark.parametrize("duration_deg", [120.0, 160.0])
def test_the_maps_are_those_of_the_plant(camless_plant, camless_maps, duration_deg):
    """Fixtures of the plugin, for our engine."""
    cycle = camless_plant.steady_cycle(1500.0, ValveCommand(6.0, duration_deg))
    told = camless_maps.air_charge(6.0, duration_deg, 1500.0)
    assert cycle.air_charge == pytest.approx(float(told), rel=0.01)


def test_durations_change_evenly(run_scenario, tip_in):
    """A requirement of our own on a figure of our own."""
    result = run_scenario(tip_in)
    assert result.meets(EVEN)


def test_the_engine_runs_without_its_flow_sensor(run_scenario, tip_in):
    """The scenario with a fault that its file does not have."""
    broken = tip_in.replace(
        name="tip-in without flow sensor", faults=(Fault("maf-dropout", start=1.5, end=4.0),)
    )
    result = run_scenario(broken)
    assert result.meets(SEEN)
    assert result.meets(STILL_RUNS)
