"""The application: its commands, and how errors become an exit status."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version

from cyclopts import App, CycloptsError

from ._common import BAD_INPUT, INTERRUPTED, MET, say_error
from .analyse import analyse
from .bench import bench
from .map import map_
from .report import report
from .simulate import simulate
from .validate import validate


def _version() -> str:
    try:
        return version("camless-ctrl")
    except PackageNotFoundError:
        return "unknown (run from its source folder)"


app = App(
    name="camless",
    help="Design and check the air-charge control of a camless engine.",
    help_epilogue=(
        "Exit status: 0 requirements met, 1 a stated requirement not met, 2 bad input, "
        "130 interrupted."
    ),
    version=_version,
    suppress_keyboard_interrupt=False,
)
_COMMANDS = {
    "validate": validate,
    "map": map_,
    "analyse": analyse,
    "simulate": simulate,
    "report": report,
    "bench": bench,
}
for _place, (_name, _command) in enumerate(_COMMANDS.items()):
    app.command(_command, name=_name, sort_key=_place)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit status.

    Parameters
    ----------
    arguments : sequence of str, optional
        Those of the process by default.
    """
    tokens = list(sys.argv[1:] if arguments is None else arguments)
    try:
        status = app(
            tokens,
            exit_on_error=False,
            print_error=False,
            result_action="return_value",
        )
    except CycloptsError as error:
        say_error(f"{error} (camless --help tells the options)")
        return BAD_INPUT
    except KeyboardInterrupt:
        say_error("interrupted; nothing was written")
        return INTERRUPTED
    except (ValueError, OSError, RuntimeError) as error:
        return _expected(error)
    return MET if status is None else int(status)


def _expected(error: Exception) -> int:
    """Report an error that the package raises on purpose; anything else is a defect."""
    # Imported late: the plant takes a second to load, and help needs none of it.
    from plant.errors import ConvergenceError, ParameterError, SimulationError

    from ..output import OutputError

    if isinstance(error, ParameterError | ConvergenceError | SimulationError | OutputError):
        say_error(str(error))
        return BAD_INPUT
    raise error
