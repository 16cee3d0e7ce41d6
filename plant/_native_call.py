"""How Python calls machine code: the two sides of the call, written from one description.

All numbers go as one vector of float64: fields of tuples, sizes of arrays, integers (below
2^53). Then come a pointer to each array and one to the fields of the result. Both sides are
written out as source, since loops over the arguments would take as long as the kernel.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, get_type_hints


@dataclass(frozen=True)
class Array:
    """Kind of a parameter: a C-contiguous array, handed over without a copy."""

    dimensions: int
    dtype: str = "float64"


VECTOR, MATRIX, INDICES = Array(1), Array(2), Array(1, "int64")

_FORM = {int: "int(numbers[{}])", float: "numbers[{}]", bool: "numbers[{}] != 0.0"}


@dataclass(frozen=True)
class Signature:
    """Kinds of the parameters and of the result of a function."""

    parameters: tuple[Any, ...]
    returns: Any

    @property
    def arrays(self) -> list[Array]:
        """Kinds of the arrays."""
        return [kind for kind in self.parameters if isinstance(kind, Array)]

    @property
    def numbers(self) -> int:
        """Count of the numbers that the arguments send."""
        return sum(_numbers(kind) for kind in self.parameters)

    @property
    def results(self) -> int:
        """Count of the fields of a result that is a tuple."""
        return len(getattr(self.returns, "_fields", ()))


def _numbers(kind: Any) -> int:
    if isinstance(kind, Array):
        return kind.dimensions
    return 1 if kind in (int, float) else len(kind._fields)


def receiver(signature: Signature) -> str:
    """Source of ``receive``, the C function, which calls ``function``."""
    pointers, given, at = [], [], 0
    for i, kind in enumerate(signature.parameters):
        places = range(at, at + _numbers(kind))
        at = places.stop
        if isinstance(kind, Array):
            sizes = ", ".join(_FORM[int].format(k) for k in places)
            pointers.append(f"array_{i}, ")
            given.append(f"carray(array_{i}, ({sizes},))")
        elif kind in _FORM:
            given.append(_FORM[kind].format(*places))
        else:
            types = get_type_hints(kind).values()
            fields = [_FORM[t].format(k) for t, k in zip(types, places, strict=True)]
            given.append(f"type_{i}({', '.join(fields)})")
    lines = [
        f"def receive(numbers, {''.join(pointers)}result):",
        f"    value = function({', '.join(given)})",
        *(f"    result[{k}] = value[{k}]" for k in range(signature.results)),
        f"    return {'value' if signature.returns is int else 0}",
    ]
    return "\n".join(lines)


def sender(signature: Signature) -> str:
    """Source of ``send``, the Python function, which calls the C function as ``function``."""
    names = [f"a{i}" for i in range(len(signature.parameters))]
    numbers, pointers, lines = [], [], [f"def send({', '.join(names)}):"]
    for name, kind in zip(names, signature.parameters, strict=True):
        if isinstance(kind, Array):
            lines.append(f"    if {name}.dtype != {kind.dtype}:")
            lines.append(f"        raise TypeError(f'need {kind.dtype}, not {{{name}!r}}')")
            numbers.append(f"*{name}.shape")  # `pack` wants the right count of sizes
            pointers.append(f"pointer({name}), ")
        else:
            numbers.append(name if kind in (int, float) else f"*{name}")
    call = f"function(pack({', '.join(numbers)}), {''.join(pointers)}"
    if signature.results:
        types = get_type_hints(signature.returns).values()
        fields = [f"{t.__name__}(r{k})" for k, t in enumerate(types)]
        every = "".join(f"r{k}, " for k in range(signature.results))
        lines += ["    result = space()", f"    {call}result)", f"    {every}= result"]
        lines.append(f"    return returns({', '.join(fields)})")
    else:
        lines.append(f"    {'return ' if signature.returns is int else ''}{call}None)")
    return "\n".join(lines)
