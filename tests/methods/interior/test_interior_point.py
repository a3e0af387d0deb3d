"""The interior point reaches rounding level on every monotone problem, whatever its bounds and its rank."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.optimize import linprog

from lcp_plugin import LCP, solve
from lcp_plugin.core.checks import FloatVector
from lcp_plugin.core.matrix.scaling import scaled
from lcp_plugin.core.settings import Status
from lcp_plugin.methods.interior.interior_point import InteriorPoint, Search
from lcp_plugin.methods.interior.kernels import interior_steps, triangles
from lcp_plugin.methods.interior.newton_matrix import DenseNewtonMatrix, SparseNewtonMatrix
from lcp_plugin.methods.interior.primal_active_set import NotConvex, PrimalActiveSet, UpdatedFactor
from lcp_plugin.methods.interior.quasidefinite import QuasidefiniteNewtonMatrix, Symbolic, signs_of
from lcp_plugin.methods.interior.suited_matrix import equilibration, suited
from lcp_plugin.problems.programs.conversion import QuadraticProgram, lcp_from_qp
from lcp_plugin.systems.symmetry import is_symmetric_to_rounding


def random_matrix(kind: str, n: int, rng: np.random.Generator) -> Any:
    """A monotone matrix of the kind."""
    B = rng.standard_normal((n, n))
    half = B[:, : max(1, n // 2)]
    return {
        "definite": B @ B.T + 0.1 * np.eye(n),
        "rank-deficient": half @ half.T,
        "nonsymmetric": half @ half.T + B - B.T,
        "skew": B - B.T,
        "zero": np.zeros((n, n)),
    }[kind]


def random_bounds(kind: str, n: int, rng: np.random.Generator) -> tuple[Any, Any]:
    """Bounds: plain, or one-sided of both kinds, boxed, free and fixed rows mixed."""
    lower, upper = np.zeros(n), np.full(n, np.inf)
    if kind == "mixed":
        row = rng.integers(0, 5, n)
        lower = np.where(row <= 1, -np.inf, rng.integers(-3, 3, n).astype(float))
        upper = np.where((row == 1) | (row == 2), np.inf, np.where(row == 0, 1.0, lower + rng.random(n) + 0.1))
        upper = np.where(row == 4, lower, upper)
    return lower, upper


def with_answer(M: Any, lower: Any, upper: Any, rng: np.random.Generator, degenerate: float = 0.2) -> LCP:
    """A problem whose answer was chosen first, part of its rows with both distance and slack 0."""
    n = lower.size
    bound = np.where(rng.random(n) < 0.5, lower, upper)
    z = np.where((rng.random(n) < 0.5) & np.isfinite(bound), bound, np.clip(rng.standard_normal(n), lower, upper))
    size = np.where(rng.random(n) < degenerate, 0.0, rng.random(n))
    w = np.where(z == lower, size, 0.0) - np.where((z == upper) & (z != lower), size, 0.0)
    return LCP(M, w - M @ z, lower=lower, upper=upper)


@pytest.mark.parametrize("bounds", ["plain", "mixed"])
@pytest.mark.parametrize("storage", ["dense", "sparse"])
@pytest.mark.parametrize("kind", ["definite", "rank-deficient", "nonsymmetric", "skew", "zero"])
def test_solves_monotone_problems(kind: str, storage: str, bounds: str) -> None:
    """Every monotone problem with a known answer is solved to 1e-10, degenerate rows included."""
    for seed in range(6):
        rng = np.random.default_rng(seed)
        n = [1, 2, 5, 12, 30, 200][seed]
        M = random_matrix(kind, n, rng)
        if storage == "sparse":
            M = sp.csr_array(np.where(rng.random((n, n)) < 0.2, M, 0.0)) if kind == "zero" else sp.csr_array(M)
        result = solve(with_answer(M, *random_bounds(bounds, n, rng), rng), InteriorPoint(), tolerance=1e-10)
        assert result.status in (Status.SOLVED, Status.PRECISION_LIMIT), (seed, result.certificate)
        assert result.iterations <= 40


def test_empty_and_fixed_problems() -> None:
    """Nothing to decide is no special case: n = 0, and all rows fixed."""
    assert solve(LCP(np.zeros((0, 0)), []), InteriorPoint()).status is Status.SOLVED
    fixed = LCP([[1.0, 2.0], [3.0, 4.0]], [-9.0, 9.0], lower=[1.0, 2.0], upper=[1.0, 2.0])
    assert solve(fixed, InteriorPoint()).z.tolist() == [1.0, 2.0]


@pytest.mark.parametrize("condition", [1e2, 1e6, 1e8])
@pytest.mark.parametrize("active", [0.3, 0.7])
def test_ill_conditioned_dense_problem_needs_few_factors(condition: float, active: float) -> None:
    """Dense SPD, n = 200: natural residual at rounding level after work of less than ten full Cholesky factors."""
    n, rng = 200, np.random.default_rng(1)
    vectors, _ = np.linalg.qr(rng.standard_normal((n, n)))
    M = (vectors * np.geomspace(1.0, 1.0 / condition, n)) @ vectors.T
    M = 0.5 * (M + M.T)
    is_active = rng.random(n) < active
    z, w = np.where(is_active, 0.0, rng.random(n)), np.where(is_active, rng.random(n), 0.0)
    result = solve(LCP(M, w - M @ z), InteriorPoint(), tolerance=1e-13)
    assert result.status is Status.SOLVED
    assert np.max(np.abs(result.z - z)) <= 1e-13 * condition
    assert result.work <= 10 * n / 6 + 60


@pytest.mark.parametrize("skew", [0.0, 1e-6])
@pytest.mark.parametrize("n", [60, 200])
def test_an_answer_much_larger_than_q_takes_a_dozen_steps(n: int, skew: float) -> None:
    """Eigenvalues from 1 to 1e-8 and q ~ 1: z is 1e4 times as large as w, and no path of short steps leads there."""
    rng = np.random.default_rng(1)
    orthogonal, _ = np.linalg.qr(rng.standard_normal((n, n)))
    M = (orthogonal * np.logspace(0, -8, n)) @ orthogonal.T
    turn = rng.standard_normal((n, n))
    problem = LCP((M + M.T) / 2.0 + skew * (turn - turn.T), rng.standard_normal(n))
    result = solve(problem, "interior_point")
    assert result.is_solved
    assert result.z.max() > 1e3 * result.w.max()
    assert result.iterations <= 20


def test_contact_matrix_of_low_rank() -> None:
    """A Delassus matrix J W Jᵀ with more contacts than freedoms: w is the known one, z one of many."""
    rng = np.random.default_rng(3)
    J = rng.standard_normal((60, 24))
    M = J @ np.diag(rng.random(24) + 0.1) @ J.T
    z = np.maximum(rng.standard_normal(60), 0.0)
    w = np.where(z > 0.0, 0.0, rng.random(60))
    result = solve(LCP(M, w - M @ z), InteriorPoint(), tolerance=1e-12)
    assert result.status is Status.SOLVED
    np.testing.assert_allclose(result.w, w, atol=1e-11)


def test_interior_steps_take_over_where_the_first_guess_is_poor() -> None:
    """With no budget for the guess the interior point alone converges to the same answer."""
    problem = with_answer(random_matrix("definite", 50, np.random.default_rng(0)), np.zeros(50), np.full(50, np.inf),
                          np.random.default_rng(1), degenerate=0.0)
    guessed = solve(problem, InteriorPoint(), tolerance=1e-12)
    sparse = solve(LCP(sp.csr_array(problem.M) + sp.csr_array(([1e-9], ([0], [49])), shape=(50, 50)), problem.q),
                   InteriorPoint(), tolerance=1e-12)
    assert guessed.iterations <= 3 < sparse.iterations
    np.testing.assert_allclose(guessed.z, sparse.z, atol=1e-6)


@pytest.mark.parametrize("seed", range(6))
def test_linear_programs_agree_with_highs(seed: int) -> None:
    """P = 0, redundant equalities, a degenerate vertex: the objective is that of HiGHS."""
    rng = np.random.default_rng(seed)
    n, m = 20, 12
    G, A = rng.standard_normal((m, n)), rng.standard_normal((3, n))
    A = np.vstack([A, A[0] + A[1], 2.0 * A[2]])
    x = np.where(rng.random(n) < 0.5, 0.0, rng.random(n))
    multiplier = np.maximum(rng.standard_normal(m), 0.0)
    c = -(G.T @ multiplier + A.T @ rng.standard_normal(5) - np.where(x == 0.0, rng.random(n), 0.0))
    h = G @ x + np.where(multiplier > 0.0, 0.0, rng.random(m) * (rng.random(m) < 0.5))
    problem = lcp_from_qp(QuadraticProgram(np.zeros((n, n)), c, G, h, A, A @ x, lower=0.0), "kkt")
    solution = problem.origin.recover(solve(problem, InteriorPoint(), tolerance=1e-10))
    truth = linprog(c, G, h, A, A @ x, bounds=(0.0, None), method="highs").fun
    assert solution.error <= 1e-9
    assert abs(solution.objective - truth) <= 1e-8 * (1.0 + abs(truth))


def test_unsolvable_problem_ends_by_itself() -> None:
    """Where w = −1 whatever z ≥ 0 is, the run ends without success and without a limit."""
    result = solve(LCP(np.zeros((2, 2)), [-1.0, 1.0]), InteriorPoint())
    assert result.status is not Status.SOLVED
    assert result.iterations < 500


def test_units_do_not_matter() -> None:
    """Congruence by powers of two leaves the number of steps and the answer alone."""
    rng = np.random.default_rng(4)
    M, n = random_matrix("nonsymmetric", 40, rng), 40
    problem = with_answer(M, *random_bounds("mixed", n, rng), rng)
    c = np.ldexp(1.0, rng.integers(-10, 10, n))
    other = LCP(M * c[:, None] * c, problem.q * c, lower=problem.lower / c, upper=problem.upper / c)
    first, second = (solve(p, InteriorPoint(), tolerance=1e-11) for p in (problem, other))
    assert (first.status, second.status) == (Status.SOLVED, Status.SOLVED)
    np.testing.assert_allclose(second.w / c, first.w, atol=1e-8)


def test_updated_factor_is_that_of_the_present_rows() -> None:
    """After any sequence of joins and leaves L Lᵀ is the block of the present rows, in their order."""
    rng = np.random.default_rng(0)
    n = 30
    M = random_matrix("definite", n, rng)
    order, L = np.empty(n, dtype=np.intp), np.empty((n, n))
    size = triangles.join(M, 0.0, L, order, 0, np.flatnonzero(rng.random(n) < 0.5))
    for _ in range(40):
        j = int(rng.integers(n))
        place = np.flatnonzero(order[:size] == j)
        if place.size:
            triangles.leave(L, order, size, int(place[0]), np.empty(size), np.empty(size))
            size -= 1
        else:
            size = triangles.join(M, 0.0, L, order, size, np.array([j]))
        factor, rows = np.tril(L[:size, :size]), order[:size]
        np.testing.assert_allclose(factor @ factor.T, M[np.ix_(rows, rows)], rtol=1e-12, atol=1e-12)
        x, right = np.zeros(n), rng.standard_normal(n)
        x[:size] = right[rows]
        triangles.forward(L, size, x)
        triangles.backward(L, size, x)
        np.testing.assert_allclose(x[:size], np.linalg.solve(M[np.ix_(rows, rows)], right[rows]), atol=1e-9)


def test_a_row_that_makes_the_block_singular_does_not_join() -> None:
    """Where the new pivot is rounding, the size is −1; a factor of both rows is shifted."""
    order, L = np.empty(2, dtype=np.intp), np.empty((2, 2))
    assert triangles.join(np.ones((2, 2)), 0.0, L, order, 0, np.arange(2)) == -1
    assert UpdatedFactor(np.ones((2, 2)), np.arange(1)).join(np.arange(1, 2)) is False


def test_a_factor_refuses_an_indefinite_block() -> None:
    """A block with a clearly negative eigenvalue is refused, a singular one shifted."""
    with pytest.raises(NotConvex):
        UpdatedFactor(np.array([[1.0, 2.0], [2.0, 1.0]]), np.arange(2))
    assert 0.0 < UpdatedFactor(np.ones((2, 2)), np.arange(2)).shift <= 1e-9


def test_energy_falls_at_every_factor() -> None:
    """The primal active set method never raises ½ zᵀM z + qᵀz, and ends at a point without wrong signs."""
    rng = np.random.default_rng(7)
    n = 120
    M, q = random_matrix("rank-deficient", n, rng), rng.standard_normal(n)
    q = M @ q + np.abs(rng.standard_normal(n))
    primal = PrimalActiveSet(M, q, np.zeros(n), np.full(n, 2.0))
    primal.start(rng.random(n), rng.random(n) < 0.5)
    energies = [primal.z @ (0.5 * M @ primal.z + q)]
    for _ in primal.steps(10_000):
        energies.append(primal.z @ (0.5 * M @ primal.z + q))
        assert np.all((primal.z >= 0.0) & (primal.z <= 2.0))
    assert primal.is_solved
    assert np.all(np.diff(energies) <= 1e-9 * np.abs(energies[:-1]))


@pytest.mark.parametrize("n", [1, 7, 200])
def test_newton_matrices_solve_their_system(n: int) -> None:
    """Dense and sparse factors agree with LAPACK on M + diag, at the first and at later factorisations."""
    rng = np.random.default_rng(n)
    B = sp.random_array((n, n), density=min(1.0, 5.0 / n), rng=rng)
    M = sp.csr_array(B @ B.T + B - B.T)
    for matrix in (DenseNewtonMatrix(M.toarray(), False), SparseNewtonMatrix(M)):
        for _ in range(3):
            diagonal, right = 10.0 ** rng.uniform(-3, 3, n), rng.standard_normal(n)
            assert matrix.factorise(diagonal)
            expected = np.linalg.solve(M.toarray() + np.diag(diagonal), right)
            np.testing.assert_allclose(matrix.solve(right), expected, rtol=1e-9, atol=1e-12)


def test_singular_newton_matrix_is_regularised() -> None:
    """A singular, consistent system is solved although its factor is that of a regularised one."""
    A = np.ones((2, 3))
    M = sp.csr_array(np.block([[np.eye(3), A.T], [-A, np.zeros((2, 2))]]))
    right = M @ np.arange(5.0)
    programs = QuasidefiniteNewtonMatrix(M, np.repeat([1.0, -1.0], [3, 2]))
    for matrix in (SparseNewtonMatrix(M), DenseNewtonMatrix(M.toarray(), False), programs):
        assert matrix.factorise(np.zeros(5))
        np.testing.assert_allclose(M @ matrix.solve(right), right, atol=1e-9)


@pytest.mark.parametrize("n", [1, 30, 300])
def test_ldl_solves_the_systems_of_programs(n: int) -> None:
    """LDLᵀ agrees with LAPACK on [P + D, Aᵀ; −A, E], rows in any order, at the first and at later factorisations."""
    rng = np.random.default_rng(n)
    B, A = (sp.random_array((n, n), density=min(1.0, 3.0 / n), rng=rng) for _ in range(2))
    order = rng.permutation(2 * n)
    P = B @ B.T
    M = sp.csr_array(sp.csr_array(sp.block_array([[P + P.T, A.T], [-A, None]]))[order][:, order])
    M.sort_indices()
    signs = signs_of(M)
    assert signs is not None
    matrix = QuasidefiniteNewtonMatrix(M, signs)
    for _ in range(3):
        diagonal, right = 10.0 ** rng.uniform(-3, 3, 2 * n), rng.standard_normal(2 * n)
        assert matrix.factorise(diagonal)
        expected = np.linalg.solve(M.toarray() + np.diag(diagonal), right)
        np.testing.assert_allclose(matrix.solve(right), expected, rtol=1e-6, atol=1e-8 * np.abs(expected).max())


def random_program(n: int, rng: np.random.Generator) -> tuple[sp.csr_array, FloatVector]:
    """Return the sparse matrix of a program with n unknowns and n multipliers, and its signs."""
    A = sp.random_array((n, n), density=0.2, rng=rng, data_sampler=rng.standard_normal)
    return sp.csr_array(sp.block_array([[sp.eye_array(n), A.T], [-A, None]])), np.repeat([1.0, -1.0], n)


@pytest.mark.parametrize("n", [1, 7, 60])
def test_a_pattern_handed_on_changes_no_bit(n: int) -> None:
    """A factor in the order and pattern that another matrix has found solves to the same bits as one in its own."""
    rng = np.random.default_rng(n)
    M, signs = random_program(n, rng)
    symbolic = Symbolic.of(M)
    kept = [part.copy() for part in symbolic.pattern]
    for _ in range(3):
        numbers = rng.uniform(0.5, 2.0, (2 * n, 1))
        other = sp.csr_array(M * numbers * numbers.T)
        matrices = [QuasidefiniteNewtonMatrix(other, signs, handed_on) for handed_on in (symbolic, None)]
        assert matrices[0].symbolic is symbolic
        diagonal, right = 10.0 ** rng.uniform(-3, 3, 2 * n), rng.standard_normal(2 * n)
        assert all(matrix.factorise(diagonal) for matrix in matrices)
        assert np.array_equal(*(matrix.solve(right) for matrix in matrices))
    assert all(map(np.array_equal, symbolic.pattern, kept))


def test_a_pattern_that_does_not_fit_is_not_used() -> None:
    """A matrix with entries elsewhere makes its own pattern, and solves its own system."""
    rng = np.random.default_rng(0)
    (M, signs), (other, _) = random_program(20, rng), random_program(20, rng)
    matrix = QuasidefiniteNewtonMatrix(M, signs, Symbolic.of(other))
    assert matrix.symbolic.fits(M)
    assert matrix.factorise(np.ones(40))
    right = rng.standard_normal(40)
    np.testing.assert_allclose(M @ matrix.solve(right) + matrix.solve(right), right, atol=1e-10)


@pytest.mark.parametrize("fixed", [0, 5])
def test_a_resolve_finds_what_the_first_solve_knew_of_the_matrix(fixed: int) -> None:
    """Problems that share their matrix share its units, order and pattern; what was solved before changes no bit."""
    rng = np.random.default_rng(3)
    M, _ = random_program(40, rng)
    q, lower, upper = rng.standard_normal((2, 80)), np.repeat([-1.0, 0.0], 40), np.full(80, np.inf)
    upper[:fixed] = lower[:fixed]
    kept = np.arange(fixed, 80) if fixed else None
    first = LCP(M, q[0], lower=lower, upper=upper)
    second = first.with_q(q[1])
    assert solve(first, "interior_point").status is Status.SOLVED
    known = suited(first.matrix, kept)
    assert solve(second, "interior_point").status is Status.SOLVED
    assert suited(second.matrix, kept) is known
    alone = solve(LCP(M, q[1], lower=lower, upper=upper), "interior_point")
    assert np.array_equal(solve(second, "interior_point").z, alone.z)
    assert suited(second.matrix, np.arange(10)).M.shape == (10, 10)


def test_pinned_rows_stay_and_free_ones_are_solved_for() -> None:
    """The factor of the whole matrix, some rows pinned, solves the block of the others as well as its own would."""
    rng = np.random.default_rng(4)
    for _ in range(20):
        M, _ = random_program(15, rng)
        search = Search(LCP(M, rng.standard_normal(30), lower=-1.0, upper=1.0))
        n = search.q.size  # but for an unknown that meets no other
        free = np.flatnonzero((rng.random(n) < 0.5) | (search.signs > 0.0))
        before = rng.standard_normal(n)
        y = before.copy()
        assert search._solve_for(y, free) > 0.0
        pinned = np.setdiff1d(np.arange(n), free)
        assert np.array_equal(y[pinned], before[pinned])
        block, right = search.M[free][:, free].toarray(), (search.M[:, pinned] @ before[pinned] + search.q)[free]
        expected = np.linalg.lstsq(block, -right, rcond=None)[0]
        missed = [np.abs(block @ found + right).max() for found in (y[free], expected)]
        assert missed[0] <= 10.0 * missed[1] + 1e-8


def test_signs_are_found_or_there_are_none() -> None:
    """diag(s) M is symmetric for the signs that are found; where no choice of them is right none are."""
    rng = np.random.default_rng(0)
    for _ in range(50):
        n = int(rng.integers(1, 12))
        S = rng.integers(-2, 3, (n, n)) * (rng.random((n, n)) < 0.4)
        s = rng.choice([-1.0, 1.0], n)
        M = sp.csr_array(s[:, None] * (S + S.T).astype(float))
        found = signs_of(M)
        assert found is not None
        assert (np.diag(found) @ M.toarray() == (np.diag(found) @ M.toarray()).T).all()
    triangle = np.array([[0.0, 1.0, 1.0], [-1.0, 0.0, 1.0], [-1.0, -1.0, 0.0]])  # all three oppose each other
    assert signs_of(sp.csr_array(triangle)) is None
    assert signs_of(sp.csr_array(np.triu(triangle))) is None


def test_a_useless_factor_is_made_again_with_more_regularisation() -> None:
    """A zero pivot, about which an updated factor says nothing, is seen; the system is solved all the same."""
    M = sp.csr_array([[0.0, 1.0, 1.0], [-1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
    matrix = QuasidefiniteNewtonMatrix(M, np.array([1.0, -1.0, -1.0]))
    matrix.state[interior_steps.NOW] = matrix.state[interior_steps.LEAST] = interior_steps.SMALLEST_REGULARISATION
    for diagonal in (np.ones(3), np.zeros(3), np.ones(3)):
        assert matrix.factorise(diagonal)
        right = (M + sp.diags_array(diagonal)) @ np.array([1.0, 2.0, 3.0])
        np.testing.assert_allclose((M + sp.diags_array(diagonal)) @ matrix.solve(right), right, atol=1e-9)


def test_equilibration_evens_rows_and_keeps_symmetry() -> None:
    """The factors are alike on both sides, and rows differ afterwards by no more than 16."""
    rng = np.random.default_rng(0)
    size = 10.0 ** rng.uniform(-6, 6, 20)
    M = random_matrix("definite", 20, rng) * size[:, None] * size
    M = np.maximum(M, M.T)
    for matrix in (M, sp.csr_array(M)):
        exponents = equilibration(matrix)
        assert exponents is not None
        assert np.array_equal(exponents.row, exponents.column)
        largest = abs(scaled(matrix, exponents)).max(axis=1)
        largest = largest.toarray().ravel() if sp.issparse(largest) else largest
        assert largest.max() <= 16.0 * largest.min()
    assert is_symmetric_to_rounding(scaled(M, equilibration(M)))
    M[0, 19] *= 1.0 + 1e-9
    assert not is_symmetric_to_rounding(M)


def test_steps_never_get_worse() -> None:
    """Each step carries the best z so far and exactly its residual."""
    from lcp_plugin.core.certificates.residuals import Certificate

    rng = np.random.default_rng(5)
    problem = with_answer(random_matrix("nonsymmetric", 30, rng), *random_bounds("mixed", 30, rng), rng)
    last = np.inf
    for k, step in enumerate(InteriorPoint().iterates(problem, problem.nearest_to_zero.copy())):
        assert np.all((step.z >= problem.lower) & (step.z <= problem.upper))
        if step.residual is not None:
            assert step.residual == Certificate.of(problem, step.z).scaled_residual
            assert step.residual <= last
            last = step.residual
        assert k < 300
    assert last <= 1e-12


def test_a_gap_that_falls_is_improvement_where_the_residual_hides_it() -> None:
    """Residuals of few equations more than barely consistent, z ≥ 0: every w is 0 at the answer, and steps go on."""
    rng = np.random.default_rng(1)
    A, x = rng.standard_normal((300, 600)), rng.standard_normal(600) * (rng.random(600) < 0.1)
    b = A @ x + 0.1 * rng.standard_normal(300)
    P = A.T @ A
    assert solve(LCP(0.5 * (P + P.T), -A.T @ b), "interior_point").status is Status.SOLVED
