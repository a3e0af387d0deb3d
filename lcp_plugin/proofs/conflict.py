"""The constraints that conflict: an irreducible infeasible set, with a proof and a point for each member.

A Farkas vector y of rows w = M x + q ≥ 0, Mᵀy = 0 and qᵀy < 0, proves that its rows S conflict. S is irreducible if y
is the only solution of M_Sᵀy = 0, up to its scale: then any proper subset of the rows is independent, so a point
satisfies them with equality. Otherwise another solution v of these equations exists, and on the line y + t v an entry
vanishes that leaves a proof. So members are removed by linear algebra in rational numbers, without linear programs. The
rank of M_S modulo a prime is at most its rank: if it is |S| − 1, no other solution exists.

References
----------
J. Gleeson, J. Ryan, *Identifying minimally infeasible subsystems of inequalities*, ORSA J. Computing 2 (1990),
doi:10.1287/ijoc.2.1.61.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from fractions import Fraction

from ..core.deadline import is_over, time_limit
from ..core.names import listed
from .exact import (
    ZERO,
    Fractions,
    Row,
    common_denominator,
    products,
    rank_profile,
    rational_rows,
    solved_nearby,
)
from .farkas import FarkasCertificate, LinearConstraints

MOST_NAMED = 12  # members in the text
MOST_ENTRIES = 4_000_000  # of the dense matrix whose rank is computed: some seconds
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
    """Return an irreducible set of constraints that conflict, some of those with a multiplier.

    Parameters
    ----------
    rows, name, multipliers
        As in :class:`Conflict`. Without an exact proof, all of them are returned, not proved irreducible.
    max_seconds : float
        Limit of the search; at the limit the smallest set found so far is returned, not proved irreducible.
    """
    y, numbers = {i: value for i, value in multipliers.items() if value}, random.Random(0)
    if not FarkasCertificate(rows, y).holds:
        return Conflict(rows, name, y)
    with time_limit(max_seconds):
        while not is_over():
            members = sorted(y)
            own = rational_rows(rows.matrix[members])
            if _rank(own) == len(members) - 1:
                return Conflict(rows, name, y, is_irreducible=True)
            columns: dict[int, Row] = {}
            for k, row in enumerate(own):
                for j, entry in row.items():
                    columns.setdefault(j, {})[k] = entry
            guess = [Fraction(numbers.randint(1, 1 << 20)) for _ in members]
            equations = [*columns.values()]
            v = solved_nearby(equations, [ZERO] * len(equations), guess, [True] * len(members))
            smaller = None if v is None else _without_a_member(rows, y, members, v)
            if smaller is None:
                break
            y = smaller
    return Conflict(rows, name, y)


def _rank(rows: list[Row]) -> int:
    """Return a number that is at most the rank of some rows, −1 if they are too many for it."""
    place = {j: k for k, j in enumerate(sorted({j for row in rows for j in row}))}
    if len(rows) * len(place) > MOST_ENTRIES:
        return -1
    whole = [[0] * len(place) for _ in rows]
    for entries, row in zip(whole, rows, strict=True):
        for (j, _), entry in zip(row.items(), common_denominator([*row.values()])[0], strict=True):
            entries[place[j]] = entry
    return len(rank_profile(whole)[0])


def _without_a_member(
    rows: LinearConstraints, y: Mapping[int, Fraction], members: list[int], v: Fractions
) -> dict[int, Fraction] | None:
    """Return a Farkas vector of fewer members, a combination of y and another solution v; None if v is none."""
    limits = {i: Fraction(float(rows.q[i])) for i in members}
    free = {i for i in members if rows.needs_fall[i]}
    other = dict(zip(members, v, strict=True))
    for found in _combinations(y, other, free):
        kept = {i: value for i, value in found.items() if value}
        if not kept or len(kept) == len(members):
            continue
        sign = -1 if kept.keys() <= free else 1
        size = sum((limits[i] * value for i, value in kept.items()), ZERO)
        if size > 0 and sign < 0:
            kept, size = {i: -value for i, value in kept.items()}, -size
        if size < 0 and all(i in free or value > 0 for i, value in kept.items()):
            return kept
    return None


def _combinations(
    y: Mapping[int, Fraction], v: Mapping[int, Fraction], free: set[int]
) -> Iterator[dict[int, Fraction]]:
    """Yield combinations of y and v in which an entry vanishes, of an inequality if v has some."""
    bound = [i for i in y if i not in free and v[i]]
    ratios = {-y[i] / v[i] for i in bound or y if v[i]}
    forward, back = (t for t in ratios if t > 0), (t for t in ratios if t < 0)
    ends = {min(forward, default=None), max(back, default=None)} if bound else ratios
    yield from ({i: y[i] + t * v[i] for i in y} for t in ends if t is not None)
    for sign in (1, -1):
        if bound and all(sign * v[i] >= 0 for i in y if i not in free):
            r = min(sign * v[i] / y[i] for i in y if i not in free)
            yield {i: sign * v[i] - r * y[i] for i in y}
