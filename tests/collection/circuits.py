"""Electrical circuits with ideal diodes (mixed problems) and relays (boxes [−1, 1])."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from .entry import OWN, Entry, planted, solvable

BROGLIATO = (
    "Acary, Bonnefon, Brogliato, Nonsmooth Modeling and Simulation for Switched Circuits, Springer 2011, "
    "doi:10.1007/978-90-481-9681-4"
)
ACARY = (
    "Acary, Brogliato, Implicit Euler numerical scheme and chattering-free implementation of sliding mode systems, "
    "Systems & Control Letters 59 (2010)"
)
MONOTONE = "M positive semidefinite and linearly feasible: Cottle 1968"

Matrix = NDArray[np.float64]


def entries() -> Iterator[Entry]:
    """Yield diode circuits, then relays."""
    yield from _diodes()
    yield from _relays()


def circuit(
    resistors: Sequence[tuple[int, int, float]], diodes: Sequence[tuple[int, int]], nodes: int
) -> Matrix:
    """Return M of (node potentials free, diode currents ≥ 0): currents balance, no diode has forward voltage.

    Node 0 is the ground. A resistor is (node, node, conductance), a diode (from, to).
    """
    G = np.zeros((nodes + 1, nodes + 1))
    for a, b, conductance in resistors:
        G[a, a] += conductance
        G[b, b] += conductance
        G[a, b] -= conductance
        G[b, a] -= conductance
    leaves = np.zeros((nodes + 1, len(diodes)))
    for k, (a, b) in enumerate(diodes):
        leaves[a, k] += 1.0
        leaves[b, k] -= 1.0
    G, leaves = G[1:, 1:], leaves[1:]
    return np.block([[G, leaves], [-leaves.T, np.zeros((len(diodes), len(diodes)))]])


def diode_problem(
    name: str,
    resistors: Sequence[tuple[int, int, float]],
    diodes: Sequence[tuple[int, int]],
    injected: Sequence[float],
    *,
    drop: float = 0.0,
    source: str = BROGLIATO,
) -> Entry:
    """Return the mixed problem: q is minus the injected currents, then the voltage drop of the diodes."""
    nodes = len(injected)
    M = circuit(resistors, diodes, nodes)
    q = np.concatenate([-np.asarray(injected, dtype=float), np.full(len(diodes), drop)])
    lower = np.concatenate([np.full(nodes, -np.inf), np.zeros(len(diodes))])
    theorem = MONOTONE if len(q) > 10 else ""
    return solvable(name, f"{source}; own numbers", M, q, lower=lower, theorem=theorem)


BRIDGE = [(1, 3), (2, 3), (4, 1), (4, 2)]


def _diodes() -> Iterator[Entry]:
    for current in (2.0, -2.0, 0.0):
        yield diode_problem(
            f"half_wave_{current:+g}", [(1, 0, 0.5), (2, 0, 1.0)], [(1, 2)], [current, 0.0]
        )
    for current in (3.0, -3.0, 0.0):
        resistors = [(1, 2, 0.125), (3, 4, 1.0), (4, 0, 1.0)]
        yield diode_problem(
            f"bridge_{current:+g}", resistors, BRIDGE, [current, -current, 0.0, 0.0]
        )
    yield diode_problem(
        "bridge_with_drop",
        [(1, 2, 0.125), (3, 4, 1.0), (4, 0, 1.0)],
        BRIDGE,
        [3.0, -3.0, 0.0, 0.0],
        drop=0.5,
    )
    yield diode_problem(
        "bridge_weak_load",
        [(1, 2, 2.0**-20), (3, 4, 2.0**10), (4, 0, 1.0)],
        BRIDGE,
        [3.0, -3.0, 0.0, 0.0],
    )
    yield diode_problem(
        "clipper", [(1, 0, 1.0), (1, 2, 4.0), (2, 0, 0.25)], [(2, 0), (0, 2)], [5.0, 0.0], drop=0.75
    )
    yield diode_problem(
        "maximum_of_three",
        [(1, 0, 1.0), (2, 0, 1.0), (3, 0, 1.0), (4, 0, 0.5)],
        [(1, 4), (2, 4), (3, 4)],
        [3.0, 5.0, 4.0, 0.0],
    )
    yield diode_problem(
        "parallel_diodes", [(1, 0, 1.0), (2, 0, 1.0)], [(1, 2), (1, 2), (1, 2)], [4.0, 0.0]
    )
    yield diode_problem(
        "antiparallel_loop", [(1, 0, 1.0), (2, 0, 1.0)], [(1, 2), (2, 1)], [4.0, 0.0]
    )


def relay(
    name: str,
    M: Matrix,
    q: Sequence[float],
    *,
    solution: Sequence[object] | None = None,
    source: str = ACARY,
) -> Entry:
    """Return the relay problem z ∈ [−1, 1], z = ∓1 where w = M z + q is positive or negative."""
    theorem = "continuous piecewise linear map on a compact box: Brouwer"
    return solvable(name, source, M, q, lower=-1.0, upper=1.0, solution=solution, theorem=theorem)


def _relays() -> Iterator[Entry]:
    yield relay("relay_sliding", np.array([[2.0]]), [-1.0], solution=["1/2"])
    yield relay("relay_reaching", np.array([[2.0]]), [-5.0], solution=[1])
    yield relay(
        "relay_twisting", np.array([[1.0, 0.5], [0.0, 2.0]]), [-0.25, 1.0], solution=["1/2", "-1/2"]
    )
    yield relay("relay_edge", np.eye(2), [1.0, -1.0], solution=[-1, 1])
    yield relay("relay_without_influence", np.zeros((3, 3)), [2.0, -1.0, 0.0], solution=[-1, 1, 0])
    yield relay(
        "relay_filippov", np.array([[0.0, -1.0], [1.0, 0.0]]), [0.5, 0.25], solution=["-1/4", "1/2"]
    )
    yield relay(
        "relay_skew_4",
        np.array([[0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 3], [0, 0, -3, 0.0]]),
        [-0.5, 2, 1, 6],
        solution=None,
    )
    yield relay("relay_negative", np.array([[-1.0]]), [0.25], solution=[-1])
    yield relay(
        "relay_indefinite_4",
        np.array([[1, 2, 0, -1], [2, 1, 1, 0], [0, 3, -2, 1], [1, 0, 1, 1.0]]),
        [0.5, -1, 2, 0],
    )
    yield relay("relay_large_gain", 2.0**20 * np.array([[2.0, 1.0], [1.0, 2.0]]), [2.0**18, -3.0])
    for n in (20, 100):
        generator = np.random.default_rng(n)
        B = generator.integers(-2, 3, (n, n)).astype(float)
        z = generator.integers(-4, 5, n) / 4.0
        w = np.where(z == -1.0, 2.0, np.where(z == 1.0, -2.0, 0.0)) * (generator.random(n) < 0.8)
        lower, upper = -np.ones(n), np.ones(n)
        yield planted(
            f"relay_network_{n}", f"{OWN}, after {ACARY}", B @ B.T, z, w, lower=lower, upper=upper
        )
        yield planted(
            f"relay_network_{n}_singular",
            f"{OWN}, after {ACARY}",
            B[:, : n // 2] @ B[:, : n // 2].T,
            z,
            w,
            lower=lower,
            upper=upper,
        )
