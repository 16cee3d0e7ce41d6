"""Work in a process of its own: results, errors, time limit, interruption, nothing left over."""

from __future__ import annotations

import math
import operator
import os
import signal
import subprocess
import sys
import time

import pytest

from camless_ctrl.synthesis import SynthesisError, run_stoppable
from plant import ParameterError

posix = pytest.mark.skipif(not hasattr(signal, "alarm"), reason="POSIX signals")


@pytest.fixture
def started(monkeypatch):
    """Processes that were started."""
    seen: list[subprocess.Popen] = []

    class Recorded(subprocess.Popen):
        def __init__(self, *args, **kwargs):
            super().__init__(*args, **kwargs)
            seen.append(self)

    monkeypatch.setattr(subprocess, "Popen", Recorded)
    return seen


def assert_gone(process: subprocess.Popen) -> None:
    assert process.returncode is not None  # waited for: no zombie
    with pytest.raises(ProcessLookupError):
        os.kill(process.pid, 0)


def test_result_comes_back():
    assert run_stoppable(math.hypot, (3.0, 4.0)) == 5.0


def test_one_blas_thread():
    assert run_stoppable(os.getenv, ("OMP_NUM_THREADS",)) == "1"
    assert run_stoppable(os.getenv, ("OPENBLAS_NUM_THREADS",)) == "1"


def test_printing_does_not_mix_with_the_answer():
    assert run_stoppable(print, ("noise",)) is None


def test_childs_exception_comes_back_with_its_message():
    with pytest.raises(SynthesisError, match=r"truediv raised ZeroDivisionError: .*zero") as raised:
        run_stoppable(operator.truediv, (1, 0))
    assert "Traceback" in raised.value.__notes__[0]


def test_death_of_the_process_is_told(started):
    with pytest.raises(SynthesisError, match="died with exit code 3"):
        run_stoppable(os._exit, (3,))
    assert_gone(started[0])


@posix
@pytest.mark.parametrize(
    ("function", "args"),
    [(time.sleep, (60.0,)), (pow, (3, 10**9))],  # the second never lets Python speak
    ids=["sleeps", "spins"],
)
def test_endless_work_is_stopped_at_its_limit(started, function, args):
    start = time.perf_counter()
    with pytest.raises(SynthesisError, match=r"time limit of 0\.5 s; likely reason: it is endless"):
        run_stoppable(function, args, 0.5, likely_reason="it is endless")
    assert 0.5 <= time.perf_counter() - start < 3.0
    assert_gone(started[0])


@posix
def test_interruption_stops_the_work(started):
    def interrupt(signum, frame):
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGALRM, interrupt)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.3)
        with pytest.raises(KeyboardInterrupt):
            run_stoppable(time.sleep, (60.0,))
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    assert_gone(started[0])


@posix
def test_process_ends_by_itself_if_its_parent_is_gone():
    code = "from camless_ctrl.synthesis._child import _live_at_most as f; f(1); 3**(10**9)"
    done = subprocess.run([sys.executable, "-c", code], timeout=20, check=False)
    assert done.returncode == -signal.SIGALRM


def test_caller_may_be_a_script_without_a_guard(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        "import math\nfrom camless_ctrl.synthesis import run_stoppable\n"
        "print('started')\nprint(run_stoppable(math.sqrt, (16.0,)))\n"
    )
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["started", "4.0"]  # once: the script is not run again


def test_function_of_the_main_script_is_refused(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        "from camless_ctrl.synthesis import run_stoppable\n"
        "def mine():\n    return 1\nrun_stoppable(mine)\n"
    )
    done = subprocess.run(
        [sys.executable, str(script)], capture_output=True, text=True, check=False
    )
    assert "ParameterError: mine is defined in the main script" in done.stderr


def test_what_cannot_be_sent_is_refused():
    with pytest.raises(ParameterError, match="cannot be sent to another process"):
        run_stoppable(lambda: 1)
    with pytest.raises(ParameterError, match="timeout_s is 0 s"):
        run_stoppable(math.sqrt, (4.0,), 0.0)


def test_the_start_imports_nothing_heavy():
    code = "sorted({'numpy', 'scipy', 'control', 'slycot'} & set(__import__('sys').modules))"
    assert run_stoppable(eval, (code,)) == []
