"""What the compiled loop over marches claims of each step, in exact arithmetic."""

from __future__ import annotations

from fractions import Fraction
from typing import NamedTuple

import numpy as np
import pytest
import scipy.sparse as sp
from exact import exact_rows

from lcp_plugin import LCP
from lcp_plugin.methods.banded import Banded
from lcp_plugin.methods.banded.march_kernels import MARCHES

STEPS = 3


class Marches(NamedTuple):
    """What the compiled loop takes."""

    problem: LCP
    forcing: np.ndarray
    propagator: sp.csr_array
    lower: np.ndarray
    upper: np.ndarray
    states: np.ndarray


def drawn(rng: np.random.Generator, kind: str) -> Marches:
    """A tridiagonal M with no positive entry beside its diagonal, and 16 marches with it."""
    n = int(rng.integers(1, 6))
    shape = (n, MARCHES)
    beside = [-rng.random(max(n - 1, 0)) * (rng.random(max(n - 1, 0)) < 0.9) for _ in range(2)]
    centre = np.r_[0.0, -beside[0]] + np.r_[-beside[1], 0.0]
    centre += 2.0**-30 if kind == "nearly singular" else rng.uniform(0.1, 2.0)
    M, C = (
        sp.diags_array([beside[0], centre, beside[1]], offsets=[-1, 0, 1], shape=(n, n)),
        -sp.eye_array(n),
    )
    if rng.random() < 0.5:
        C = sp.random_array((n, n), density=0.6, rng=rng) - sp.eye_array(n)
    forcing, lower, z = (
        rng.normal(size=(STEPS, *shape)),
        rng.normal(size=shape),
        rng.normal(size=shape),
    )
    upper = lower + np.where(rng.random(shape) < 0.5, np.inf, rng.integers(0, 3, shape))
    lower = np.where(rng.random(shape) < 0.2, -np.inf, lower)
    forcing[:, 0], upper[0] = (
        -9.0,
        np.inf,
    )  # where the nearest point to 0 solves a step, nothing is claimed of it
    unit = {"large": 2.0**450, "small": 2.0**-450, "nearly subnormal": 2.0**-1000}.get(kind, 1.0)
    rows = np.exp2(rng.integers(-200, 200, n)) if kind == "rows in other units" else np.ones(n)
    if kind == "degenerate":  # at its bound with w = 0 or nearly so
        forcing, lower, z = np.round(forcing), np.round(lower), np.round(z)
        M = sp.diags_array(
            [-np.ones(max(n - 1, 0)), np.full(n, 2.0), -np.ones(max(n - 1, 0))],
            offsets=[-1, 0, 1],
            shape=(n, n),
        )
        upper = np.where(np.isfinite(upper), np.ceil(upper), np.inf)
    M, C = sp.csr_array(sp.diags_array(rows) @ M), sp.csr_array(sp.diags_array(rows) @ C)
    states = np.clip(z, lower, upper)
    return Marches(
        LCP(M, np.zeros(n)),
        unit * rows[:, None] * forcing,
        C,
        unit * lower,
        unit * upper,
        unit * states,
    )


def exact_residual(
    problem: LCP, M: list[list[Fraction]], q: np.ndarray, bounds: np.ndarray, z: np.ndarray
) -> Fraction:
    """The largest |z_i − mid(lower_i, upper_i, z_i − w_i/d_i)|."""
    exact, largest = [Fraction(float(value)) for value in z], Fraction(0)
    for row, offset, scale, own, (low, high) in zip(
        M, q, problem.residual_scale, exact, bounds.T, strict=True
    ):
        w = sum(
            (entry * value for entry, value in zip(row, exact, strict=True)),
            Fraction(float(offset)),
        )
        reached = own - w / Fraction(float(scale))
        reached = max(reached, Fraction(float(low))) if np.isfinite(low) else reached
        reached = min(reached, Fraction(float(high))) if np.isfinite(high) else reached
        largest = max(largest, abs(own - reached))
    return largest


KINDS = (
    "ordinary",
    "nearly singular",
    "rows in other units",
    "large",
    "small",
    "nearly subnormal",
    "degenerate",
)


def of_each(rng: np.random.Generator, given: Marches) -> tuple[list[LCP], list[sp.csr_array]]:
    """For each march an M and a propagator of its own on the pattern of these."""
    shares = rng.uniform(1.0, 2.0, (2, MARCHES))
    problems = [
        LCP(sp.csr_array(given.problem.csr * share), given.problem.q) for share in shares[0]
    ]
    return problems, [sp.csr_array(given.propagator * share) for share in shares[1]]


@pytest.mark.sampled(3)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("own", [False, True])
def test_the_residual_of_each_step_is_bounded(kind: str, own: bool) -> None:
    """No step of a march has a larger exact relative residual than the compiled loop says, nor far below it.

    With one M for all marches, and one for each.
    """
    rng, checked, sharp = np.random.default_rng(58), 0, 0
    for _ in range(5):
        given, claim = drawn(rng, kind), 1e-6
        _, forcing, _, lower, upper, states = given
        problems, propagators = (
            of_each(rng, given) if own else ([given.problem], [given.propagator])
        )
        found = Banded().fused_marches(
            problems, forcing, propagators, lower, upper, states, np.arange(STEPS), claim, 100
        )
        for j in range(MARCHES):
            problem, propagator = problems[j * own], propagators[j * own]
            M, before, bounds = (
                exact_rows(problem.csr),
                states[:, j],
                np.array([lower[:, j], upper[:, j]]),
            )
            nearest = np.clip(0.0, *bounds)
            for k, z in enumerate(found.answers[j, : found.steps]):
                q = forcing[k, :, j] + propagator @ before
                residual = exact_residual(problem, M, q, bounds, z)
                reference = exact_residual(problem, M, q, bounds, nearest)
                said = found.solve_of(j, k, z).residual
                assert residual <= Fraction(said) * reference
                assert said < claim
                assert ((bounds[0] <= z) & (z <= bounds[1])).all()
                checked, sharp, before = checked + 1, sharp + (said <= 1e-14), z
    assert checked == 5 * MARCHES * STEPS
    assert sharp >= 0.5 * checked


@pytest.mark.parametrize("kind", KINDS)
def test_matrices_of_their_own_are_those_alone(kind: str) -> None:
    """16 marches with M and propagator of their own on one pattern have the bits of each by itself."""
    rng, checked = np.random.default_rng(73), 0
    for _ in range(5):
        given = drawn(rng, kind)
        problems, propagators = of_each(rng, given)
        _, forcing, _, *states = given
        rest = np.arange(STEPS), 1e-6, 100
        whole = Banded().fused_marches(problems, forcing, propagators, *states, *rest)
        for j, (one, C) in enumerate(zip(problems, propagators, strict=True)):
            of_march = (rows[..., j : j + 1] for rows in states)
            alone = Banded().fused_marches([one], forcing[..., j : j + 1], [C], *of_march, *rest)
            assert np.array_equal(whole.answers[j, : whole.steps], alone.answers[0, : whole.steps])
            checked += whole.steps
    assert checked == 5 * MARCHES * STEPS
