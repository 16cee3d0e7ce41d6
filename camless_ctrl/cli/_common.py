"""What the commands share: options, exit status, tables and progress on the terminal."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

if TYPE_CHECKING:
    from rich.console import Console

    from ..requirements import RequirementResult

MET, NOT_MET, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
PIPE_WIDTH = 140  # columns of tables where the output is no terminal

JsonFile = Annotated[
    Path | None, Parameter(name="--json", help="Write the result to this file as JSON.")
]
Quiet = Annotated[
    bool, Parameter(name=["--quiet", "-q"], negative="", help="Print errors and nothing else.")
]
Seed = Annotated[int, Parameter(name="--seed", help="Seed of all random work.")]


def at_least_one(name: str, values: Sequence[float]) -> None:
    """Refuse an option that takes a list and was given none.

    Raises
    ------
    ParameterError
        If there are no values.
    """
    from plant import ParameterError

    if not values:
        raise ParameterError(f"{name} has no value, but takes one or more: give them after it")


def out(quiet: bool) -> Console:
    """Return the console of results, on standard output.

    In a file or a pipe, where nothing tells a width, tables are as wide as their words need.
    """
    from rich.console import Console

    console = Console(quiet=quiet, highlight=False, soft_wrap=True)
    if not console.is_terminal:
        console.width = max(console.width, PIPE_WIDTH)
    return console


def messages() -> Console:
    """Return the console of errors and progress, on standard error."""
    from rich.console import Console

    return Console(stderr=True, highlight=False, soft_wrap=True)


def say_error(message: str) -> None:
    """Print an error as one line on standard error."""
    from rich.text import Text

    line = " ".join(message.split())
    messages().print(Text.assemble(("error: ", "bold red"), line))


class Bar:
    """A progress bar on standard error; silent unless that is a terminal."""

    def __init__(self, progress: Any, task: Any) -> None:
        self._progress, self._task = progress, task

    def __call__(self, label: str, done: int, total: int) -> None:
        """Show what is being done, and how much of how much is."""
        self._progress.update(
            self._task, description=label or "finished", completed=done, total=total
        )


@contextmanager
def bar(label: str, quiet: bool) -> Iterator[Bar]:
    """Show progress while the block runs."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
    from rich.progress import TimeElapsedColumn as Elapsed

    console = messages()
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), Elapsed())
    hidden = quiet or not console.is_terminal
    with Progress(*columns, console=console, transient=True, disable=hidden) as progress:
        yield Bar(progress, progress.add_task(label, total=None))


def print_table(
    console: Console,
    title: str,
    columns: Sequence[str],
    rows: Sequence[Sequence[str]],
    *,
    words: Collection[str] = (),
) -> None:
    """Print a table; its first column and those of `words` align to the left, others right."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(title=Text(title), title_justify="left", box=box.SIMPLE_HEAD)
    for k, name in enumerate(columns):
        left = k == 0 or name in words
        table.add_column(Text(name), justify="left" if left else "right", no_wrap=k == 0)
    for row in rows:
        table.add_row(*(Text(cell) for cell in row))  # Text: no markup in what users give
    console.print(table)


def print_requirements(console: Console, found: Sequence[RequirementResult]) -> None:
    """Print requirements with bound, value and verdict."""
    print_table(
        console,
        "Requirements",
        ["requirement", "bound", "value", "verdict", "where"],
        [
            [
                row.requirement.name,
                f"{row.requirement.sense} {row.requirement.bound:g} {_unit(row)}".rstrip(),
                f"{row.value:.4g} {_unit(row)}".rstrip(),
                "met" if row.met else "NOT MET",
                row.note,
            ]
            for row in found
        ],
    )


def status(found: Sequence[RequirementResult]) -> int:
    """Return the exit status of a verdict."""
    return MET if all(row.met for row in found) else NOT_MET


def _unit(row: RequirementResult) -> str:
    return "" if row.requirement.unit == "1" else row.requirement.unit
