"""Ctrl-C while a first solve still imports and compiles: a result, or a plain KeyboardInterrupt."""

import signal
import subprocess
import sys
import time

import pytest

SOLVES = {
    "LCP": "solve(LCP(np.eye(90) * 2.0, -np.ones(90)))",
    "QuadraticProgram": "solve(QuadraticProgram(np.eye(9), -np.ones(9), G=np.ones((1, 9)), h=[1.0]))",
    "ConeProblem": "solve(ConeProblem(np.eye(3), [0.0, -2.0, 0.0], [('second_order', 3)]))",
    "NonlinearProblem": "solve(NonlinearProblem(lambda x: x**3 - 1.0), x0=np.full(3, 2.0))",
}
CODE = """
import signal
import numpy as np
from lcp_plugin import LCP, ConeProblem, NonlinearProblem, QuadraticProgram, solve
print("begins", flush=True)
result = {}
signal.signal(signal.SIGINT, signal.SIG_IGN)  # it has come too late
print(result.status.name)
"""


@pytest.mark.quick(1)
@pytest.mark.parametrize("kind", SOLVES)
@pytest.mark.parametrize("share", [0.03, 0.1, 0.3, 0.8])
def test_an_interruption_of_a_first_solve_is_a_result(kind, share):
    """SIGINT after parts of a second: KeyboardInterrupt before the first step, INTERRUPTED after it, else SOLVED."""
    process = subprocess.Popen(
        [sys.executable, "-c", CODE.format(SOLVES[kind])],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    process.stdout.readline()
    time.sleep(share)
    process.send_signal(signal.SIGINT)
    printed, errors = process.communicate(timeout=60)
    is_raised = "KeyboardInterrupt" in errors
    assert printed.strip() in ("INTERRUPTED", "SOLVED") or is_raised, errors
