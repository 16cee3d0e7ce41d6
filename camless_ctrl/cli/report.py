"""`camless report`: write the robustness report."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from ._common import MET, NOT_MET, JsonFile, Quiet, Seed, bar, out


def report(
    *,
    folder: Annotated[
        Path, Parameter(name="--out", help="Folder of index.html and report.json; made if need be.")
    ] = Path("report"),
    json: JsonFile = None,
    seed: Seed = 0,
    quiet: Quiet = False,
) -> int:
    """Write the robustness report: one self-contained page and one JSON file.

    The page needs no network. The exit status is 1 when a requirement is not met.

    Example: camless report --out report/
    """
    import matplotlib as mpl

    from plant._checks import whole

    from ..jsonable import to_json
    from ..output import reserved_file
    from ..report import Context, build_report

    whole("--seed", seed, 0, 2**63 - 1)
    mpl.use("agg")  # figures go to the page; no window is wanted
    command = shlex.join(["camless", *sys.argv[1:]])
    with reserved_file(json) as file, bar("report", quiet) as progress:
        result = build_report(
            folder, context=Context(seed=seed, command=command), progress=progress
        )
        if file is not None:
            file.write(to_json(result.document))
    out(quiet).print(str(result), markup=False)
    return MET if result.passed else NOT_MET
