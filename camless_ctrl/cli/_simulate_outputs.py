"""Files that a scenario's run writes: reserved before it, all of them there after it or none."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..scenario_result import ScenarioResult


@contextmanager
def reserved_outputs(
    wanted: Mapping[str, Path | None], inputs: Iterable[Path] = ()
) -> Iterator[dict[str, Path]]:
    """Reserve a place for each output before the work.

    Parameters
    ----------
    wanted : mapping of str to Path
        Files by the option that names them; None where an option is not given.
    inputs : iterable of Path
        Files that the work is read from.

    Yields
    ------
    dict of str to Path
        Where to write each meanwhile. When the block ends, all files move to their places; when
        it raises, none of them is left.

    Raises
    ------
    ParameterError
        If two options name the same file, one names an input, or a picture of an unknown kind
        is asked for.
    OutputError
        If a file cannot be made where it was asked for.
    """
    from plant import ParameterError

    from ..output import require_place, reserved_folder

    given = {option: path for option, path in wanted.items() if path is not None}
    read = {path.resolve() for path in inputs}
    taken: dict[Path, str] = {}
    for option, path in given.items():
        place = path.resolve()
        first = taken.setdefault(place, option)
        if first != option:
            raise ParameterError(
                f"{first} and {option} both name {path}: give them different files"
            )
        if any(_same(place, source) for source in read):
            raise ParameterError(
                f"{option} names {path}, which the scenario is read from and would be lost: name "
                "another file"
            )
        require_place(path)
    if "--plot" in given:
        _require_picture(given["--plot"])
    with ExitStack() as stack:
        folders = sorted({path.absolute().parent for path in given.values()})
        staged = {folder: stack.enter_context(reserved_folder(folder)) for folder in folders}
        yield {option: staged[path.absolute().parent] / path.name for option, path in given.items()}


def _same(place: Path, source: Path) -> bool:
    """Whether two paths are one file, by whatever names."""
    return place == source or (place.exists() and source.exists() and place.samefile(source))


def write_outputs(result: ScenarioResult, places: Mapping[str, Path]) -> None:
    """Write a result to the places that `reserved_outputs` gave.

    Raises
    ------
    OutputError
        If one cannot be written.
    """
    from ..output import OutputError

    for option, place in places.items():
        try:
            if option == "--plot":
                _draw(result, place)
            elif option == "--json":
                result.to_json(place)
            elif option == "--csv":
                result.to_csv(place)
            else:
                result.to_netcdf(place)
        except OSError as error:
            raise OutputError(
                f"{option} {place.name} cannot be written ({error.strerror or error}): name "
                "another folder, or make room"
            ) from error


def _draw(result: ScenarioResult, place: Path) -> None:
    import matplotlib.pyplot as plt

    figure = result.plot()
    figure.savefig(place)
    plt.close(figure)


def _require_picture(path: Path) -> None:
    """Refuse a kind of picture that cannot be drawn."""
    from matplotlib.backend_bases import FigureCanvasBase

    from plant import ParameterError

    kinds = FigureCanvasBase.get_supported_filetypes()
    if path.suffix.removeprefix(".").lower() not in kinds:
        raise ParameterError(
            f"--plot is {path}, but its name must end with one of "
            f"{', '.join(f'.{kind}' for kind in sorted(kinds))}"
        )
