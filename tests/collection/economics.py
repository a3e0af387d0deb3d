"""Equilibria of markets, transport and industry, all with linear functions."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from .entry import OWN, Entry, planted, solvable

TAKAYAMA_JUDGE = (
    "Takayama, Judge, Spatial and Temporal Price and Allocation Models, North-Holland 1971"
)
DANTZIG_MANNE = (
    "Hansen, Koopmans, On the definition and computation of a capital stock invariant under optimization, "
    "J. Economic Theory 5 (1972); Dantzig, Manne, A complementarity algorithm for an optimal capital path with "
    "invariant proportions, J. Economic Theory 9 (1974)"
)
COURNOT = (
    "Murphy, Sherali, Soyster, A mathematical programming approach for determining oligopolistic market equilibrium, "
    "Math. Programming 24 (1982)"
)

Matrix = NDArray[np.float64]


def entries() -> Iterator[Entry]:
    """Yield spatial prices, production, capital stocks, oligopolies and traffic."""
    yield from _spatial_prices()
    yield from _capital()
    yield from _oligopoly()


def _spatial_prices() -> Iterator[Entry]:
    for m, k, seed in ((2, 2, 0), (2, 3, 1), (3, 3, 2)):
        generator = np.random.default_rng(seed)
        supply_slope, demand_slope = generator.integers(1, 5, m), generator.integers(1, 5, k)
        M = _shipments(np.diag(supply_slope), np.diag(demand_slope))
        intercept = (
            generator.integers(1, 10, (m, 1))
            - generator.integers(20, 40, k)
            + generator.integers(1, 12, (m, k))
        )
        yield solvable(
            f"spatial_price_{m}x{k}", f"{TAKAYAMA_JUDGE}; own numbers", M, intercept.ravel()
        )
    for m, k, seed in ((5, 5, 3), (10, 12, 4)):
        generator = np.random.default_rng(seed)
        # Prices here depend on the quantities there too, and not symmetrically.
        slopes = [
            np.diag(generator.integers(8, 16, size)) + generator.integers(0, 2, (size, size))
            for size in (m, k)
        ]
        M = _shipments(*slopes)
        ships = generator.random(m * k) < 0.3
        z = ships * generator.integers(1, 9, m * k)
        w = ~ships * generator.integers(0, 9, m * k)
        yield planted(f"spatial_price_{m}x{k}_asymmetric", f"{TAKAYAMA_JUDGE}; planted", M, z, w)
    generator = np.random.default_rng(5)
    m, k = 3, 3
    # Rows: supply balance ⟂ supply price, demand balance ⟂ demand price, price difference ⟂ shipment.
    A = np.vstack([np.kron(np.eye(m), -np.ones(k)), np.kron(np.ones(m), np.eye(k))])
    slopes = np.diag(generator.integers(1, 4, m + k)).astype(float)
    M = np.block([[slopes, A], [-A.T, np.zeros((m * k, m * k))]])
    z = np.concatenate([[3, 5, 4], [9, 8, 9], [2, 0, 0, 0, 3, 0, 0, 1, 6]])
    w = np.concatenate([np.zeros(6), [0, 1, 2, 3, 0, 1, 2, 0, 0]])
    yield planted("spatial_price_in_prices", f"{TAKAYAMA_JUDGE}; planted", M, z, w)


def _shipments(supply: Matrix, demand: Matrix) -> Matrix:
    """Matrix of x_ij ↦ supply price_i − demand price_j."""
    m, k = len(supply), len(demand)
    M: Matrix = np.kron(supply, np.ones((k, k))) + np.kron(np.ones((m, m)), demand)
    return M


def _capital() -> Iterator[Entry]:
    """X maximizes c·x − ½ xᵀQ x with outputs covering inputs plus the stock to be kept, discounted by γ."""
    inputs = np.array([[2.0, 1.0, 0.5], [1.0, 3.0, 1.0]])
    outputs = np.array([[1.0, 0.5, 0.0], [0.5, 1.5, 0.5]])
    for gamma in (1.0, 0.75, 0.5):
        primal, dual = inputs - outputs, inputs - gamma * outputs
        M = np.block([[np.diag([2.0, 1.0, 4.0]), dual.T], [-primal, np.zeros((2, 2))]])
        yield solvable(
            f"capital_stock_{gamma}", f"{DANTZIG_MANNE}; own numbers", M, [-10, -8, -6, 7, 5]
        )
    generator = np.random.default_rng(7)
    goods, activities = 6, 12
    inputs = generator.integers(1, 8, (goods, activities)) / 4.0
    outputs = np.round(0.6 * 4 * inputs) / 4.0
    M = np.block(
        [
            [np.zeros((activities, activities)), (inputs - 0.875 * outputs).T],
            [-(inputs - outputs), np.zeros((goods, goods))],
        ]
    )
    n = goods + activities
    z = generator.integers(1, 6, n) * (generator.random(n) < 0.4)
    yield planted("capital_stock_linear_18", f"{DANTZIG_MANNE}; planted", M, z, 2.0 * (z == 0))


def _oligopoly() -> Iterator[Entry]:
    """Price a − b Σ x; firm i: marginal cost c_i + d_i x_i. M = b (I + 1 1ᵀ) + diag d."""
    for n in (2, 5, 30):
        M = np.eye(n) + np.ones((n, n))
        yield solvable(f"cournot_{n}_equal_firms", COURNOT, M, [-(n + 1.0)] * n, solution=[1] * n)
        z = np.arange(n) % 3
        yield planted(
            f"cournot_{n}_some_stay_out",
            f"{COURNOT}; planted",
            M + np.diag(np.arange(n) % 2),
            z,
            (z == 0) * 1.0,
        )
    z, w = np.array([0, 4, 2, 4.0]), np.array([3, -2, 0, 0.0])
    yield planted(
        "cournot_capacity", f"{COURNOT}; planted", np.eye(4) + np.ones((4, 4)), z, w, upper=4.0
    )
    yield solvable(
        "cournot_entry_barrier",
        f"{OWN}: falling marginal cost",
        np.ones((3, 3)) - 0.5 * np.eye(3),
        [-4, -4, -6],
    )
