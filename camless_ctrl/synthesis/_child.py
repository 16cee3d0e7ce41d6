"""What a stoppable child process runs: one call, read from the input, answered on the output.

Nothing is imported here beyond the standard library: what the work needs is imported when it
is unpickled.
"""

from __future__ import annotations

import os
import pickle
import signal
import sys
import traceback
from typing import Any

from .errors import SynthesisError

# Answers: "value" with the result, or "error" with the name, the message and the traceback.
Answer = tuple[str, Any]


def main() -> None:
    """Read a pickled ``(function, args, lifetime_s)``, run it, write the pickled answer."""
    channel = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what the work prints must not mix with the answer
    request = sys.stdin.buffer.read()
    try:
        work, lifetime_s = pickle.loads(request)
        _live_at_most(lifetime_s)
        function, args = pickle.loads(work)
        answer: Answer = ("value", function(*args))
        reply = pickle.dumps(answer)
    except Exception as error:  # whatever it is, it goes back to the caller, who raises it
        # A SynthesisError speaks for itself; other errors are named.
        name = "" if isinstance(error, SynthesisError) else type(error).__name__
        reply = pickle.dumps(("error", (name, str(error), traceback.format_exc())))
    with channel:
        channel.write(reply)


def _live_at_most(seconds: int) -> None:
    """Let the system end this process should its parent have died and nobody stop it."""
    if hasattr(signal, "alarm"):
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(seconds)
