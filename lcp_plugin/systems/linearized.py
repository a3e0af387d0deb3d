"""The derivative at a solution: a linear system on the rows that are free, for one problem or for many in a row.

With z = P(z − w/d), w = M z + q, and R_z dz + R_w dw = 0 the generalized derivative of the natural map, a row is free
if R_w ≠ 0. For a complementarity problem, R_w is 1 on the rows between their bounds. For cones, R_w couples the rows of
a block. J = R_z + R_w M, h = dM z + dq, b the active bounds:

    dz_A = db_A,    J_FF dz_F = −(R_w (h + M db))_F

and for a function L of z and w with g = ∂L/∂z + Mᵀ ∂L/∂w: J_FFᵀ λ_F = g_F, λ_A = 0, ∂L/∂q = ∂L/∂w − R_wᵀ λ,
∂L/∂m_ij = (∂L/∂q)_i z_j, ∂L/∂b_A = (g + Mᵀ(∂L/∂q − ∂L/∂w))_A.
"""

from __future__ import annotations

from typing import Any

import numpy as np


class LinearizedSystem:
    """The system at a solution, or at as many as there are rows: vectors have shape (n,) or (k, n) throughout."""

    def _product(self, x: Any, *, transposed: bool = False) -> Any:
        """Return M x, or Mᵀx."""
        raise NotImplementedError

    def _by_slack(self, x: Any, *, transposed: bool = False) -> Any:
        """Return R_w x, or R_wᵀx; only the free rows are used."""
        return x

    def _solve_free(self, right: Any, *, transposed: bool = False) -> Any:
        """Return the solution of J_FF x = right_F, or of the transposed system, 0 in the other rows."""
        raise NotImplementedError

    @np.errstate(all="ignore")
    def tangent(self, h: Any, held: Any = None, more: Any = 0.0) -> Any:
        """Return dz.

        Parameters
        ----------
        h : array
            dM z + dq.
        held : array, optional
            Changes of the active bounds, 0 in free rows; by default all 0.
        more : array
            Other changes of R, for example by friction.
        """
        if held is not None and held.any():
            return held + self._solve_free(-(self._by_slack(h + self._product(held)) + more))
        return self._solve_free(-(self._by_slack(h) + more))

    @np.errstate(all="ignore")
    def adjoint(self, g: Any, by_w: Any) -> tuple[Any, Any, Any]:
        """Return ∂L/∂q, ∂L/∂b (valid at active bounds) and λ for a loss L with gradients g by z and by_w by w."""
        by_z = g + self._product(by_w, transposed=True) if by_w.any() else g
        multiplier = self._solve_free(by_z, transposed=True)
        change = self._by_slack(multiplier, transposed=True)
        return by_w - change, by_z - self._product(change, transposed=True), multiplier
