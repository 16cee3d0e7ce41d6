"""Units of the columns of table files, and how they are converted to that of a quantity."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple


class Conversion(NamedTuple):
    """What makes a value of one unit one of another: ``factor * value + offset``."""

    factor: float = 1.0
    offset: float = 0.0


_SAME = Conversion()
_CELSIUS = Conversion(1.0, 273.15)

# By the unit that is wanted: what a file may say, as it is written. What may mean two things
# (mPa for MPa, C) is left out.
UNITS: Mapping[str, Mapping[str, Conversion]] = MappingProxyType(
    {
        "mg": {"mg": _SAME, "g": Conversion(1e3), "kg": Conversion(1e6)},
        "rpm": dict.fromkeys(
            ("rpm", "1/min", "min-1", "min^-1", "/min", "r/min", "rev/min", "RPM"), _SAME
        ),
        "deg": dict.fromkeys(("deg", "°", "degree", "degrees"), _SAME),
        "Pa": {
            "Pa": _SAME,
            "hPa": Conversion(100.0),
            "mbar": Conversion(100.0),
            "kPa": Conversion(1e3),
            "bar": Conversion(1e5),
        },
        "K": {"K": _SAME, "degC": _CELSIUS, "°C": _CELSIUS, "deg C": _CELSIUS},
        "1": {"1": _SAME, "-": _SAME, "%": Conversion(0.01)},
        "s": dict.fromkeys(("s", "sec", "second", "seconds"), _SAME),
        "cycles": dict.fromkeys(("cycles", "cycle", "1", "-"), _SAME),
    }
)


def conversion(told: str, wanted: str) -> Conversion | None:
    """Return how a unit that a file tells becomes the one that is wanted.

    Parameters
    ----------
    told : str
        What the file says, brackets aside; nothing is the wanted unit.
    wanted : str
        A key of `UNITS`.

    Returns
    -------
    Conversion or None
        None if the unit does not fit.
    """
    return UNITS[wanted].get(told) if told else _SAME
