"""Problems with a wrong point that a careless stopping criterion calls SOLVED, for every problem class."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np


class Case(NamedTuple):
    """LCP with lower bounds, a wrong point, and the only solution; None if no solution exists.

    Attributes
    ----------
    M : array, shape (n, n)
    q, lower, wrong : array, shape (n,)
    right : array, shape (n,), or None
    """

    M: Any
    q: Any
    lower: Any
    wrong: Any
    right: Any

    def judge(self, z: Any, *, is_solved: bool) -> None:
        """Fail if a point is SOLVED and is not the solution; further entries of z are not compared."""
        if is_solved and self.right is None:
            at = z[: self.q.size]
            terms = np.abs(self.M) @ np.abs(at) + np.abs(self.q)
            # Below 2⁻⁴² of the terms a demand is noise: the limit of SOLVED, on the page solved.md
            assert terms.max() >= 2.0**42, f"no solution, but {z} is SOLVED"
        elif is_solved:
            # A residual is not an error: a slack up to tolerance^(1/4) of the demand passes
            np.testing.assert_allclose(z[: self.q.size], self.right, rtol=1e-2, atol=1e-3)


TINY = 2.0**-17
STACKED = np.array([[1e-8, -1e-8, 0], [-1e-8, 1 + 1e-8, -1], [0, -1, 1 + 1e-8]])
WEIGHTS = np.linalg.solve(STACKED, [0.04905, 0, 0])  # about 9.81e6, 4.905e6, 4.905e6
TABLE: dict[str, tuple[Any, ...]] = {  # M, q, a wrong point, the right one or None, lower
    "the snapped point is measured": (
        [[1, 1], [0, 1]],
        [-(2.0**33), 64],
        [2.0**33, 64],
        [2.0**33, 0],
    ),
    "an idle row is not a reference": (
        [[1, 2048, 0], [0, 1, 1], [0, 1, 1 + TINY]],
        [-1024, -2, -2 - TINY],
        [0, 1.5, 0.5],
        [0, 1, 1],
    ),
    "terms that cancel": (
        [[1, -1, 0], [-1, 1, 0], [1, 0, 1]],
        [-1, 0, -(2.0**27)],
        [2.0**20, 2.0**20, 2.0**27 - 2.0**20],
        None,
    ),
    "a contradiction next to 2^36": (
        [[1, -1, 0], [-1, 1, 0], [1, 0, 1]],
        [-1, 0, -(2.0**36)],
        [2.0**20, 2.0**20, 2.0**36],
        None,
    ),
    "a small row next to one twice as large": (
        [[1, -1, 0], [-1, 1.5, 0], [1, 0, 1]],
        [-1, 0, -(2.0**43)],
        [1, 0, 2.0**43 - 1],
        [3, 2, 2.0**43 - 3],
    ),
    "a small row next to a row in large units": (
        [[2.0**20, -(2.0**20), 0], [-1, 1.5, 0], [1, 0, 1]],
        [-(2.0**20), 0, -(2.0**43)],
        [1, 0, 2.0**43 - 1],
        [3, 2, 2.0**43 - 3],
    ),
    "a row next to a large one": (
        [[1, 1, 0], [0, 1, -2], [0, 0, 1]],
        [-(2.0**46), 0, -1],
        [2.0**46 - 10, 10, 1],
        [2.0**46 - 2, 2, 1],
    ),
    "a bound next to a large row": (
        [[1, 1, 0], [0, 1, -2], [0, 0, 1]],
        [-(2.0**46), 0, 0],
        [2.0**46 - 10, 10, 1],
        [2.0**46 - 2, 2, 1],
        [0, 0, 1],
    ),
    "components": (np.eye(2), [-1e10, -0.5], [1e10, 0.6], [1e10, 0.5]),
    "a row of zeros": ([[1, 1], [0, 0]], [-1, -1e-9], [1, 0], None),
    "a tiny diagonal entry": ([[1, -2], [3, 1e-9]], [-3, -1], [1.672, 0], [3, 0]),
    "heavy on light": (STACKED, [-0.04905, 0, 0], [4.905e6, 0, 0], WEIGHTS),
    "a sign that is wrong for every z": ([[1e-9, 1], [-1, 0]], [-1, -1], [0, 1.1e16], None),
    "a sign next to 1e15": (
        [[1, 0, 2], [0, 1, 2], [-2, -2, 0]],
        [0, -1e15, -1],
        [0, 0, 0.5e15],
        None,
    ),
    "a row in small units": (
        [[1e6, 0, 0], [-2, -1, 0], [-1, 2, 1]],
        [-1e6, 1, -1e15],
        [1, 0, 1e15],
        None,
    ),
    "a chain to a row with q": (
        [[1, 0, 1, -1], [0, 1, 1, -1], [-1, -1, 0, 0], [1, 1, 0, 0]],
        [-1e19, 2, -2, 0],
        [-1, -1, 1e19, 0],
        None,
        [-1e10, -1, 0, 0],
    ),
    "rows that do not act": (
        [[0.1, 0, 0, 1], [0, 0.1, 0, 1e8], [0, 0, 0.1, 1e16], [-1, -1, -1, 0]],
        [-50, -50, -50, 1],
        [2, 0, 0, 49.8],
        [1, 0, 0, 49.9],
    ),
    "not moved to a bound": ([[1e-9, -1], [1, 1e-9]], [-1e-9, 0], [6, 5e-9], [1, 0]),
    "a chain through a row in small units": (
        [[1, 0, 0], [-1e-13, 1, 0], [0, -1e13, 1]],
        [-1, 0, 0],
        [1, 0, 0],
        [1, 1e-13, 1],
    ),
    "a circle through a row in small units": (
        [[3, 0, 0, -(2.0**-42)], [0, 1, 0, 0], [-(2.0**43), -2, 4, 0], [0, -2, 0, 3]],
        [0, 0, 0, -2],
        [0, 0, 0, 2 / 3],
        [2.0**-41 / 9, 0, 1 / 9, 2 / 3],
    ),
    "excused at 1e-8": ([[2e-6, 1], [-1, 1e-11]], [-1, -2e-11], [2e-12, 1], [0, 2]),
}


def _case(M: Any, q: Any, wrong: Any, right: Any, lower: Any = 0.0) -> Case:
    q = np.array(q, float)
    lower, wrong = np.broadcast_to(np.array(lower, float), q.shape), np.array(wrong, float)
    return Case(np.array(M, float), q, lower, wrong, None if right is None else np.array(right))


CONSTRUCTED = {name: _case(*row) for name, row in TABLE.items()}
