"""Derivatives of a batch agree with single derivatives, and bad problems do not affect others."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from inputs.contact_families import falling
from inputs.planted import planted
from tools.refusals import assert_refused, refusals

from lcp_plugin import (
    LCP,
    InvalidOption,
    InvalidProblem,
    UnsuitableProblem,
    derivative,
    solve_batch,
)
from lcp_plugin.problems.sensitivity import BatchDerivative

INF = np.inf
EPSILON = np.finfo(np.float64).eps


def of(data: tuple[Any, ...], **options: Any) -> BatchDerivative:
    M, q, lower, upper = data
    return derivative(solve_batch(M, q, lower=lower, upper=upper, **options))


def condition(found: BatchDerivative, k: int) -> float:
    """Return the condition number of the free block of problem k."""
    one = found[k]
    block = one.problem.csr.toarray()[np.ix_(one.free, one.free)]
    return float(np.linalg.cond(block)) if block.size else 1.0


def assert_each(found: BatchDerivative, seed: int = 0) -> None:
    """Compare each row with the Derivative of the problem, entries of M included."""
    rng = np.random.default_rng(seed)
    z = found.batch.z
    g, gw, dq, dlower, dupper = ([rng.normal(size=len(row)) for row in z] for _ in range(5))
    gradient, dz = found.vjp(g, gw), found.jvp(dq=dq, dlower=dlower, dupper=dupper)
    for k, one in enumerate(found):
        own = one.vjp(g[k], gw[k])
        loss = 1e2 * EPSILON * condition(found, k)
        for name in ("q", "lower", "upper"):
            ours, theirs = getattr(gradient, name)[k], getattr(own, name)
            assert np.abs(ours - theirs).max(initial=0.0) <= loss * (
                1.0 + np.abs(own.q).max(initial=0.0)
            ), name
        change = one.jvp(dq=dq[k], dlower=dlower[k], dupper=dupper[k])
        assert np.abs(dz[k] - change).max(initial=0.0) <= loss * (
            1.0 + np.abs(change).max(initial=0.0)
        )
        assert np.abs(found.z[k] - one.z).max(initial=0.0) <= loss * (
            1.0 + np.abs(one.z).max(initial=0.0)
        )
        assert found.free[k].tolist() == one.free.tolist()


@pytest.mark.quick(1)
@pytest.mark.parametrize("symmetric", [True, False])
@pytest.mark.parametrize("shared", [True, False])
@pytest.mark.parametrize("n", [1, 2, 9, 30])
def test_a_batch_has_the_derivatives_of_each(symmetric, shared, n):
    """Arrays, one M for all and lists have the derivatives, z and free rows of single problems."""
    data = planted(20, n, n, symmetric=symmetric, shared=shared)
    found = of(data)
    assert_each(found)
    M, q, lower, upper = data
    listed = [LCP(M if shared else M[k], q[k], lower=lower[k], upper=upper[k]) for k in range(20)]
    again = derivative(solve_batch(listed))
    assert np.array_equal(again.vjp(np.ones(n)).q, found.vjp(np.ones(n)).q)


def test_problems_of_any_sizes_and_kinds():
    """Dense, sparse, large and tridiagonal problems, some too large for the stack."""
    problems = []
    for k, n in enumerate((1, 3, 7, 30, 300)):
        M, q, lower, upper = (array[0] for array in planted(1, n, k, symmetric=bool(k % 2)))
        problems.append(LCP(M, q, lower=lower, upper=upper))
    chain = sp.diags_array(
        [-np.ones(39), np.full(40, 2.5), -np.ones(39)], offsets=[-1, 0, 1], format="csr"
    )
    rng = np.random.default_rng(0)
    problems += [
        LCP(chain, rng.normal(size=40)),
        LCP([[2.0, 0.0], [0.0, 1.0]], [-1.0, 1.0], upper=0.25),
    ]
    for problem in problems:
        found = derivative(solve_batch([problem, problem.with_q(0.5 * problem.q)]))
        assert_each(found)
        for gradient, one in zip(found.vjp(np.ones(problem.n)).M, found, strict=True):
            own = one.vjp(np.ones(one.z.size)).M
            assert np.array_equal(gradient.indices, own.indices)
            assert np.allclose(gradient.data, own.data, rtol=1e-12, atol=1e-13)
        dM = rng.normal(size=(problem.n, problem.n))
        for k, dz in enumerate(found.jvp(dM=dM)):
            assert np.allclose(dz, found[k].jvp(dM=dM), rtol=1e-11, atol=1e-12)
    with pytest.raises(InvalidOption, match="takes problems of one size"):
        derivative(solve_batch(problems))


def test_kinks():
    """Degenerate rows are named, with one-sided changes and fixed gradients."""
    M, q, lower, upper = planted(40, 6, 8)
    plain = of((M, q, lower, upper))
    q[:10], lower[:10], upper[:10] = 0.0, 0.0, INF  # z = 0 = w
    found = of((M, q, lower, upper))
    assert found.degenerate[:10].all()
    assert not found.degenerate[10:].any()
    dq = np.random.default_rng(0).normal(size=q.shape)
    dz, gradient = found.jvp(dq=dq), found.vjp(dq)
    assert (dz[:10] >= 0.0).all()
    assert np.array_equal(dz[10:], plain.jvp(dq=dq)[10:])
    for k in range(10):
        assert found[k].is_unique is False
        assert np.array_equal(dz[k], found[k].jvp(dq=dq[k]))
        assert np.array_equal(gradient.lower[k], found[k].vjp(dq[k]).lower)


def test_zero_rows_that_are_free_together_with_a_kink():
    """If fixed degenerate rows leave a singular block, they are free, as one by one."""
    M = np.array([[[0.0, 1.0, 0.0], [-1.0, 1.0, 0.0], [1.0, 0.0, 1.0]]])
    found = derivative(
        solve_batch(M, np.array([[0.0, 1.0, -2.0]]), lower=[-INF, 0.0, 0.0], z0=[1.0, 0.0, 1.0])
    )
    assert found.degenerate.tolist() == [[False, True, False]]
    gradient = found.vjp([1.0, 2.0, 3.0])
    assert np.isfinite(gradient.q).all()
    assert gradient.q[0].tolist() == found[0].vjp([1.0, 2.0, 3.0]).q.tolist()
    assert found.free.tolist() == [found[0].free.tolist()]


def test_contacts_have_gradients_where_impulses_are_not_determined():
    """Pyramids make M_FF singular and rows degenerate: each has a gradient in the loop, that which each has alone."""
    rng = np.random.default_rng(5)
    drawn = [falling(4, 2, 10.0, rng).arrays for _ in range(60)]
    M, q = (np.array(part) for part in zip(*drawn, strict=True))
    found = derivative(solve_batch(M, q))
    g = np.random.default_rng(6).normal(size=q.shape)
    gradient = found.vjp(g)
    assert not found.errors
    for k, one in enumerate(found):
        own = one.vjp(g[k])
        assert found.free[k].tolist() == one.free.tolist()
        for name in ("q", "lower", "upper"):
            assert getattr(gradient, name)[k] == pytest.approx(
                getattr(own, name), rel=1e-9, abs=1e-11
            )
        assert one.is_unique is False or not one.advice


def test_a_bad_problem_costs_itself_alone():
    """Invalid or unsolved problems have NaN rows and an error; other problems are unaffected."""
    M, q, lower, upper = planted(8, 4, 9)
    lower[:], upper[:] = 0.0, INF
    clean = of((M, q, lower, upper)).vjp(np.ones(4))
    q[1, 2] = np.nan
    M[2], q[2] = -np.eye(4), -1.0  # no solution
    M[3], q[3] = 0.0, 0.0  # every z ≥ 0 is one
    lower[3], upper[3] = -INF, INF
    found = of((M, q, lower, upper))
    assert not np.isfinite(found.jvp(dq=np.ones(4))[3]).any()
    assert sorted(found.errors) == [1, 2, 3]
    gradient = found.vjp(np.ones(4))
    assert isinstance(found.errors[1], InvalidProblem)
    assert "problem 2 ended" in str(found.errors[2])
    assert "singular" in str(found.errors[3])
    for name in ("q", "lower", "upper", "M"):
        rows = getattr(gradient, name)
        assert np.isnan(rows[[1, 2]]).all()
        assert not rows[3].any()  # of least change
        assert np.array_equal(rows[[0, 4, 5, 6, 7]], getattr(clean, name)[[0, 4, 5, 6, 7]])
    assert np.isnan(found.jvp(dq=np.ones(4))[[1, 2, 3]]).all()
    assert np.isnan(found.z[[1, 2]]).all()
    with pytest.raises(UnsuitableProblem, match="only a solution has a derivative"):
        found[2]
    with pytest.raises(IndexError, match="there are 8 results, and none has the number 8"):
        found[8]
    g = np.ones((8, 4))
    g[[1, 2, 3]] = 0.0  # a function that does not look at them
    silent = found.vjp(g)
    assert all(not getattr(silent, name)[[1, 2, 3]].any() for name in ("q", "lower", "upper", "M"))
    g[[1, 2]] = np.nan
    assert np.isnan(found.vjp(g).q[1]).all()


def test_a_change_that_fails_spoils_no_gradient():
    """For w = −z, z = 0 has no one-sided derivative, but its gradients with fixed z exist."""
    found = derivative(solve_batch([[[-1.0]], [[1.0]]], [[0.0], [-1.0]]))
    before = found.vjp([[2.0], [3.0]])
    assert before.lower.tolist() == [[2.0], [0.0]]
    assert np.isnan(found.jvp(dq=-1.0 * np.ones(1))).ravel().tolist() == [True, False]
    assert list(found.errors) == [0]
    after = found.vjp([[2.0], [3.0]])
    assert all(
        np.array_equal(getattr(after, name), getattr(before, name))
        for name in ("q", "lower", "upper", "M")
    )


def test_batches_of_nothing():
    """Batches without problems, or without unknowns, have empty derivatives."""
    assert derivative(solve_batch(np.zeros((0, 3, 3)), np.zeros((0, 3)))).vjp(
        np.ones(3)
    ).M.shape == (0, 3, 3)
    empty = derivative(solve_batch(np.zeros((2, 0, 0)), np.zeros((2, 0))))
    assert empty.jvp(dq=np.zeros((2, 0))).shape == (2, 0)
    assert len(derivative(solve_batch([]))) == 0


@refusals(r"""
one.vjp(np.ones((3, 4))) → g must have shape .*here \(5, 4\) or \(4,\), got
one.vjp(np.full((5, 4), np.nan)) → g must be finite, but g\[0, 0\] = nan
one.vjp(np.ones(4), np.full(4, INF)) → gw must be finite, but gw\[0, 0\]
one.jvp(dM=np.ones((4, 4, 4))) → dM must have shape \(B, n, n\) or
one.jvp(dM=np.full((5, 4, 4), INF)) → dM must be finite
one.jvp(dlower='no') → dlower must have shape
derivative(LCP([[2.0]], [0.0])) → InvalidOption: got LCP
derivative(None) → InvalidOption: got NoneType
derivative([1.0, 0.0]) → InvalidOption: got list
derivative(derivative) → InvalidOption: got function
""")
def test_what_is_refused(call, words):
    """Other shapes and numbers that are not finite raise errors that name the argument."""
    assert_refused(call, words, {**globals(), "one": of(planted(5, 4, 10))}, InvalidProblem)


def test_a_slack_of_rounding_need_not_be_a_kink():
    """The second row barely depends on its variable, which is exactly free and large."""
    found = derivative(solve_batch([[[10.0, 0.0], [1.0, 1e-11]]], [[-1.0, -0.1]]))
    assert found[0].is_unique
    assert not found.degenerate.any()
    np.testing.assert_allclose(found.vjp(np.ones((1, 2))).q, [[1e10, -1e11]], rtol=1e-9)
    np.testing.assert_allclose(found.jvp(dq=[1.0, 1.0]), [found[0].jvp(dq=[1.0, 1.0])])
