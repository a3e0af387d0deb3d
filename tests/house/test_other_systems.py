"""What macOS or Windows lack is not needed; this imitates the lack, it does not run on them."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from tools.processes import printed_by

ROOT = Path(__file__).parents[2]
WITHOUT = """
import os, signal, sys
for name in ("resource", "fcntl", "pwd", "grp", "termios"):
    sys.modules[name] = None
for name in ("register_at_fork", "fork", "sched_getaffinity", "killpg", "setsid"):
    if hasattr(os, name):
        delattr(os, name)
for name in ("SIGALRM", "SIGHUP", "SIGKILL", "SIGUSR1", "SIGUSR2", "alarm", "setitimer", "pthread_sigmask"):
    if hasattr(signal, name):
        delattr(signal, name)
"""
# Python warns of a file that is opened in the encoding of the system, which is cp1252 on many a Windows.
STRICT = """
import warnings
warnings.filterwarnings("error", category=EncodingWarning, module="lcp_plugin")
"""


@pytest.mark.full
def test_modules_and_calls_of_linux_alone_are_not_needed():
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


@pytest.mark.full
def test_files_are_opened_in_a_named_encoding(tmp_path):
    """No file is read or written in the encoding of the system; a path may have any letter."""
    code = """
import numpy as np
import lcp_plugin as lp
from pathlib import Path
from lcp_plugin.commands.cli import app
from lcp_plugin.interfaces.nl import write_nl
from typer.testing import CliRunner

problem = lp.LCP([[2.0, 1.0], [1.0, 2.0]], [-5.0, 1.0])
problem.save("ü ß.npz"), problem.save("Ω.npz")
np.savez("qp.npz", P=np.eye(2), c=[-1.0, 1.0])
write_nl(problem, "zwei é.nl")
for name in ("ü ß.npz", "Ω.npz", "zwei é.nl"):
    print(lp.solve(lp.load_problem(name)).status.name)
for words in (["solve", "ü ß.npz"], ["solve", "qp.npz"], ["list"], ["analyze", "zwei é.nl"]):
    print(CliRunner().invoke(app, words).exit_code)
"""
    done = subprocess.run(
        [sys.executable, "-X", "warn_default_encoding", "-X", "utf8", "-c", STRICT + code],
        cwd=tmp_path, capture_output=True, text=True, encoding="utf-8", check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["SOLVED"] * 3 + ["0"] * 4


@pytest.mark.full
@pytest.mark.parametrize("words", [["list"], ["solve", "obstacle_2d:size=6"], ["solve", "--help"]])
def test_a_command_prints_in_a_code_page_of_windows(words):
    """Characters that cp1252 lacks are printed as '?'; no command ends with an error because of them."""
    done = subprocess.run(
        [sys.executable, "-m", "lcp_plugin", *words],
        env=os.environ | {"PYTHONIOENCODING": "cp1252", "PYTHONUTF8": "0"}, capture_output=True, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, b"")
    assert done.stdout.decode("cp1252")
