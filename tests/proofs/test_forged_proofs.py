"""Every proof with one part missing, one number changed or one sign turned; every measure with both sides violated.

Whether a forged proof still holds is decided in fractions, from the definition of the proof.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from campaigns.best_equilibria import undetected

from lcp_plugin import (
    LCP,
    ConeProblem,
    EquilibriumProgram,
    FrictionalContact,
    NonlinearProblem,
    QuadraticProgram,
    analyze,
    certify,
    solve,
)
from lcp_plugin.methods.search import search
from lcp_plugin.problems.cones.certificate import ContactInfeasibility
from lcp_plugin.problems.programs.value_bounds import distance_of_equations
from lcp_plugin.proofs.no_solution import Case, Infeasibility, NoSolution

Numbers = Sequence[Fraction]


def forged(y: Sequence[Any]) -> Iterator[list[Fraction]]:
    """Yield the vector with an entry missing, changed by a thousandth, or with the other sign, each in turn."""
    exact = [Fraction(one) for one in y]
    for k, one in enumerate(exact):
        for other in (Fraction(0), one * Fraction(1001, 1000), -one):
            if one:
                yield [*exact[:k], other, *exact[k + 1 :]]
    yield [-one for one in exact]


def product(matrix: Any, y: Numbers) -> list[Fraction]:
    """Return Mᵀy in fractions."""
    return [dot(column, y) for column in np.asarray(matrix, dtype=float).T]


def dot(q: Any, y: Numbers) -> Fraction:
    return sum((Fraction(float(one)) * v for one, v in zip(q, y, strict=True)), Fraction(0))


def closes(problem: LCP, path: dict[int, str], y: Numbers) -> bool:
    """Return whether y is a Farkas vector of a piece, with bounds 0 and ∞: sup yᵀ(Mz + q − w) < 0."""
    pull = product(problem.csr.toarray(), y)
    signs = all(v >= 0 or path.get(i) == "zero" for i, v in enumerate(y))
    return (
        signs
        and all(v <= 0 or path.get(j) == "lower" for j, v in enumerate(pull))
        and dot(problem.q, y) < 0
    )


def refuses(proof: Any) -> bool:
    """Return whether a proof that does not hold has no margin, and excludes nothing."""
    return not proof.verify() and proof.margin == 0.0 and not proof.excludes(1e-300)


def test_a_forged_contradiction_of_an_lcp_is_refused():
    """By one row, two rows, and a row with a bound."""
    for M, q in (
        ([[-1.0, 0], [0, 1]], [-1, 2]),
        ([[1.0, -1], [-1, 1]], [-1, -1]),
        ([[1.0, -2], [-2, 3]], [-1, -1]),
    ):
        problem = LCP(M, q)
        proof = solve(problem).proof
        assert isinstance(proof, Infeasibility)
        assert closes(problem, {}, proof.exact_y)
        assert proof.verify()
        for y in forged(proof.exact_y):
            other = replace(proof, exact_y=tuple(y))
            assert other.verify() == closes(problem, {}, y)
            assert other.verify() or refuses(other)


def leaves(tree: Case, path: dict[int, str]) -> Iterator[tuple[Case, dict[int, str]]]:
    if tree.row < 0:
        yield tree, path
    for choice, branch in tree.branches.items():
        yield from leaves(branch, path | {tree.row: choice})


def with_leaf(tree: Case, leaf: Case, other: Case | None) -> Case:
    """Return the tree with another leaf, or without this one."""
    if tree is leaf:
        assert other is not None
        return other
    kept = {choice: one for choice, one in tree.branches.items() if one is not leaf or other}
    return Case(
        tree.row, {choice: with_leaf(one, leaf, other) for choice, one in kept.items()}, tree.y
    )


def test_a_forged_tree_of_cases_is_refused():
    """With an open piece, a missing piece, a Farkas vector of another piece, of a changed number or of another sign."""
    problem = LCP([[1.0, -2.0, 1.0], [-3.0, 2.0, -2.0], [1.0, -2.0, 0.0]], [-1.0, 2.0, 2.0])
    proof = search(problem)
    assert isinstance(proof, NoSolution)
    assert proof.verify()
    assert proof.excludes(1e-8)
    pieces = [*leaves(proof.tree, {})]
    assert len(pieces) > 1
    for leaf, path in pieces:
        assert leaf.y is not None
        assert closes(problem, path, [Fraction(one) for one in leaf.y])
        both = Case(branches={"lower": leaf}, y=leaf.y)
        for without in (Case(), None, both):
            assert refuses(NoSolution(problem, with_leaf(proof.tree, leaf, without)))
        for y in [*forged(leaf.y), *(one.y for one, _ in pieces)]:
            other = NoSolution(problem, with_leaf(proof.tree, leaf, Case(y=y)))
            assert other.verify() == closes(problem, path, [Fraction(one) for one in y])
            assert other.verify() or refuses(other)
    split = Case(proof.tree.row, proof.tree.branches)
    assert refuses(NoSolution(problem, Case(proof.tree.row, dict.fromkeys(split.branches, split))))


def test_forged_multipliers_of_inconsistent_constraints_are_refused():
    """Of rows, equations and bounds on both sides: Cᵀy = 0, y ≥ 0 for inequalities, dᵀy < 0."""
    upper = QuadraticProgram(None, [0.0, 0], [[1.0, 1]], [1.0], lower=[1.0, 1.0])
    lower = QuadraticProgram(None, [0.0, 0], [[-1.0, -1]], [-3.0], upper=1.0)
    equations = QuadraticProgram(None, [0.0, 0], A=[[1.0, 1], [2.0, 2]], b=[1.0, 3.0])
    for program in (upper, lower, equations):
        proof, rows = solve(program).proof, program.constraints
        C, is_equation = rows.matrix.toarray(), rows.is_equality.tolist()
        finite = np.where(np.isfinite(rows.limit), rows.limit, 0.0)

        def holds(y, C=C, finite=finite, is_equation=is_equation):
            signs = all(v >= 0 or free for v, free in zip(y, is_equation, strict=True))
            return signs and not any(product(C, y)) and dot(finite, y) < 0

        assert proof.verify()
        assert holds(proof.multipliers)
        for y in forged(proof.multipliers):
            other = replace(proof, multipliers=tuple(y))
            assert other.verify() == holds(y)
            assert other.verify() or (other.margin, other.excludes(1e-300)) == (0.0, False)


def test_a_forged_direction_of_descent_is_refused():
    """Point and direction must stay within rows and bounds on both sides; P d = 0 and cᵀd < 0."""
    P = [[0.0, 0, 0], [0, 0, 0], [0, 0, 1]]
    program = QuadraticProgram(
        P,
        [-1.0, 1, 0],
        [[1.0, -1, 0]],
        [4.0],
        [[0.0, 0, 1]],
        [2.0],
        lower=[0, -9, -5],
        upper=[np.inf, np.inf, 5],
    )
    proof, rows = solve(program.with_vectors(c=[-1.0, 0.5, 0])).proof, program.constraints
    C, c = rows.matrix.toarray(), [-1.0, 0.5, 0]

    def holds(point, d):
        for k, limit in enumerate(rows.limit.tolist()):
            at, along = dot(C[k], point), dot(C[k], d)
            within = (
                at == limit and along == 0 if rows.is_equality[k] else at <= limit and along <= 0
            )
            if limit < np.inf and not within:
                return False
        return not any(product(P, d)) and dot(c, d) < 0

    assert proof.verify()
    assert holds(proof.point, proof.direction)
    outside = [
        [*proof.point[:j], Fraction(end), *proof.point[j + 1 :]]
        for j in range(3)
        for end in (-99, 99)
    ]
    for d in [*forged(proof.direction), [0, 0, 0], [*proof.direction[:2], 1]]:
        assert replace(proof, direction=tuple(map(Fraction, d))).verify() == holds(proof.point, d)
    for point in outside:
        assert replace(proof, point=tuple(point)).verify() == holds(point, proof.direction)
    assert not all(holds(point, proof.direction) for point in outside)


def test_a_forged_conflict_is_refused():
    """With a member missing, another multiplier, the other sign, and with a member that is not needed."""
    program = QuadraticProgram(
        None, [1.0, 1], [[1.0, 1], [0, -1], [1, 0]], [10.0, -7, 99], lower=[4.0, 0]
    )
    conflict = solve(program).conflict
    members = conflict.members
    assert conflict.verify()
    for y in forged([conflict.multipliers[i] for i in members]):
        named = {i: one for i, one in zip(members, y, strict=True) if one}
        assert not named or not replace(conflict, multipliers=named).verify()
    more = conflict.multipliers | {2: Fraction(1)}
    assert not replace(conflict, multipliers=more).verify()


def test_a_forged_proof_over_cones_is_refused():
    """A pile without support: y in the dual cones, −Mᵀy in them, and qᵀy < 0; a part missing, changed, turned."""
    contact = FrictionalContact(np.zeros((6, 6)), [-1.0, 0, 0, 1.0, 0, 0], [0.5, 0.5], dimension=3)
    proof = solve(contact).proof
    assert isinstance(proof, ContactInfeasibility)
    assert proof.verify()
    first = np.eye(6)[0]
    assert ContactInfeasibility(contact, first).verify()
    for wrong in (
        0 * first,
        -first,
        np.eye(6)[3],
        np.eye(6)[1],
        first + np.eye(6)[3],
        first + np.eye(6)[1],
        -np.eye(6)[3],
    ):
        assert not ContactInfeasibility(contact, wrong).verify()


def test_a_forged_best_equilibrium_is_refused():
    """With a piece of the tree missing, a larger bound, another point, another value, another status."""
    program = QuadraticProgram(np.eye(2), [-2.0, -1.0], lower=[0.0, 0.0])
    result = solve(EquilibriumProgram(program, [0], [1], 0.0, np.inf), prove=True)
    assert result.verify()
    assert undetected(result) == []


@pytest.mark.parametrize("n", [17, 40])
def test_a_positive_definite_matrix_is_a_p_matrix_whatever_its_size(n):
    """Not symmetric, not H₊, with more rows than minors are counted for; a negative eigenvalue takes the verdict."""
    A, B = np.random.default_rng(n).normal(size=(2, n, n))
    M = A @ A.T + 0.1 * np.eye(n) + B - B.T
    report = analyze(M)
    assert (report.is_p_matrix, report.is_positive_definite) == (True, True)
    vector = np.linalg.eigh(M + M.T)[1][:, :1]
    other = analyze(M - (vector.T @ M @ vector + 1.0) * vector @ vector.T)
    assert other.is_positive_definite is False
    assert other.is_p_matrix is not True


def test_rows_of_extreme_size_bound_no_distance_to_feasible_points():
    """Powers of two beyond 2⁴⁰⁰ could leave the range of doubles in squares: the bound is refused, not wrong."""
    x, excess = np.array([0.5, 0.5]), np.array([1e-16])
    for size, is_bounded in (
        (1.0, True),
        (2.0**390, True),
        (2.0**-390, True),
        (2.0**410, False),
        (2.0**-410, False),
    ):
        program = QuadraticProgram(None, [1.0, 1], A=[[size, size]], b=[size], lower=0, upper=1)
        assert (distance_of_equations(program, x, size * excess) is not None) == is_bounded


MEASURES: dict[str, tuple[Callable[[], Any], list[float], list[list[float]]]] = {
    "LCP": (
        lambda: LCP(np.eye(3), [-1.0, 2.0, -9.0], lower=0, upper=3),
        [1.0, 0.0, 3.0],
        [[1.1, 0, 3], [0.9, 0, 3], [0, 0, 3], [1, 0.1, 3], [1, -0.1, 3], [1, 0, 3.1], [1, 0, 2.9], [1, 0, 0]],
    ),
    "NonlinearProblem": (
        lambda: NonlinearProblem(
            lambda x: x + x**3 - [2.0, -2.0, 99.0], lambda x: np.diag(1 + 3 * x**2), lower=0, upper=3
        ),
        [1.0, 0.0, 3.0],
        [[1.1, 0, 3], [0.9, 0, 3], [0, 0, 3], [1, 0.1, 3], [1, -0.1, 3], [1, 0, 3.1], [1, 0, 2.9], [1, 0, 0]],
    ),
    "QuadraticProgram": (
        lambda: QuadraticProgram(
            np.eye(4), [-1.0, 2, -9, 0], [[0.0, 0, 0, 1]], [-1.0], [[1.0, 0, 0, -1]], [2.0], lower=-2, upper=3
        ),
        [1.0, -2.0, 3.0, -1.0],
        [[1, -2, 3.1, -1], [1, -2, 2.9, -1], [1, -2.1, 3, -1], [1, -1.9, 3, -1], [1, -2, 3, -0.9],
         [0.9, -2, 3, -1.1], [1.1, -2, 3, -1], [0.9, -2, 3, -1]],
    ),
    "FrictionalContact": (
        lambda: FrictionalContact(np.eye(6), [-1.0, 2, 0, -1, 0.3, 0.2], [0.5, 0.5], dimension=3),
        [1.0, -0.5, 0, 1, -0.3, -0.2],
        [[1, -0.6, 0, 1, -0.3, -0.2], [1, -0.4, 0, 1, -0.3, -0.2], [1, 0.5, 0, 1, -0.3, -0.2],
         [1, -0.5, 0, 1.1, -0.3, -0.2], [1, -0.5, 0, 0.9, -0.3, -0.2], [1, -0.5, 0, 1, -0.2, -0.2],
         [1, -0.5, 0.1, 1, -0.3, -0.2], [-1, -0.5, 0, 1, -0.3, -0.2]],
    ),
    "ConeProblem": (
        lambda: ConeProblem(np.eye(4), [-1.0, 2, 0, 0.5], [("second_order", 3), ("box", [-1.0], [1.0])]),
        [1.5, -1.5, 0.0, -0.5],
        [[1.5, -1.6, 0, -0.5], [1.5, -1.4, 0, -0.5], [1.6, -1.5, 0, -0.5], [1.4, -1.5, 0, -0.5],
         [1.5, -1.5, 0.1, -0.5], [1.5, -1.5, 0, -0.6], [1.5, -1.5, 0, -0.4], [1.5, -1.5, 0, 1.1], [1.5, -1.5, 0, -1.1]],
    ),
}  # fmt: skip


def test_a_point_off_by_a_tenth_on_any_side_is_disproved():
    """Below and above a bound, off an inner value, off a row or an equation, out of a cone: no side is unwatched."""
    for name, (build, right, wrong) in MEASURES.items():
        problem = build()
        assert certify(problem, right).verdict == "proved", name
        for point in wrong:
            assert certify(problem, point).verdict == "disproved", (name, point)


def test_pairs_of_an_equilibrium_program_are_measured_on_each_side():
    """The distance to the nearest branch, below and above both bounds, with a slack of either sign."""
    problem = EquilibriumProgram(QuadraticProgram(np.eye(2), [0.0, 0.0]), [0], [1], 0.0, 2.0)
    for z, w, distance in (
        (0, 5, 0), (1, 0, 0), (2, -5, 0), (-0.5, 5, 0.5), (0.5, 5, 0.5), (2.5, -5, 0.5), (1.5, -5, 0.5),
        (1, 0.25, 0.25), (1, -0.25, 0.25), (2.5, 0, 0.5), (-0.5, 0, 0.5), (0, -0.25, 0.25), (2, 0.25, 0.25),
        (2.5, 5, 2.5), (-0.5, -5, 2.5),
    ):  # fmt: skip
        assert problem.violations(np.array([z, w], float)).tolist() == [distance], (z, w)
