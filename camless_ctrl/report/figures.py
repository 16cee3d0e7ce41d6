"""Matplotlib figures as SVG that can stand inside an HTML page."""

from __future__ import annotations

import io
import re
from typing import TYPE_CHECKING

from plant._plotting import styled

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_REFERENCE = re.compile(r'(\bid="|xlink:href="#|\bhref="#|url\(#)')
_COORDINATES = re.compile(r' (?:d|x|y)="[^"]*"')
_LONG = re.compile(r"-?\d+\.\d{3,}")
_PADDING = re.compile(r"[ \t]*<!--.*?-->\n?|^[ \t]+|[ \t]+$", re.DOTALL | re.MULTILINE)
_METADATA = re.compile(r"<metadata>.*?</metadata>", re.DOTALL)


def svg(drawn: Figure | Axes, prefix: str) -> str:
    """Return a figure as an ``<svg>`` element, and close it.

    Parameters
    ----------
    drawn : matplotlib.figure.Figure or matplotlib.axes.Axes
        The figure, or axes of it.
    prefix : str
        Put before every id in it, so that many figures can stand in one page.
    """
    import matplotlib.pyplot as plt

    figure = drawn.get_figure(root=True)
    assert figure is not None  # axes of a removed figure
    with styled(), io.StringIO() as buffer:
        # Without dates and versions the same numbers give the same file.
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
        text = buffer.getvalue()
    plt.close(figure)
    text = _METADATA.sub("", text[text.index("<svg") :])
    # The page's own style sizes the figure, keeps its shape, and hides it from screen
    # readers, which are given the alternative text.
    head, rest = text.split(">", 1)
    width = re.search(r'width="([\d.]+)pt"', head)
    head = re.sub(r' (width|height)="[\d.]+pt"', "", head)
    size = f' style="width:{float(width[1]) * 4 / 3:.0f}px"' if width else ""
    # What only people who read the file see is a tenth of it.
    rest = _PADDING.sub("", rest)
    # A hundredth of a point is far below what can be seen, and half of the page.
    rest = _COORDINATES.sub(lambda found: _LONG.sub(_shorter, found[0]), rest)
    return _REFERENCE.sub(rf"\g<1>{prefix}-", f'{head}{size} aria-hidden="true">{rest}').strip()


def _shorter(number: re.Match[str]) -> str:
    """Round a coordinate to a hundredth of a point."""
    return f"{float(number[0]):.2f}".rstrip("0").rstrip(".")


def side_by_side(count: int, height: float = 3.9) -> tuple[Figure, list[Axes]]:
    """Return a figure with `count` axes in a row, in the package's style."""
    import matplotlib.pyplot as plt

    with styled():
        figure, row = plt.subplots(1, count, figsize=(5.2 * count, height), squeeze=False)
    return figure, list(row[0])


def one_legend(figure: Figure, columns: int = 4) -> None:
    """Replace the legends of a figure's axes by one under them all."""
    found: dict[str, Artist] = {}
    for ax in figure.axes:
        legend = ax.get_legend()
        if legend is None:
            continue
        for handle, text in zip(legend.legend_handles, legend.get_texts(), strict=True):
            if handle is not None:
                found.setdefault(text.get_text(), handle)
        legend.remove()
    with styled():
        figure.legend(
            list(found.values()),
            list(found),
            loc="outside lower center",
            ncols=min(columns, len(found)),
        )
