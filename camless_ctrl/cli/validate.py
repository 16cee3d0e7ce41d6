"""`camless validate`: the plant against every published figure and claim."""

from __future__ import annotations

from ._common import MET, NOT_MET, JsonFile, Quiet, bar, out


def validate(*, json: JsonFile = None, quiet: Quiet = False) -> int:
    """Compute every published figure and claim, and say which are reproduced.

    The exit status is 1 when a figure that can be met is more than 2 % off, their rms is more
    than 0.7 %, or a claim is lost.

    Example: camless validate --json validation.json
    """
    from plant.validation import validate as run

    from ..output import reserved_file

    with reserved_file(json) as file:
        with bar("validation", quiet) as progress:
            report = run(progress=lambda done, total: progress("validation", done, total))
        if file is not None:
            file.write(report.to_json())
    out(quiet).print(str(report), markup=False)
    return MET if report.holds else NOT_MET
