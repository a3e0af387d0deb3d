"""Derivatives of programs and least squares: those of differences, also of another solver; refusals name a part."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from inputs.stacked_programs import differentiable_program
from tools.refusals import assert_refused, refusals

from lcp_plugin import (
    LCP,
    BoundedLeastSquares,
    FrictionalContact,
    InvalidOption,
    QuadraticProgram,
    UnsuitableProblem,
    derivative,
    march,
    solve,
    solve_batch,
)

STEP = 1e-6
NAMES = "P", "c", "G", "h", "A", "b", "lower", "upper"


def changes(data: dict[str, Any], seed: int) -> dict[str, Any]:
    """Return a random change of all data."""
    rng = np.random.default_rng([32, seed])
    d = {name: rng.normal(size=np.shape(value)) for name, value in data.items()}
    return d | {"P": d["P"] + d["P"].T}


def shifted(data: dict[str, Any], d: dict[str, Any], step: float) -> dict[str, Any]:
    return {name: value + step * d[name] for name, value in data.items()}


def inner(gradient: Any, d: dict[str, Any]) -> float:
    """Return the change of a function with this gradient."""
    return float(sum(np.sum(getattr(gradient, name) * d[name]) for name in d))


def agree(found: Any, dx: Any, d: dict[str, Any], accuracy: float) -> None:
    """Compare jvp, and vjp along the same change, with dx."""
    named = {f"d{name}": one for name, one in d.items()}
    size = max(1.0, np.abs(dx).max())
    np.testing.assert_allclose(found.jvp(**named), dx, rtol=0.0, atol=accuracy * size)
    g = np.random.default_rng(5).normal(size=dx.size)
    assert inner(found.vjp(g), d) == pytest.approx(g @ dx, abs=accuracy * size * np.abs(g).sum())


def test_the_derivative_of_a_program_is_that_of_differences(draws):
    """Of random programs, in all data at once, to 1e-6; every tenth is sparse."""
    for seed in draws(300, 10):
        data = differentiable_program(seed)
        d = changes(data, seed)
        ahead, behind = (solve(QuadraticProgram(**shifted(data, d, s))).x for s in (STEP, -STEP))
        stored = data
        if seed % 10 == 0:
            stored = data | {name: sp.csr_array(data[name]) for name in "PGA"}
        found = derivative(solve(QuadraticProgram(**stored)))
        assert found.is_unique
        assert found.degenerate == []
        agree(found, (ahead - behind) / (2.0 * STEP), d, 1e-6)


@pytest.mark.parametrize(("seed", "unit"), [(0, 1.0), (26, 1e4), (233, 1e6)])
def test_a_kink_is_found_although_the_data_are_rounded_in_other_units(seed, unit):
    """The row is active with multiplier 0 up to the rounding of c and h, which the inverse of P amplifies."""
    rng = np.random.default_rng(seed)
    B = rng.normal(size=(2, 2))
    P, x, G, u = B @ B.T + 0.5 * np.eye(2), rng.normal(size=2), rng.normal(size=(1, 2)), [1.0, unit]
    found = derivative(solve(QuadraticProgram(P / np.outer(u, u), -P @ x / u, G / u, G @ x)))
    assert found.degenerate == ["row 0 of G"]
    with pytest.raises(UnsuitableProblem, match="row 0 of G"):
        found.jvp(dh=[1.0])


def test_degenerate_programs_are_refused_by_the_name_of_the_part(draws):
    """Of random ones the one-sided derivatives are those of differences on that side."""
    for seed in draws(60, 5):
        data = differentiable_program(seed, is_degenerate=True)
        result = solve(QuadraticProgram(**data))
        found = derivative(result)
        part = "lower[0]" if seed % 2 else "row 0 of G"
        assert found.degenerate == [part]
        assert found.is_unique is False
        with pytest.raises(UnsuitableProblem, match=rf"kink here: {part.replace('[', '.')}"):
            found.vjp(result.x)
        with pytest.raises(UnsuitableProblem, match="kink here"):
            found.jvp(dc=result.x)
        d = changes(data, seed)
        ahead = solve(QuadraticProgram(**shifted(data, d, STEP))).x
        named = {f"d{name}": one for name, one in d.items()}
        dx = (ahead - result.x) / STEP
        size = max(1.0, np.abs(dx).max())
        assert np.allclose(found.one_sided().jvp(**named), dx, rtol=0.0, atol=1e-3 * size)
        assert np.isfinite(found.one_sided().vjp(result.x).c).all()


@refusals(r"""
derivative(solve(several)).vjp([1.0, 0.0]) → UnsuitableProblem: several values: coal, gas
derivative(solve(twice)).jvp(db=[1.0, 1.0]) → UnsuitableProblem: row 0 of A, row 1 of A; .*dependent
derivative(solve(QuadraticProgram(np.eye(1), [0.0], [[1.0], [-1.0]], [0.0, -1.0]))) → UnsuitableProblem: INFEASIBLE
found.jvp(dqq=[1.0, 0.0]) → InvalidOption: no option 'dqq'; known: dA, dG, dP, db
found.jvp(dc=np.ones(3)) → InvalidProblem: dc must have shape \(2,\), got shape \(3,\)
found.vjp([np.nan, 0.0]) → InvalidProblem: g must be finite
derivative(solve(balanced)).vjp([1.0, 1.0]) → UnsuitableProblem: kink here: l1.0. active
""")
def test_a_program_without_a_derivative_names_the_part(call, words):
    """Several solutions, dependent rows, another status, a penalty that a gradient balances; wrong changes."""
    names = {
        "several": QuadraticProgram(
            None, [-1.0, -1.0], [[1.0, 1.0]], [2.0], lower=0.0, names=["coal", "gas"]
        ),
        "twice": QuadraticProgram(np.eye(2), [0.0, -1.0], A=[[1.0, 1.0], [2.0, 2.0]], b=[2.0, 4.0]),
        "balanced": BoundedLeastSquares(np.eye(2), [1.0, 3.0], lower=-np.inf, l1=1.0),
        "found": derivative(solve(QuadraticProgram(np.eye(2), [-1.0, 1.0], lower=0.0))),
    }
    assert_refused(call, words, names)


@pytest.mark.parametrize("is_shared", [True, False])
def test_a_batch_has_the_derivatives_of_its_programs(is_shared):
    """Rows agree with single derivatives; a degenerate and an infeasible program have errors and NaN."""
    data = differentiable_program(8)
    program, n = QuadraticProgram(**data), data["c"].size
    rng = np.random.default_rng(3)
    programs = [program.with_vectors(c=data["c"] + 0.1 * rng.normal(size=n)) for _ in range(20)]
    degenerate = differentiable_program(8, is_degenerate=True)
    programs[3] = program.with_vectors(**{name: degenerate[name] for name in ("c", "h", "b")})
    if not is_shared:
        programs = [
            QuadraticProgram(one.P * (1.0 + 0.01 * k), *(getattr(one, name) for name in NAMES[1:]))
            for k, one in enumerate(programs)
        ]
        programs[3] = QuadraticProgram(**degenerate)
    programs[5] = program.with_vectors(h=data["h"] - 100.0)
    batch = solve_batch(programs)
    found, g = derivative(batch), rng.normal(size=n)
    assert found.is_unique.tolist() == [k not in (3, 5) for k in range(20)]
    d = changes(data, 1)
    dx = found.jvp(**{f"d{name}": one for name, one in d.items()})
    gradient = found.vjp(g)
    assert set(found.errors) == {3, 5}
    assert np.isnan(dx[[3, 5]]).all()
    total = 0.0
    for k, result in enumerate(batch):
        if k in found.errors:
            continue
        one = derivative(result)
        own = one.jvp(**{f"d{name}": value for name, value in d.items()})
        np.testing.assert_allclose(dx[k], own, rtol=1e-9, atol=1e-9)
        alone = one.vjp(g)
        np.testing.assert_allclose(gradient.h[k], alone.h, rtol=1e-9, atol=1e-9)
        if not is_shared:
            np.testing.assert_allclose(gradient.G[k], alone.G, rtol=1e-9, atol=1e-9)
        total += alone.G
    if is_shared:  # the sum, in which the degenerate program is NaN
        good = [one for k, one in enumerate(programs) if k not in (3, 5)]
        summed = derivative(solve_batch(good)).vjp(g).G
        np.testing.assert_allclose(summed, total, rtol=1e-9, atol=1e-8)


@pytest.mark.parametrize("kind", ["nonnegative", "lasso", "boxes"])
def test_the_derivative_of_least_squares_is_that_of_differences(kind):
    """In A, b, bounds, penalties, weights and ridge at once; single, sparse and in a batch."""
    rng = np.random.default_rng(4)
    data = {"A": rng.normal(size=(9, 5)), "b": rng.normal(size=9), "weights": rng.uniform(0.5, 2.0, 9),
            "ridge": 0.1, "l1": np.full(5, 0.01)}  # fmt: skip
    if kind == "lasso":
        data |= {"lower": -np.inf, "l1": rng.uniform(0.5, 3.0, 5)}
    if kind == "boxes":
        data |= {"lower": np.full(5, -0.1), "upper": np.full(5, 0.2)}
    d = {name: rng.normal(size=np.shape(value)) for name, value in data.items()}
    if kind == "lasso":
        del d["lower"]
    moved = [
        {**data, **{name: data[name] + s * one for name, one in d.items()}} for s in (STEP, -STEP)
    ]
    ahead, behind = (solve(BoundedLeastSquares(**one), tolerance=1e-12).x for one in moved)
    result = solve(BoundedLeastSquares(**data))
    assert 0 < np.count_nonzero(result.active_mask) + np.count_nonzero(result.x == 0.0) < 9
    found = derivative(result)
    agree(found, (ahead - behind) / (2.0 * STEP), d, 1e-6)
    sparse = derivative(solve(BoundedLeastSquares(**data | {"A": sp.csr_array(data["A"])})))
    agree(sparse, (ahead - behind) / (2.0 * STEP), d, 1e-6)
    batch = derivative(
        solve_batch(BoundedLeastSquares(**data), np.stack([data["b"], data["b"] + 0.1]))
    )
    named = {f"d{name}": one for name, one in d.items()}
    np.testing.assert_allclose(batch.jvp(**named)[0], found.jvp(**named), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(
        batch.vjp(np.ones(5)).b[0], found.vjp(np.ones(5)).b, rtol=1e-9, atol=1e-9
    )


def test_a_batch_of_least_squares_with_starts_has_the_derivatives_of_its_problems():
    rng = np.random.default_rng(0)
    problem = BoundedLeastSquares(rng.random((6, 3)), rng.random(6), lower=0)
    problems = [problem.with_vectors(rng.random(6)) for _ in range(3)]
    batch = solve_batch(problems, z0=[np.zeros(3), None, np.ones(3)])
    changes = derivative(batch).jvp(db=np.ones(6))
    alone = [derivative(solve(one)).jvp(db=np.ones(6)) for one in problems]
    np.testing.assert_allclose(changes, alone, rtol=1e-9)
    apart = [problem, BoundedLeastSquares(2.0 * problem.A, problem.b, lower=0)]
    with pytest.raises(InvalidOption, match="those by problem"):
        derivative(solve_batch(apart))


def test_a_derivative_can_be_sent_to_another_process():
    """After pickle the numbers are equal, of one program and of a batch; a single one has no errors."""
    program = QuadraticProgram(**differentiable_program(3))
    for solved in (solve(program), solve_batch([program, program])):
        found = derivative(solved)
        sent = pickle.loads(pickle.dumps(found))
        assert np.array_equal(sent.jvp(dc=program.c), found.jvp(dc=program.c))
        assert found.errors == {}


def test_a_jvp_names_what_it_takes():
    """Changes without a name, in every kind of derivative, and rows of from_ranges."""
    lcp, contact = LCP(np.eye(2), [-1.0, -1.0]), FrictionalContact(np.eye(3), [-1.0, 0.3, 0.0], 0.5)
    program = QuadraticProgram.from_ranges(np.eye(2), [-1, -2], [[1, 1]], [0], [2])
    results = solve(lcp), solve_batch([lcp, lcp]), solve(contact), solve(program)
    for result in (*results, march(lcp, np.ones((2, 2)))):
        with pytest.raises(InvalidOption, match=r"by name, got list; write jvp\(name=…\)"):
            derivative(result).jvp([1.0, 0.0])
    for result, name in ((solve(program), "dc"), (march(lcp, np.ones((2, 2))), "dforcing")):
        with pytest.raises(InvalidOption, match=f"no option 'dq'; the change of q is {name}"):
            derivative(result).jvp(dq=[1.0, 0.0])
    with pytest.raises(InvalidOption, match="from_ranges makes h"):
        derivative(solve(program)).jvp(dupper_rows=[1.0])


@pytest.mark.parametrize("seed", [11, 14, 58])
def test_a_kink_is_found_in_units_far_apart(seed):
    """A multiplier of 0 is a kink, and one of 1e-3 is none, in units of x and of the rows up to 1e8 apart."""
    rng = np.random.default_rng(seed)
    B, G, x = rng.normal(size=(4, 4)), rng.normal(size=(3, 4)), rng.normal(size=4)
    of_x, of_rows = 10.0 ** rng.uniform(-4, 4, 4), 10.0 ** rng.uniform(-4, 4, 3)
    P, G, x = (
        (B @ B.T + 0.3 * np.eye(4)) * np.outer(of_x, of_x),
        G * np.outer(of_rows, of_x),
        x / of_x,
    )
    for small, is_unique in ((0.0, False), (1e-3, True)):
        c = -P @ x - G.T @ (np.array([1.0, small, 0.0]) / of_rows)
        found = derivative(solve(QuadraticProgram(P, c, G, G @ x + [0.0, 0.0, of_rows[2]])))
        assert found.is_unique == is_unique
        assert is_unique or found.degenerate == ["row 1 of G"]


@pytest.mark.parametrize("lower", [-np.inf, 0.0])
@pytest.mark.parametrize("name", ["l1", "weights", "ridge", "upper"])
def test_a_derivative_by_a_parameter_at_its_own_limit_is_the_one_sided_difference(name, lower):
    """With l1 = 0, weights = 0, ridge = 0 and upper = ∞, for unknowns of both signs; vjp is the transpose."""
    for seed in range(5):
        rng = np.random.default_rng(seed)
        A, b, change = rng.normal(size=(6, 3)), rng.normal(size=6), 1e-6
        data = {"l1": np.zeros(3), "weights": np.array([0.0, 1, 1, 1, 1, 2]), "ridge": 0.0}
        moved = data | {name: data[name] + change} if name in data else data
        result = solve(BoundedLeastSquares(A, b, lower=lower, **data))
        other = solve(BoundedLeastSquares(A, b, lower=lower, **moved)).require_solved()
        found, d = derivative(result), {name: np.ones(np.shape(data.get(name, b[:3])))}
        agree(found, (other.x - result.x) / change, d, 1e-4)


def test_a_penalty_that_begins_at_an_unknown_that_is_0_is_a_kink():
    """By l1 = 0 of an x that is 0 no derivative exists; by all other data it does."""
    found = derivative(solve(BoundedLeastSquares(np.eye(2), [-1.0, 0.0], lower=-np.inf)))
    np.testing.assert_allclose(found.jvp(dl1=[1.0, 0.0], db=[0.0, 1.0]), [1.0, 1.0])
    with pytest.raises(UnsuitableProblem, match="kink by l1"):
        found.jvp(dl1=1.0)


REPEATED = {
    "a row twice": {"G": [[1.0], [1.0]], "h": [1.0, 1.0]},
    "a row in another unit": {"G": [[1.0], [2.0]], "h": [1.0, 2.0]},
    "a row and a bound": {"G": [[1.0]], "h": [1.0], "upper": 1.0},
}


@pytest.mark.parametrize("name", REPEATED)
def test_constraints_that_are_active_twice_are_kinks_of_their_own_sides_only(name):
    """Min (x − 2)² with x ≤ 1 stated twice is smooth in c and P, and if both sides move; one alone is a kink."""
    program = QuadraticProgram([[2.0]], [-4.0], **REPEATED[name])
    found = derivative(solve(program))
    assert found.jvp(dc=[1.0], dP=[[1.0]]) == pytest.approx([0.0])
    both = (
        {"dupper": 1.0, "dh": [1.0]} if "upper" in REPEATED[name] else {"dh": REPEATED[name]["h"]}
    )
    assert found.jvp(**both) == pytest.approx([1.0])
    assert derivative(solve_batch([program] * 2)).jvp(dc=[1.0]).tolist() == [[0.0], [0.0]]
    for call in (lambda: found.jvp(dh=np.eye(program.h.size)[0]), lambda: found.vjp([1.0])):
        with pytest.raises(UnsuitableProblem, match="x has a kink here"):
            call()
