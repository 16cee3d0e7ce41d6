"""Work on many items, shared among processes that can be stopped."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from plant._checks import whole

from .synthesis.stoppable import run_stoppable

_LONGEST_S = 3600.0  # s, after which another process is taken to hang

Progress = Callable[[int, int], None]
Item = TypeVar("Item")
Found = TypeVar("Found")


def in_processes(
    function: Callable[[Item], Found],
    items: Sequence[Item],
    processes: int,
    progress: Progress | None = None,
) -> list[Found]:
    """Return the function of each item, computed here and in further processes.

    Parameters
    ----------
    function : callable
        Function of an importable module; items and results must be picklable.
    items : sequence
        The items.
    processes : int
        Number of processes, this one among them.
    progress : callable, optional
        Called with the number of items known to be done and the number in all.
    """
    whole("processes", processes, 1, 256)
    processes = min(processes, max(len(items), 1))
    total, done = len(items), 0
    found: dict[int, Found] = {}
    shares = [list(range(k, total, processes)) for k in range(processes)]

    def report(count: int) -> None:
        nonlocal done
        done += count
        if progress is not None:
            progress(done, total)

    with ThreadPoolExecutor(max(processes - 1, 1)) as pool:
        others = [
            pool.submit(run_stoppable, _each, (function, [items[i] for i in share]), _LONGEST_S)
            for share in shares[1:]
        ]
        for i in shares[0]:
            found[i] = function(items[i])
            report(1)
        for share, other in zip(shares[1:], others, strict=True):
            found.update(zip(share, other.result(), strict=True))
            report(len(share))
    return [found[i] for i in range(total)]


def _each(function: Callable[[Item], Found], items: list[Item]) -> list[Found]:
    return [function(item) for item in items]
