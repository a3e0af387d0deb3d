"""Newton and the active-set linear algebra under it: exact where it should be, and safe where full steps cycle."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
import scipy.sparse as sp
from inputs.planted import planted_lcp
from inputs.small_families import draw, lower_triangle
from oracles.exact_criterion import failures

from lcp_plugin import LCP, Status, solve
from lcp_plugin.algorithms import Newton
from lcp_plugin.gallery.problems import five_point_matrix

TOLERANCE = 1e-9


# --- Newton ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("kind", ["dense SPD", "sparse SPD", "banded", "nonsymmetric P"])
def test_newton_finds_the_planted_answer_with_bounds_of_every_kind(kind, seed):
    """Boxed, one-sided, free, fixed and degenerate rows come out right on each of the four kinds of factor."""
    rng = np.random.default_rng(100 + seed)
    B = rng.integers(-3, 4, (40, 40)).astype(float)
    M = {
        "dense SPD": lambda: B @ B.T + np.eye(40),
        "sparse SPD": lambda: five_point_matrix(15, 4.0),
        "banded": lambda: sp.diags_array(
            [-np.ones(299), np.full(300, 4.0), -2.0 * np.ones(299)], offsets=[-1, 0, 1]
        ),
        "nonsymmetric P": lambda: B @ B.T + np.eye(40) + 9.0 * (np.triu(B, 1) - np.triu(B, 1).T),
    }[kind]()
    problem, z = planted_lcp(M, seed)
    result = solve(
        problem, Newton(), tolerance=1e-12, z0=rng.integers(-5, 6, problem.n).astype(float)
    )
    assert result.status is Status.SOLVED
    assert np.allclose(result.z, z, atol=1e-8)


def cyclic(entries: list[float]) -> np.ndarray:
    """I plus a cyclic subdiagonal: entries[i] in row i, column i − 1 (mod n)."""
    M = np.eye(len(entries))
    for i, entry in enumerate(entries):
        M[i, i - 1] += entry
    return M


@pytest.mark.parametrize("family", ["definite", "cyclic"])
def test_the_line_search_leads_to_the_solution_of_each_p_matrix(family):
    """Full steps cycle or are off in some of these, with bounds of every kind: SOLVED by the rule in fractions."""
    for problem in draw(family, 60, 12):
        assert failures(problem, solve(problem, "newton").require_solved().z) == []


@pytest.mark.parametrize("n", [1, 2, 50, 200])
@pytest.mark.parametrize("family", ["murty", "murty transposed", "fathi", "fathi transposed"])
def test_exponential_families_take_at_most_one_step_a_row(family, n):
    """On Murty's and Fathi's matrices, exponential for pivoting, Newton needs at most n + 1 steps."""
    L = lower_triangle(n)
    M = {"murty": L, "murty transposed": L.T, "fathi": L @ L.T, "fathi transposed": L.T @ L}[family]
    result = solve(LCP(M, -np.ones(n)), Newton(), tolerance=TOLERANCE)
    assert result.status is Status.SOLVED
    assert result.iterations <= n + 1


def test_csizmadia_is_solved_exactly_where_doubles_can_state_the_answer():
    """The triangular matrix of minus ones is almost singular, but z = 1, 2, 4, … is found to the last bit."""
    for n in (10, 50):
        M = np.eye(n) - np.tril(np.ones((n, n)), -1)
        result = solve(LCP(M, -np.ones(n)), Newton(), tolerance=0.0)
        assert np.array_equal(result.z, 2.0 ** np.arange(n))


# --- Active sets and factors ---------------------------------------------------------------------------------


TRANSPORT = """
import sys
import numpy as np, scipy.sparse as sp
from itertools import islice
from lcp_plugin import LCP
from lcp_plugin.gallery.problems import five_point_matrix
from lcp_plugin.methods.newton import Newton
a, b = int(sys.argv[1]), int(sys.argv[2])
cost = np.random.default_rng(5).uniform(1, 10, a * b)
sums = [sp.kron(sp.eye_array(a), np.ones((1, b))), sp.kron(np.ones((1, a)), sp.eye_array(b))]
supply = np.r_[np.full(a, float(b)), np.full(b, float(a))]
free = sp.csr_array((a * b, a * b))
problem = LCP.from_qp(free, cost, A=sp.vstack(sums).tocsr(), b=supply, lower=np.zeros(a * b))
np.seterr(all="ignore")  # as `solve` does
print(sum(1 for _ in islice(Newton().iterates(problem, np.zeros(problem.n)), 40)))
"""


@pytest.mark.full
@pytest.mark.parametrize("size", [(55, 60), (50, 70)])
def test_transport_programs_leave_the_interpreter_alive(size):
    """Free blocks of a transport program are structurally singular: Newton goes on, and SuperLU prints nothing."""
    command = [sys.executable, "-c", TRANSPORT, *map(str, size)]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=100, check=False)
    assert ended.returncode == 0, ended.stderr
    assert not ended.stderr
    assert ended.stdout.strip().isdigit()
