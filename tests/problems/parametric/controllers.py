"""Model predictive controllers as programs whose vectors depend on the state."""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_discrete_are

from lcp_plugin import QuadraticProgram


def controller(
    A: np.ndarray,
    B: np.ndarray,
    Q: np.ndarray,
    R: np.ndarray,
    horizon: int,
    force: float,
    room: float | np.ndarray,
) -> tuple[QuadraticProgram, dict[str, np.ndarray]]:
    """Return the program in the forces of all steps, and how c and h depend on the state.

    min Σ xᵀQx + uᵀRu + the cost of the unconstrained controller afterwards; |u| ≤ force, |x| ≤ room at every step.
    """
    n, m = B.shape
    cost = np.kron(np.eye(horizon), Q)
    cost[-n:, -n:] = solve_discrete_are(A, B, Q, R)
    free = np.vstack([np.linalg.matrix_power(A, k + 1) for k in range(horizon)])
    forced = np.zeros((horizon * n, horizon * m))
    for i in range(horizon):
        for j in range(i + 1):
            forced[i * n : (i + 1) * n, j * m : (j + 1) * m] = np.linalg.matrix_power(A, i - j) @ B
    P = forced.T @ cost @ forced + np.kron(np.eye(horizon), R)
    limits = np.tile(np.broadcast_to(room, n), horizon)
    program = QuadraticProgram(
        (P + P.T) / 2,
        np.zeros(horizon * m),
        G=np.vstack([forced, -forced]),
        h=np.concatenate([limits, limits]),
        lower=-force,
        upper=force,
    )
    return program, {"c": forced.T @ cost @ free, "h": np.vstack([-free, free])}


def double_integrator(horizon: int) -> tuple[QuadraticProgram, dict[str, np.ndarray]]:
    """Bemporad, Morari, Dua, Pistikopoulos 2002: position and speed, one force."""
    return controller(
        np.array([[1.0, 1.0], [0.0, 1.0]]),
        np.array([[0.5], [1.0]]),
        np.eye(2),
        np.array([[0.1]]),
        horizon,
        1.0,
        5.0,
    )
