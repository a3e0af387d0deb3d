"""Rigid bodies in contact: M = J W Jᵀ with more contacts than degrees of freedom, exact and as a simulator stores it.

J holds normals and lever arms, W the inverse masses and inertias, z are contact impulses, w the velocities with which
the gaps open. Every body rests on so many points that z is not unique; w is.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from .entry import OWN, Entry, planted, solvable

MOREAU = "Moreau, Unilateral contact and dry friction in finite freedom dynamics, CISM 302, Springer 1988"
LOTSTEDT = (
    "Lötstedt, Mechanical systems of rigid bodies subject to unilateral constraints, SIAM J. Appl. Math. 42 (1982), "
    "doi:10.1137/0142022"
)

Matrix = NDArray[np.float64]
GRID = 2.0**-23  # 1.2e-7: rounding to it keeps all data exact in double precision


def entries() -> Iterator[Entry]:
    """Yield blocks and stacks, then random contacts: exact, rounded symmetrically, rounded to either side."""
    yield from _blocks()
    yield from _stacks()
    for dofs, contacts in ((3, 9), (6, 24), (30, 80), (60, 200)):
        yield from _random(dofs, contacts)


def _blocks() -> Iterator[Entry]:
    """One plane block (vertical velocity, rotation) on supports at given distances from its centre."""
    for name, arms in (
        ("two", [-1, 1]),
        ("three", [-1, 0, 1]),
        ("five", [-2, -1, 0, 1, 2]),
        ("one_side", [1, 2, 3]),
    ):
        J = np.column_stack([np.ones(len(arms)), arms])
        M = J @ np.diag([1.0, 0.5]) @ J.T
        yield solvable(f"block_on_{name}_supports", MOREAU, M, -J[:, 0] * 9.75)
        yield solvable(f"block_on_{name}_supports_rotating", MOREAU, M, J @ [-1.0, 2.0])
    J = np.array([[1, x, y] for x in (-1, 1) for y in (-1, 1)], dtype=float)
    M = J @ np.diag([1.0, 2.0, 2.0]) @ J.T
    yield solvable(
        "table_on_four_legs",
        f"{LOTSTEDT}: the indeterminate table",
        M,
        [-1] * 4,
        solution=["1/4"] * 4,
    )
    yield solvable("table_loaded_at_a_corner", LOTSTEDT, M, J @ [-1.0, -1.0, -0.75])
    yield solvable("two_equal_contacts", OWN, np.ones((2, 2)), [-1, -1], solution=[1, 0])
    yield solvable(
        "wedged_ball",
        f"{OWN}: two walls against each other",
        [[1, -1], [-1, 1]],
        [0, 0],
        solution=[0, 0],
    )


def stack(blocks: int, points: int) -> tuple[Matrix, Matrix]:
    """Return J and the free-fall velocity of blocks on top of each other, touching at `points` points each."""
    arms = np.linspace(-1.0, 1.0, points)
    J = np.zeros((blocks * points, 2 * blocks))
    for k in range(blocks):
        rows = slice(k * points, (k + 1) * points)
        J[rows, 2 * k], J[rows, 2 * k + 1] = 1.0, arms
        if k:
            J[rows, 2 * k - 2], J[rows, 2 * k - 1] = -1.0, -arms
    velocity = np.zeros(2 * blocks)
    velocity[::2] = -1.0
    return J, velocity


def _stacks() -> Iterator[Entry]:
    """A stack at rest: each interface carries the weight above it, evenly spread."""
    for blocks, points in ((2, 2), (3, 3), (5, 2), (10, 5), (25, 9)):
        J, velocity = stack(blocks, points)
        mass = np.tile([1.0, 2.0], blocks)
        weight = np.repeat([str(blocks - k) + f"/{points}" for k in range(blocks)], points)
        yield solvable(
            f"stack_{blocks}_on_{points}_points",
            MOREAU,
            J @ np.diag(mass) @ J.T,
            J @ velocity,
            solution=weight,
        )


def _random(dofs: int, contacts: int) -> Iterator[Entry]:
    generator = np.random.default_rng(contacts)
    J = generator.integers(-3, 4, (contacts, dofs)).astype(float)
    J[:, 0] = 1.0 + np.abs(
        J[:, 0]
    )  # all gaps open when the first coordinate rises: strictly feasible
    W = np.diag(2.0 ** generator.integers(-3, 2, dofs))
    M = J @ W @ J.T
    touching = generator.random(contacts) < 0.6
    z = touching * generator.integers(1, 6, contacts).astype(float)
    w = ~touching * generator.integers(0, 6, contacts).astype(float)
    name = f"random_contact_{dofs}_dofs_{contacts}"
    # w must be a velocity: w − q ∈ range J holds for q = w − M z.
    yield planted(name, MOREAU, M, z, w)

    irregular = J * (1.0 + 0.25 * generator.random(J.shape))
    delassus = irregular @ W @ irregular.T
    rounded = GRID * np.round(delassus / GRID)
    rounded = np.tril(rounded) + np.tril(rounded, -1).T
    yield planted(f"{name}_rounded", f"{MOREAU}; stored with seven digits", rounded, z, w)
    sides = GRID * np.where(
        np.tri(contacts, dtype=bool), np.floor(delassus / GRID), np.ceil(delassus / GRID)
    )
    yield planted(f"{name}_rounded_unsymmetric", f"{MOREAU}; stored with seven digits", sides, z, w)
    # q of the unrounded problem, rounded: strictly feasible and monotone, hence solvable, also after small changes.
    velocity = generator.standard_normal(dofs)
    velocity[0] = -3.0
    q = GRID * np.round(irregular @ velocity / GRID)
    yield solvable(
        f"{name}_rounded_free",
        f"{MOREAU}; stored with seven digits",
        rounded,
        q,
        theorem="strictly feasible monotone problems stay solvable under small changes (Robinson 1979)",
    )
