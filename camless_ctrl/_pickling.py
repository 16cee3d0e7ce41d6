"""Copies of frozen dataclasses that hold scratch space: made anew from their fields."""

from __future__ import annotations

from dataclasses import fields
from typing import Any


def by_fields(instance: Any) -> tuple[Any, tuple[type, dict[str, Any]]]:
    """Return what ``__reduce__`` of a dataclass is to return.

    Scratch arrays that share memory would come apart in a copy, so it gets its own.
    """
    cls = type(instance)
    return _made, (cls, {f.name: getattr(instance, f.name) for f in fields(cls) if f.init})


def _made(cls: type, values: dict[str, Any]) -> Any:
    return cls(**values)
