"""The claims of convergence_guarantee are true for actual runs, and it makes no false claim."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from campaigns.guarantees import run_case
from inputs import textbook_scenes
from tools.processes import lcp_plugin
from tools.refusals import assert_refused, refusals

from lcp_plugin import LCP, Status, convergence_guarantee, gallery, solve
from lcp_plugin.algorithms import REGISTRY, NPSplitting
from lcp_plugin.gallery.problems import five_point_matrix

SPD_NOT_H = [[1.0, 0.9, 0.9], [0.9, 1.0, 0.9], [0.9, 0.9, 1.0]]
UNSCALED: dict[str, Any] = {"scaling": None, "momentum": None}


def with_matrix(M: Any) -> LCP:
    return LCP(M, -np.ones(np.shape(M)[0]))


# --- Rates -------------------------------------------------------------------------------------------------


@pytest.mark.quick(1)
@pytest.mark.parametrize("seed", range(6))
def test_no_run_contradicts_a_guarantee(seed):
    """Rates, contraction bounds and arrivals hold in 40 random cases; the campaign runs thousands."""
    rng = np.random.default_rng(1000 + seed)
    outcomes = [run_case(rng) for _ in range(40)]
    assert [text for outcome in outcomes for text in outcome.violations] == []
    assert (
        Counter(outcome.label.partition(": ")[2] for outcome in outcomes)["guaranteed with rate"]
        >= 8
    )


@pytest.mark.parametrize(
    ("name", "options", "rate"),
    [
        ("pj", {}, 0.5),
        ("pgs", {}, 0.5),  # row 1 uses the new value of row 0: 0 there
        ("psor", {"relaxation": 1.2}, 0.8),  # row 0: 0.2 + 1.2/2
        ("npj", {"scaling": "diagonal", "momentum": None}, 0.75),  # (1 + 1 + 2 − 2·(1 − ½))/4
        ("mgs", {}, 0.5),
    ],
)
def test_rates_of_a_matrix_by_hand(name, options, rate):
    """The rates for [[1, −½], [−½, 1]] with v = 1 equal the values computed by hand."""
    guarantee = convergence_guarantee(with_matrix([[1.0, -0.5], [-0.5, 1.0]]), name, **options)
    assert guarantee.is_guaranteed
    assert guarantee.rate == pytest.approx(rate, rel=1e-12)
    assert np.array_equal(guarantee.v, [1.0, 1.0])


# --- What is covered ---------------------------------------------------------------------------------------


def test_what_is_proved_of_direct_methods():
    """Lemke, Newton and banded have guarantees on certain matrices, interior point has none."""
    murty = with_matrix(np.eye(6) + 2.0 * np.triu(np.ones((6, 6)), 1))
    rotation = with_matrix([[0.0, 1.0], [-1.0, 0.0]])
    m_matrix = with_matrix([[2.0, -1.0], [-1.0, 2.0]])
    boxed = m_matrix.with_q(m_matrix.q, upper=1.0)
    claims = {
        "lemke": (True, False, True, True),
        "newton": (False, False, True, False),
        "banded": (False, False, True, True),
        "interior_point": (False, False, False, False),
    }
    for name, expected in claims.items():
        found = [
            convergence_guarantee(problem, name) for problem in (murty, rotation, m_matrix, boxed)
        ]
        assert tuple(guarantee.is_guaranteed for guarantee in found) == expected
        assert all(guarantee.is_guaranteed or name in guarantee.theorem for guarantee in found)
        assert all(guarantee.rate is None for guarantee in found)
    assert convergence_guarantee(rotation.with_q(rotation.q, upper=1.0), "lemke").is_guaranteed
    assert "3 pivots" in convergence_guarantee(m_matrix, "lemke", max_pivots=3).theorem
    drift = with_matrix([[2.0, -1.0], [0.0, 2.0]])
    found = [convergence_guarantee(one, "multigrid").is_guaranteed for one in (m_matrix, drift)]
    assert found == [True, False]


def test_nothing_is_claimed_for_the_scaling_trap_unscaled():
    """Unscaled NPSOR(1.7), which runs into a limit cycle there, and its relatives get no guarantee, but a remedy."""
    trap = textbook_scenes.scaling_trap()
    for name in ("npgs", "npsor", "npaor", "npsplitting"):
        guarantee = convergence_guarantee(trap.problem, name, **UNSCALED)
        assert not guarantee.is_guaranteed
        assert guarantee.remedy == 'algorithm="psor" converges on this M'
    assert convergence_guarantee(trap.problem, "psor").is_guaranteed


def test_positive_definite_matrices():
    """SPD but not H₊: PSOR-type sweeps and a short gradient step are covered, Jacobi is not, and diverges."""
    problem = with_matrix(SPD_NOT_H)
    for name, options in (
        ("pgs", {}),
        ("psor", {}),
        ("psor", {"relaxation": 1.9, "sweep": "symmetric"}),
        ("paor", {"relaxation": 1.3, "acceleration": 1.3}),
        ("gfp", {"relaxation": 0.7}),
    ):
        guarantee = convergence_guarantee(problem, name, **options)
        assert guarantee.is_guaranteed
        assert guarantee.rate is None
        assert "positive definite" in guarantee.theorem
        assert solve(problem, name, max_iterations=20_000, **options).is_solved
    assert convergence_guarantee(problem).is_guaranteed
    jacobi = convergence_guarantee(problem, "pj")
    assert jacobi.verdict == "not covered"
    assert "psor" in jacobi.remedy
    free = problem.with_q(problem.q, lower=-np.inf)
    assert not solve(free, "pj", z0=[1.0, 2.0, 3.0], max_iterations=500).is_solved


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("gfp", {"relaxation": 2.0}),
        ("paor", {"relaxation": 2.5, "acceleration": 2.5}),
        ("gfp", {"relaxation": 3.0}),
    ],
)
def test_a_relaxation_of_two_or_more_is_covered_on_no_matrix(name, options):
    """ω ≥ 2: determinant or trace forbid convergence where no constraint is active, even on the identity."""
    problem = with_matrix(np.eye(2))
    guarantee = convergence_guarantee(problem, name, **options)
    assert guarantee.verdict == "not covered"
    assert "psor" in guarantee.remedy
    free = problem.with_q(problem.q, lower=-np.inf)
    assert not solve(free, name, max_iterations=300, **options).is_solved


def test_an_iteration_that_cannot_run_is_not_covered():
    """A zero diagonal or an upper bound gives the message of the algorithm."""
    assert (
        "positive diagonal"
        in convergence_guarantee(with_matrix([[0.0, 1.0], [1.0, 1.0]]), "pgs").remedy
    )
    boxed = LCP(np.eye(2), [1.0, 1.0], upper=1.0)
    assert convergence_guarantee(boxed, "mgs").verdict == "not covered"
    assert convergence_guarantee(boxed, "pgs").is_guaranteed


@refusals(r"""
convergence_guarantee(eye, "psr") → UnknownAlgorithm: psor
convergence_guarantee(eye, "npgs", relaxation=1.0) → InvalidOption: relaxation
convergence_guarantee(np.eye(2), "npgs") → InvalidOption: LCP
convergence_guarantee(eye, "npgs", scaling_factor=2.0) → InvalidOption: needs scaling="diagonal"
""")
def test_arguments_are_checked(call, words):
    """Unknown names and options raise the errors of solve; automatic scaling takes no factor."""
    assert_refused(call, words, {"eye": with_matrix(np.eye(2))})


# --- At the limit of a theorem -------------------------------------------------------------------------------


UNDONE: dict[str, dict[str, float]] = {
    "msor": {
        "relaxation": 1.19,
        "omega": (1.19 - 1.0) / 1.19,
    },  # keeps a diagonal of rounding errors
    "mj": {"omega": 2.0**60},  # the pivot αΩ + d rounds to αΩ: a cycle of two
    "psor": {"relaxation": 2.0 - 2.0**-52},  # ω (1/d) d rounds to 2
    "npaor": {"relaxation": 1e17, "acceleration": 0.0, "scaling_factor": 1e20},
}


@pytest.mark.parametrize("name", UNDONE)
def test_what_rounding_may_undo_is_not_guaranteed(name):
    """A margin smaller than the rounding of the step sizes proves nothing of the iteration that runs."""
    problem = with_matrix([[3.0, 1.0], [1.0, 3.0]] if name == "psor" else [[1.0]])
    scaling = {"scaling": "diagonal"} if name == "npaor" else {}
    found = convergence_guarantee(problem, name, **UNDONE[name], **scaling)
    assert found.verdict == "not covered"


# --- The numbers behind it -----------------------------------------------------------------------------------


def test_a_splitting_of_one_s_own_is_covered_by_theorem_4_1():
    """A splitting that is not a part of M gets a rate from ρ(T) < 1, up to n = 1000."""
    for n, covered in ((30, True), (1001, False)):
        M = sp.diags_array(
            [np.full(n - 1, -1.0), np.full(n, 4.0), np.full(n - 1, -1.0)], offsets=[-1, 0, 1]
        )
        problem = LCP(sp.csr_array(M), -np.ones(n))
        guarantee = convergence_guarantee(problem, NPSplitting(splitting=sp.csr_array(1.1 * M)))
        assert guarantee.is_guaranteed == covered
        assert covered or "n > 1000" in guarantee.theorem


# --- The command ---------------------------------------------------------------------------------------------


def test_the_command_tells_matrix_and_guarantees():
    """The command prints claims, algorithms and the paper's variants."""
    result = lcp_plugin("analyze", "paper_example_1:n=100")
    assert result.exit_code == 0
    for words in (
        "H₊-matrix                     yes",
        "npsor, momentum=none, scaling=none not covered",
    ):
        assert words in result.stdout
    lines = result.stdout.splitlines()
    assert all(any(line.startswith(f"{name} ") for line in lines) for name in ("auto", *REGISTRY))
    rate = convergence_guarantee(gallery.build("paper_example_1", n=100).problem, "pgs").rate
    printed = next(float(line.split()[2]) for line in lines if line.startswith("pgs "))
    assert rate <= printed <= rate + 1e-3  # rounded upwards


# --- A matrix with the wrong sign is reported at once, a solvable matrix is not ---


@pytest.mark.parametrize("k", [4, 10])
def test_a_negated_m_matrix_is_proved_infeasible(k):
    """A problem with −M an M-matrix and a random q has no solution, and a proof shows it."""
    M, rng = -five_point_matrix(k, 4.0), np.random.default_rng(k)
    infeasible = solve(LCP(M, rng.standard_normal(k * k)))
    assert infeasible.status is Status.INFEASIBLE
    assert infeasible.infeasibility.verify()


def test_guaranteed_run_that_is_slow_ends_at_its_limit_of_steps():
    """A sweep whose convergence is proved is never STALLED or DIVERGED, and the advice has the reason."""
    n = 400
    M = sp.diags_array([-np.ones(n - 1), 2.0 * np.ones(n), -np.ones(n - 1)], offsets=[-1, 0, 1])
    slow = LCP(sp.csr_array(M), -np.ones(n))
    result = solve(slow, "gfp", max_iterations=2000)
    assert result.guarantee.is_guaranteed
    assert result.status is Status.MAX_ITERATIONS
    assert result.iterations < 2000
    assert "a theorem proves convergence" in result.advice
    lower = np.tril(np.full((14, 14), 200.0), -1) + np.eye(14)
    growing = LCP(lower, -lower.sum(axis=1), lower=-np.inf)
    result = solve(growing, "pj")
    assert result.guarantee.is_guaranteed
    assert result.status is Status.SOLVED
