"""The result of a scenario: signals, verdicts on its requirements, picture and files."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from plant.errors import ParameterError

from .closed_loop_result import ClosedLoopResult

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

    from .closed_loop_requirement import ClosedLoopRequirement, Verdict
    from .scenario import Scenario


@dataclass(frozen=True, eq=False, repr=False)
class ScenarioResult:
    """What came of a scenario.

    Attributes
    ----------
    scenario : Scenario
        What was run.
    run : ClosedLoopResult
        Signals of each event. Time is 0 at the start of the profile, and negative in the
        warm-up before it.
    seed : int
        Seed of noise and jitter.
    provenance : mapping
        Versions, platform and engine that it was computed with, see `run_provenance`.
    plots_to : Path or None
        Folder in which `meets` leaves pictures of requirements that are not met; none if None.
    """

    scenario: Scenario = field(repr=False)
    run: ClosedLoopResult = field(repr=False)
    seed: int
    provenance: Mapping[str, Any] = field(repr=False)
    plots_to: Path | None = field(default=None, repr=False)

    @cached_property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Verdicts on the requirements of the scenario, in their order."""
        return tuple(requirement.evaluate(self) for requirement in self.scenario.requirements)

    @property
    def met(self) -> bool:
        """Whether all requirements of the scenario are met."""
        return all(verdict.met for verdict in self.verdicts)

    def meets(self, requirement: ClosedLoopRequirement | str) -> Verdict:
        """Return the verdict on a requirement: true if it is met, else with number and instant.

        Parameters
        ----------
        requirement : ClosedLoopRequirement or str
            Any requirement, or the name of one of the scenario's. If it is not met and
            `plots_to` is set, a picture is saved there, which the verdict names.

        Raises
        ------
        ParameterError
            If the scenario has no requirement of that name.
        OutputError
            If the picture cannot be written.
        """
        verdict = self._requirement(requirement).evaluate(self)
        if verdict.met or self.plots_to is None:
            return verdict
        return replace(verdict, plot=self._save_plot(verdict, Path(self.plots_to)))

    def plot(self, verdicts: Sequence[Verdict] | None = None) -> Figure:
        """Draw charge and demand, error, speed, mode and alarms over time.

        Faults are shaded, and the worst instant of each requirement that is not met is flagged.

        Parameters
        ----------
        verdicts : sequence of Verdict, optional
            Verdicts whose instants are flagged if they are not met; those on the scenario's
            requirements by default.
        """
        from ._result_plot import draw

        return draw(self, self.verdicts if verdicts is None else verdicts)

    def to_dataset(self) -> xr.Dataset:
        """Return the signals of each event, with units, scenario, seed and provenance."""
        from ._result_file import origin

        return self.run.to_dataset().assign_attrs(origin(self))

    def crank_dataset(self) -> xr.Dataset:
        """Return the signals over the crank angle, with units, scenario, seed and provenance.

        Raises
        ------
        ParameterError
            If the run did not record them.
        """
        from ._result_file import origin

        return self.run.crank_dataset().assign_attrs(origin(self))

    def to_csv(self, path: str | os.PathLike[str]) -> None:
        """Write the signals as a table, a row an event; the header tells units: ``time[s]``.

        What is not known (NaN) stays empty.

        Raises
        ------
        OutputError
            If the file cannot be written.
        """
        from ._result_file import write_csv

        write_csv(self, Path(path))

    def to_netcdf(self, path: str | os.PathLike[str]) -> None:
        """Write all signals, those over the crank angle too if recorded, as netCDF.

        Raises
        ------
        OutputError
            If the file cannot be written.
        """
        from ._result_file import write_netcdf

        write_netcdf(self, Path(path))

    def to_json(self, path: str | os.PathLike[str]) -> None:
        """Write scenario, seed, provenance, verdicts and all signals, every number exactly.

        Raises
        ------
        OutputError
            If the file cannot be written.
        """
        from ._result_file import write_json

        write_json(self, Path(path))

    def to_dict(self) -> dict[str, Any]:
        """Return scenario, seed, provenance and verdicts as plain data, without the signals."""
        return {
            "scenario": self.scenario.to_dict(),
            "seed": self.seed,
            "provenance": dict(self.provenance),
            "met": self.met,
            "verdicts": [verdict.to_dict() for verdict in self.verdicts],
        }

    @property
    def remarks(self) -> tuple[str, ...]:
        """What no requirement may have asked for: limited events, and alarms without a fault.

        Limited are events of the profile whose demand is outside what can be commanded; alarms
        count from the warm-up on, as in the metric `FalseAlarms`.
        """
        from ._metric_alarms import FalseAlarms
        from ._metric_events import Events

        found = []
        inside = Events.of(self).within(0.0, math.inf)
        events = np.count_nonzero(inside)
        limited = np.flatnonzero(inside & self.run.limited)
        if limited.size:
            found.append(
                f"{limited.size} of {events} events ({100.0 * limited.size / events:.3g} %) were "
                "limited: their demand is out of reach, first at "
                f"{self.run.time[limited[0]]:.2f} s (event {limited[0]})"
            )
        metric = FalseAlarms()
        alarms = metric.measure(self)
        if alarms.value > 0.0:
            found.append(
                f"{alarms.value:.0f} events with an alarm outside of any fault and the "
                f"{metric.margin_s:g} s after it, {alarms.note} at {alarms.time:.2f} s (event "
                f"{alarms.event})"
            )
        return tuple(found)

    def __str__(self) -> str:
        """Return what was run, a line for each verdict, and what else is to be told."""
        missed = sum(not verdict.met for verdict in self.verdicts)
        told = "no requirements"
        if self.verdicts:
            told = f"{missed} of {len(self.verdicts)} NOT MET" if missed else "all requirements met"
        events, seconds = self.run.time.size, float(self.run.time[-1])
        return "\n".join(
            [
                f"{self.scenario.name}: {told} ({events} events, {seconds:.3g} s, seed "
                f"{self.seed})",
                *(f"  {verdict}" for verdict in self.verdicts),
                *(f"  {remark}" for remark in self.remarks),
            ]
        )

    def __repr__(self) -> str:
        """Return name, size and seed, without the verdicts: those may take a while."""
        return f"ScenarioResult({self.scenario.name!r}, {self.run.time.size} events)"

    def _requirement(self, which: ClosedLoopRequirement | str) -> ClosedLoopRequirement:
        if not isinstance(which, str):
            return which
        for requirement in self.scenario.requirements:
            if requirement.name == which:
                return requirement
        names = ", ".join(repr(r.name) for r in self.scenario.requirements) or "none"
        raise ParameterError(
            f"scenario {self.scenario.name!r} has no requirement {which!r}; it has {names}: name "
            "one of them, or give a ClosedLoopRequirement"
        )

    def _save_plot(self, verdict: Verdict, folder: Path) -> Path:
        import matplotlib.pyplot as plt

        from .output import OutputError, reserved_path

        name = f"{_slug(self.scenario.name)}-{_slug(verdict.requirement.name)}-{self.seed}.png"
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(
                f"folder {folder} cannot be made ({error.strerror or error}): name another one "
                "for the plots"
            ) from error
        target = folder.absolute() / name
        figure = self.plot([verdict])
        try:
            with reserved_path(target) as place:
                figure.savefig(place)
        finally:
            plt.close(figure)
        return target


def load_result(path: str | os.PathLike[str]) -> ScenarioResult:
    """Read a result that `ScenarioResult.to_json` or `ScenarioResult.to_netcdf` wrote.

    The state of the controller after the run is not kept in files: it is None.

    Parameters
    ----------
    path : path-like
        The file.

    Raises
    ------
    ParameterError
        If the file cannot be read, or holds no such result; if a part of it is missing, the
        message names the part.
    """
    from ._result_file import read

    return read(Path(path)).result


def _slug(name: str) -> str:
    """A name as part of a file name."""
    return re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")[:60] or "result"
