"""Derivatives of a solution: exact if they exist, one-sided if degenerate, otherwise errors."""

from __future__ import annotations

import itertools
import re
from fractions import Fraction

import numpy as np
import pytest
import scipy.sparse as sp
from campaigns import derivatives as campaign
from hypothesis import given, settings
from hypothesis import strategies as st
from inputs.drawn_scaling import scaled_solved, strict
from oracles.exact import LOWER, UPPER, exact_solution
from oracles.exact_derivatives import Change, Piece, distance, piece_at

from lcp_plugin import (
    LCP,
    BoundedLeastSquares,
    ConeProblem,
    FrictionalContact,
    InvalidOption,
    InvalidProblem,
    NonlinearProblem,
    QuadraticProgram,
    Status,
    UnsuitableProblem,
    derivative,
    solve,
    solve_batch,
)
from lcp_plugin.gallery.problems import five_point_matrix
from lcp_plugin.problems.sensitivity import Derivative
from lcp_plugin.strategies import h_plus_matrices, solved_lcps

STRICT = strict(solved_lcps(bounds=True))
ACCURACY = 1e-12
KINK = LCP([[2.0, 1.0], [1.0, 3.0]], [-2.0, -1.0])  # z = (1, 0), w = 0


def found_of(problem: LCP, **options: float) -> Derivative:
    return derivative(solve(problem, **options))


def piece_of(found: Derivative, z=None) -> Piece:
    """The piece on which the rows in `free` are free, at the exact solution where that is given."""
    return piece_at(found.problem, found.z if z is None else np.array(z, dtype=float), found.free)


def check_against(piece: Piece, found: Derivative, accuracy: float = ACCURACY) -> None:
    """Compare both products, in all data and to all data, with the exact piece."""
    assert not [*campaign.wrong_products(found, piece, np.random.default_rng(0), accuracy)]


# --- Exactness ----------------------------------------------------------------------------------------------


@settings.get_profile("few")
@given(STRICT | strict(solved_lcps(h_plus_matrices(density=0.5).map(sp.csr_array))))
def test_both_products_are_those_in_rational_arithmetic(drawn):
    """Products at the known solution are exact for M, q and bounds and all row types."""
    problem, z = drawn
    found = found_of(problem)
    piece = piece_of(found, z)
    assert found.z == pytest.approx(np.array(z, dtype=float), rel=1e-14, abs=1e-14)
    assert piece.is_strict
    assert found.degenerate.size == 0
    check_against(piece, found, accuracy=ACCURACY * campaign.condition(piece))


@settings.get_profile("few")
@given(scaled_solved(STRICT, 20, 20), st.integers(0, 9))
def test_units_of_rows_and_unknowns_do_not_matter(drawn, seed):
    """With rows and columns times 2^±20, dz has 12 digits of the largest scaled component."""
    problem, z = drawn
    found = found_of(problem)
    if not found.free.any() or not solve(problem).is_solved:
        return
    piece = piece_of(found, z)
    assert piece.is_solution
    dq = np.random.default_rng(seed).normal(size=problem.n) * problem.residual_scale
    change = Change(np.zeros((problem.n, problem.n)), dq, np.zeros(problem.n), np.zeros(problem.n))
    exact, dz = piece.jvp(change), found.jvp(dq=dq)
    F = piece.free
    terms = abs(np.linalg.inv(problem.csr.toarray()[np.ix_(F, F)])) @ abs(
        problem.csr.toarray()[np.ix_(F, F)]
    )
    size = terms @ abs(dz[F])
    assert all(
        abs(Fraction(dz[i]) - exact[i]) <= Fraction(1e-12 * size[k]) for k, i in enumerate(F)
    )


@pytest.mark.quick(3)
@pytest.mark.parametrize("kind", campaign.KINDS)
@pytest.mark.parametrize("family", campaign.FAMILIES)
def test_the_campaign_finds_nothing(family, kind):
    """Five random problems per family and class of the campaign pass."""
    for k in range(5):
        assert not [*campaign.faults(family, kind, 6, np.random.default_rng([7, k]))]


def test_the_gradient_by_the_matrix_has_its_pattern():
    """The gradient is a CSR array on the sparsity pattern of M, for dense and sparse M."""
    dense = campaign.h_plus(6, np.random.default_rng(2))
    for M in (dense, sp.csr_array(dense)):
        gradient = found_of(LCP(M, -np.ones(6))).vjp(np.ones(6)).M
        assert isinstance(gradient, sp.csr_array)
        assert np.array_equal(gradient.indices, sp.csr_array(dense).indices)
        assert np.array_equal(gradient.indptr, sp.csr_array(dense).indptr)


# --- Classification of rows ---------------------------------------------------------------------------------


@settings.get_profile("few")
@given(solved_lcps(bounds=True), st.integers(0, 99))
def test_planted_degenerate_rows_are_named(drawn, seed):
    """Never unique; jvp is the exact one-sided derivative, and vjp the gradient of the piece that `free` names."""
    problem, z = drawn
    found = found_of(problem)
    piece = piece_of(found, z)
    strict = Piece(
        problem,
        tuple(
            (UPPER if z[i] == problem.upper[i] else LOWER)
            if problem.lower[i] != problem.upper[i] and z[i] in (problem.lower[i], problem.upper[i])
            else state
            for i, state in enumerate(piece.states)
        ),
    )
    assert strict.is_solution
    assert found.degenerate.tolist() == strict.degenerate
    if strict.degenerate:
        assert found.is_unique is False
    if len(strict.degenerate) > 4:
        return
    rng = np.random.default_rng(seed)
    change, (g, gw) = Change.drawn(problem.n, rng), rng.normal(size=(2, problem.n))
    is_fixed = problem.lower == problem.upper
    change.dupper[is_fixed] = change.dlower[is_fixed]
    rows = sorted({*strict.free, *strict.degenerate})
    M = problem.csr.toarray()[np.ix_(rows, rows)]
    allowed = ACCURACY * (np.linalg.cond(M, np.inf) if rows else 1.0)
    assert distance(found.jvp(**change.arguments), strict.one_sided(change)) <= allowed
    gradient, exact = found.vjp(g, gw), piece.vjp(g, gw)
    assert set(piece.free) <= set(rows)
    assert distance(gradient.q, exact.q) <= allowed
    ends = [a + b for a, b in zip(exact.lower, exact.upper, strict=True)]
    assert distance(gradient.lower + gradient.upper, ends) <= allowed
    assert not (gradient.lower * gradient.upper).any()


def test_a_row_is_degenerate_to_the_rounding_of_others():
    """Row 0 with w₀ = z₁ is degenerate if z₁ = 0 is 4e-16 because of cancellation with z₂ = 3."""
    problem = LCP(
        [[2.0, 1.0, 0.0], [0.0, 5.0, 3.0], [0.0, 3.0, 4.0]],
        [0.0, -9.0, -12.0],
        lower=[0.0, -1.0, 2.0],
        upper=[1.0, 1.0, 4.0],
    )
    for start in (
        [0.0, 4.4408921e-16, 3.0],
        [0.0, -1e-15, 3.0],
        [0.0, 0.0, 3.0],
        [1e-17, 1e-18, 3.0 - 4e-16],
    ):
        found = derivative(solve(problem, z0=start))
        assert found.degenerate.tolist() == [0]
        assert found.jvp(dq=[-1.0, 0.0, 0.0]) == pytest.approx([0.5, 0.0, 0.0], abs=1e-15)
        assert found.jvp(dq=[1.0, 0.0, 0.0]) == pytest.approx([0.0, 0.0, 0.0], abs=1e-15)


@pytest.mark.quick(1)
@pytest.mark.parametrize("tolerance", [1e-3, 1e-8])
@pytest.mark.parametrize("scale", [1.0, 1e6])
def test_rows_are_settled_from_a_coarse_solution(tolerance, scale):
    """A z at tolerance 1e-3 is refined: rows and derivative agree with the exact solution."""
    rng = np.random.default_rng(3)
    for k, family in itertools.product(range(9), ("h_plus", "definite", "chain")):
        problem = campaign.drawn(family, campaign.KINDS[k % 3], 8, rng)
        result = solve(
            LCP(problem.csr * scale, problem.q * scale, lower=problem.lower, upper=problem.upper),
            "pgs",
            tolerance=tolerance,
            max_iterations=20_000,
        )
        if result.status is not Status.SOLVED:
            continue
        found = derivative(result)
        assert distance(found.z, exact_solution(result.certificate.problem).z) <= 1e-12
        check_against(piece_of(found), found, accuracy=1e-8)


# --- Which systems are solved -------------------------------------------------------------------------------


SINGULAR_ROOTS = ([[1.0], [1.0]], [[1.0, 2.0], [4.0, 5.0], [7.0, 8.0]], [[0.0]])


@pytest.mark.parametrize("root", SINGULAR_ROOTS)
def test_a_singular_block_has_the_derivative_of_least_change(root):
    """The derivative uses M⁺, also if rounding gives Cholesky a last pivot."""
    M, n = np.array(root) @ np.array(root).T, len(root)
    found, inverse = found_of(LCP(M, np.zeros(n), lower=-np.inf)), np.linalg.pinv(M)
    assert found.is_unique is False
    assert f"M has rank {np.linalg.matrix_rank(M)} on the {n} free rows" in found.advice
    assert "w the same for all of them" in found.advice
    within, g = M @ np.arange(1.0, n + 1), np.arange(2.0, n + 2)  # a change that M z can follow
    assert found.jvp(dq=within) == pytest.approx(-inverse @ within, rel=1e-12)
    assert found.vjp(g).q == pytest.approx(-inverse.T @ g, rel=1e-12)


def test_a_change_that_leaves_no_solution_is_refused_in_words():
    """If M_FF z_F cannot follow dq, jvp raises an error; the gradient of least change exists."""
    found = Derivative(LCP([[1.0, 1.0], [1.0, 1.0]], [-2.0, -2.0]), np.ones(2), np.zeros(2))
    with pytest.raises(UnsuitableProblem, match="after this change no z solves them"):
        found.jvp(dq=[1.0, -1.0])
    assert found.vjp([1.0, 1.0]).q == pytest.approx([-0.5, -0.5])


def convection(n: int, drift: float) -> sp.csr_array:
    """The five-point stencil on n × n points with upwind differences: a nonsymmetric M-matrix."""
    return five_point_matrix(n, 4.0 + 2.0 * drift + 1e-3, (-1.0 - drift, -1.0))


# --- Mistakes -----------------------------------------------------------------------------------------------


def test_what_is_not_solved_has_no_derivative():
    """UnsuitableProblem names the status and gives its advice."""
    stopped = solve(LCP(convection(20, 0.0), -np.ones(400)), "pgs", max_iterations=1)
    with pytest.raises(
        UnsuitableProblem,
        match="only a solution has a derivative, and this run ended MAX_ITERATIONS",
    ):
        derivative(stopped)
    infeasible = solve(LCP([[-1.0]], [-1.0]))
    with pytest.raises(UnsuitableProblem, match=infeasible.status.name):
        derivative(infeasible)


@pytest.mark.parametrize("call", [
    lambda found: found.jvp(dq=[1.0]), lambda found: found.jvp(dq=[1.0, np.nan]), lambda found: found.jvp(dM=[1.0]),
    lambda found: found.jvp(dM=np.eye(3)), lambda found: found.jvp(dM=[[np.inf, 0.0], [0.0, 0.0]]),
    lambda found: found.jvp(dlower=[1.0]), lambda found: found.jvp(dupper=np.nan), lambda found: found.jvp(dlower="a"),
    lambda found: found.jvp(dM=sp.eye_array(3)), lambda found: found.jvp(dq=[1.0, 1j]),
    lambda found: found.vjp([1.0]), lambda found: found.vjp([1.0, np.nan]), lambda found: found.vjp([1.0, 1.0], [1.0]),
    lambda found: found.dw([1.0]), lambda found: found.dw([1.0, 1.0], dq=[np.inf, 0.0]),
])  # fmt: skip
def test_wrong_shapes_and_numbers_are_refused(call):
    """InvalidProblem names the argument; the derivative stays usable."""
    found = found_of(LCP([[2, 1], [1, 2]], [-5, 1]))
    with pytest.raises(InvalidProblem, match=r"^(dM|dq|dlower|dupper|dz|g|gw) must be "):
        call(found)
    assert np.array_equal(found.jvp(dq=[1.0, 0.0]), [-0.5, 0.0])


@pytest.mark.parametrize("diagonal", [1e-6, 1e-9, 1e-12])
def test_a_tiny_diagonal_entry_makes_no_row_degenerate(diagonal):
    """Unknown z₀ = 1e-9 is determined by row 1 only, and free in spite of rounding at m₀₀."""
    M, z = np.array([[diagonal, 1.0], [-1.0, 1.0]]), np.array([1e-9, 1.0])
    found = derivative(solve(LCP(M, -M @ z)))
    assert found.degenerate.size == 0
    np.testing.assert_allclose(
        found.jvp(dq=[0, 1]), -np.linalg.solve(M, [0, 1]), rtol=1e-9, atol=1e-15
    )


@pytest.mark.parametrize("q", [-1e19, 1e19, -1e-17, 1e-9])
@pytest.mark.parametrize("coupling", [0.0, 1e-9, -1.0])
def test_a_row_of_another_size_hides_no_kink(q, coupling):
    """Rows 0 and 1, a kink and a free row, are unaffected by row 2 with q of another size."""
    M, z, w = np.array([[3.0, 1.0], [-1.0, 4.0]]), np.array([0.0, 2.0]), np.zeros(2)
    whole = np.block([[M, np.zeros((2, 1))], [np.array([[0.0, coupling, 1.0]])]])
    found = derivative(solve(LCP(whole, [*(w - M @ z), q])))
    assert found.degenerate.tolist() == [0]
    np.testing.assert_allclose(found.jvp(dq=[1, 0, 0])[:2], [0, 0], atol=1e-15)
    np.testing.assert_allclose(found.jvp(dq=[-1, 0, 0])[:2], [4 / 13, 1 / 13], rtol=1e-12)


FIT = BoundedLeastSquares(np.eye(2), [1.0, 2.0], lower=0.0, upper=[np.inf, 1.5])
PROGRAM = QuadraticProgram(2.0 * np.eye(2), [-2.0, -4.0], G=[[1.0, 1.0]], h=[2.0], lower=0.0)


def test_the_advice_for_a_program_works_as_it_is_written():
    """The call in the message for a program, for a list of results and for a mixed batch, executed."""
    both = solve_batch([PROGRAM, LCP([[1.0]], [1.0])])
    named = {"problem": PROGRAM, "results": [solve(PROGRAM), solve(FIT)], "batch": both}
    for name, subject in named.items():
        with pytest.raises(InvalidOption, match=r"write .*derivative\(") as refused:
            derivative(subject)
        call = str(refused.value).split("write ")[1]
        found = eval(call, {"derivative": derivative, "solve": solve, **named})
        first = found if name == "problem" else found[0]
        np.testing.assert_allclose(first.jvp(dc=[-1.0, 1.0]), [0.5, -0.5], atol=1e-8)


def test_the_advice_for_a_batch_of_other_classes_works_as_it_is_written():
    """Of LCPs of two sizes, contacts and nonlinear problems each answer has a derivative."""
    contact = FrictionalContact(np.eye(3), [-1.0, 3.0, 4.0], 0.5)
    curved = NonlinearProblem(lambda x: x - 1, lower=[0.0, 0.0])
    small = [LCP([[1.0]], [-1.0]), LCP(np.eye(2), [-1.0, 1.0])]
    for problems in (small, [contact] * 2, [curved] * 2):
        batch = solve_batch(problems)
        with pytest.raises(
            InvalidOption, match=r"write \[derivative\((\w+)\) for \1 in \w+\]"
        ) as e:
            derivative(batch)
        assert "from_qp" not in str(e.value)
        call = re.search(r"\[derivative.*\]", str(e.value))
        assert call is not None
        assert len(eval(call[0], {"derivative": derivative, "batch": batch, "results": batch})) == 2


def cases_of_each_class(rng: np.random.Generator) -> dict[str, tuple]:
    """Return what states a problem of each class, and the data that its derivative is by; solutions next to kinks."""
    A, b = rng.normal(size=(6, 6)), rng.normal(size=6)
    M, z, w = A @ A.T + np.eye(6), np.abs(b), np.array([0, 0, 1.0, 1e-3, 5e-7, 0])
    z[w > 0] = 0.0
    z[5] = 5e-7
    q, G, mu, ridge, l1 = w - M @ z, A[:2], np.full(2, 0.5), 0.1, np.full(6, 0.5)
    bounds, of_lcp = {"lower": np.zeros(6), "upper": np.full(6, np.inf)}, {"M": M, "q": q}
    of_rows = {"P": M, "c": q - G[0], "G": G, "h": G @ z + [0.0, 5e-7]}
    x = z + 0.25  # an l1 makes 0 a kink
    of_squares = {"b": A @ x - np.linalg.solve(A.T, w - ridge * x - l1), "weights": np.ones(6)}
    of_squares |= {"A": A, "l1": l1, "ridge": ridge, **bounds, "lower": np.full(6, 0.25)}
    cones = [("second_order", 3), ("nonnegative", 3)]

    def curved(q, lower, upper):
        return NonlinearProblem(
            lambda x: M @ x + x**3 - z**3 + q, lambda x: M + np.diag(3 * x**2), lower, upper
        )

    return {
        "LCP": (LCP, of_lcp | bounds),
        "NonlinearProblem": (curved, {"q": q} | bounds),
        "FrictionalContact": (
            lambda M, q, friction: FrictionalContact((M + M.T) / 2, q, friction),
            of_lcp | {"friction": mu},
        ),
        "ConeProblem": (lambda M, q: ConeProblem(M, q, cones), of_lcp),
        "QuadraticProgram": (QuadraticProgram, of_rows | bounds),
        "BoundedLeastSquares": (BoundedLeastSquares, of_squares),
    }


@pytest.mark.parametrize("is_batch", [False, True])
@pytest.mark.parametrize("name", cases_of_each_class(np.random.default_rng(0)))
def test_in_every_class_jvp_is_a_difference_and_vjp_its_transpose(name, is_batch):
    """By all data at once, ⟨g, J d⟩ = ⟨Jᵀg, d⟩, for solutions 1e-3 and 5e-7 from a kink, alone and in a batch."""
    for seed in range(5):
        rng = np.random.default_rng([7, seed])
        state, data = cases_of_each_class(rng)[name]
        problem, options = state(**data), {"tolerance": 1e-13}
        options |= {"x0": np.ones(6)} if name == "NonlinearProblem" else {}
        if is_batch and name in ("NonlinearProblem", "ConeProblem"):
            return
        if is_batch and name == "FrictionalContact":
            problem = FrictionalContact.worlds(problem.W, problem.b[None], problem.friction)
            result = solve_batch(problem, **options)
        else:
            result = solve_batch([problem]) if is_batch else solve(problem, **options)
        d = {key: rng.normal(size=np.shape(value)) for key, value in data.items()}
        d |= {"P": d["P"] + d["P"].T} if "P" in d else {}
        d |= {"M": d["M"] + d["M"].T} if "friction" in d else {}
        found, g = derivative(result), rng.normal(size=6)
        gradient, dz = found.vjp(g), found.jvp(**{f"d{key}": one for key, one in d.items()})
        by = {key: getattr(gradient, key) for key in d}
        by |= {"M": by["M"][0]} if isinstance(by.get("M"), list) else {}
        parts = {
            key: one.toarray() if sp.issparse(one) else np.asarray(one) for key, one in by.items()
        }
        terms = [np.sum(parts[key].reshape(np.shape(d[key])) * d[key]) for key in d]
        assert np.ravel(dz) @ g == pytest.approx(
            sum(terms), abs=1e-12 * (1.0 + np.abs(terms).sum())
        )
        ahead, behind = (
            solve(state(**{key: one + t * d[key] for key, one in data.items()}), **options).x
            for t in (1e-8, -1e-8)
        )
        np.testing.assert_allclose(
            np.ravel(dz), (ahead - behind) / 2e-8, atol=1e-4 * (1.0 + np.abs(dz).max())
        )


@pytest.mark.parametrize("power", [0.0, 0.1])
def test_the_advice_names_a_split_that_is_not_unique(power):
    """Two classes of vehicles on two routes: only their sum is determined, linear or not, also if one flow is 0."""
    R, E = np.tile(np.eye(2), (2, 2)), np.kron(np.eye(2), np.ones((1, 2)))
    M = np.block([[R, -E.T], [E, np.zeros((2, 2))]])
    q, free = np.array([1, 1.5, 1, 1.5, -2, -1]), [-np.inf, -np.inf]

    def F(x):
        return M @ x + q + np.append(power * (R @ x[:4]) ** 4, [0, 0])

    def slope(x):
        steeper = 4 * power * (R @ x[:4]) ** 3
        return M + np.pad(steeper[:, np.newaxis] * R, ((0, 2), (0, 2)))

    names = ["car 0", "car 1", "truck 0", "truck 1", "u", "v"]
    problem = NonlinearProblem(F, slope, lower=[0, 0, 0, 0, *free], names=names)
    found = derivative(solve(problem, x0=np.array([0.6, 1.4, 1.0, 0.0, 3.0, 3.0])))
    assert not found.is_unique
    assert "other solutions differ in car 0, car 1, truck 0, truck 1" in found.advice


def test_a_consistent_change_of_a_repeated_equation_has_a_derivative():
    """z₀ = 1 stands twice: dq of the first row moves z₁ + z₂ alone, by the least change (0, 1/2, 1/2)."""
    problem = LCP([[1.0, -1, -1], [1, 0, 0], [1, 0, 0]], [-3.0, -1, -1], lower=-np.inf)
    found = derivative(solve(problem)).jvp(dq=[1.0, 0, 0])
    np.testing.assert_allclose(found, [0.0, 0.5, 0.5], atol=1e-12)
