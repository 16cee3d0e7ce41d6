"""Checks across the parts of a scenario: whether they fit each other, and a design can be made."""

from __future__ import annotations

from typing import TYPE_CHECKING

from plant import ParameterError
from plant._checks import whole
from plant._map_grid import SPEED_RANGE_RPM

from ._metric_alarms import AlarmTime
from ._metric_errors import WorstError
from ._metric_modes import ModeTime
from ._scenario_tables import Place, ScenarioError

if TYPE_CHECKING:
    from plant import Engine

    from ._metric import Metric
    from .faults import Fault
    from .operating_profile import OperatingProfile
    from .scenario import Scenario

_ROUNDING_RPM = 1e-6
_AIR_SENSORS = ("maf", "map")


def check_parts(scenario: Scenario) -> None:
    """Refuse parts that contradict each other, whatever design the scenario is run with.

    Raises
    ------
    ScenarioError
        With the place, as in a file of one scenario.
    """
    n = scenario.engine.n_cylinders
    check_equal(scenario.engine)
    offset = scenario.valves.duration_offset
    if isinstance(offset, tuple) and len(offset) != n:
        raise ScenarioError(
            f"duration_offset has {len(offset)} values, but the engine has {n} cylinders: give one "
            "for each, or a number for all",
            ("valves",),
            "duration_offset",
        )
    for i, fault in enumerate(scenario.faults):
        if fault.cylinder is not None:
            _check_cylinder(fault.cylinder, n, ("faults", i), "cylinder")
    for i, span in enumerate(scenario.profile.deactivated):
        _check_cylinder(span.cylinder, n, ("profile", "deactivated", i), "cylinder")
    _check_starts(scenario.faults, scenario.profile, n)
    names: set[str] = set()
    for i, requirement in enumerate(scenario.requirements):
        place = ("requirements", i)
        if requirement.name in names:
            raise ScenarioError(
                f"two requirements are called {requirement.name!r}: give each a name of its own",
                place,
                "name",
            )
        names.add(requirement.name)
        _check_metric(requirement.metric, len(scenario.faults), n, place)


def check_equal(engine: Engine) -> None:
    """Refuse a nominal engine with unequal cylinders.

    Raises
    ------
    ScenarioError
        If its cylinders are unequal.
    """
    if len(set(engine.cylinder_flow_factors)) > 1:
        raise ScenarioError(
            f"cylinder_flow_factors are {engine.cylinder_flow_factors}, but the nominal engine has "
            "equal cylinders: give them to the true engine",
            ("engine",),
            "cylinder_flow_factors",
        )


def check_design(scenario: Scenario) -> None:
    """Refuse what no design of the scenario can be made for, before it is begun.

    A scenario that is run with a design of one's own need not meet it.

    Raises
    ------
    ScenarioError
        If a speed is out of reach, or the estimator refuses a sensor; with the place, as in a
        file of one scenario.
    """
    _check_speeds(scenario)
    from ._estimator_workspace import noise_variance

    for name in _AIR_SENSORS:
        if noise_variance(getattr(scenario.assumed_sensors, name)) == 0.0:
            raise ScenarioError(
                "noise is 0 and bits say that nothing is quantised, but a filter that trusts a "
                f"sample of the {name} sensor without bound has no solution: give it noise above "
                "0, or bits; or knows_sensors = false in [controller]",
                ("sensors", name),
                "noise",
            )


def _check_speeds(scenario: Scenario) -> None:
    """Refuse speeds that the design does not reach."""
    low, high = SPEED_RANGE_RPM
    own = scenario.controller.speed_range_rpm
    reach = f"a design reaches from {low:g} to {high:g} rpm"
    if own is not None:
        if own[0] < low or own[1] > high:
            raise ScenarioError(
                f"speed_range_rpm is {own[0]:g} to {own[1]:g} rpm, but {reach}: stay within",
                ("controller",),
                "speed_range_rpm",
            )
        low, high = own
        reach = f"speed_range_rpm of the controller is {low:g} to {high:g} rpm"
    signal = scenario.profile.speed_rpm
    if low <= min(signal.values) and max(signal.values) <= high:
        return
    # What counts is what the events meet: points may lie beyond the end.
    events = _events(scenario.profile, scenario.engine.n_cylinders)
    for time, speed in zip(*events, strict=True):
        if speed < low - _ROUNDING_RPM or speed > high + _ROUNDING_RPM:
            remedy = "stay within" if own is None else "stay within, or widen speed_range_rpm"
            raise ScenarioError(
                f"speed_rpm is {speed:g} rpm at {time:.4g} s, but {reach}: {remedy}",
                ("profile",),
                "speed_rpm",
            )


def _check_starts(faults: tuple[Fault, ...], profile: OperatingProfile, n: int) -> None:
    """Refuse faults that start after the last event."""
    # On the axis of time the last event lies less than the longest gap before the end.
    sure = -1.0
    if profile.axis == "time":
        sure = profile.length - 120.0 / (n * min(profile.speed_rpm.values))
    if all(fault.start <= sure for fault in faults):
        return
    end = _events(profile, n)[0][-1]
    for i, fault in enumerate(faults):
        if fault.start > end:
            raise ScenarioError(
                f"fault {i + 1} starts at {fault.start:g} s, but the last event is at {end:.4g} s: "
                "let it start earlier, or lengthen the profile",
                ("faults", i),
                "start",
            )


def _check_metric(metric: Metric, faults: int, n: int, place: Place) -> None:
    """Refuse a metric of a fault or a cylinder that is not there."""
    of_fault = isinstance(metric, AlarmTime | ModeTime)
    of_fault |= isinstance(metric, WorstError) and metric.window != "all"
    number = getattr(metric, "fault", 1)
    if of_fault and number > faults:
        has, remedy = (
            (f"has {faults}", f"give a number from 1 to {faults}")
            if faults
            else ("has none", "leave the requirement out, or add a fault")
        )
        raise ScenarioError(f"fault is {number}, but the scenario {has}: {remedy}", place, "fault")
    without = getattr(metric, "without_cylinders", ())
    for cylinder in without if isinstance(without, tuple) else ():
        _check_cylinder(cylinder, n, place, "without_cylinders")


def _check_cylinder(cylinder: int, n: int, place: Place, key: str) -> None:
    """Refuse a cylinder that is not there."""
    try:
        whole(key, cylinder, 1, n, remedy=f"the engine has {n} cylinders")
    except ParameterError as error:
        raise ScenarioError(str(error), place, key) from error


def _events(profile: OperatingProfile, n: int) -> tuple[list[float], list[float]]:
    """Time in s and speed in rpm of each event of a profile."""
    try:
        events = profile.events(n)
    except ParameterError as error:
        raise ScenarioError(str(error), ("profile",), "length") from error
    return events.time.tolist(), events.speed_rpm.tolist()
