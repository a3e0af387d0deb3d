"""Regions of parameters with their laws, against solvers of others point by point, and against closed forms."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from pathlib import Path
from typing import Any

import daqp
import numpy as np
import pytest
import scipy.sparse as sp
from controllers import double_integrator

from lcp_plugin import (
    LCP,
    InvalidOption,
    QuadraticProgram,
    UnsuitableProblem,
    derivative,
    regions,
    solve,
    trace,
)
from lcp_plugin.core.errors import UnsupportedModel


def by_daqp(program: QuadraticProgram) -> np.ndarray | None:
    """Return x by daqp, None where it says infeasible."""
    P, G = (np.ascontiguousarray(sp.csr_array(one).toarray()) for one in (program.P, program.G))
    upper = np.concatenate([program.upper, program.h])
    lower = np.concatenate([program.lower, np.full(program.h.size, -1e30)])
    x, _, flag, _ = daqp.solve(
        P, program.c.copy(), G, upper, lower, np.zeros(upper.size, dtype=np.int32)
    )
    return np.array(x) if flag == 1 else None


@pytest.mark.sampled(1)
@pytest.mark.parametrize("horizon", [2, 4])
def test_a_double_integrator_has_its_law_everywhere(horizon: int) -> None:
    """At 300 drawn states x is daqp's, and there is none where daqp finds none; no region is missing."""
    program, changes = double_integrator(horizon)
    found = regions(program, changes, ([-5.0, -5.0], [5.0, 5.0]))
    assert found.is_solved
    assert found.coverage == 1.0
    states = np.random.default_rng(horizon).uniform(-5, 5, (300, 2))
    for state, x in zip(states, found.x_at(states), strict=True):
        expected = by_daqp(found.at(state))
        assert (expected is None) == bool(np.isnan(x).any())
        if expected is not None:
            np.testing.assert_allclose(x, expected, atol=1e-6)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("seed", range(6))
def test_p_matrices_have_regions_over_the_whole_box(seed: int) -> None:
    """Of an LCP with a P-matrix and two or three parameters: the regions fill the box, z is that of `solve`."""
    random = np.random.default_rng(seed)
    n, p = 5, 2 + seed % 2
    A = random.standard_normal((n, n))
    M = A @ A.T + np.eye(n) + 0.3 * (A - A.T)
    upper = np.where(random.random(n) < 0.3, 0.5, np.inf)
    problem, Q = LCP(M, random.standard_normal(n), upper=upper), random.standard_normal((n, p))
    found = regions(problem, {"q": Q}, (-np.ones(p), np.ones(p)))
    assert found.is_solved
    assert found.coverage == 1.0
    assert sum(region.volume for region in found) == pytest.approx(1.0, abs=1e-6)
    for theta in random.uniform(-1, 1, (40, p)):
        result = solve(problem.with_q(problem.q + Q @ theta)).require_solved()
        np.testing.assert_allclose(found.x_at(theta), result.z, atol=1e-7)


@pytest.mark.parametrize("width", [1e-3, 1e-6, 1e-8])
def test_a_narrow_range_has_its_own_regions(width: float) -> None:
    """Of an actuator that moves by a millionth of what parameters do, or less: x follows θ inside, three by three."""
    program = QuadraticProgram(np.eye(2), [0.0, 0.0], lower=[0.0, -1.0], upper=[width, 1.0])
    found = regions(program, {"c": -np.eye(2)}, ([-1.0, -2.0], [1.0, 2.0]))
    assert len(found) == 9
    assert found.is_solved
    np.testing.assert_allclose(found.x_at([0.5 * width, 0.5]), [0.5 * width, 0.5], rtol=1e-9)


def test_bounds_and_equations_may_move() -> None:
    """The nearest point of a moving box on a moving line: closed form along one parameter."""
    program = QuadraticProgram(
        np.eye(2), [0.0, 0.0], A=[[1.0, 1.0]], b=[0.0], lower=-1.0, upper=1.0
    )
    found = regions(program, {"b": [2.0], "upper": [0.5, 0.0]}, ([-0.9], [0.9]))
    assert found.is_solved
    for theta in np.linspace(-0.9, 0.9, 19):
        top = 1.0 + 0.5 * theta
        first = min(theta, top)
        np.testing.assert_allclose(found.x_at([theta]), [first, 2 * theta - first], atol=1e-9)


def test_what_is_saved_is_the_law(tmp_path: Path) -> None:
    """Arrays, and C that a compiler takes, give the x of `x_at`."""
    program, changes = double_integrator(3)
    found = regions(program, changes, ([-5.0, -5.0], [5.0, 5.0]))
    found.save(tmp_path / "law.npz")
    with np.load(tmp_path / "law.npz") as data:
        assert np.array_equal(data["F"], found.laws[0])
        E, e, starts = data["E"], data["e"], data["starts"]
    states = np.random.default_rng(0).uniform(-4, 4, (100, 2))
    where = found.locate(states)
    for state, k in zip(states, where, strict=True):
        if k >= 0:
            assert (
                E[starts[k] : starts[k + 1]] @ state <= e[starts[k] : starts[k + 1]] + 1e-7
            ).all()
    found.save(tmp_path / "law.c")
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        pytest.skip("no compiler of C here")
    subprocess.run(
        [
            compiler,
            "-shared",
            "-fPIC",
            "-Wall",
            "-Werror",
            "-o",
            tmp_path / "law.so",
            tmp_path / "law.c",
        ],
        check=True,
    )
    law = ctypes.CDLL(str(tmp_path / "law.so")).law
    pointer = ctypes.POINTER(ctypes.c_double)
    for state, k in zip(states, where, strict=True):
        x = np.zeros(found.n)
        given = law(np.ascontiguousarray(state).ctypes.data_as(pointer), x.ctypes.data_as(pointer))
        assert (given < 0) == (k < 0)
        if k >= 0:
            np.testing.assert_allclose(x, found.x_at(state), atol=1e-9)


def test_it_tells_what_it_found_and_draws_it() -> None:
    """explain() says how many, how sure; the picture shows each region."""
    plt = pytest.importorskip("matplotlib.pyplot")
    plt.switch_backend("agg")
    program, changes = double_integrator(2)
    found = regions(program, changes, ([-5.0, -5.0], [5.0, 5.0]))
    assert "certified" in found.explain()
    assert f"Regions({len(found)} of 2 parameters, SOLVED" in repr(found)
    axes = found.plot()
    assert len(axes.collections[1].get_paths()) == len(found)
    plt.close(axes.figure)
    few = regions(program, changes, ([-5.0, -5.0], [5.0, 5.0]), max_regions=2)
    assert not few.is_solved
    assert "nothing was found" in few.explain()


@pytest.mark.parametrize(
    ("given", "error", "words"),
    [
        (({"q": [1.0, 0.0]}, ([0.0], [1.0])), InvalidOption, "c, h, b, lower, upper may move"),
        (
            ({"P": np.eye(2)}, ([0.0], [1.0])),
            InvalidOption,
            "may move, not P: x is not piecewise affine in P",
        ),
        (
            ({"c": [1.0]}, ([0.0], [1.0])),
            InvalidOption,
            r"change of c by each .* of shape \(2, 1\), got shape \(1,\)",
        ),
        (({"c": [1.0, 0.0]}, ([1.0], [0.0])), InvalidOption, "low < high"),
        (({"c": [1.0, 0.0]}, 3), InvalidOption, "corners of a box"),
        (
            ({"upper": [1.0, 0.0]}, ([0.0], [1.0])),
            InvalidOption,
            r"upper\[0\] is inf and cannot move",
        ),
        ((7, ([0.0], [1.0])), InvalidOption, "parameters must say what depends"),
        (
            ({"c": np.eye(2, 9)}, (np.zeros(9), np.ones(9))),
            InvalidOption,
            "up to 6 parameters, got 9",
        ),
    ],
)
def test_what_cannot_be_used_is_refused_in_words(
    given: Any, error: type[Exception], words: str
) -> None:
    """Names, shapes, boxes."""
    with pytest.raises(error, match=words):
        regions(QuadraticProgram(np.eye(2), [0.0, 0.0]), *given)


def test_where_x_is_not_unique_it_says_so() -> None:
    """A flat objective has no law; one that is not convex has no minimum to follow; nothing feasible has none."""
    flat = QuadraticProgram(None, [0.0, 0.0], lower=0.0, upper=[1.0, np.inf])
    with pytest.raises(UnsuitableProblem, match="unique"):
        regions(flat, {"c": np.zeros((2, 1))}, ([0.0], [1.0]))
    with pytest.raises(UnsupportedModel):
        regions(
            QuadraticProgram([[-1.0]], [0.0], lower=0.0, upper=1.0), {"c": [1.0]}, ([0.0], [1.0])
        )
    with pytest.raises(UnsuitableProblem, match="unique"):
        regions(
            QuadraticProgram([[1.0]], [0.0], G=[[1.0], [-1.0]], h=[0.0, -1.0]),
            {"c": [1.0]},
            ([0.0], [1.0]),
        )
    found = regions(
        QuadraticProgram([[1.0]], [0.0], lower=-1.0, upper=1.0), {"c": [1.0]}, ([0.0], [1.0])
    )
    with pytest.raises(InvalidOption, match="θ must have shape"):
        found.x_at([1.0, 2.0])
    with pytest.raises(InvalidOption, match=r"saved as \.npz or \.c"):
        found.save("law.txt")


ORDINARY = {  # what a fresh reader tried: program, what moves, box, how many regions
    "a row at 0 where x cancels": (
        QuadraticProgram([[5.0]], [-2.0], G=[[1.0]], h=[0.0]),
        {"c": [2.0]},
        (-3, 3),
        2,
    ),
    "a case that ends at the box": (
        QuadraticProgram([[1.0]], [0.0], lower=-1, upper=1),
        {"c": [-1.0]},
        (-1, 3),
        2,
    ),
    "bounds that cross": (
        QuadraticProgram([[1.0]], [0.0], lower=0, upper=1),
        {"upper": [1.0]},
        (-2, 2),
        1,
    ),
    "a row twice": (
        QuadraticProgram(np.eye(2), [0, 0], G=[[1, 1], [2, 2]], h=[-1, -2]),
        {"c": np.eye(2)},
        (-2, 2),
        2,
    ),
    "an equation twice": (
        QuadraticProgram(np.eye(2), [0, 0], A=[[1, 1], [1, 1]], b=[1, 1]),
        {"c": [1, 0]},
        (-1, 1),
        1,
    ),
    "an equation 0 = 0": (
        QuadraticProgram(np.eye(2), [0, 0], A=[[1, 1], [0, 0]], b=[1, 0]),
        {"c": [1, 0]},
        (-1, 1),
        1,
    ),
    "the identity, a row that rests": (LCP(np.eye(2), [0, 0]), {"q": [[1.0], [0.0]]}, (-1, 1), 2),
}


@pytest.mark.parametrize("name", ORDINARY)
def test_ordinary_data_have_their_regions(name: str) -> None:
    """All are found and certified, none is missing."""
    problem, changes, (low, high), count = ORDINARY[name]
    p = np.atleast_2d(np.array(next(iter(changes.values())), dtype=float).T).shape[0]
    found = regions(problem, changes, (np.full(p, float(low)), np.full(p, float(high))))
    assert found.is_solved
    assert found.coverage == 1.0
    assert len(found) == count


@pytest.mark.sampled(1)
@pytest.mark.parametrize("unit", [1e6, 1e-6])
def test_units_change_no_region(unit: float) -> None:
    """In other units of x, or all costs times 1e9, has as many regions."""
    program, changes = double_integrator(3)
    box = [-5.0, -5.0], [5.0, 5.0]
    P, G = (np.asarray(sp.csr_array(one).toarray()) for one in (program.P, program.G))
    other = QuadraticProgram(
        P / unit**2,
        program.c / unit,
        G=G / unit,
        h=program.h,
        lower=program.lower * unit,
        upper=program.upper * unit,
    )
    found = regions(other, {"c": changes["c"] / unit, "h": changes["h"]}, box)
    own = regions(program, changes, box)
    assert found.is_solved
    assert len(found) == len(own)
    costly = QuadraticProgram(
        P * 1e9, program.c, G=G, h=program.h, lower=program.lower, upper=program.upper
    )
    assert len(regions(costly, {"c": changes["c"] * 1e9, "h": changes["h"]}, box)) == len(own)


def test_more_than_one_solution_is_no_law() -> None:
    """A matrix that is no P-matrix is refused; equations that contradict each other for some θ as well."""
    with pytest.raises(UnsuitableProblem, match="no P-matrix"):
        regions(
            LCP([[1.0, 3.0], [3.0, 1.0]], [-1.0, -1.0]),
            {"q": np.eye(2)},
            ([-2.0, -2.0], [2.0, 2.0]),
        )
    twice = QuadraticProgram(np.eye(2), [0, 0], A=[[1, 1], [1, 1]], b=[1, 1])
    with pytest.raises(UnsuitableProblem, match="depend on each other"):
        regions(twice, {"b": [1.0, 0.0]}, ([-1.0], [1.0]))


@pytest.mark.parametrize("seed", range(30))
def test_integer_programs_have_the_x_of_daqp(seed: int) -> None:
    """Rows and costs of small whole numbers, which meet in corners: solved, and right at every drawn θ."""
    random = np.random.default_rng(seed)
    n, m, p = 3, 3, 1 + seed % 3
    B = random.integers(-2, 3, (n, n))
    program = QuadraticProgram(
        (B @ B.T + np.eye(n)).astype(float),
        random.integers(-2, 3, n).astype(float),
        G=random.integers(-2, 3, (m, n)).astype(float),
        h=random.integers(0, 4, m).astype(float),
        lower=-2.0,
        upper=2.0,
    )
    changes = {
        "c": random.integers(-2, 3, (n, p)).astype(float),
        "h": random.integers(-1, 2, (m, p)).astype(float),
    }
    found = regions(program, changes, (np.full(p, -2.0), np.full(p, 2.0)))
    assert found.is_solved
    for theta in random.uniform(-2, 2, (30, p)):
        expected, x = by_daqp(found.at(theta)), found.x_at(theta)
        assert (expected is None) == bool(np.isnan(x).any())
        if expected is not None:
            np.testing.assert_allclose(x, expected, atol=1e-6)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("far", [1e6, 1e12, 1e19])
@pytest.mark.parametrize("where", ["row", "bound", "cost"])
def test_a_number_that_nobody_reaches_changes_no_region(far: float, where: str) -> None:
    """A limit of a row, an upper bound, the cost of an unknown that stays at its bound: x is daqp's without it."""
    G, h, upper = (
        np.array([[1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 2.0, 0.0]]),
        np.array([1.0, 2.0, 3.0]),
        np.ones(3),
    )
    c = np.zeros(3)
    h[2] = far if where == "row" else 3.0
    upper[1] = far if where == "bound" else 1.0
    c[2] = far if where == "cost" else 0.5
    program = QuadraticProgram(np.eye(3), c, G=G, h=h, lower=[-1, -1, 0], upper=upper)
    found = regions(program, {"c": np.eye(3, 2)}, ([-3.0, -3.0], [3.0, 3.0]))
    assert found.is_solved
    assert found.coverage == 1.0
    plain = QuadraticProgram(
        np.eye(2),
        np.zeros(2),
        G=G[:, :2],
        h=np.minimum(h, 1e3),
        lower=-1,
        upper=np.minimum(upper[:2], 1e3),
    )
    for theta in np.random.default_rng(0).uniform(-3, 3, (60, 2)):
        expected = by_daqp(plain.with_vectors(c=theta))
        np.testing.assert_allclose(found.x_at(theta)[:2], expected, atol=1e-6)


def test_what_to_write_for_a_cvxpy_problem_and_for_a_path() -> None:
    """The advice of a refusal is a call that there is."""
    import cvxpy as cp

    x = cp.Variable()
    with pytest.raises(InvalidOption, match="state its arrays as a QuadraticProgram"):
        regions(cp.Problem(cp.Minimize(x**2), [x >= 1]), {"c": [1.0]}, ([0.0], [1.0]))
    path = trace(LCP([[1.0]], [-1.0]), {"q": 1.0}, 0.0, 2.0)
    with pytest.raises(InvalidOption, match=r"path\.derivative\(theta\)"):
        derivative(path)
    assert path.derivative(0.5).x == pytest.approx([-1.0])
