"""Replay of a saved result: the same scenario and seed, compared bit for bit.

All that a file tells is compared, but for the versions that it was made with: those are told.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ._result_file import read, signals, statement, trace_signals
from .provenance import provenance_differences
from .scenario_result import ScenarioResult

if TYPE_CHECKING:
    from .closed_loop_result import ClosedLoopResult
    from .controller_design import ControllerDesign

_TOLD = 10  # differences that are printed
_NONE = object()  # stands for a field that is not there


@dataclass(frozen=True, eq=False)
class Replay:
    """A saved result and the same run made again; true if all numbers are the same.

    Attributes
    ----------
    path : Path
        The file.
    stored, again : ScenarioResult
        What it holds, and what came of it now.
    differences : tuple of str
        One for each signal that differs, how often and where first, and for each field that
        does: of scenario, seed, faults, number of cylinders, verdicts.
    origins : tuple of str
        Versions, platform or engine that differ.
    """

    path: Path
    stored: ScenarioResult = field(repr=False)
    again: ScenarioResult = field(repr=False)
    differences: tuple[str, ...]
    origins: tuple[str, ...]

    @property
    def same(self) -> bool:
        """Whether all is the same, numbers bit for bit; NaN is the same as NaN."""
        return not self.differences

    def __bool__(self) -> bool:
        """Whether all is the same."""
        return self.same

    def __str__(self) -> str:
        """Return whether it is the same, else the differences, and versions that differ."""
        count = len(_all_signals(self.stored.run))
        what = f"{self.path}: {self.stored.scenario.name}, seed {self.stored.seed}"
        if self.same:
            lines = [f"{what}: all {count} signals and the verdicts are the same, bit for bit"]
        else:
            some = "signal or field DIFFERS"
            if len(self.differences) > 1:
                some = "signals or fields DIFFER"
            lines = [f"{what}: {len(self.differences)} {some}"]
            lines += [f"  {text}" for text in self.differences[:_TOLD]]
            if len(self.differences) > _TOLD:
                lines.append(f"  and {len(self.differences) - _TOLD} more")
        if self.origins:
            lines.append("  made with other versions:" if self.same else "  what else differs:")
            lines += [f"    {text}" for text in self.origins]
        return "\n".join(lines)


def replay_result(path: str | os.PathLike[str], design: ControllerDesign | None = None) -> Replay:
    """Run the scenario of a saved result again, and compare all signals and fields.

    Parameters
    ----------
    path : path-like
        File that `ScenarioResult.to_json` or `ScenarioResult.to_netcdf` wrote.
    design : ControllerDesign, optional
        Design of the controller; made from the scenario by default, as `run_scenario` does.

    Raises
    ------
    ParameterError
        If the file cannot be read, or holds no result.
    """
    from .scenario_run import run_scenario

    stored, told = read(Path(path))
    again = run_scenario(
        stored.scenario, design, seed=stored.seed, record_deg=_record_deg(stored.run)
    )
    return Replay(
        Path(path),
        stored,
        again,
        signal_differences(stored.run, again.run) + field_differences(told, statement(again)),
        provenance_differences(stored.provenance, again.provenance),
    )


def signal_differences(stored: ClosedLoopResult, now: ClosedLoopResult) -> tuple[str, ...]:
    """Return a sentence for each signal of two runs that is not the same bit for bit.

    Signs of zero count; a NaN is the same as any other NaN.
    """
    before, after = _all_signals(stored), _all_signals(now)
    found = []
    for name in dict.fromkeys((*before, *after)):
        if name not in before or name not in after:
            found.append(f"{name}: only {'now' if name in after else 'stored'}")
        else:
            text = _difference(before[name], after[name], stored)
            found += [f"{name}: {text}"] if text else []
    return tuple(found)


def field_differences(stored: Any, now: Any, name: str = "") -> tuple[str, ...]:
    """Return a sentence for each field of two objects of JSON that is not the same.

    Parameters
    ----------
    stored, now : object
        What JSON knows.
    name : str
        What they are called.
    """
    if isinstance(stored, dict) and isinstance(now, dict):
        pairs = {key: (stored.get(key, _NONE), now.get(key, _NONE)) for key in (*stored, *now)}
    elif isinstance(stored, list) and isinstance(now, list):
        pairs = {
            f"{i + 1}": pair
            for i, pair in enumerate(itertools.zip_longest(stored, now, fillvalue=_NONE))
        }
    elif stored == now and isinstance(stored, bool) == isinstance(now, bool):
        return ()
    else:
        return (f"{name}: {_said(stored)} stored, {_said(now)} now",)
    places = {key: f"{name}.{key}" if name else key for key in pairs}
    return tuple(
        text for key, pair in pairs.items() for text in field_differences(*pair, places[key])
    )


def _said(value: Any) -> str:
    return "nothing" if value is _NONE else repr(value)


def _difference(stored: np.ndarray, now: np.ndarray, run: ClosedLoopResult) -> str:
    """How two arrays differ; empty if they do not."""
    if stored.shape != now.shape or stored.dtype != now.dtype:
        return f"{stored.dtype} {stored.shape} stored, {now.dtype} {now.shape} now"
    other = stored != now
    if stored.dtype.kind == "f":
        other |= np.signbit(stored) != np.signbit(now)
        other &= ~(np.isnan(stored) & np.isnan(now))
    if not other.any():
        return ""
    place = tuple(int(k) for k in np.argwhere(other)[0])
    k = place[0]
    if stored.shape == run.time.shape:
        where = f"event {k} ({run.time[k]:.4g} s, cylinder {run.cylinder[k]})"
    else:
        where = f"sample {k}" + (f", cylinder {place[1] + 1}" if len(place) > 1 else "")
    return (
        f"{np.count_nonzero(other)} of {other.size} values, first at {where}: "
        f"{stored[place].item()!r} stored, {now[place].item()!r} now"
    )


def _all_signals(run: ClosedLoopResult) -> Mapping[str, np.ndarray]:
    crank = {f"crank {name}": values for name, values in trace_signals(run).items()}
    return {**signals(run), **crank}


def _record_deg(run: ClosedLoopResult) -> float | None:
    """Step at which the signals over the crank angle were kept, deg; None if they were not."""
    if run.trace is None:
        return None
    return float(np.median(np.diff(run.trace.crank_angle_deg)))
