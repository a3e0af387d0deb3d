"""Structures with zero-energy modes that the load excites: a factorization names them; others are solved."""

import cvxpy as cp
import numpy as np
import pytest
import scipy.sparse as sp
from unheld import Structure, block, chain, circuit, truss

from lcp_plugin import QPSolver, QuadraticProgram, Status, solve
from lcp_plugin.problems.programs.no_minimum import QPUnboundedness

UNHELD = {
    "block pulled off its floor": lambda: block(12, 12, 0.0, 1.0),
    "block pushed sideways": lambda: block(12, 12, 1.0, 0.0),
    "block pressed down and pushed": lambda: block(12, 12, 1.0, -1.0),
    "block pulled aslant": lambda: block(6, 4, 0.3, 1.0),
    "beam of 840 unknowns pulled off": lambda: block(59, 6, 0.0, 1.0),
    "chain of 28": lambda: chain(28, 1.0),
    "chain of 5000": lambda: chain(5000, 1.0),
    "circuit without ground": lambda: circuit(600, 1.0),
    "frame that folds up": lambda: truss(20, 1e3, braced=False),
}
HELD = {
    "block pressed down": lambda: block(12, 12, 0.0, -1.0),
    "block that springs of 1e-9 hold": lambda: block(12, 12, 0.0, -1.0, spring=1e-9),
    "block at rest": lambda: block(6, 6, 0.0, 0.0),
    "chain pressed down": lambda: chain(28, -1.0),
    "circuit that a sink empties": lambda: circuit(600, -1.0),
    "frame with diagonals": lambda: truss(20, 1e3, braced=True),
}


@pytest.mark.full
@pytest.mark.parametrize("name", UNHELD)
def test_a_program_of_a_structure_that_nothing_holds_is_unbounded(name):
    """UNBOUNDED with a proof that verifies; it names unknowns if its direction strains nothing."""
    result = solve(UNHELD[name]().program)
    assert result.status is Status.UNBOUNDED
    assert isinstance(result.proof, QPUnboundedness)
    assert result.proof.verify()
    assert ("nothing holds unknowns" in str(result.proof)) == result.proof.is_free_motion
    assert str(result.proof) in result.explain()


@pytest.mark.full
@pytest.mark.parametrize("name", [name for name in UNHELD if name != "chain of 5000"])
def test_a_problem_of_a_structure_that_nothing_holds_is_not_solved(name):
    """INFEASIBLE with a proof that verifies, where a linear program finds it; never SOLVED."""
    result = solve(UNHELD[name]().problem, max_seconds=10.0)
    assert not result.is_solved
    if result.has_no_solution:
        assert result.proof.verify()
        assert "nothing holds unknowns" in result.explain()


@pytest.mark.parametrize("name", HELD)
def test_what_is_held_is_solved(name):
    """The same structures pressed down, weakly held or balanced are SOLVED; no message names a motion."""
    structure = HELD[name]()
    for result in (solve(structure.problem), solve(structure.program)):
        assert result.is_solved
        assert "nothing holds" not in result.explain()


@pytest.mark.quick(1)
@pytest.mark.parametrize(
    ("n", "stiff", "weak"), [(300, 30, 10), (300, 30, 22), (300, 20, 22), (1500, 20, 18)]
)
def test_stiff_parts_do_not_hide_what_holds_a_soft_one(n, stiff, weak):
    """A stiff chain, at its end a spring of 1 and one of 2^-weak to the ground: a minimum at 2^weak, never no solution.

    The unknowns are in units in which the rows alone do not show that something holds the chain.
    """
    spring = np.append(np.full(n - 2, 2.0**stiff), 1.0)
    d = np.append(spring, 2.0**-weak) + np.append(0.0, spring)
    unit = sp.diags_array(np.ldexp(1.0, np.arange(n) % 4))
    K = sp.csr_array(unit @ sp.diags_array([-spring, d, -spring], offsets=[-1, 0, 1]) @ unit)
    x = (2.0**weak + np.append(np.ones(n - 1), 0.0)) / unit.diagonal()
    # without any rounding: x is the minimum
    structure = Structure(K, -(K @ x), np.full(n, -np.inf))
    for result in (solve(structure.problem), solve(structure.program)):
        assert not result.has_no_solution
        assert "nothing holds" not in result.explain()


def test_a_direction_keeps_contacts_closed_or_opens_them():
    """What is pressed on a floor slides along it; what is pulled off it rises."""
    pressed, pulled = block(6, 6, 1.0, -1.0), block(6, 6, 0.0, 1.0)
    slides, rises = (
        np.array(solve(one.program).proof.direction, dtype=float) for one in (pressed, pulled)
    )
    for direction, moves in ((slides, slides[0::2]), (rises, rises[1::2])):
        assert moves == pytest.approx(1.0, rel=1e-9)
        assert np.abs(direction).sum() == pytest.approx(moves.sum(), rel=1e-9)


@pytest.mark.quick(1)
@pytest.mark.parametrize("seed", range(3))
def test_the_units_of_unknowns_do_not_matter(seed):
    """A free chain whose rows add up to rounding only, each unknown in a unit of its own: UNBOUNDED."""
    spring, rng = 0.1 * np.arange(1.0, 50.0), np.random.default_rng(seed)
    unit = sp.diags_array(np.ldexp(1.0, rng.integers(-10, 11, 50)))
    d = np.append(spring, 0.0) + np.append(0.0, spring)
    K = sp.csr_array(unit @ sp.diags_array([-spring, d, -spring], offsets=[-1, 0, 1]) @ unit)
    assert solve(QuadraticProgram(K, -unit.diagonal())).status is Status.UNBOUNDED


def test_rows_that_hold_the_structure_are_seen():
    """G x ≤ h or A x = b in the way of the only motion: SOLVED; in the way of none: UNBOUNDED."""
    K, q, lower = chain(28, 1.0)
    last = np.zeros((1, 28))
    last[0, -1] = 1.0
    difference = last.copy()
    difference[0, 0] = -1.0
    assert solve(QuadraticProgram(K, q, G=last, h=[5.0], lower=lower)).is_solved
    assert solve(QuadraticProgram(K, q, A=last, b=[5.0], lower=lower)).is_solved
    for rows in (dict(G=difference, h=[5.0]), dict(A=difference, b=[0.5]), dict(G=-last, h=[5.0])):
        result = solve(QuadraticProgram(K, q, lower=lower, **rows))
        assert result.status is Status.UNBOUNDED
        assert "nothing holds unknowns" in str(result.proof)


def test_cvxpy_says_unbounded_and_why():
    """A model in cvxpy of a chain that is pulled off: unbounded, the words in its statistics."""
    K, q, lower = chain(40, 1.0)
    x = cp.Variable(40)
    bounded = np.flatnonzero(np.isfinite(lower))
    problem = cp.Problem(
        cp.Minimize(0.5 * cp.quad_form(x, cp.psd_wrap(K)) + q @ x), [x[bounded] >= lower[bounded]]
    )
    problem.solve(solver=QPSolver)
    assert problem.status == cp.UNBOUNDED
    assert "nothing holds unknowns" in str(problem.solver_stats.extra_stats.proof)
