"""Pairs whose sides are points of cones: ``cp.SOC(t, x)``, and impulses with friction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import cvxpy as cp
import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ..core.checks import FloatVector
from ..core.errors import UnsupportedModel
from ..core.lcp import LCP
from ..expressions.statement import SquareModel
from ..problems.cones.data import Blocks, ConeProblem
from ..problems.cones.frictional_contact import FrictionalContact


@dataclass(frozen=True, eq=False)
class ConePair:
    """The unknowns of one pair, cone by cone.

    Attributes
    ----------
    columns : ndarray of int, shape (d k,)
    rows : int
        d, number of rows of a cone.
    friction : ndarray, shape (k,), or None
        Coefficients if the slack follows Coulomb's law.
    """

    columns: NDArray[np.int64]
    rows: int
    friction: FloatVector | None

    def blocks(self, M: Any, q: FloatVector) -> Blocks:
        """Return the problem of M and q, shape (d k,), over these cones alone."""
        if self.friction is None:
            return ConeProblem(
                M, q, [("second_order", self.rows)] * (self.columns.size // self.rows)
            )
        return FrictionalContact(M, q, self.friction, dimension=self.rows)


def stacked(cone: cp.SOC) -> Any:
    """Return t above x: shape (d,) of one cone, (d, k) of k."""
    t, x = cone.args
    if x.ndim < 2:
        return cp.hstack([t, x if x.ndim else cp.reshape(x, (1,), order="F")])
    return cp.vstack([cp.reshape(t, (1, t.size), order="F"), x if cone.axis == 0 else x.T])


def over_cones(found: SquareModel, pairs: Sequence[ConePair], name: Any) -> SquareModel:
    """Return the problem over cones, the rows of other pairs and equations before the cones.

    Parameters
    ----------
    found : SquareModel
        Model in which the unknowns of cones have no bounds.
    pairs : sequence of ConePair
    name : callable
        Function from the number of an unknown to its name.

    Raises
    ------
    UnsupportedModel
        If sides are not affine, or the model has friction and other conditions.
    """
    rows = found.problem
    if not isinstance(rows, LCP):
        raise UnsupportedModel(
            "cones can be combined with affine sides only, and this model has nonlinear ones; write them as affine "
            "expressions, or solve the nonlinear part separately"
        )
    kept = found.elimination.kept
    place = np.full(found.elimination.offset.size, -1)
    place[kept] = np.arange(kept.size)
    own = place[np.concatenate([pair.columns for pair in pairs])]
    others = np.setdiff1d(np.arange(kept.size), own)
    order = np.concatenate([others, own])
    M, q = rows.csr[order][:, order], rows.q[order]
    with_friction = [pair.friction for pair in pairs if pair.friction is not None]
    problem: Blocks
    if not with_friction:
        cones: list[tuple[Any, ...]] = (
            [("box", rows.lower[others], rows.upper[others])] if others.size else []
        )
        for pair in pairs:
            cones += [("second_order", pair.rows)] * (pair.columns.size // pair.rows)
        problem = ConeProblem(M, q, cones)
    elif others.size or len(with_friction) < len(pairs) or len({pair.rows for pair in pairs}) > 1:
        what = [name(column) for column in kept[others][:5].tolist()]
        what = what or ["cones of another kind"]
        raise UnsupportedModel(
            f"a model with friction_cone has impulses as its only unknowns, and this one has also {', '.join(what)}; "
            "write the velocities as u = W @ r + b, or as a chain of definitions"
        )
    else:
        problem = FrictionalContact(M, q, np.concatenate(with_friction), dimension=pairs[0].rows)
    expansion = found.elimination.expansion
    if expansion is None:
        expansion = sp.eye_array(kept.size, format="csr")
    elimination = replace(
        found.elimination, kept=kept[order], expansion=sp.csr_array(expansion[:, order])
    )
    places, signs = found.places[order], found.signs[order]
    return replace(found, problem=problem, elimination=elimination, places=places, signs=signs)
