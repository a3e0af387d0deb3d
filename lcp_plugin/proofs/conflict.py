"""The constraints that conflict: an irreducible infeasible set, with a proof and a point for each member.

A Farkas vector y of rows w = M x + q ≥ 0, Mᵀy = 0 and qᵀy < 0, proves that its rows S conflict. S is irreducible if y
is the only solution of M_Sᵀy = 0, up to its scale: then any proper subset of the rows is independent, so a point
satisfies them with equality. A vertex of Mᵀy = 0, qᵀy = −1, y ≥ 0 is such a y. A linear program gives its members, and
rational numbers its entries. The rank of M_S modulo a prime is at most its rank: if it is |S| − 1, no other solution
exists.

References
----------
J. Gleeson, J. Ryan, *Identifying minimally infeasible subsystems of inequalities*, ORSA J. Computing 2 (1990),
doi:10.1287/ijoc.2.1.61.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction

import numpy as np

from ..core.deadline import is_over, time_limit
from ..core.names import listed
from .exact import (
    ZERO,
    Fractions,
    integer_rows,
    products,
    rank_profile,
    rational_rows,
    solved_nearby,
)
from .farkas import FarkasCertificate, FarkasProgram, LinearConstraints

MOST_NAMED = 12  # members in the text
MOST_ENTRIES = 4_000_000  # of the dense matrix whose rank is computed: some seconds
MOST_IN_PROGRAM = 200_000  # entries of a matrix of which all rows are in the program: some seconds
SECONDS = 60.0  # of a search without another limit


@dataclass(frozen=True, eq=False)
class Conflict:
    """Constraints that cannot hold together.

    Attributes
    ----------
    rows : LinearConstraints
        All constraints, as rows w = M x + q ≥ 0, or = 0, of an x without bounds.
    name : callable
        From the number of a row to its name.
    multipliers : mapping of int to Fraction
        Farkas multipliers of the members by row, positive for inequalities.
    is_irreducible : bool
        True if it is proved that any proper subset of the members is satisfied by a point.

    Examples
    --------
    >>> from lcp_plugin import QuadraticProgram, solve
    >>> names = [["cap", "order"], ["ship", "store"]]
    >>> program = QuadraticProgram(None, [1, 1], [[1, 1], [0, -1]], [10, -7], lower=[4, 0], names=names)
    >>> conflict = solve(program).conflict
    >>> print(conflict)
    these 3 of 4 constraints cannot hold together; without any one of them a point exists: cap · order · ship ≥ 4
    >>> conflict.verify(), [float(x) for x in conflict.point(0)]
    (True, [4.0, 7.0])
    """

    rows: LinearConstraints = field(repr=False)
    name: Callable[[int], str] = field(repr=False)
    multipliers: Mapping[int, Fraction]
    is_irreducible: bool = False

    @property
    def members(self) -> list[int]:
        """Numbers of the rows, in order."""
        return sorted(self.multipliers)

    @property
    def names(self) -> list[str]:
        """Names of the members, each once, in order."""
        return [*dict.fromkeys(map(self.name, self.members))]

    def point(self, k: int) -> Fractions | None:
        """Return a point, exact, that satisfies all members but ``members[k]``; None if it takes too long.

        The other members hold with equality there, and ``members[k]`` is violated by as little as possible.
        """
        members, n = self.members, self.rows.matrix.shape[1]
        right = [-Fraction(float(self.rows.q[i])) for i in members]
        size = sum((self.multipliers[i] * d for i, d in zip(members, right, strict=True)), ZERO)
        right[k] -= size / self.multipliers[members[k]]
        return solved_nearby(
            rational_rows(self.rows.matrix[members]), right, [ZERO] * n, [True] * n
        )

    def verify(self) -> bool:
        """Return whether the multipliers and the points prove that the members conflict irreducibly; exact."""
        members, q = self.members, [Fraction(float(self.rows.q[i])) for i in self.members]
        if not FarkasCertificate(self.rows, self.multipliers).holds:
            return False
        rows = rational_rows(self.rows.matrix[members])
        for k in range(len(members)):
            if (x := self.point(k)) is None:
                return False
            w = [value + one for value, one in zip(products(rows, x), q, strict=True)]
            if any(w[:k]) or any(w[k + 1 :]):
                return False
        return True

    def __str__(self) -> str:
        count, others = len(self.members), int(self.rows.needs_rise.sum())
        if count == 1:
            return f"1 of {others} constraints cannot hold: {self.names[0]}"
        least = "without any one of them a point exists"
        if not self.is_irreducible:
            least = "it is not proved that all of them are needed"
        together = f"these {count} of {others} constraints cannot hold together; {least}"
        return f"{together}: {listed(self.names, MOST_NAMED, ' · ')}"


def find_conflict(
    rows: LinearConstraints,
    name: Callable[[int], str],
    multipliers: Mapping[int, Fraction],
    max_seconds: float = SECONDS,
) -> Conflict:
    """Return an irreducible set of constraints that conflict.

    Parameters
    ----------
    rows, name, multipliers
        As in :class:`Conflict`. Without an exact proof, all of them are returned, not proved irreducible.
    max_seconds : float
        Limit of the search; at the limit the smallest set found so far is returned, not proved irreducible.
    """
    y: Mapping[int, Fraction] = {i: value for i, value in multipliers.items() if value}
    if not FarkasCertificate(rows, y).holds:
        return Conflict(rows, name, y)
    with time_limit(max_seconds):
        is_irreducible = _is_irreducible(rows, y)
        vertex = y if is_irreducible or is_over() else _at_vertex(rows, y)
        if len(vertex) < len(y) and FarkasCertificate(rows, vertex).holds:
            y, is_irreducible = vertex, _is_irreducible(rows, vertex)
    return Conflict(rows, name, y, is_irreducible)


def _at_vertex(rows: LinearConstraints, y: Mapping[int, Fraction]) -> Mapping[int, Fraction]:
    """Return the multipliers of a vertex of all Farkas vectors, whose members are irreducible; y if none is found.

    The rows of y alone are asked if the matrix is large.
    """
    chosen = np.arange(rows.q.size) if rows.matrix.nnz <= MOST_IN_PROGRAM else np.array(sorted(y))
    parts = {
        name: getattr(rows, name)[chosen]
        for name in ("matrix", "q", "needs_rise", "needs_fall", "weights")
    }
    program = FarkasProgram(replace(rows, **parts))
    answer = program.solve()
    for found in () if answer is None else program.candidates(program.vector(answer.x)):
        exact = {int(chosen[i]): Fraction(value) for i, value in enumerate(found) if value}
        if FarkasCertificate(rows, exact).holds:
            return exact
    return y


def _is_irreducible(rows: LinearConstraints, y: Mapping[int, Fraction]) -> bool:
    """Return whether it is proved that the rows of y have only y as a dependence: by their rank modulo a prime."""
    own = rational_rows(rows.matrix[sorted(y)])
    place = {j: k for k, j in enumerate(sorted({j for row in own for j in row}))}
    if is_over() or len(own) * len(place) > MOST_ENTRIES:
        return False
    return len(rank_profile(integer_rows(own, place)[0])[0]) == len(own) - 1
