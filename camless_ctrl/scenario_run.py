"""From a scenario to its result: plant, controller and profile, run event by event."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

from plant import ParameterError
from plant.trace import Trace

from ._scenario_checks import check_design
from .baselines import FEEDFORWARD, GRADIENT, INTEGRAL, baseline_controllers
from .closed_loop import simulate
from .closed_loop_result import ClosedLoopResult
from .controller import AirChargeController
from .controller_design import ControllerDesign, _of
from .faults import Fault
from .model_store import stored_design
from .operating_profile import ProfileEvents
from .provenance import run_provenance
from .scenario import Law, Scenario
from .scenario_result import ScenarioResult

Progress = Callable[[str, int, int], None]

_BASELINES: dict[Law, str] = {
    "gradient": GRADIENT,
    "integral": INTEGRAL,
    "feedforward": FEEDFORWARD,
}
_ROUNDING_RPM = 1e-6
_ROUNDING_S = 1e-9  # by which the time of an event may miss the edge of a fault that it is on


def scenario_design(scenario: Scenario, *, progress: Progress | None = None) -> ControllerDesign:
    """Return the design of a scenario's controller, from disk if it was made before.

    Parameters
    ----------
    scenario : Scenario
        Tells nominal engine, assumed sensors and range of speed.
    progress : callable, optional
        Called with what is being made, the number of parts done and the number in all.

    Raises
    ------
    ParameterError
        If a speed is out of a design's reach, or the estimator refuses a sensor; before anything
        is made.
    """
    check_design(scenario)
    return stored_design(
        scenario.engine,
        sensors=scenario.assumed_sensors,
        speed_range_rpm=scenario.controller.speed_range_rpm,
        progress=progress,
    )


def run_scenario(
    scenario: Scenario,
    design: ControllerDesign | None = None,
    *,
    seed: int | None = None,
    progress: Progress | None = None,
    record_deg: float | None = None,
) -> ScenarioResult:
    """Run a scenario against the full plant, runner and actuator oscillation on.

    Parameters
    ----------
    scenario : Scenario
        What to run.
    design : ControllerDesign, optional
        Of the scenario's nominal engine; `scenario_design` by default.
    seed : int, optional
        Seed of noise and jitter; the scenario's own by default.
    progress : callable, optional
        Called with what is being done, the number of parts done and the number in all.
    record_deg : float, optional
        Step at which crank-level signals are kept, deg; none are by default.

    Returns
    -------
    ScenarioResult
        Its times count from the start of the profile; those of the warm-up are negative.

    Raises
    ------
    ParameterError
        If the design is one of another engine or does not reach the profile's speeds, or none
        can be made.
    """
    n = scenario.engine.n_cylinders
    warm_up = scenario.controller.warm_up_cycles
    events = scenario.profile.events(n, warm_up_cycles=warm_up)
    if design is None:
        design = scenario_design(scenario, progress=progress)
    _require_design(scenario, design, events)
    plant = scenario.plant
    before = -float(events.time[0])  # s, of the warm-up
    run = simulate(
        plant,
        controller_of(scenario, design),
        events.demand,
        events.speed_rpm,
        sensors=scenario.sensors,
        valves=scenario.valves,
        faults=tuple(_later(fault, before) for fault in scenario.faults),
        conditions=events.conditions,
        throttle_deg=events.throttle_deg,
        seed=scenario.seed if seed is None else seed,
        name=scenario.name,
        record_deg=record_deg,
        progress=_of("closed loop", progress),
    )
    run = _from_start(run, warm_up * n, scenario.faults)
    return ScenarioResult(scenario, run, run.seed, run_provenance(plant))


def controller_of(scenario: Scenario, design: ControllerDesign) -> AirChargeController:
    """Controller of a design with the law that a scenario asks for."""
    law = scenario.controller.law
    if law == "least-squares":
        return design.controller
    return baseline_controllers(design)[_BASELINES[law]]


def _require_design(scenario: Scenario, design: ControllerDesign, events: ProfileEvents) -> None:
    """Refuse a design of another engine, or one that does not reach the speeds."""
    if design.engine != scenario.engine:
        names = (field.name for field in dataclasses.fields(scenario.engine))
        other = [k for k in names if getattr(design.engine, k) != getattr(scenario.engine, k)]
        raise ParameterError(
            f"the design is one of another engine than the nominal engine of scenario "
            f"{scenario.name!r}: they differ in {', '.join(other)}; make the design with "
            "scenario_design, or leave it out"
        )
    low, high = float(design.model.speeds_rpm[0]), float(design.model.speeds_rpm[-1])
    slowest, fastest = float(events.speed_rpm.min()), float(events.speed_rpm.max())
    if slowest < low - _ROUNDING_RPM or fastest > high + _ROUNDING_RPM:
        raise ParameterError(
            f"scenario {scenario.name!r} runs from {slowest:g} to {fastest:g} rpm, but the "
            f"controller's maps reach from {low:g} to {high:g} rpm: change speed_rpm, or "
            "speed_range_rpm"
        )


def _later(fault: Fault, seconds: float) -> Fault:
    """A fault on a clock that starts earlier by some seconds; it acts on an event on its edge."""
    shift = seconds - _ROUNDING_S
    return fault.replace(start=max(fault.start + shift, 0.0), end=fault.end + shift)


def _from_start(run: ClosedLoopResult, first: int, faults: tuple[Fault, ...]) -> ClosedLoopResult:
    """A run whose times count from one of its events."""
    zero = float(run.time[first])
    trace: Trace | None = run.trace
    if trace is not None:
        trace = dataclasses.replace(trace, time=trace.time - zero)
    return dataclasses.replace(run, time=run.time - zero, trace=trace, faults=faults)
