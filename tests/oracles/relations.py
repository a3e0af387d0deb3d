"""Metamorphic relations: a problem changed so that its answers are known from those of the original, and back.

Each relation takes (problem, rng) and returns the changed problem with the way back of its solutions. Factors are
powers of two and data are moved by small integers, so that nothing rounds where the data are small integers; the
relations of `ROUNDED` do round. A relation keeps whether the problem has a solution, is feasible, or not even that.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from lcp_plugin import LCP

Vector = np.ndarray
Generator = np.random.Generator


class Changed(NamedTuple):
    """The changed problem, and what leads from a solution of it to one of the original."""

    problem: LCP
    back: Callable[[Vector], Vector]


Relation = Callable[[LCP, Generator], Changed]


def as_given(problem: LCP, M: np.ndarray, q: Vector, lower: Vector, upper: Vector) -> LCP:
    """A problem stated dense or sparse, as the original is."""
    return LCP(M if problem.is_dense else sp.csr_array(M), q, lower=lower, upper=upper)


def permuted(problem: LCP, rng: Generator) -> Changed:
    """The unknowns in another order."""
    order = rng.permutation(problem.n)
    changed = as_given(
        problem,
        problem.csr.toarray()[np.ix_(order, order)],
        problem.q[order],
        problem.lower[order],
        problem.upper[order],
    )
    return Changed(changed, lambda z: z[np.argsort(order)])


def scaled(problem: LCP, rows: Vector, columns: Vector) -> Changed:
    """W in other units, and z = columns · z'."""
    M = rows[:, None] * problem.csr.toarray() * columns
    changed = as_given(
        problem, M, rows * problem.q, problem.lower / columns, problem.upper / columns
    )
    return Changed(changed, lambda z: columns * z)


def powers_of_two(n: int, rng: Generator) -> Vector:
    return np.exp2(rng.integers(-6, 7, n))


def rows_by_powers_of_two(problem: LCP, rng: Generator) -> Changed:
    return scaled(problem, powers_of_two(problem.n, rng), np.ones(problem.n))


def columns_by_powers_of_two(problem: LCP, rng: Generator) -> Changed:
    return scaled(problem, np.ones(problem.n), powers_of_two(problem.n, rng))


def rows_by_any_factors(problem: LCP, rng: Generator) -> Changed:
    return scaled(problem, rng.uniform(0.1, 10.0, problem.n), np.ones(problem.n))


def columns_by_any_factors(problem: LCP, rng: Generator) -> Changed:
    return scaled(problem, np.ones(problem.n), rng.uniform(0.1, 10.0, problem.n))


def shifted(problem: LCP, rng: Generator) -> Changed:
    """In the unknown z' = z + c."""
    by = rng.integers(-5, 6, problem.n).astype(float)
    q = problem.q - problem.csr @ by
    return Changed(
        LCP(problem.M, q, lower=problem.lower + by, upper=problem.upper + by), lambda z: z - by
    )


def mirrored(problem: LCP, rng: Generator) -> Changed:
    """In the unknown z' = −z: lower and upper bounds change places."""
    return Changed(
        LCP(problem.M, -problem.q, lower=-problem.upper, upper=-problem.lower), lambda z: -z
    )


def with_a_neighbor(problem: LCP, rng: Generator) -> Changed:
    """One block more, solved by (2.5, 0), in between, before or behind."""
    n, place = problem.n, int(rng.integers(0, problem.n + 1))
    own = np.r_[0:place, place + 2 : n + 2]
    other = np.array([place, place + 1])
    M, q = np.zeros((n + 2, n + 2)), np.zeros(n + 2)
    lower, upper = np.zeros(n + 2), np.full(n + 2, np.inf)
    M[np.ix_(own, own)], M[np.ix_(other, other)] = problem.csr.toarray(), [[2.0, 1.0], [1.0, 2.0]]
    q[own], q[other] = problem.q, [-5.0, 1.0]
    lower[own], upper[own] = problem.lower, problem.upper
    return Changed(as_given(problem, M, q, lower, upper), lambda z: z[own])


def twice(problem: LCP, rng: Generator) -> Changed:
    """The problem beside a copy of itself, row by row in turn."""
    n = problem.n
    M = np.kron(problem.csr.toarray(), np.eye(2))
    q, lower, upper = (np.repeat(side, 2) for side in (problem.q, problem.lower, problem.upper))
    return Changed(
        as_given(problem, M, q, lower, upper), lambda z: z[int(rng.integers(2)) : 2 * n : 2]
    )


def with_a_free_row(problem: LCP, rng: Generator) -> Changed:
    """One free unknown more, y = aᵀz + b, that no other row reads."""
    n = problem.n
    M = np.zeros((n + 1, n + 1))
    M[:n, :n], M[n, :n], M[n, n] = problem.csr.toarray(), rng.integers(-1, 2, n), 1.0
    q = np.append(problem.q, rng.integers(-3, 4))
    lower, upper = np.append(problem.lower, -np.inf), np.append(problem.upper, np.inf)
    return Changed(as_given(problem, M, q, lower, upper), lambda z: z[:n])


def split(problem: LCP, rng: Generator) -> Changed:
    """Free unknowns as differences u − v of two that are not negative; M becomes singular, definiteness is lost."""
    free = (problem.lower == -np.inf) & (problem.upper == np.inf)
    n, which = problem.n, np.flatnonzero(free)
    E = np.zeros((n, n + which.size))  # z = E z'
    E[:, :n] = np.eye(n)
    E[which, np.arange(n, n + which.size)] = -1.0
    lower = np.append(np.where(free, 0.0, problem.lower), np.zeros(which.size))
    upper = np.append(problem.upper, np.full(which.size, np.inf))
    changed = as_given(problem, E.T @ problem.csr.toarray() @ E, E.T @ problem.q, lower, upper)
    return Changed(changed, lambda z: E @ z)


EXACT: dict[str, Relation] = {
    "permuted": permuted,
    "rows by powers of two": rows_by_powers_of_two,
    "columns by powers of two": columns_by_powers_of_two,
    "shifted": shifted,
    "mirrored": mirrored,
    "with a neighbor": with_a_neighbor,
    "twice": twice,
    "with a free row": with_a_free_row,
    "split": split,
}
ROUNDED: dict[str, Relation] = {
    "rows by any factors": rows_by_any_factors,
    "columns by any factors": columns_by_any_factors,
}


# --- What belongs to the caller -------------------------------------------------------------------------------------


def bits(*given: Any) -> tuple[bytes, ...]:
    """Every bit of arrays and sparse arrays of any format; of anything else, its text."""
    found: list[bytes] = []
    for each in given:
        if sp.issparse(each):
            parts = [
                getattr(each, name, None)
                for name in ("data", "indices", "indptr", "offsets", "row", "col")
            ]
            each = tuple(part for part in parts if isinstance(part, np.ndarray))
        if isinstance(each, tuple):
            found += bits(*each)
        elif isinstance(each, np.ndarray) and each.dtype != object:
            found.append(each.tobytes())
        else:
            found.append(repr(each).encode())
    return tuple(found)


def data_of(problem: LCP) -> tuple[bytes, ...]:
    """Every bit that states a problem."""
    return bits(problem.M, problem.q, problem.lower, problem.upper)


def surroundings() -> dict[str, Any]:
    """What is global to the process and none of a library's business."""
    import os
    import signal
    import warnings

    import numba

    state = np.random.get_state()  # noqa: NPY002 - the global one is what must not change
    return {
        "numpy's random state": bits(*state),
        "numpy's error settings": np.geterr(),
        "numpy's print options": repr(np.get_printoptions()),
        "warnings filters": list(warnings.filters),
        "numba's thread number": numba.get_num_threads(),
        "environment": dict(os.environ),
        "signal handlers": (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)),
        "folder": str(os.getcwd()),  # noqa: PTH109 - the same word as chdir
    }
