"""Problems of MacMPEC with affine pairs and a convex objective, from their published statements, with published optima.

S. Leyffer's collection (https://wiki.mcs.anl.gov/leyffer/index.php/MacMPEC) prints for each problem the best value that
was known; where the printed statement has another least value, ``collection`` is the printed one. Left out is what is
not convex quadratic over affine pairs as stated, and some more:

* an objective that is bilinear or concave: ex9.2.8 (−4xy), ralph2 (−4xy), stackelberg1 (½xy), ralphmod (indefinite),
  gnash, hakonsen, siouxfls1, tap, taxmcp, water (powers);
* a pair or a constraint with products of variables: bard3, bilevel3 (x², concave objective), dempe, desilva, df1,
  outrata31…34, scholtes1, scholtes2 (exp); bar-truss, bem-milanc30, design-cent, incid-set, pack-comp, pack-rig
  (shapes of elements times displacements), siouxfls;
* data of many pages: flp4, portfl-i, qpec-100, qpec-200, monteiro, monteiroB, liswet1-100, liswet1-200;
* TrafficSignalCycle, whose printed values no solution of the printed statement has: the least of TSC-1 is 54.9635, not
  45.15, and TSC-7 has no solution;
* more of the same kinds: bard1m, bilevel1m, bilevel2m, ex9.1.2…9, ex9.2.2…9, jr2, kth1, kth2, qpec1, scale2…5, and
  scholtes4;
* the same in other words: bard1 and ex9.2.7 (ex9.2.1), bard2m (bard2), ex9.1.10 (ex9.1.8), nash1b…e (other starting
  points), scholtes3 (kth3).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import cvxpy as cp
import numpy as np

from lcp_plugin import complements


class Published(NamedTuple):
    """A problem's statement, its least value, how exactly that is known, and what the collection prints."""

    state: Callable[[], cp.Problem]
    optimum: float
    accuracy: float
    collection: float


COLLECTION: dict[str, Published] = {}


def published(
    optimum: float, collection: float | None = None, accuracy: float = 1e-6
) -> Callable[[Any], Any]:
    """Enter a statement into the collection."""

    def enter(state: Callable[[], cp.Problem]) -> Callable[[], cp.Problem]:
        printed = optimum if collection is None else collection
        COLLECTION[state.__name__.strip("_")] = Published(state, optimum, accuracy, printed)
        return state

    return enter


def least(objective: Any, *constraints: Any) -> cp.Problem:
    """Return the problem of the least objective; lists among the constraints are opened."""
    flat = [one for entry in constraints for one in (entry if isinstance(entry, list) else [entry])]
    return cp.Problem(cp.Minimize(objective), flat)


def follower(gradient: Any, y: Any, offset: Any, Y: Any, rest: Any = 0.0) -> list[Any]:
    """Return what makes y best for a follower: gradient = Yᵀl and 0 ≤ l ⟂ offset + rest + Y y ≥ 0."""
    matrix = np.array(Y, dtype=float)
    multipliers = cp.Variable(len(matrix))
    slack = np.array(offset, dtype=float) + rest + matrix @ y
    return [gradient == matrix.T @ multipliers, complements(multipliers >= 0, slack >= 0)]


MIX = np.array([[0.4, 0.7], [0.6, 0.3]])  # what two products take of two goods
WISHES = np.array([4.0, 13.0, 35.0, 2.0])
LARGEST_Y = np.array([20.0, 20.0, 40.0, 40.0])
GOODS = np.kron(np.eye(2), MIX)


def sales(y: Any) -> Any:
    """The income (200 − s) s + (160 − t) t of two firms' sales s = y₁ + y₃ and t = y₂ + y₄, negated."""
    s, t = y[0] + y[2], y[1] + y[3]
    return cp.square(s) - 200 * s + cp.square(t) - 160 * t


@published(-6598.0)
def bard2() -> cp.Problem:
    x, y, l = cp.Variable(4, nonneg=True), cp.Variable(4, nonneg=True), cp.Variable(4)
    return least(
        sales(y),
        cp.sum(x) <= 40,
        x <= [10, 5, 15, 20],
        y <= LARGEST_Y,
        2 * (y - WISHES) + GOODS.T @ l == 0,
        complements(l >= 0, x - GOODS @ y >= 0),
    )


# --- F. Facchinei, H. Jiang, L. Qi, *A smoothing method for … equilibrium constraints* (1996) ---


@published(0.0)
def bilevel1() -> cp.Problem:
    x, y = cp.Variable(2), cp.Variable(2)
    Y = np.vstack([np.kron(np.eye(2), [[1], [-1]]), -2 * np.eye(2)])
    rest = cp.hstack([np.zeros(4), x])
    return least(
        2 * cp.sum(x) - 3 * cp.sum(y) - 60,
        x >= 0,
        x <= 50,
        x[0] + x[1] + y[0] - 2 * y[1] <= 40,
        follower(2 * (y - x + 20), y, [10, 20, 10, 20, -10, -10], Y, rest),
    )


@published(-6600.0)
def bilevel2() -> cp.Problem:
    x, y = cp.Variable(4, nonneg=True), cp.Variable(4)
    Y = np.vstack([-GOODS, np.eye(4), -np.eye(4)])
    return least(
        sales(y),
        cp.sum(x) <= 40,
        x <= [10, 5, 15, 20],
        follower(
            y - WISHES, y, np.concatenate([np.zeros(8), LARGEST_Y]), Y, cp.hstack([x, np.zeros(8)])
        ),
    )


# --- P. Hansen, B. Jaumard, G. Savard (1992); J. Gauvin, G. Savard (1992) ---


@published(-18.4)
def bilin() -> cp.Problem:
    x, y = cp.Variable(2, nonneg=True), cp.Variable(6)
    F = np.array(
        [
            [0, 0, 0, -1, -2, 4],
            [0, 0, 0, 1, 4, -2],
            [0, 0, 0, 1, -1, -1],
            [1, -1, -1, 0, 0, 0],
            [2, -4, 1, 0, 0, 0],
            [-4, 2, 1, 0, 0, 0],
        ]
    )
    w = F @ y + np.array([2, 1, 2, 1, 2, 2]) + cp.hstack([np.zeros(4), -4 * x])
    return least(
        -8 * x[0] - 4 * x[1] + 4 * y[0] - 40 * y[1] - 4 * y[2],
        x[0] + 2 * x[1] - y[2] <= 1.3,
        complements(y >= 0, w >= 0),
    )


@published(20.0)
def gauvin() -> cp.Problem:
    x, y, u = cp.Variable(bounds=[0, 15]), cp.Variable(), cp.Variable()
    return least(
        x**2 + (y - 10) ** 2,
        complements(y >= 0, 4 * (x + 2 * y - 30) + u >= 0),
        complements(u >= 0, 20 - x - y >= 0),
    )


# --- C. A. Floudas and others, *Handbook of Test Problems in Local and Global Optimization*, chapter 9 (1999) ---


@published(-13.0)
def ex9_1_1() -> cp.Problem:
    x, y, l = cp.Variable(nonneg=True), cp.Variable(2), cp.Variable(5)
    slack = np.array([[-1, -4], [-3, 2], [-1, 3], [1, 0], [-1, 0]]) @ y + [16, 48, -12, 0, 4]
    return least(
        -x - 3 * y[0] + 2 * y[1],
        l[0] + 3 * l[1] + l[2] - l[3] + l[4] == 1,
        2 * l[1] == 3 * l[2],
        complements(l >= 0, slack + np.array([2, -8, 2, 0, 0]) * x >= 0),
    )


@published(-3.25)
def ex9_1_8() -> cp.Problem:
    x, y = cp.Variable(2, nonneg=True), cp.Variable(2, nonneg=True)
    Y = [[-1, 1], [0, -1], [1, 0], [0, 1]]
    rest = cp.hstack([2 * x[0], -x[0] + 3 * x[1], 0, 0])
    lower = follower(np.array([-4, 1]), y, [-2.5, 2, 0, 0], Y, rest)
    return least(-2 * x[0] + x[1] + 0.5 * y[0], cp.sum(x) <= 2, lower)


@published(17.0)
def ex9_2_1() -> cp.Problem:
    x, y = cp.Variable(nonneg=True), cp.Variable(1, nonneg=True)
    lower = follower(
        2 * (y - 1) - 1.5 * x,
        y,
        [-3, 4, 7, 0],
        [[-1], [0.5], [-1], [1]],
        np.array([3, -1, -1, 0]) * x,
    )
    return least((x - 5) ** 2 + cp.sum_squares(2 * y + 1), lower)


# --- M. Fukushima, Z.-Q. Luo, J.-S. Pang (1998); J. V. Outrata ---


@published(0.0)
def flp2() -> cp.Problem:
    x, y = cp.Variable(2, bounds=[0, 10]), cp.Variable(2)
    w = np.array([[8 / 3, 2], [2, 5 / 4]]) @ x + np.array([[2, 8 / 3], [5 / 4, 2]]) @ y - [36, 25]
    return least(cp.sum_squares(cp.sum(x) + y - 15) / 2, complements(y >= 0, w >= 0))


@published(0.0)
def nash1() -> cp.Problem:
    x, y, l = cp.Variable(2, bounds=[0, 10]), cp.Variable(2), cp.Variable(2)
    return least(
        cp.sum_squares(x - y) / 2,
        np.array([[2, 8 / 3], [1.25, 2]]) @ y + l == [34, 24.25],
        complements(l >= 0, 15 - x[::-1] - y >= 0),
    )


# --- S. Leyffer, S. Scholtes, D. Ralph and others: small ones, and QPECs ---


@published(15.6178, accuracy=5e-5)
def hs044_i() -> cp.Problem:
    x, l, m = cp.Variable(4), cp.Variable(6), cp.Variable(4)
    A = -np.array(
        [[1, 2, 0, 0], [4, 1, 0, 0], [3, 4, 0, 0], [0, 0, 2, 1], [0, 0, 1, 2], [0, 0, 1, 1]]
    )
    H = np.kron([[0, 1], [1, 0]], [[-1, 1], [1, -1]])
    lower, upper = [0.01, -10, 0.1, -1, -1, 0.001], [10, -0.01, 1, -0.1, 1, 10]
    u, v = np.array([0.2, 1.2, 2, 0.1, 0.1, -0.1]), np.array([1.2, 0.2, 0.1, 2, 10, -0.2])
    z = cp.Variable(6, bounds=[np.array(lower), np.array(upper)])
    stationary = (
        H @ x + [1, -1, -1, 0] + cp.multiply(u[:4], z[:4]) - cp.multiply(A.sum(axis=0), l[:4]) - m
        == 0
    )
    slack = np.array([8, 12, 12, 8, 8, 5]) - cp.multiply(v, z) + A @ x
    return least(
        cp.sum_squares(x - [0, 3, 0, 4]),
        stationary,
        complements(l >= 0, slack >= 0),
        complements(x >= 0, m >= 0),
    )


@published(0.5)
def jr1() -> cp.Problem:
    x, y = cp.Variable(), cp.Variable()
    return least((x - 1) ** 2 + y**2, complements(y >= 0, y - x >= 0))


@published(0.5)
def kth3() -> cp.Problem:
    x, y = cp.Variable(), cp.Variable()
    return least((x - 1) ** 2 / 2 + (y - 1) ** 2, complements(x >= 0, y >= 0))


@published(0.01399, accuracy=5e-6)
def liswet1_050() -> cp.Problem:
    N, K, C = 50, 2, np.array([1, -2, 1])
    x, z, l = cp.Variable(N + K), cp.Variable(N, nonneg=True), cp.Variable(N)
    differences = sum(np.eye(N, N + K, K - i) * C[i] for i in range(K + 1))
    wanted = np.sqrt(np.arange(N + K) / (N + K - 1)) + 0.1 * np.sin(np.arange(1, N + K + 1))
    # the printed one lies on a line up to here
    solution = 0.2615076808640952 + 0.0158336842688068 * np.arange(N + K)
    solution[-2:] = 1.057170460561012, 1.098662759204049
    return least(
        cp.sum_squares(x - solution),
        x - wanted == differences.T @ l,
        cp.sum(z) >= 0.2,
        complements(l >= 0, differences @ x - z >= 0),
    )


def jiang_ralph(shift_x: float, shift_y: float) -> cp.Problem:
    """A QPEC of H. Jiang and D. Ralph (1997), enlarged."""
    x, y = cp.Variable(10), cp.Variable(20)
    return least(
        cp.sum_squares(x + shift_x) + cp.sum_squares(y + shift_y),
        complements(y >= 0, y - cp.hstack([x, np.zeros(10)]) >= 0),
    )


@published(45.0)
def qpec2() -> cp.Problem:
    return jiang_ralph(-1.0, -2.0)


@published(0.0)
def ralph1() -> cp.Problem:
    x, y = cp.Variable(nonneg=True), cp.Variable()
    return least(x - y, complements(y >= 0, y - x >= 0))


def scaled(a: float, b: float, c: float, d: float) -> cp.Problem:
    """Minimize (a x₁ − b)² + (c x₂ − d)² over 0 ≤ x₁ ⟂ x₂ ≥ 0."""
    x, y = cp.Variable(), cp.Variable()
    return least((a * x - b) ** 2 + (c * y - d) ** 2, complements(x >= 0, y >= 0))


@published(1.0)
def scale1() -> cp.Problem:
    return scaled(100, 1, 1, 1)


@published(1.0)
def scholtes5() -> cp.Problem:
    x, y = cp.Variable(2), cp.Variable()
    return least(
        cp.sum_squares(x - [1, 2]) + (y + 1) ** 2,
        complements(x[0] >= 0, y >= 0),
        complements(x[1] >= 0, y >= 0),
    )


@published(1e-4)
def sl1() -> cp.Problem:
    x, z, l = cp.Variable(2), cp.Variable(3), cp.Variable(3)
    slack = cp.hstack([10 * x[0] + x[1] - 10 - z[0], x[0] - 2 - z[1], x[1] - 50 * z[2]])
    return least(
        (x[0] - 2) ** 2 + x[1] ** 2,
        z >= [10, 0.01, 0],
        z <= [1e10, 10, 1],
        0.02 * x[0] == 10 * l[0] + l[1],
        2 * x[1] == l[0] + l[2],
        complements(l >= 0, slack >= 0),
    )


# --- B. F. Hobbs, C. Metzler, J.-S. Pang, *Strategic gaming analysis for electric power systems* (2000) ---
