"""What macOS or Windows lack is not needed; this imitates the lack, it does not run on them."""

from __future__ import annotations

import pytest
from fresh_process import printed_by

WITHOUT = """
import os, sys
for name in ("resource", "fcntl", "pwd", "grp", "termios"):
    sys.modules[name] = None
for name in ("register_at_fork", "fork", "sched_getaffinity", "killpg", "setsid"):
    if hasattr(os, name):
        delattr(os, name)
"""


@pytest.mark.full
def test_modules_and_calls_of_linux_alone_are_not_needed() -> None:
    """One problem, a batch, a model in cvxpy and the commands without them."""
    code = """
import cvxpy as cp
import numpy as np
from typer.testing import CliRunner
import lcp_plugin
from lcp_plugin import LCP, gallery, solve, solve_batch
from lcp_plugin.commands.cli import app

two = LCP([[2.0, 1.0], [1.0, 2.0]], [-5.0, 1.0])
print(solve(gallery.obstacle_2d(size=20).problem).status.name, solve_batch([two, two]).z.tolist())
x = cp.Variable(2)
model = cp.Problem(cp.Minimize(0), [lcp_plugin.complements(x >= 0, two.M @ x + two.q >= 0)])
model.solve(method="LCP")
print(model.status)
for words in (["list"], ["solve", "obstacle_2d:size=10", "--json"], ["analyze", "paper_example_1"]):
    print(CliRunner().invoke(app, words).exit_code)
"""
    printed = printed_by(WITHOUT + code).splitlines()
    assert printed == ["SOLVED [[2.5, 0.0], [2.5, 0.0]]", "optimal", "0", "0", "0"]
