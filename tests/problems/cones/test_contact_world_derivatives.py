"""Derivatives of a batch of contact problems: differences, and single derivatives."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tools.refusals import assert_refused, refusals

from lcp_plugin import (
    FrictionalContact,
    InvalidProblem,
    Status,
    UnsuitableProblem,
    derivative,
    solve_batch,
)
from lcp_plugin.problems.cones.factors import cone_stack_of
from lcp_plugin.problems.sensitivity import ContactBatchDerivative


def drawn(
    count: int, rng: np.random.Generator, *, compliance: float = 0.05, k: int = 4
) -> tuple[Any, Any, Any]:
    """W, b and friction of one body at k contacts: singular without compliance."""
    J = rng.standard_normal((count, 3 * k, 6))
    b = (J @ rng.standard_normal((count, 6, 1)))[:, :, 0]
    return J @ J.swapaxes(1, 2) + compliance * np.eye(3 * k), b, rng.uniform(0.1, 0.9, (count, k))


def derived(*data: Any, **options: Any) -> ContactBatchDerivative:
    return derivative(solve_batch(FrictionalContact.worlds(*data, dimension=3), **options))


def close(a: Any, b: Any, tolerance: float) -> bool:
    return bool(np.abs(a - b).max(initial=0.0) <= tolerance * max(np.abs(b).max(initial=0.0), 1e-6))


def test_what_sticks_on_one_body_has_the_gradient_of_least_norm():
    """The gradient uses the pseudo-inverse of D⁻¹W, and is independent of rounding directions."""
    rng = np.random.default_rng(0)
    J = rng.standard_normal((40, 12, 6))
    W, r = J @ J.swapaxes(1, 2), np.tile([1.0, 0.1, -0.1], 4)
    found, g = derived(W, -W @ r, 5.0), rng.standard_normal((40, 12))
    assert all(one.is_singular for one in found)
    sticks = found.batch.motion.sticks.all(axis=1) & ~found.degenerate.any(axis=1)
    assert sticks.sum() >= 10
    gradient = found.vjp(g)
    for k in np.flatnonzero(sticks):
        d = np.repeat(cone_stack_of(found.instances[k]).d[0], 3)
        assert close(
            gradient.q[k], -np.linalg.pinv(W[k] / d[:, np.newaxis], rcond=1e-12).T @ g[k] / d, 1e-8
        )
        assert close(found[k].vjp(g[k]).q, gradient.q[k], 1e-8)
    assert np.abs(found.dw(found.jvp(dq=W @ r), dq=W @ r)[sticks]).max() < 1e-10


def test_instances_of_different_size():
    """Data and changes of absent contacts have no effect on instances of different size."""
    rng = np.random.default_rng(2)
    W, b, mu = drawn(15, rng)
    counts = np.arange(15) % 5
    g, gw, dq = (rng.standard_normal((15, 12)) for _ in range(3))
    for k, count in enumerate(counts):
        for rows in (b, g, gw, dq):
            rows[k, 3 * count :] = np.nan
    found = derivative(solve_batch(FrictionalContact.worlds(W, b, mu, contacts=counts)))
    gradient, dz = found.vjp(g, gw), found.jvp(dq=dq, dfriction=1.0)
    for k, count in enumerate(counts):
        own, one = slice(3 * count), found[k]
        assert not gradient.q[k, 3 * count :].any()
        assert not gradient.friction[k, count:].any()
        assert not gradient.M[k, :, 3 * count :].any()
        assert not dz[k, 3 * count :].any()
        assert close(dz[k, own], one.jvp(dq=dq[k, own], dfriction=1.0), 1e-9)
        assert close(gradient.q[k, own], one.vjp(g[k, own], gw[k, own]).q, 1e-9)


def test_what_the_loop_leaves_and_what_has_no_derivative():
    """Badly scaled instances are solved singly; NaN rows belong only to failed instances."""
    scale = np.array([1.0, 1.0, 1.0, 1e4, 1e4, 1e4])
    coupled = np.eye(6) + 0.3 * np.fliplr(np.eye(6))
    W, b = np.stack([np.eye(6)] * 4), np.tile([-1.0, 3.0, 4.0, -1.0, 0.1, 0.0], (4, 1))
    W[0], W[1, 0, 0] = coupled * scale * scale[:, np.newaxis], np.nan
    b[0], W[2, :3, :3] = b[0] * scale, np.diag([0.0, 1.0, 1.0])
    batch = solve_batch(
        FrictionalContact.worlds(W, b, [[0.5, 0.5], [0.5, 0.5], [0.0, 0.0], [0.5, 0.5]])
    )
    found = derivative(batch)
    assert batch.status[2] is Status.INFEASIBLE
    assert sorted(found.errors) == [1, 2]
    assert isinstance(found.errors[1], InvalidProblem)
    with pytest.raises(UnsuitableProblem, match="INFEASIBLE"):
        _ = found[2]
    asked = np.zeros((4, 6))
    asked[[0, 1], 0] = 1.0
    gradient = found.vjp(asked)
    assert np.isnan(gradient.q[1]).all()
    assert not gradient.q[2].any()
    assert close(gradient.q[0], found[0].vjp(asked[0]).q, 1e-9)
    assert np.isnan(found.jvp(dq=asked)[[1, 2]]).all()
    assert sorted(found.errors) == [1, 2]
    assert found.vjp(np.zeros(6)).q.shape == (4, 6)
    assert derived(np.eye(3), np.zeros((0, 3)), 0.5).vjp(np.zeros(3)).M.shape == (0, 3, 3)


@refusals(r"""
found.vjp(np.zeros(4)) → g must have shape \(B, n\) or \(n,\), here
found.jvp(dM=np.zeros(3)) → dM must have shape \(B, n, n\)
found.jvp(dfriction=[1.0, 2.0]) → dfriction must have shape
found.jvp(dq=[np.nan, 0.0, 0.0]) → dq\[0, 0\] = nan
""")
def test_wrong_changes_are_refused_in_words(call, words):
    """Wrong changes raise errors with the required shapes."""
    found = derived(np.eye(3)[None], np.array([[-1.0, 3.0, 4.0]]), 0.5)
    assert_refused(call, words, {"found": found}, InvalidProblem)
