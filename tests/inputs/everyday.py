"""Problems as people assemble them: zeros are 1e-17, bodies are at rest, and weights are decimal numbers."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from lcp_plugin import LCP

Generator = np.random.Generator
GRAVITY = 0.0981  # velocity that a time step of 0.01 adds
NOISE = (0.0, 1e-17, 1e-16, 1e-15, 1e-14, 1e-13, 1e-12)  # of a simulator, in velocities


class Contacts(NamedTuple):
    """Contacts without friction of bodies that fall, and that their supports keep at rest.

    Attributes
    ----------
    normals : array, shape (contacts, coordinates)
        Velocity of each contact per velocity of the coordinates.
    inverse_mass : array, shape (coordinates,)
    velocity : array, shape (coordinates,)
        Velocity without contact.
    """

    normals: Any
    inverse_mass: Any
    velocity: Any

    def lcp(self, noise: Any = 0.0) -> LCP:
        """Return the LCP of the impulses; noise is added to the velocities of the contacts."""
        M = (self.normals * self.inverse_mass) @ self.normals.T
        return LCP(M, self.normals @ self.velocity + noise)

    def velocity_after(self, impulses: Any) -> Any:
        """Return the velocity of the coordinates after the impulses, shape (coordinates,)."""
        return self.velocity + self.inverse_mass * (self.normals.T @ impulses)


def wall(courses: int, bricks: int, angle: float) -> Contacts:
    """Return a wall in running bond, two contacts per face, in a frame that is rotated by an angle."""
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    up = rotation @ [0.0, 1.0]
    centers = [
        (column + 0.5 * (course % 2), 0.5 * course)
        for course in range(courses)
        for column in range(bricks - course % 2)
    ]
    rows: list[Any] = []
    for upper, (x, y) in enumerate(centers):
        below = [k for k, (a, b) in enumerate(centers) if b == y - 0.5 and abs(a - x) < 1.0]
        for lower in below or [None] * (y == 0.0):
            left = x - 0.5 if lower is None else max(x, centers[lower][0]) - 0.5
            right = x + 0.5 if lower is None else min(x, centers[lower][0]) + 0.5
            for point in (left, right):
                row = np.zeros((len(centers), 3))
                for brick, sign in ((upper, 1.0), (lower, -1.0)):
                    if brick is not None:
                        arm = rotation @ (np.array([point, y - 0.25]) - centers[brick])
                        row[brick] += sign * np.array([*up, arm[0] * up[1] - arm[1] * up[0]])
                rows.append(row.ravel())
    inertia = (1.0 + 0.5**2) / 12.0
    inverse_mass = np.tile([1.0, 1.0, 1.0 / inertia], len(centers))
    return Contacts(np.array(rows), inverse_mass, np.tile([*(-GRAVITY * up), 0.0], len(centers)))


def doubled_stack(boxes: int, rng: Generator) -> Contacts:
    """Return boxes on four corners each, and on four more contacts near these."""
    rows = []
    for box in range(boxes):
        for k in range(8):
            at = np.array([1 - 2 * (k & 1), (k & 2) - 1]) * (1.0 + 0.1 * rng.random(2) * (k > 3))
            row = np.zeros((boxes, 3))
            row[box] = 1.0, at[1], -at[0]
            if box:
                row[box - 1] = -row[box]
            rows.append(row.ravel())
    inverse_mass = np.repeat(10.0 ** rng.uniform(-0.5, 0.5, boxes), 3) * np.tile([1, 6, 6], boxes)
    return Contacts(np.array(rows), inverse_mass, np.tile([-GRAVITY, 0.0, 0.0], boxes))


def network(nodes: int, rng: Generator) -> Any:
    """Return the Laplacian of a connected network whose weights have one decimal, shape (nodes, nodes)."""
    weights = np.triu(rng.integers(0, 10, (nodes, nodes)) / 10, 1)
    weights += 0.3 * np.eye(nodes, k=1)
    weights += weights.T
    return np.diag(weights.sum(axis=1)) - weights


def rod(n: int) -> sp.csr_array:
    """Return I + 0.1 K for the stiffness K of a free rod of n nodes: a step of time on springs."""
    K = sp.diags_array([-np.ones(n - 1), 2.0 * np.ones(n), -np.ones(n - 1)], offsets=[-1, 0, 1])
    ends = sp.csr_array(([1.0, 1.0], ([0, n - 1], [0, n - 1])), shape=(n, n))
    return (sp.eye_array(n) + 0.1 * (K - ends)).tocsr()


def market(rng: Generator) -> tuple[LCP, Any, Any, Any]:
    """Return the equilibrium of four factories and six towns, and costs (4, 6), supplies (4,), demands (6,)."""
    costs, supplies = rng.integers(1, 20, (4, 6)) / 10, np.full(4, 3.0)
    demands = 2.0 - 0.1 * rng.integers(0, 3, 6)
    out = np.kron(np.eye(4), np.ones(6))
    into = np.kron(np.ones(4), np.eye(6))
    M = np.block(
        [[np.zeros((24, 24)), out.T, -into.T], [-out, np.zeros((4, 10))], [into, np.zeros((6, 10))]]
    )
    return LCP(M, np.concatenate([costs.ravel(), supplies, -demands])), costs, supplies, demands


def sliding_contacts(contacts: int, rng: Generator) -> tuple[LCP, Any]:
    """Return contacts with a pyramid of four edges each and a solution chosen first; some contacts are not loaded."""
    normals = rng.normal(size=(contacts, 6))
    edges = np.repeat(rng.normal(size=(contacts, 2, 6)), 2, axis=1)
    edges[:, 1::2] *= -1.0
    J = np.vstack([normals, edges.reshape(-1, 6)])
    E = np.kron(np.eye(contacts), np.ones((4, 1)))
    none = np.zeros((contacts, contacts))
    M = np.block([[J @ J.T, np.vstack([none, E])], [0.5 * np.eye(contacts), -E.T, none]])
    is_loaded = rng.random(contacts) < 0.7
    normal = np.where(is_loaded, rng.integers(2, 6, contacts), 0.0)
    friction, slip = np.zeros((contacts, 4)), np.zeros(contacts)
    open_speed = np.where(is_loaded, 0.0, 1.0)
    friction[:, 0] = 0.5 * normal  # slides against the first edge
    slip[is_loaded] = 1.0
    speed = np.where(is_loaded[:, None], [0.0, 2.0, 1.0, 1.0], 1.0)
    z = np.concatenate([normal, friction.ravel(), slip])
    w = np.concatenate([open_speed, speed.ravel(), np.zeros(contacts)])
    return LCP(M, w - M @ z), z


def put_on_two_assets(nodes: int, volatilities: tuple[float, float], correlation: float) -> LCP:
    """Return a step in time of an American put on the mean of two assets, on a wide grid of logarithms."""
    a, b = volatilities
    rate, step, width, h = 0.03, 0.02, 4.0, 1.0 / (nodes + 1)
    near = np.ones(nodes - 1)
    D = sp.diags_array([-near, near], offsets=[-1, 1]) / (2.0 * h * width)
    D2 = sp.diags_array([near, -2.0 * np.ones(nodes), near], offsets=[-1, 0, 1]) / (h * width) ** 2
    one = sp.eye_array(nodes)
    L = sp.kron(0.5 * a**2 * D2 + (rate - 0.5 * a**2) * D, one)
    L += sp.kron(one, 0.5 * b**2 * D2 + (rate - 0.5 * b**2) * D)
    L += correlation * a * b * sp.kron(D, D) - rate * sp.eye_array(nodes**2)
    prices = np.exp(width * (np.linspace(h, 1.0 - h, nodes) - 0.5))
    payoff = np.maximum(1.0 - 0.5 * (prices[:, np.newaxis] + prices), 0.0).ravel()
    return LCP(sp.csr_array(sp.eye_array(nodes**2) - step * L), -payoff, lower=payoff)


def standing(steps: int, feet: int, states: int, rng: Generator) -> tuple[Any, ...]:
    """Return P, c, G, h, A and b of a body that stands still over some steps: forces without costs, the optimum is 0.

    The unknowns of a step are `states` positions and velocities, which have costs, and a tangential and a normal force
    of each foot. Gravity acts on the first coordinate; arms of the feet, in the other coordinates, sum to 0.
    """
    half, forces, dt, gravity = states // 2, 2 * feet, 0.05, 9.81
    arms = np.round(rng.normal(size=(half, forces)), 1)
    arms[0] = np.tile([0.0, 1.0], feet)
    normal = arms[1:, 1::2]
    normal -= np.round(normal.mean(axis=1, keepdims=True), 12)
    arms[1:, 1::2] = normal
    step = np.block([[np.eye(half), dt * np.eye(half)], [np.zeros((half, half)), np.eye(half)]])
    push = np.vstack([0.5 * dt * dt * arms, dt * arms])
    fall = gravity * np.concatenate([0.5 * dt * dt * np.eye(half)[0], dt * np.eye(half)[0]])
    size = states + forces
    A, b = np.zeros((steps * states, steps * size)), np.tile(fall, steps)
    for k in range(steps):
        rows = slice(k * states, (k + 1) * states)
        A[rows, k * size : k * size + states] = -np.eye(states)
        A[rows, k * size + states : (k + 1) * size] = push
        if k:
            A[rows, (k - 1) * size : (k - 1) * size + states] = step
    cone = np.zeros((2 * feet, size))
    for foot in range(feet):
        at = states + 2 * foot
        cone[2 * foot : 2 * foot + 2, at : at + 2] = [[1.0, -0.5], [-1.0, -0.5]]
    weights = np.concatenate([rng.integers(1, 20, states) / 10, np.zeros(forces)])
    G = np.kron(np.eye(steps), cone)
    return np.diag(np.tile(weights, steps)), np.zeros(steps * size), G, np.zeros(len(G)), A, b
