"""Contacts with friction whose answer is known to exist: planted impulses, bodies at rest, towers, few motions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from lcp_plugin.problems.contact import Contacts, contact_data

OPEN, STICKS = 0, 1  # and slips: 2, 3


def rows_of_bodies(count: int, bodies: int, rng: np.random.Generator) -> Any:
    """J, shape (3 count, 6 bodies): contacts with random frames between two bodies, or one and the ground."""
    J = np.zeros((count, 3, 6 * bodies))
    for c in range(count):
        normal = np.array([0.0, 0.0, 1.0]) + 0.2 * rng.standard_normal(3)
        normal /= np.linalg.norm(normal)
        first = np.cross(normal, [1.0, 0.0, 0.0])
        first /= np.linalg.norm(first)
        one, other = rng.integers(bodies), rng.integers(-1, bodies)
        for body, sign in ((one, 1.0), (other, -1.0)):
            if body >= 0 and (sign > 0.0 or one != other):
                arm = rng.standard_normal(3)
                for k, d in enumerate((normal, first, np.cross(normal, first))):
                    J[c, k, 6 * body : 6 * body + 6] += sign * np.array([*d, *np.cross(arm, d)])
    return J.reshape(3 * count, -1)


def pyramids(W: Any, b: Any, friction: Any) -> tuple[Any, Any]:
    """Return M and q of contacts with four directions of friction each, normals first in each block of W."""
    count = len(friction)
    normals, tangents = (
        np.eye(3 * count)[:, ::3],
        np.eye(3 * count)[:, np.arange(3 * count) % 3 > 0],
    )
    D, E = (
        np.hstack([normals, tangents, -tangents]),
        np.tile(np.repeat(np.eye(count), 2, 0), (2, 1)),
    )
    size = 5 * count
    M = np.zeros((size + count, size + count))
    M[:size, :size], M[count:size, size:] = D.T @ W @ D, E
    M[size:, :count], M[size:, count:size] = np.diag(friction), -E.T
    return M, np.concatenate([D.T @ b, np.zeros(count)])


def delassus(count: int, bodies: int, ratio: float, rng: np.random.Generator) -> tuple[Any, Any]:
    """W of bodies whose masses differ by up to that ratio, and J."""
    J, mass = rows_of_bodies(count, bodies, rng), np.repeat(ratio ** rng.random(bodies), 6)
    return J / mass @ J.T, J


def planted(count: int, bodies: int, ratio: float, rng: np.random.Generator) -> Contacts:
    """Random impulses of contacts that open, stick and slip, some at a kink, and the velocities that they answer."""
    W, _ = delassus(count, bodies, ratio, rng)
    friction, kind = rng.uniform(0.1, 1.0, count), rng.integers(0, 4, count)
    size = 1.0 / np.sqrt(np.diag(W).reshape(count, 3).mean(axis=1))
    x, w = np.zeros((2, count, 3))
    x[:, 0] = np.where(kind != OPEN, rng.uniform(0.1, 2.0, count), 0.0) * size
    for c in range(count):
        limit = friction[c] * x[c, 0]
        if kind[c] == OPEN:
            w[c] = [rng.uniform() * (rng.random() < 0.8), *rng.standard_normal(2)]
        elif kind[c] == STICKS:
            share = rng.standard_normal(2)
            x[c, 1:] = (
                limit * rng.choice([1.0, rng.random()], p=[0.1, 0.9]) * share / np.abs(share).sum()
            )
        else:
            w[c, 1:] = 0.1 * rng.standard_normal(2) / size[c]
            steepest = 1 + int(np.abs(w[c, 1:]).argmax())
            x[c, steepest] = -np.sign(w[c, steepest]) * limit
    return contact_data(W, friction, (w.ravel() - W @ x.ravel()).reshape(count, 3))


def falling(count: int, bodies: int, ratio: float, rng: np.random.Generator) -> Contacts:
    """Bodies that gravity pulls into their contacts, half of the time with other pushes."""
    W, J = delassus(count, bodies, ratio, rng)
    pull = np.zeros(6 * bodies)
    pull[2::6] = -1.0
    pull += 0.3 * rng.standard_normal(6 * bodies) * (rng.random() < 0.5)
    return contact_data(W, rng.uniform(0.1, 1.0, count), (J @ pull).reshape(count, 3))


def frictionless(count: int, bodies: int, ratio: float, rng: np.random.Generator) -> Contacts:
    """The same on ice: velocities are unique."""
    data = falling(count, bodies, ratio, rng)
    return contact_data(data.W, 0.0, data.velocities)


FAMILIES: dict[str, Callable[..., Contacts]] = {
    "planted": planted,
    "falling": falling,
    "frictionless": frictionless,
}
