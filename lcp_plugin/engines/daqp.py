"""DAQP: a dual active set for small dense convex programs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Any, ClassVar

import numpy as np

from ..core.checks import FloatVector
from .engine import (
    Engine,
    EngineAnswer,
    EngineStatus,
    ProgramData,
    SolverLimits,
)

EQUATION = 5  # of daqp's `sense`
SAYS = {
    1: EngineStatus.OPTIMAL,
    2: EngineStatus.OPTIMAL,
    -1: EngineStatus.INFEASIBLE,
    -3: EngineStatus.UNBOUNDED,
    -4: EngineStatus.STOPPED,
}


class DAQP(Engine):
    """DAQP: a dual active set method, which updates its factorization row by row.

    References
    ----------
    Arnström, Bemporad, Axehill, *A dual active-set solver for embedded quadratic programming using recursive LDLᵀ
    updates*, IEEE Transactions on Automatic Control 67 (2022), doi:10.1109/TAC.2022.3176430.
    """

    name: ClassVar[str] = "daqp"
    solves: ClassVar[str] = "dense convex programs of up to some hundred rows"
    cost: ClassVar[str] = "n² a step, n³ to begin with"
    reference: ClassVar[str] = "Arnström, Bemporad, Axehill 2022"
    obeys: ClassVar[str] = "max_seconds; verbose prints nothing; Ctrl-C waits for its end"
    steps: ClassVar[str] = "iter_limit"
    ends_on_active_set: ClassVar[bool] = True
    defaults: ClassVar = {"primal_tol": 1e-9, "iter_limit": 1000}

    def answer(self, program: ProgramData, limits: SolverLimits) -> EngineAnswer:
        """Return daqp's point."""
        P, G, A = program.P, program.G, program.A
        if not isinstance(P, np.ndarray):
            P, G, A = P.toarray(), G.toarray(), A.toarray()
        m, n, p = program.h.size, program.c.size, program.b.size
        settings = self.settings
        has_bounds = np.isfinite(program.lower).any() or np.isfinite(program.upper).any()
        bounds = n if has_bounds else 0
        if limits.seconds < math.inf:
            settings["time_limit"] = limits.seconds
        above = np.concatenate(
            (program.upper, program.h, program.b) if bounds else (program.h, program.b)
        )
        sense, below = np.zeros(above.size, np.intc), np.empty(above.size)
        below.fill(-np.inf)
        if bounds:
            below[:n] = program.lower
        if p:
            sense[bounds + m :], below[bounds + m :] = EQUATION, program.b
        # Copies: daqp takes no arrays that are read-only. Some entry of a semidefinite P is positive, or all are 0.
        x, y, flag, steps = _call_daqp(
            np.array(P) if P.item(P.argmax()) > 0.0 else None,
            np.array(program.c),
            np.concatenate((G, A)) if p else np.array(G),
            above,
            below,
            sense,
            settings,
        )
        y = np.append(np.maximum(y[bounds : bounds + m], 0.0), y[bounds + m :])
        return EngineAnswer(x, y, steps, SAYS.get(flag, EngineStatus.GAVE_UP))

    def points(
        self,
        P: Any,
        c: Any,
        C: Any,
        d: Any,
        m: int,
        lower: Any,
        upper: Any,
        items: Iterable[int],
        seconds: float = 0.0,
    ) -> Iterator[tuple[FloatVector, FloatVector, int, int]]:
        """Yield x, signed multipliers of bounds and rows, daqp's exit flag and number of steps, per item of a stack.

        NaN if daqp has no solution, because daqp then returns uninitialized arrays.

        Parameters
        ----------
        P, c, C, d, lower, upper : arrays
            Shapes (B or 1, n, n), (B, n), (B or 1, rows, n), (B, rows), (B, n), (B, n).
        m : int
            Number of inequalities; the remaining rows are equalities.
        """
        count, n = c.shape
        sense = np.zeros(n + d.shape[1], np.intc)
        sense[n + m :] = EQUATION
        above, below = np.concatenate([upper, d], axis=1), np.full((count, sense.size), -np.inf)
        below[:, :n], below[:, n + m :] = lower, d[:, m:]
        costs, settings, has_P = np.array(c), {**self.settings, "time_limit": seconds}, P.any()
        matrices = [np.array(one) for one in (P, C)]
        of_P, of_C = (range(count) if len(one) > 1 else [0] * count for one in matrices)
        for k in items:
            hessian = matrices[0][of_P[k]] if has_P else None
            yield _call_daqp(
                hessian, costs[k], matrices[1][of_C[k]], above[k], below[k], sense, settings
            )


def _call_daqp(
    P: Any, c: Any, C: Any, above: Any, below: Any, sense: Any, settings: dict[str, Any]
) -> tuple[FloatVector, FloatVector, int, int]:
    """Return x, all multipliers, daqp's exit flag and its steps."""
    import daqp

    x, _, flag, info = daqp.solve(P, c, C, above, below, sense, **settings)
    if flag <= 0:
        return np.full(c.size, np.nan), np.full(sense.size, np.nan), flag, info["iterations"]
    return np.asarray(x), np.asarray(info["lam"]), flag, info["iterations"]
