"""Our answers agree with convex solvers that share no code with us, and the comparison itself can be trusted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp
from inputs import membranes
from inputs.planted import planted_lcp
from tools.refusals import assert_refused, refusals

from lcp_plugin import LCP, Certificate, Result, cross_validate, solve

COUNT = 60
BATCHES = 10


def spd_matrix(generator: np.random.Generator, n: int) -> np.ndarray:
    B = generator.normal(size=(n, n))
    return B @ B.T / n + generator.uniform(0.05, 1.0) * np.eye(n)


def random_spd_problem(seed: int) -> LCP:
    """A problem of 1 to 30 unknowns, with every kind of bounds, dense or sparse."""
    generator = np.random.default_rng(seed)
    n = int(generator.integers(1, 31))
    M = spd_matrix(generator, n)
    if seed % 3 == 0:
        M[(abs(M) < 0.2) & ~np.eye(n, dtype=bool)] = 0.0
        M += np.diag(abs(M).sum(axis=1))
    problem, _ = planted_lcp(M, generator, bounds=seed % 4 > 0)
    q = generator.normal(size=n) * 10.0 ** generator.integers(-3, 4)
    return LCP(sp.csr_array(M) if seed % 3 == 0 else M, q, lower=problem.lower, upper=problem.upper)


def clear_rows(certificate: Certificate, threshold: float) -> np.ndarray:
    """Return 1 at the lower bound, 2 at the upper, 3 between, 0 if degenerate."""
    problem, z, w = certificate.problem, certificate.z, certificate.w
    inside = (z - problem.lower > threshold) & (problem.upper - z > threshold)
    return np.select([w > threshold, w < -threshold, inside], [1, 2, 3], 0)


def altered(result: Result, i: int, by: float) -> Result:
    """Return the result with z_i changed."""
    z = result.z.copy()
    z[i] += by
    return replace(result, z=z)


# --- Agreement ----------------------------------------------------------------------------------------------


@pytest.mark.quick(1)
@pytest.mark.parametrize("batch", range(BATCHES))
def test_random_spd_problems_agree(batch):
    """Solutions z of random SPD problems agree to 1e-7, and clear active sets are equal."""
    for seed in range(batch, COUNT, BATCHES):
        problem = random_spd_problem(seed)
        check = cross_validate(problem, tolerance=1e-12)
        size = max(1.0, abs(check.ours.z).max())
        assert check.agrees, f"seed {seed}\n{check}"
        assert check.formulation.startswith("quadratic program")
        assert check.difference_z <= 1e-7 * size, f"seed {seed}\n{check}"
        assert check.theirs is not None
        mine, other = clear_rows(check.ours, 1e-6 * size), clear_rows(check.theirs, 1e-6 * size)
        decided = (mine > 0) & (other > 0)
        assert np.array_equal(mine[decided], other[decided]), f"seed {seed}\n{check}"


def test_a_solution_that_is_not_unique_is_named():
    """Two z on one face of solutions have the same w, and the verdict is that z is not unique."""
    check = cross_validate(LCP([[1.0, 1.0], [1.0, 1.0]], [-1.0, -1.0]), algorithm="pgs")
    assert check.agrees
    assert check.difference_z > 0.1 > 1e-9 > check.difference_w


@pytest.mark.quick(1)
@pytest.mark.parametrize("reference", ["DAQP", "OSQP", "SCS", "PIQP", "CLARABEL", "HIGHS"])
def test_every_installed_reference_agrees(reference):
    """Each installed solver agrees on a symmetric and on a nonsymmetric problem, boxes and free rows included."""
    import cvxpy

    if reference not in cvxpy.installed_solvers():
        pytest.skip(f"{reference} is optional")
    options = {"OSQP": {"eps_abs": 1e-10, "eps_rel": 1e-10, "max_iter": 100_000},
               "SCS": {"eps_abs": 1e-10, "eps_rel": 1e-10}}.get(reference, {})  # fmt: skip
    for target in ("obstacle_2d:size=6", "convection_diffusion:size=5"):
        check = cross_validate(
            membranes.parse(target).problem, reference=reference.lower(), **options
        )
        assert check.agrees, check
        assert check.reference == reference
    check = cross_validate(random_spd_problem(7), reference=reference, algorithm="psor", **options)
    assert check.agrees, check


# --- What is wrong is caught --------------------------------------------------------------------------------


@pytest.mark.parametrize("by", [1.0, 1e-3, 1e-6])
@pytest.mark.parametrize("target", ["obstacle_2d:size=8", "convection_diffusion:size=6"])
def test_planted_wrong_answer_is_caught(target, by):
    """A SOLVED result with one wrong component is a mismatch."""
    problem = membranes.parse(target).problem
    wrong = altered(solve(problem, tolerance=1e-9), problem.n // 2, by)
    check = cross_validate(problem, wrong)
    assert check.verdict == "mismatch", check
    assert "our status SOLVED is false" in check.reason
    assert check.difference_z == pytest.approx(by, rel=1e-2)


def test_a_result_less_accurate_than_the_tolerance_is_no_mismatch():
    """A run that ended early is not comparable; a run with a loose tolerance agrees."""
    problem = membranes.parse("obstacle_2d:size=20").problem
    early = cross_validate(problem, solve(problem, max_iterations=2))
    assert early.verdict == "not comparable"
    assert "our solution is not accurate, MAX_ITERATIONS" in early.reason
    assert cross_validate(problem, solve(problem, tolerance=1e-5)).agrees


# --- Only where it is legitimate ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("M", "reason"),
    [
        ([[1.0, 2.0], [2.0, 1.0]], "M is symmetric indefinite: a pivot is negative at shift"),
        (
            [[1.0, 5.0], [0.0, 1.0]],
            "M[0, 1] and M[1, 0] differ; the symmetric part of M is indefinite",
        ),
    ],
)
@pytest.mark.parametrize("kind", [np.array, sp.csr_array], ids=["dense", "sparse"])
def test_no_program_where_it_is_not_convex(M, reason, kind):
    """An indefinite problem reaches no solver, and the formulation contains the reason."""
    check = cross_validate(LCP(kind(M), [1.0, 1.0]))
    assert (check.verdict, check.theirs) == ("not comparable", None)
    assert check.formulation.startswith(reason)
    assert "no convex program" in check.reason


def test_a_wrong_answer_is_a_mismatch_also_where_there_is_no_program():
    """A false SOLVED is a mismatch because of its residual."""
    problem = membranes.parse("random_h_plus:n=30").problem
    result = solve(problem, tolerance=1e-9)
    assert cross_validate(problem, result).verdict == "not comparable"
    assert cross_validate(problem, altered(result, 3, 100.0)).verdict == "mismatch"


def test_two_solutions_are_no_mismatch():
    """Two certified answers of a problem that is not monotone only show that z is not unique."""
    problem = LCP([[1.0, 2.0], [2.0, 1.0]], [-1.0, -1.0])  # (1, 0), (0, 1), (1/3, 1/3)
    check = cross_validate(problem, solve(problem, "pgs", z0=[0.0, 1.0]))
    assert check.verdict == "not comparable"


# --- Solvers that fail, arguments that cannot be used -------------------------------------------------------


def test_a_reference_that_raises_is_not_comparable():
    """If the reference rejects an option, the reason contains its message."""
    problem = membranes.parse("obstacle_2d:size=6").problem
    check = cross_validate(problem, reference="OSQP", no_such_option=1)
    assert (check.verdict, check.theirs) == ("not comparable", None)
    assert "no_such_option" in check.reason
    assert np.isnan(check.difference_z)


def test_a_solver_is_not_compared_with_itself():
    """Method interior_point uses PIQP, and is therefore compared only with other solvers."""
    problem = membranes.parse("obstacle_2d:size=6").problem
    check = cross_validate(problem, reference="piqp", algorithm="interior_point")
    assert check.verdict == "not comparable"
    assert "PIQP computed our solution too" in check.reason
    assert cross_validate(problem, algorithm="interior_point").agrees
    assert cross_validate(problem, reference="piqp", algorithm="psor").agrees


@refusals(r"""
cross_validate(LCP([[2.0]], [-1.0]), reference="osq") → InvalidOption: cvxpy has no solver 'osq'
cross_validate(np.eye(2)) → InvalidOption: needs an LCP, got ndarray
cross_validate(LCP([[2.0]], [-1.0]), [0.5]) → InvalidOption: result must be a Result of solve
cross_validate(LCP([[2.0]], [-1.0]), solve(LCP(np.eye(2), [-1.0, -1.0]))) → InvalidProblem: z must be
""")
def test_arguments_that_cannot_be_used(call, words):
    """Wrong arguments are named, with what is needed."""
    assert_refused(call, words, {"cross_validate": cross_validate})


def test_explain_tells_verdict_first(capfd):
    """The explanation begins with the verdict and lists both sides; the solvers print nothing."""
    check = cross_validate(membranes.parse("obstacle_2d:size=3").problem)
    out, err = capfd.readouterr()
    assert (out, err) == ("", "")
    lines = check.explain().splitlines()
    assert lines[0].startswith("agree: ")
    for word in ("formulation", "ours", check.reference, "|Δz|", "objective gap", "disagreement"):
        assert any(line.startswith(word) for line in lines), word
    assert str(check) == check.explain()
