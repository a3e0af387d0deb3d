"""The stopping criterion against constructed wrong points, enumeration in fractions, and exact results one ulp off."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import badly_scaled
import numpy as np
import pytest
import scipy.sparse as sp
from campaigns.scaling import KINDS, answered, measured, random_scaling
from hypothesis import given
from hypothesis import strategies as st
from oracles.exact import exact_solution
from oracles.truth import ExactData
from scipy.sparse import csgraph

from lcp_plugin import (
    LCP,
    Certificate,
    ConeProblem,
    FrictionalContact,
    NonlinearProblem,
    Status,
    march,
    solve,
    solve_batch,
)
from lcp_plugin.algorithms import REGISTRY
from lcp_plugin.core.matrix import Matrix
from lcp_plugin.core.structure import is_nearly_symmetric
from lcp_plugin.gallery.problems import five_point_matrix
from lcp_plugin.judges.lcp import row_data


@np.errstate(all="ignore")
def passes(problem: LCP, z: Any) -> bool:
    """Return whether z passes the criterion without a move to bounds."""
    return bool(row_data(problem).measure_at(np.array(z, float), None, 1e-8).passes)


@pytest.mark.parametrize("power", [-300, 0, 300])
def test_a_row_of_zeros_is_infeasible_in_any_unit(power):
    """w₂ = −1e-9 for every z, also if M and q are multiplied by a power of two."""
    result = solve(LCP(np.ldexp([[1.0, 1.0], [0.0, 0.0]], power), np.ldexp([-1.0, -1e-9], power)))
    assert result.status is Status.INFEASIBLE
    assert result.proof.verify()


# --- Residuals relative to row-wise terms ---


def test_right_to_an_ulp_is_solved_whatever_the_diagonal_entry_is():
    """If m_ii is small relative to its row, an error of 1e-16 in w_i is not a distance of 1e-4."""
    for tiny in 10.0 ** -np.arange(6.0, 14.0):
        problem = LCP([[1.0, -2.0], [3.0, tiny]], [-3.0, -8.0])
        right = np.array([(3.0 * tiny + 16.0), 8.0 - 9.0]) / (tiny + 6.0)
        assert right[1] < 0.0  # so that z = (3, 0) is the solution
        assert passes(problem, [np.nextafter(3.0, 4.0), 0.0])
        beside = LCP([[1.0, -2.0], [3.0, tiny]], [-1.0, -5.0])
        z_2 = 2.0 / (tiny + 6.0)
        assert passes(beside, [1.0 + 2.0 * z_2, np.nextafter(z_2, 1.0)])


def test_a_degenerate_row_that_sweeps_approach_is_right():
    """For z* = w* = 0 the remainder of z is as large as the terms of its row, which passes."""
    M = 4.0 * np.eye(60) - np.eye(60, k=1) - np.eye(60, k=-1)
    z = np.where(np.arange(60) < 20, 1.0, 0.0)
    result = solve(LCP(M, np.where(np.arange(60) == 20, 1.0, 0.0) - M @ z), "npgs")
    assert result.is_solved
    assert result.z == pytest.approx(z, abs=1e-7)
    assert result.iterations <= 80


@pytest.mark.parametrize("none", [1e20, 1e30, np.inf])
def test_a_bound_of_1e20_is_none(none):
    """A bound of 1e20 means none in arrays, with another q, and in a batch; 1e19 is a bound."""
    M, q = np.array([[2.0, 1.0], [1.0, 2.0]]), np.array([-5.0, 1.0])
    problem = LCP(M, q, lower=-none, upper=[none, 1e19])
    assert problem.lower.tolist() == [-np.inf, -np.inf]
    assert problem.upper.tolist() == [np.inf, 1e19]
    right = np.linalg.solve(M, -q)
    other = problem.with_q(2.0 * q, lower=[-1e25, -none])
    batch = solve_batch(M, np.array([q, 2.0 * q]), lower=-none, upper=np.full((2, 2), none))
    answers = [solve(problem), solve(other), *batch]
    for result, expected in zip(answers, (right, 2.0 * right, right, 2.0 * right), strict=True):
        assert result.is_solved
        assert result.z == pytest.approx(expected)


# --- SOLVED holds in every component of a problem ---

TOLERANCE = 1e-8
FAR_APART = LCP(np.eye(2), [-1e10, -0.5])
WRONG_IN_ONE = np.array([1e10, 0.6])  # relative to the larger component by 1e-11


def is_lie(problem: LCP, z: np.ndarray) -> bool:
    return ExactData(problem).is_lie(z.tolist(), TOLERANCE)


# --- One component is wrong and small relative to another
# -------------------------------------------------------------


@pytest.mark.parametrize("name", REGISTRY)
def test_no_method_stops_at_a_component_that_is_wrong(name):
    """Every method continues until the small component is also within the tolerance."""
    result = solve(FAR_APART, name, z0=WRONG_IN_ONE)
    assert result.is_solved
    assert abs(result.z[1] - 0.5) <= TOLERANCE * 0.5


def test_the_worst_component_is_one_beyond_its_rounding_level():
    """The second row is wrong by the rounding error of 3 · 0.1, which counts as 0; the first one by 1e-12."""
    problem = LCP(np.diag([1.0, 0.1]), [-1.0, -(3.0 * 0.1)], lower=[0.0, 3.0])
    certificate = Certificate.of(problem, [1.0 + 1e-12, 3.0])
    assert certificate.relative_residual == pytest.approx(1e-12, rel=1e-2)
    assert certificate.worst_index == 0


# --- Components that z° solves ---------------------------------------------------------------------------------------


def test_what_z0_solves_exactly_is_left_there():
    """A component that z° solves exactly returns z°, also from another start."""
    result = solve(LCP(np.eye(2), [-1.0, 2.0]), z0=[0.0, 1e-300])
    assert result.is_solved
    assert result.z.tolist() == [1.0, 0.0]


def test_a_narrow_box_is_no_rounding():
    """The bound z₂ ≤ 1e-17 makes r(z°) small, but w₂ = −1 shows that z₂ = 1e-17 is right."""
    problem = LCP(np.eye(2), [-3.0, -1.0], lower=[1.0, 0.0], upper=[np.inf, 1e-17])
    result = solve(problem)
    assert result.is_solved
    assert result.z.tolist() == [3.0, 1e-17]


def test_a_component_at_the_rounding_of_its_data_leaves_the_others_their_answer():
    """The value z₂ = 3 misses by the rounding error of 0.3, which is no demand: the problem is SOLVED."""
    M = np.zeros((6, 6))
    M[:5, :5] = (
        np.tril(np.full((5, 5), -1.0), -1) + np.triu(np.full((5, 5), 2.0), 1) + 3.0 * np.eye(5)
    )
    M[5, 5] = 0.3
    problem = LCP(M, [-1.0, -2.0, -3.0, 1.0, -5.0, -0.9], lower=[0.0] * 5 + [3.0])
    for name in ("auto", "newton", "npsor", "interior_point", "lemke"):
        result = solve(problem, name)
        assert result.is_solved, name
        assert result.z[5] == 3.0
        alone = problem.with_q(np.r_[problem.q[:5], 1.0])  # the last component is solved by z° here
        assert not is_lie(alone, result.z), name


def test_a_residual_beyond_the_range_of_doubles_is_not_rounding():
    """Row w₁ = −1e200 with the scale 1e-200, and w₂ = −1 is infeasible: 1e400 is not rounding."""
    result = solve(LCP([[-1e-200, 0.0], [0.0, 0.0]], [-1e200, -1.0]))
    assert result.status not in (Status.PRECISION_LIMIT, Status.SOLVED)


@pytest.mark.parametrize("name", ["auto", *REGISTRY])
def test_a_start_out_of_all_proportion_to_its_component_does_no_harm(name):
    """1e200 where the answer is 1e-200: the relative residual overflows, and a damped sweep cannot see that z falls."""
    problem = LCP(np.eye(2), [-1e-200, -1.0])
    result = solve(problem, name, z0=[1e200, 0.0])
    assert result.is_solved or name in ("npgs", "npj", "npsplitting")
    assert not result.is_solved or not is_lie(problem, result.z)


LARGE = 2.0**36  # next to it, a violation of 1 is above the limit of 2⁻⁴²
CONTRADICTORY = np.array([[1.0, -1.0, 0.0], [-1.0, 1.0, 0.0], [1.0, 0.0, 1.0]])


def test_a_component_without_solution_is_refuted_after_a_call_on_another_component():
    """A problem without a solution is not SOLVED after an earlier call at a loose tolerance."""
    problem = LCP(np.kron(np.eye(2), CONTRADICTORY), [-1, 1, -LARGE, -1, 0, -LARGE])
    start = [LARGE, LARGE, 0, LARGE, LARGE - 0.5, 0]
    solve(problem, z0=start, tolerance=0.1)
    assert not solve(problem).is_solved


@pytest.mark.full
@pytest.mark.parametrize("as_stored", [np.asarray, sp.csr_array])
def test_every_component_without_solution_is_refuted_whatever_their_number(as_stored):
    """The limit of rows for a proof before SOLVED holds for each component, not for all of them."""
    count = 101
    M, q = as_stored(np.kron(np.eye(count), CONTRADICTORY)), [-1, 0, -LARGE] * count
    start = [LARGE, LARGE, 0] * count
    assert not solve(LCP(M, q), z0=start).is_solved
    assert not any(one.is_solved for one in solve_batch(LCP(M, q), [q, q], z0=[start, start]))


@pytest.mark.quick(1)
@pytest.mark.parametrize("further", [0, 30])
def test_rows_at_rounding_level_with_finite_bounds_are_not_solved(further):
    """A contradiction above 2⁻⁴² of the terms is not SOLVED at z where its terms are large."""
    n = 3 + further
    M, q = 4.0 * np.eye(n), np.ones(n)
    M[:3, :3], q[:3] = CONTRADICTORY, [-1.0, 0.0, -LARGE]
    M[range(2, n - 1), range(3, n)] = 2.0**-70  # one component
    result = solve(LCP(M, q, upper=2.0**40))
    right = np.r_[2.0**40, 2.0**40, np.zeros(n - 2)]
    assert not result.is_solved or np.allclose(result.z, right, rtol=1e-4)


def test_an_absolute_tolerance_does_not_end_the_test_of_proofs():
    """A point that a proof excludes is not SOLVED with a tiny absolute tolerance."""
    for one in (
        LCP(CONTRADICTORY, [-1, 0, -LARGE]),
        ConeProblem(CONTRADICTORY, [-1, 0, -LARGE], [("box", np.zeros(3), np.inf)]),
    ):
        start = [LARGE, LARGE, 0.0]
        assert not solve(one, z0=start, absolute_tolerance=1e-300).is_solved


def test_infeasible_is_infeasible_whatever_stands_beside():
    """An infeasible component makes the problem INFEASIBLE, with a proof for the unscaled data."""
    problem = LCP(np.diag([1.0, -1.0, 2.0]), [-1e6, -1e3, -1.0])
    result = solve(problem)
    assert result.status is Status.INFEASIBLE
    assert result.infeasibility is not None
    assert result.infeasibility.problem is problem
    assert result.infeasibility.verify()


# --- The componentwise test of the criterion ---


@pytest.mark.quick(5)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 1e-8])
def test_the_guard_refuses_nothing_right(kind, tolerance):
    """A point right to a hundredth of the tolerance passes in every row, for any scaling."""
    for seed in range(30):
        M, q, z = answered(kind, seed)
        rows, of_z = random_scaling(seed, z.size)
        right = z * (
            1.0 + 0.01 * tolerance * np.random.default_rng(seed).uniform(-1.0, 1.0, z.size)
        )
        assert Certificate.of(measured(M, q, rows, of_z), right * of_z).term_residual <= tolerance


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in ("friction", "game")])
def test_the_guard_refuses_no_rounding_beside_a_bound(kind):
    """If w is positive and large, a z off its bound by 1e-12 counts as rounding error."""
    for seed in range(30):
        M, q, z = answered(kind, seed)
        rows, of_z = random_scaling(seed, z.size)[0], np.ones(z.size)
        problem = measured(M, q, rows, of_z)
        right = row_data(problem).snap(np.where(z > 0.0, z, 1e-12) * of_z)[0]
        assert Certificate.of(problem, right).term_residual <= 1e-8, seed


FLOWS = {"growth": (-6.0, 2.0, 4.0), "upwind": (-11.0, 12.0, -1.0), "steep": (-501.0, 502.0, -1.0)}


def flow(kind: str, n: int) -> np.ndarray:
    """A well conditioned matrix along which something flows: balancing |m_ij| against |m_ji| drifts by e^(Péclet)."""
    left, middle, right = FLOWS[kind]
    return (
        middle * np.eye(n) + np.diag(np.full(n - 1, left), -1) + np.diag(np.full(n - 1, right), 1)
    )


@pytest.mark.quick(2)
@pytest.mark.parametrize("algorithm", ["auto", "npsor", "newton", "interior_point", "lemke"])
@pytest.mark.parametrize("kind", FLOWS)
@pytest.mark.parametrize("units", ["own", "one", "each", "rows"])
def test_a_flow_is_no_unit(kind, algorithm, units):
    """For convection under scaling, a SOLVED z is accurate to 1e-3, and auto solves the problem."""
    for n in (60, 200):
        rng = np.random.default_rng(n)
        M, q = flow(kind, n), rng.choice([-1.0, 1.0], n) * rng.uniform(0.5, 1.0, n)
        z = solve(LCP(M, q), "newton").z
        rows, of_z = np.exp2(rng.integers(-20, 21, (2, n)))
        if units in ("own", "one"):
            rows[:], of_z[:] = 1.0, 1.0
            of_z[n // 3] = 1.0 if units == "own" else 2.0**-10
        elif units == "rows":
            of_z[:] = 1.0
        result = solve(measured(M, q, rows, of_z), algorithm, max_iterations=2000)
        assert result.is_solved or algorithm != "auto"
        assert not result.is_solved or np.abs(result.z / of_z - z).max() <= 1e-3 * np.abs(z).max()


@pytest.mark.parametrize("algorithm", ["auto", "newton", "lemke", "interior_point"])
def test_nothing_calls_a_z_solved_that_is_wrong_in_its_small_unknowns(algorithm):
    """solve, watched or not, and solve_batch: a row missed its sign by 0.8 where its terms are 5."""
    M, Q, bounds = badly_scaled.M, badly_scaled.Q, badly_scaled.BOUNDS
    problem = LCP(M, Q, **bounds)
    results = [
        solve(problem, algorithm),
        solve(problem, algorithm, callback=lambda sample, z: False),
        solve_batch(M[None], Q[None], algorithm=algorithm, **bounds)[0],
    ]
    for result in results:
        assert result.is_solved
        assert result.z == pytest.approx(badly_scaled.ANSWER, rel=1e-6)


# --- Symmetric up to rounding is symmetric, for every method and prediction ---


def laplacian(side: int, noise: float = 0.0) -> sp.csr_array:
    """The 5-point matrix, with rounding of another size where an assembly leaves entries that ought to cancel."""
    near = sp.diags_array([1.0, 1.0], offsets=[-1, 1], shape=(side, side))
    corners = sp.csr_array(sp.kron(near, near))
    corners.data = noise * np.random.default_rng(0).uniform(-1.0, 1.0, corners.nnz)
    return five_point_matrix(side, 4.0) + corners


@pytest.mark.parametrize("algorithm", ["auto", "multigrid"])
def test_an_assembled_matrix_is_solved_as_its_symmetric_part(algorithm):
    """The same stages, and less than twice the work, for K and (K + Kᵀ)/2: rounding errors do not make K asymmetric."""
    K = laplacian(60, noise=4e-16)
    q = np.full(K.shape[0], -0.01)
    q[: q.size // 2] = 0.01
    one, other = (
        solve(LCP(M, q, upper=30.0), algorithm) for M in (K, sp.csr_array((K + K.T) * 0.5))
    )
    assert one.status is other.status is Status.SOLVED
    assert is_nearly_symmetric(Matrix(K))
    assert one.algorithm == other.algorithm
    assert 0.5 * other.work <= one.work <= 2.0 * other.work  # rounding may cost a cycle


def test_rounding_in_w_is_not_told():
    """`explain` of a contact problem names an asymmetry of W that is none of rounding, and no other."""
    W = np.eye(3) + 0.1
    W[0, 1] += 4e-17 * 4
    assert W[0, 1] != W[1, 0]
    rounded = solve(FrictionalContact(W, [-1.0, 0.3, 0.2], 0.5))
    assert "not symmetric" not in rounded.explain()
    W[0, 1] += 1e-6
    assert "W is not symmetric" in solve(FrictionalContact(W, [-1.0, 0.3, 0.2], 0.5)).explain()


# --- absolute_tolerance ---

AT_REST = [[-1.0, -1.0], [-1.0, 2.0]], [-5.6e-17, 1.0]  # no solution, by rounding


def test_contact_at_rest_is_accepted_or_at_the_rounding_level():
    """A contradiction of rounding size is PRECISION_LIMIT, and an absolute tolerance as large accepts it."""
    problem = LCP(*AT_REST)
    plain = solve(problem)
    assert plain.status is Status.PRECISION_LIMIT
    assert plain.infeasibility is not None
    value = 1.1 * max(plain.certificate.scaled_residual, plain.infeasibility.absolute_margin)
    for algorithm in ("auto", "lemke", "newton", "interior_point"):
        accepted = solve(problem, algorithm, absolute_tolerance=value)
        assert accepted.is_solved
        assert accepted.certificate.scaled_residual <= value
    assert "in the unit of z" in str(accepted)


def test_infeasible_beyond_the_tolerance_only():
    """Z ≥ 0, w = −z − gap violates by gap/1: INFEASIBLE if that exceeds both tolerances."""
    problem = LCP([[-1.0]], [-1e-3])
    assert solve(problem).status is Status.INFEASIBLE
    assert solve(problem, absolute_tolerance=1e-5).status is Status.INFEASIBLE
    assert solve(problem, absolute_tolerance=2e-3).is_solved


@given(
    st.integers(0, 10**6),
    st.integers(1, 12),
    st.floats(-9, 3),
    st.sampled_from(["auto", "psor", "newton", "lemke"]),
)
def test_solved_means_one_tolerance_or_the_other_in_every_part(seed, n, exponent, name):
    """SOLVED ⇔ ‖r_P‖∞ ≤ max(tolerance · reference, absolute_tolerance) for each component, in units of their own."""
    random = np.random.default_rng(seed)
    cut = int(random.integers(0, n))
    M = random.standard_normal((n, n)) * (random.random((n, n)) < 0.7)
    M[:cut, cut:], M[cut:, :cut] = 0.0, 0.0
    np.fill_diagonal(M, np.abs(M).sum(axis=1) + np.abs(M).sum(axis=0) + 1.0)
    unit = np.where(np.arange(n) < cut, 10.0 ** random.uniform(-6, 6), 1.0)
    problem, absolute = LCP(M, random.standard_normal(n) * unit), 10.0**exponent
    result = solve(
        problem,
        name,
        absolute_tolerance=absolute,
        tolerance=float(random.choice([1e-8, 1e-4, 0.0])),
    )
    largest, least = result.certificate.by_row.high, result.certificate.by_row.reference
    assert result.is_solved == bool(
        (largest <= np.maximum(result.tolerance * least, absolute)).all()
    )
    assert result.is_solved


def test_batches_marches_and_nonlinear_problems_take_it():
    """The same sentence holds for each problem of a batch, each step of a march, and F."""
    M, q = AT_REST
    batch = solve_batch([M, [[2.0, 0.0], [0.0, 2.0]]], [q, [-1.0, 1.0]], absolute_tolerance=1e-15)
    assert batch.all_solved
    steps = march(LCP(M, q), [q, q], propagator=0.0, absolute_tolerance=1e-15)
    assert len(steps) == 2
    assert steps.all_solved

    def F(x):
        return np.array(M) @ x + q + np.array([-1e-9, 0.0]) * x**2

    assert not solve(NonlinearProblem(F), x0=[0.0, 0.0]).is_solved
    assert solve(NonlinearProblem(F), x0=[0.0, 0.0], absolute_tolerance=1e-15).is_solved


@given(st.integers(0, 10**6))
def test_the_advised_number_is_enough(seed):
    """If the advice recommends an absolute tolerance, the same call with it is SOLVED."""
    random = np.random.default_rng(seed)
    n = int(random.integers(1, 5))
    M = random.integers(-3, 4, (n, n)).astype(float)
    q = np.where(
        random.random(n) < 0.5, 1e-17 * random.standard_normal(n), random.integers(-3, 4, n)
    )
    plain = solve(LCP(M, q))
    if "absolute_tolerance=" in plain.advice:
        value = float(plain.advice.split("absolute_tolerance=")[1].split()[0])
        assert solve(LCP(M, q), absolute_tolerance=value).is_solved


# --- Tolerated rows in random units ---


def drawn_in_units(rng: np.random.Generator) -> tuple[LCP, LCP]:
    """Return a chain, a directed graph or an M-matrix with few q_i ≠ 0, in random units of rows and unknowns.

    The second problem has other units of the rows.
    """
    n, kind = int(rng.integers(3, 8)), rng.integers(3)
    if kind == 2:
        N = rng.integers(0, 3, (n, n)) * (rng.random((n, n)) < 0.4)
        np.fill_diagonal(N, 0)
        diagonal = N.sum(1) + rng.integers(1, 3, n)
    else:
        N = np.tril(rng.integers(1, 4, (n, n)), -1)
        N = N * (rng.random((n, n)) < 0.5) if kind else np.diag(np.diag(N, -1), -1)
        diagonal = rng.integers(1, 4, n)
    q = np.where(rng.random(n) < 0.7, 0, rng.integers(-3, 3, n))
    q[rng.integers(n)] = -1
    columns = 2.0 ** rng.integers(-60, 61, n)
    M = (np.diag(diagonal) - N) * columns
    units = 1.0 / columns if rng.random() < 0.3 else 2.0 ** rng.integers(-60, 61, n)
    others = 2.0 ** rng.integers(-60, 61, n)
    one, other = (LCP(M * unit[:, None], q * unit) for unit in (units, others))
    return one, other


def floors(problem: LCP, parts: np.ndarray) -> np.ndarray:
    """Return the violation that passes in each idle row, 0 in the others, shape (n,)."""
    scale = problem.residual_scale
    sizes = np.abs(problem.q) / scale
    largest = np.array([sizes[parts == part].max() for part in parts])
    is_idle = (problem.q == 0.0) & (scale == problem.csr.diagonal())
    return np.where(is_idle, 2.0**-104 * scale * largest, 0.0)


@pytest.mark.quick(1)
@pytest.mark.parametrize("seed", range(20))
def test_tolerated_rows_in_random_units_result_is_right(seed, draws):
    """SOLVED means an error that 1e-6 of each row's terms explains, or 3e-8 of the component's largest unknown.

    In an idle row 2⁻¹⁰⁴ of the component's largest q_i/d_i explains an error also. The verdict is equal in all units.
    """
    rng = np.random.default_rng([87, seed])
    for _ in draws(500, 50):
        problem, other = drawn_in_units(rng)
        result = solve(problem)
        with np.errstate(all="ignore"):
            verdicts = [passes(one, result.z) for one in (problem, other)]
        assert verdicts[0] == verdicts[1] == result.is_solved
        if result.is_solved:
            right = exact_solution(problem).z
            parts = csgraph.connected_components(problem.csr, directed=False)[1]
            terms = abs(problem.csr) @ result.z + abs(problem.q)
            allowed = np.maximum(1e-6 * terms, floors(problem, parts))
            explained = exact_solution(LCP(problem.csr, -allowed)).z
            for i, part in enumerate(parts):
                size = max(abs(right[j]) for j in np.flatnonzero(parts == part))
                error = abs(Fraction(float(result.z[i])) - right[i])
                assert error <= 3e-8 * size + explained[i], (problem.M, problem.q)
