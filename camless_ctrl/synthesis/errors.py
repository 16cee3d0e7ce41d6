"""Error of a synthesis that found no controller."""

from __future__ import annotations


class SynthesisError(RuntimeError):
    """No controller was found, or what a solver returned did not stand its verification.

    The message says what was tried, what came out and the likely reason.
    """
