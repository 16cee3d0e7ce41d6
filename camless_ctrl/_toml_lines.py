"""Lines of the keys of a TOML text, for error messages."""

from __future__ import annotations

import re

from ._scenario_tables import Place

_BARE = r"""(?:[A-Za-z0-9_-]+|"(?:[^"\\]|\\.)*"|'[^']*')"""
_DOTTED = rf"{_BARE}(?:\s*\.\s*{_BARE})*"
_HEADER = re.compile(rf"\s*(\[\[?)\s*({_DOTTED})\s*\]\]?")
_KEY = re.compile(rf"\s*({_DOTTED})\s*=")
_STEP = re.compile(_BARE)
_QUOTES = ('"' * 3, "'" * 3, '"', "'")


def key_line(text: str, place: Place) -> int:
    """Line, from 1, of a key or table; of the nearest one around it that the text shows.

    Parameters
    ----------
    text : str
        A TOML text without errors.
    place : tuple of str and int
        Way to the key: names, and numbers of the items of a list of tables from 0.
    """
    lines = key_lines(text)
    for size in range(len(place), 0, -1):
        if place[:size] in lines:
            return lines[place[:size]]
    return 1


def key_lines(text: str) -> dict[Place, int]:
    """Line of each key and each table header; keys within a value are not told apart."""
    found: dict[Place, int] = {}
    counts: dict[Place, int] = {}
    table: Place = ()
    at, line = 0, 1
    while at < len(text):
        end = text.find("\n", at)
        end = len(text) if end < 0 else end
        header = _HEADER.match(text, at, end)
        key = None if header else _KEY.match(text, at, end)
        start = at
        if header:
            table = _within(_steps(header[2]), counts)
            if header[1] == "[[":
                # A list's table: `_within` gave the last one of that name, or the name alone.
                name = table[:-1] if table and isinstance(table[-1], int) else table
                counts[name] = counts.get(name, -1) + 1
                table = (*name, counts[name])
                counts = {k: v for k, v in counts.items() if k[: len(table)] != table}
            for size in range(1, len(table) + 1):
                found.setdefault(table[:size], line)
        elif key:
            place = table
            for step in _steps(key[1]):
                place = (*place, step)
                found.setdefault(place, line)
            end = _value_end(text, key.end())
        line += text.count("\n", start, end) + 1
        at = end + 1
    return found


def _steps(dotted: str) -> tuple[str, ...]:
    return tuple(step.strip("\"'") for step in _STEP.findall(dotted))


def _within(steps: tuple[str, ...], counts: dict[Place, int]) -> Place:
    """Place of a header, whose names of lists mean the last table of each."""
    place: Place = ()
    for step in steps:
        place = (*place, step)
        if place in counts:
            place = (*place, counts[place])
    return place


def _value_end(text: str, at: int) -> int:
    """Position of the end of the line on which a value ends."""
    depth = 0
    while at < len(text):
        char = text[at]
        quote = next((q for q in _QUOTES if text.startswith(q, at)), None)
        if quote is not None:
            at = _string_end(text, at, quote)
            continue
        if char == "#":
            end = text.find("\n", at)
            at = len(text) if end < 0 else end
            continue
        if char == "\n" and depth == 0:
            return at
        depth += (char in "[{") - (char in "]}")
        at += 1
    return at


def _string_end(text: str, at: int, quote: str) -> int:
    """Position after a string that begins at a quote."""
    at += len(quote)
    while at < len(text) and not text.startswith(quote, at):
        at += 2 if text[at] == "\\" and quote[0] == '"' else 1
    return at + len(quote)
