"""Start-up: what a second process waits for, its machine code already on disk."""

from __future__ import annotations

import statistics
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import plant

_CODE = """
import time
begin = time.perf_counter()
import plant
imported = time.perf_counter()
plant.CrankAnglePlant().steady_cycle(1500.0, plant.ValveCommand(3.0, 189.0))
done = time.perf_counter()
print(imported - begin, done - imported)
"""


@dataclass(frozen=True)
class Startup:
    """Median times in a fresh process, s.

    Attributes
    ----------
    import_s : float
        ``import plant``.
    first_cycle_s : float
        From there to the first periodic cycle, with the machine code read from disk.
    processes : int
        Number of processes timed.
    """

    import_s: float
    first_cycle_s: float
    processes: int

    def __str__(self) -> str:
        """Return both times."""
        return (
            f"import plant {self.import_s:.2f} s, first cycle {self.first_cycle_s:.2f} s "
            f"(median of {self.processes} processes)"
        )


def measure_startup(processes: int) -> Startup:
    """Time start-up in `processes` fresh processes, after one that fills the cache."""
    times = [_one_process() for _ in range(processes + 1)][1:]
    return Startup(
        statistics.median(t[0] for t in times), statistics.median(t[1] for t in times), processes
    )


def _one_process() -> tuple[float, float]:
    root = Path(plant.__file__).parents[1]  # importable there, installed or not
    done = subprocess.run(
        [sys.executable, "-c", _CODE], capture_output=True, text=True, check=True, cwd=root
    )
    imported, first = map(float, done.stdout.split())
    return imported, first
