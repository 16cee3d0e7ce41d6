"""Chapter: what is needed to make the report again."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version

from ..chapter import Context
from ..content import ChapterResult, Column, Number, Table, Text

PACKAGES = (
    "camless-ctrl",
    "numpy",
    "scipy",
    "numba",
    "control",
    "slycot",
    "casadi",
    "filterpy",
    "matplotlib",
    "xarray",
)


class ReproducibilityChapter:
    """Versions, seeds, fingerprint of the plant, command, and run time per chapter."""

    id = "reproducibility"
    title = "Reproducibility"
    concludes = True

    def compute(self, context: Context) -> ChapterResult:
        """Gather versions and times."""
        total = sum(chapter.seconds for chapter in context.finished)
        versions = Table(
            "versions",
            Text("Versions that this report was computed with."),
            [Column("package"), Column("version")],
            [
                ["Python", platform.python_version()],
                *([name, _version(name)] for name in PACKAGES),
            ],
        )
        times = Table(
            "times",
            Text("Run time of the chapters, in the order of computation."),
            [Column("chapter"), Column("time", "s", ".1f")],
            [[chapter.title, chapter.seconds] for chapter in context.finished],
        )
        return ChapterResult(
            finding=Text(
                "The report took {total:.0f} to compute, with seed {seed:.0f}.",
                total=Number(total, "s"),
                seed=Number(context.seed),
            ),
            blocks=[
                Text(
                    "The same versions, engine and seed give the same numbers. Command: "
                    "{command}. Plant: {fingerprint}. All random work starts from the seed "
                    "{seed:.0f}. Computed on {machine} with {cores:.0f} processors in "
                    "{total:.0f}.",
                    command=context.command or "build_report(...) from Python",
                    fingerprint=context.plant.fingerprint,
                    seed=Number(context.seed),
                    machine=f"{platform.system()} {platform.machine()}",
                    cores=Number(os.cpu_count() or 1),
                    total=Number(total, "s"),
                ),
                times,
                versions,
            ],
        )


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed (run from its source folder)"
