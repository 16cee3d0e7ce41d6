"""One figure style for all packages: readable at report size, colour-blind-safe.

The colours are those of Okabe and Ito (2008). Matplotlib is imported when something is
drawn, so that a computation does not pay for it.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")

STYLE: dict[str, Any] = {
    "figure.dpi": 110,
    "figure.constrained_layout.use": True,
    "savefig.bbox": "tight",
    "font.size": 10.0,
    "axes.grid": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 10.5,
    "axes.titlelocation": "left",
    "grid.color": "#d9d9d9",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.7,
    "legend.frameon": False,
    "legend.fontsize": 9.0,
    "svg.fonttype": "path",
    "svg.hashsalt": "camless-ctrl",
}


def styled() -> AbstractContextManager[None]:
    """Return a context in which Matplotlib draws in the package's style."""
    import matplotlib.pyplot as plt
    from cycler import cycler

    # Load the backend first: a notebook's switches interactive drawing on when it is loaded,
    # and inside the context that would be undone.
    load: Callable[[], None] = plt.draw_if_interactive  # untyped in the library
    load()
    style: dict[Any, Any] = {**STYLE, "axes.prop_cycle": cycler(color=COLOURS)}
    return plt.rc_context(style)


def axes(ax: Axes | None, size_inches: tuple[float, float] = (6.4, 3.6)) -> Axes:
    """Return `ax`, or the axes of a new figure."""
    if ax is not None:
        return ax
    import matplotlib.pyplot as plt

    _, new = plt.subplots(figsize=size_inches)
    return new
