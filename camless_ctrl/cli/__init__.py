"""The command line: `camless validate | map | analyse | simulate | report | bench`.

Exit status: 0 when every stated requirement is met, 1 when one is not, 2 on bad input, 130
when interrupted.
"""

from ._app import main

__all__ = ["main"]
