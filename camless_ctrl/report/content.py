"""What a chapter of the report is made of: texts with numbers, tables, figures, requirements.

A number is given once, with its unit, and appears in the page and in ``report.json``.
Everything here is plain text; escaping is the template's work.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from camless_ctrl.requirements import RequirementResult

_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def printed(value: float, spec: str) -> str:
    """Return a number as books print it: a true minus sign, powers of ten raised."""
    if math.isinf(value):
        return "∞" if value > 0.0 else "\N{MINUS SIGN}∞"
    text = f"{value:{spec}}"
    mantissa, _, exponent = text.partition("e")
    if exponent:
        text = f"{mantissa}·10{str(int(exponent)).translate(_SUPERSCRIPT)}"
    return text.replace("-", "\N{MINUS SIGN}")


@dataclass(frozen=True, slots=True)
class Number:
    """A value with its unit; ``"{:.1f}"`` prints both, a unit of "1" is not printed."""

    value: float
    unit: str = "1"

    def __format__(self, spec: str) -> str:
        """Return the value in the format `spec`, and the unit."""
        text = printed(self.value, spec)
        if self.unit in ("1", ""):
            return text
        return f"{text}{'' if self.unit == '°' else chr(0xA0)}{self.unit}"

    def __str__(self) -> str:
        """Return the value to four digits, and the unit."""
        return format(self, ".4g")


class Text:
    """A paragraph whose ``{name:.1f}`` places are filled by `Number` values or plain strings.

    Parameters
    ----------
    template : str
        The sentences.
    **values : Number or str
        What the places stand for.
    """

    kind = "text"

    def __init__(self, template: str, **values: Number | str) -> None:
        self.template = template
        self.values = values

    @property
    def numbers(self) -> dict[str, Number]:
        """The numbers of the text by name."""
        return {k: v for k, v in self.values.items() if isinstance(v, Number)}

    def __str__(self) -> str:
        """Return the text with its places filled."""
        return self.template.format(**self.values)


@dataclass(frozen=True, slots=True)
class Heading:
    """A heading inside a chapter."""

    text: str
    kind = "heading"


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a table.

    Attributes
    ----------
    name : str
        Heading.
    unit : str
        Unit of the values; "" for words.
    spec : str
        Format of numbers.
    words : tuple of str
        What true and false are called.
    """

    name: str
    unit: str = ""
    spec: str = ".4g"
    words: tuple[str, str] = ("pass", "fail")


@dataclass(frozen=True, slots=True)
class Link:
    """A cell that leads to a chapter."""

    text: str
    chapter: str


Cell = float | int | str | bool | None | Link


@dataclass(frozen=True)
class Table:
    """A table; cells are raw values, formatted by their column.

    Attributes
    ----------
    id : str
        Name in the JSON file and anchor, unique in the chapter.
    caption : Text
        What the table shows.
    columns : sequence of Column
        One per cell of a row.
    rows : sequence of sequence of Cell
        True and false are shown as the column's words, None as a dash.
    """

    id: str
    caption: Text
    columns: Sequence[Column]
    rows: Sequence[Sequence[Cell]]
    kind = "table"

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(
                    f"a row of table {self.id!r} has {len(row)} cells, but the table has "
                    f"{len(self.columns)} columns: {row!r}"
                )

    def shown(self, column: Column, cell: Cell) -> str:
        """Return a cell as the page shows it."""
        if cell is None:
            return "–"
        if isinstance(cell, bool):
            return column.words[0] if cell else column.words[1]
        if isinstance(cell, Link):
            return cell.text
        if isinstance(cell, str):
            return cell
        return printed(cell, column.spec)

    def is_value(self, index: int) -> bool:
        """Whether a column holds numbers, for its alignment."""
        cells = [row[index] for row in self.rows if row[index] is not None]
        return bool(cells) and all(
            isinstance(cell, int | float) and not isinstance(cell, bool) for cell in cells
        )

    @staticmethod
    def is_link(cell: Cell) -> bool:
        """Whether a cell leads to a chapter."""
        return isinstance(cell, Link)

    def to_dict(self) -> dict[str, Any]:
        """Return columns with units and raw rows for the JSON file."""
        return {
            "id": self.id,
            "caption": str(self.caption),
            "columns": [{"name": c.name, "unit": c.unit} for c in self.columns],
            "rows": [[c.text if isinstance(c, Link) else c for c in row] for row in self.rows],
        }


@dataclass(frozen=True)
class Figure:
    """A drawn figure.

    Attributes
    ----------
    id : str
        Anchor, unique in the chapter.
    caption : Text
        States the finding.
    alt : str
        What is drawn, for those who do not see it.
    svg : str
        From `camless_ctrl.report.figures.svg`.
    """

    id: str
    caption: Text
    alt: str
    svg: str = field(repr=False)
    kind = "figure"


Block = Text | Heading | Table | Figure


@dataclass(frozen=True)
class ChapterResult:
    """What a chapter found.

    Raises ValueError where one name stands for two values.

    Attributes
    ----------
    finding : Text
        The finding in one sentence, for the summary.
    blocks : sequence of Block
        The body.
    numbers : mapping of str to Number
        Further numbers for the JSON file.
    requirements : sequence of RequirementResult
        Requirements that the chapter has assessed.
    """

    finding: Text
    blocks: Sequence[Block]
    numbers: Mapping[str, Number] = field(default_factory=dict)
    requirements: Sequence[RequirementResult] = ()

    def __post_init__(self) -> None:
        _ = self.all_numbers  # fails here, in the chapter at fault

    @cached_property
    def all_numbers(self) -> dict[str, Number]:
        """Numbers of texts, captions and finding, with `numbers`.

        Raises
        ------
        ValueError
            If one name stands for two values.
        """
        found: dict[str, Number] = dict(self.numbers)
        for text in self._texts():
            for name, number in text.numbers.items():
                if found.setdefault(name, number) != number:
                    raise ValueError(
                        f"number {name!r} is {found[name]} in one place of the chapter and "
                        f"{number} in another: give them different names"
                    )
        return found

    def _texts(self) -> Iterator[Text]:
        yield self.finding
        for block in self.blocks:
            if isinstance(block, Text):
                yield block
            elif isinstance(block, Table | Figure):
                yield block.caption
