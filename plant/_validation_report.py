"""The result of a validation: rows of figures and claims, as text, picture and JSON."""

from __future__ import annotations

import json
import math
import textwrap
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

from ._validation_rows import FIGURE_BAR, ClaimResult, EqualCharge, FigureResult
from .parameters import PRINTED_TEMPERATURE, Engine
from .published import PAPER_TITLE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

RMS_BAR = 0.007  # 1, largest rms of the relative errors of the figures that can be met


@dataclass(frozen=True)
class ValidationReport:
    """Every published figure and claim of Part I against simulation; made by `validate`.

    Attributes
    ----------
    engine : Engine
        The engine.
    options : dict
        Options of the plant: runner, orifice, resolution.
    figures : tuple of FigureResult
        The published figures.
    claims : tuple of ClaimResult
        The published claims.
    equal_charge : EqualCharge or None
        The throttled engine at the printed charge; None if no throttle angle gives it.
    printed_temperature : tuple of FigureResult
        The figures that can be met, computed with the printed 316 K.
    """

    engine: Engine = field(repr=False)
    options: dict[str, Any]
    figures: tuple[FigureResult, ...]
    claims: tuple[ClaimResult, ...]
    equal_charge: EqualCharge | None
    printed_temperature: tuple[FigureResult, ...] = field(repr=False)

    @property
    def rms(self) -> float:
        """Root mean square of the relative errors of the figures that can be met."""
        return _rms(row for row in self.figures if not row.known_exception)

    @property
    def known_exceptions(self) -> dict[str, str]:
        """Rows that the paper engine cannot reproduce, by id, each with the reason."""
        rows: tuple[FigureResult | ClaimResult, ...] = self.figures + self.claims
        return {row.id: row.known_exception for row in rows if row.known_exception}

    @property
    def failures(self) -> tuple[str, ...]:
        """Requirements that are not met, in words; empty if the validation holds."""
        found = [
            f"{row.id} {row.quantity} is {100 * row.relative_error:+.2f} % off, but must be "
            f"within {100 * FIGURE_BAR:g} %"
            for row in self.figures
            if not row.reproduced and not row.known_exception
        ]
        if not self.rms <= RMS_BAR:
            found.append(
                f"the rms of the relative errors is {100 * self.rms:.2f} %, but must be at most "
                f"{100 * RMS_BAR:g} %"
            )
        found.extend(
            f"claim {claim.id} is not reproduced: {claim.why}"
            for claim in self.claims
            if not claim.reproduced and not claim.known_exception
        )
        return tuple(found)

    @property
    def holds(self) -> bool:
        """Whether all requirements are met.

        Each figure within 2 %, their rms at most 0.7 %, and each claim reproduced, but for
        the `known_exceptions`.
        """
        return not self.failures

    def as_dict(self) -> dict[str, Any]:
        """Return the report as JSON types; `published` and `claims` hold the rows."""
        equal = self.equal_charge
        return {
            "source": PAPER_TITLE,
            "holds": self.holds,
            "failures": list(self.failures),
            "rms": self.rms,
            "bars": {"relative_error": FIGURE_BAR, "rms": RMS_BAR},
            "published": [row.as_dict() for row in self.figures],
            "claims": [claim.as_dict() for claim in self.claims],
            "known_exceptions": self.known_exceptions,
            "equal_charge": None if equal is None else asdict(equal),
            "printed_temperature": [row.as_dict() for row in self.printed_temperature],
            "engine": asdict(self.engine),
            "options": dict(self.options),
        }

    def to_json(self) -> str:
        """Return the report as JSON text."""
        return json.dumps(self.as_dict(), indent=2, ensure_ascii=False, allow_nan=False) + "\n"

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the relative errors of the figures with the 2 % band and return the axes.

        Figures that cannot be met lie far outside: they are drawn at the edge, with their
        value.
        """
        from ._plotting import COLOURS, axes, styled

        span = 12.0  # percent, wide enough for the printed temperature's errors
        rows = list(self.figures)
        at_printed = {(row.id, row.quantity): row for row in self.printed_temperature}
        with styled():
            ax = axes(ax, (7.4, 0.36 * len(rows) + 1.4))
            bar = 100.0 * FIGURE_BAR
            ax.axvspan(-bar, bar, color="#e4e4e4", lw=0.0, label=f"±{bar:g} %")
            ax.axvline(0.0, color="0.3", lw=0.8)
            labelled: set[str] = set()
            for k, row in enumerate(rows):
                other = at_printed.get((row.id, row.quantity))
                if other is not None:
                    _mark(ax, 100.0 * other.relative_error, k, span, "s", COLOURS[1],
                          f"printed {PRINTED_TEMPERATURE:g} K", labelled, filled=False)  # fmt: skip
                label = f"{self.engine.temperature:g} K"
                _mark(ax, 100.0 * row.relative_error, k, span, "o", COLOURS[0], label, labelled)
            ax.set_yticks(range(len(rows)))
            ax.set_yticklabels(
                [
                    f"{row.id}, {'charge' if row.quantity == 'air_charge' else 'loss'}: "
                    f"{row.computed:.4g} / {row.published:.4g} {row.unit}"
                    for row in rows
                ]
            )
            ax.invert_yaxis()
            ax.set_xlim(-span, span)
            ax.set_xlabel("computed against published (%)")
            ax.set_title(f"computed / published figures, rms {100 * self.rms:.2f} %")
            ax.grid(axis="y", visible=False)
            ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        return ax

    def __str__(self) -> str:
        """Return the tables of figures and claims."""
        lines = [
            f"Validation against {PAPER_TITLE!r}",
            "",
            f"{'figure':<16}{'quantity':<14}{'published':>11}{'computed':>11}{'error':>9}"
            f"{'engine':>9}  verdict",
        ]
        for k, row in enumerate(self.figures):
            engine = "" if row.measured is None else f"{row.measured:.4g}"
            lines.append(
                f"{row.id:<16}{row.quantity:<14}{f'{row.published:g} {row.unit}':>11}"
                f"{f'{row.computed:.4g} {row.unit}':>11}{100 * row.relative_error:>7.2f} %"
                f"{engine:>9}  {_verdict(row.reproduced)}"
            )
            if row.note not in {later.note for later in self.figures[k + 1 : k + 2]}:
                lines.extend(_wrapped(row.note))
        met = sum(not row.known_exception for row in self.figures)
        lines.append(f"rms of the {met} figures that can be met: {100 * self.rms:.2f} %")
        if self.printed_temperature:
            errors = [100 * row.relative_error for row in self.printed_temperature]
            lines.append(
                f"with the printed {PRINTED_TEMPERATURE:g} K: {min(errors):+.1f} to "
                f"{max(errors):+.1f} %, rms {100 * _rms(self.printed_temperature):.2f} %"
            )
        lines.append("")
        for claim in self.claims:
            lines.append(f"{claim.id:<22}{_verdict(claim.reproduced):<16}{claim.text}")
            because = "" if claim.reproduced else "because "
            lines.extend(_wrapped(because + claim.why))
        lines.append("")
        if self.holds:
            known = ", ".join(self.known_exceptions)
            lines.append(f"holds (known exceptions: {known})")
        else:
            lines.append("does not hold:")
            lines.extend(f"  - {failure}" for failure in self.failures)
        return "\n".join(lines)


def _verdict(reproduced: bool) -> str:
    return "reproduced" if reproduced else "NOT reproduced"


def _wrapped(text: str) -> list[str]:
    return textwrap.wrap(text, 92, initial_indent="    ", subsequent_indent="    ")


def _rms(rows: Iterable[FigureResult]) -> float:
    errors = [row.relative_error for row in rows]
    return math.sqrt(sum(error**2 for error in errors) / len(errors))


def _mark(
    ax: Axes,
    x: float,
    y: float,
    span: float,
    marker: str,
    colour: str,
    label: str,
    labelled: set[str],
    *,
    filled: bool = True,
) -> None:
    """Draw one error, at the edge with its value where it lies outside."""
    face = colour if filled else "none"
    first = label if label not in labelled else None
    labelled.add(label)
    if abs(x) <= span:
        ax.plot([x], [y], marker, mfc=face, mec=colour, ms=6.0, label=first)
        return
    edge = 0.97 * span if x > 0.0 else -0.97 * span
    ax.plot([edge], [y], ">" if x > 0.0 else "<", mfc=face, mec=colour, ms=7.0, label=first)
    ax.annotate(
        f"{x:+.0f} %",
        (edge, y),
        textcoords="offset points",
        xytext=(-8.0 if x > 0.0 else 8.0, 0.0),
        ha="right" if x > 0.0 else "left",
        va="center",
        fontsize=9.0,
    )
