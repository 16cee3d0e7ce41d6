"""Work that can be stopped: in a process of its own, with one BLAS thread and a time limit.

A solver in compiled code cannot be interrupted from Python, and some spin for ever on an
ill-posed problem. Here the work runs in a fresh interpreter, as with the *spawn* method of
`multiprocessing`, but the caller's main module is not imported again: scripts without a
guard, notebooks and test runners are all safe callers.
"""

from __future__ import annotations

import json
import math
import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from typing import Any, TypeVar

from plant._checks import positive
from plant.errors import ParameterError

from .errors import SynthesisError

T = TypeVar("T")

ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "VECLIB_MAXIMUM_THREADS": "1",
}

_START = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from camless_ctrl.synthesis._child import main; main()"
)
_GRACE_S = 5  # by which a child outlives its limit at most if the parent is gone


def run_stoppable(
    function: Callable[..., T],
    args: tuple[Any, ...] = (),
    timeout_s: float = 30.0,
    *,
    likely_reason: str = "the work never ends, or the limit is too short for it",
) -> T:
    """Return ``function(*args)``, computed in a process that is killed at the time limit.

    Parameters
    ----------
    function : callable
        Function of an importable module; it, `args` and the result must be picklable.
    args : tuple
        Its arguments.
    timeout_s : float
        Time limit including the start of the process, s.
    likely_reason : str
        What the error says of the likely reason if the limit is reached.

    Raises
    ------
    SynthesisError
        If the limit is reached, the work raises (its message comes back, its traceback as a
        note), or the process dies.
    ParameterError
        If the function or its arguments cannot be sent to another process.
    """
    timeout_s = positive("timeout_s", timeout_s, "s")
    label = getattr(function, "__qualname__", repr(function))
    request = _request(function, args, label, timeout_s)
    with subprocess.Popen(
        [sys.executable, "-c", _START, json.dumps([os.path.abspath(p) for p in sys.path])],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, **ONE_THREAD},
    ) as process:
        try:
            reply, said = process.communicate(request, timeout_s)
        except subprocess.TimeoutExpired:
            _end(process)
            raise SynthesisError(
                f"{label} was stopped at its time limit of {timeout_s:g} s; likely reason: "
                f"{likely_reason}"
            ) from None
        except BaseException:  # KeyboardInterrupt too: nothing stays behind
            _end(process)
            raise
    if not reply:
        last = said.decode(errors="replace").strip().splitlines()[-1:] or ["it said nothing"]
        raise SynthesisError(
            f"the process of {label} died with exit code {process.returncode}: {last[0]}"
        )
    kind, content = pickle.loads(reply)
    if kind == "error":
        name, message, trace = content
        error = SynthesisError(f"{label} raised {name}: {message}" if name else message)
        error.add_note(f"in the process of {label}:\n{trace}")
        raise error
    result: T = content
    return result


def _end(process: subprocess.Popen[bytes]) -> None:
    """Kill a process and wait for it: Popen itself leaves a zombie after KeyboardInterrupt."""
    process.kill()
    process.wait()


def _request(
    function: Callable[..., Any], args: tuple[Any, ...], label: str, timeout_s: float
) -> bytes:
    if getattr(function, "__module__", None) == "__main__":
        raise ParameterError(
            f"{label} is defined in the main script or notebook, which another process does not "
            "load: move it into a module"
        )
    try:
        work = pickle.dumps((function, args))
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise ParameterError(
            f"{label} or its arguments cannot be sent to another process ({error}): use a "
            "function at the top of a module, and plain data (the matrices of a control system, "
            "not the system)"
        ) from error
    return pickle.dumps((work, math.ceil(timeout_s) + _GRACE_S))
