"""The constraints that conflict: an irreducible infeasible set, with a proof and a point for each member.

A Farkas vector y of rows w = M x + q ≥ 0, Mᵀy = 0 and qᵀy < 0, proves that its rows S conflict. S is irreducible if y
is the only solution of M_Sᵀy = 0, up to its scale: then any proper subset of the rows is independent, so a point
satisfies them with equality. A vertex of Mᵀy = 0, qᵀy = −1, y ≥ 0 is such a y. A linear program gives its members, and
rational numbers its entries. The rank of M_S modulo a prime is at most its rank: if it is |S| − 1, no other solution
exists. A deletion filter then drops each member without which the others still conflict. The first linear program
seeks few members: the least combination of rows that gives minus the heaviest row of the proof.

Rows that were computed in double precision conflict only to rounding: Mᵀy is then at rounding level of its terms, and
the proof covers all x within a radius, as for INFEASIBLE. Few such members are preferred to many exact ones.

References
----------
J. Gleeson, J. Ryan, *Identifying minimally infeasible subsystems of inequalities*, ORSA J. Computing 2 (1990),
doi:10.1287/ijoc.2.1.61. J. W. Chinneck, *Feasibility and Infeasibility in Optimization*, Springer 2008,
doi:10.1007/978-0-387-74932-7, §6.2 (deletion filter).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property
from itertools import chain

import numpy as np

from ..core import deadline
from ..core.checks import Indices
from ..core.names import describe_radius, grouped, listed
from . import exact, farkas
from .farkas import FarkasCertificate, FarkasProgram, LinearConstraints

RowWeights = Mapping[int, Fraction]
Namer = Callable[[int], str]


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
        True if any proper subset of the members is satisfied by a point: as proved if `is_exact`, otherwise by the
        singular values of the members' rows, which leave the point within the radius.

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
    name: Namer = field(repr=False)
    multipliers: RowWeights
    is_irreducible: bool = False

    @property
    def members(self) -> list[int]:
        """Numbers of the rows, in order."""
        return sorted(self.multipliers)

    @property
    def names(self) -> list[str]:
        """Names of the members, each once, in order."""
        return [*dict.fromkeys(map(self.name, self.members))]

    @cached_property
    def _certificate(self) -> FarkasCertificate:
        return FarkasCertificate(self.rows, self.multipliers)

    @property
    def is_exact(self) -> bool:
        """True if the members conflict for all x, not only up to `radius`."""
        return self._certificate.holds

    @property
    def radius(self) -> float:
        """Bound of ‖x‖∞ up to which the members are proved to conflict."""
        return self._certificate.radius

    def point(self, k: int) -> exact.Fractions | None:
        """Return a point, exact, that satisfies all members but ``members[k]``; None if it takes too long.

        The other members hold with equality there, and ``members[k]`` is violated by as little as possible. None also
        if the conflict is not exact.
        """
        if not self.is_exact:
            return None
        members, y, n = self.members, self.multipliers, self.rows.matrix.shape[1]
        right = [-Fraction(float(self.rows.q[i])) for i in members]
        size = sum((y[i] * d for i, d in zip(members, right, strict=True)), exact.ZERO)
        right[k] -= size / y[members[k]]
        rows = exact.rational_rows(self.rows.matrix[members])
        return exact.solved_nearby(rows, right, [exact.ZERO] * n, [True] * n)

    def verify(self) -> bool:
        """Return whether the members conflict for all x, and no fewer of them do; in exact arithmetic."""
        return self.is_exact and _is_irreducible(self.rows, self.multipliers)

    def __str__(self) -> str:
        count, others = len(self.members), int(self.rows.needs_rise.sum())
        if count == 1:
            return f"1 of {others} constraints cannot hold: {self.names[0]}"
        least = "without any one of them a point exists"
        if not self.is_irreducible:
            least = "it is not proved that all of them are needed"
        points = describe_radius(self.radius, "x")
        checked = f", checked for {points}" if points else ""
        together = f"these {count} of {others} constraints cannot hold together{checked}; {least}"
        return f"{together}: {listed(grouped(self.names, 12), 12, ' · ')}"


def find_conflict(rows: LinearConstraints, name: Namer, multipliers: RowWeights) -> Conflict:
    """Return a set of constraints that conflict, irreducible if the search ends in time; as in :class:`Conflict`."""
    y: RowWeights = {i: value for i, value in multipliers.items() if value}
    with deadline.limit(deadline.SEARCH_SECONDS):
        every, used = np.arange(rows.q.size), np.array(sorted(y))
        chosen = every if rows.matrix.nnz <= 200_000 else used  # entries: some seconds
        few = _part(rows, chosen)
        place = {int(i): k for k, i in enumerate(chosen)}
        sparse = _sparse_program(few, {place[i]: value for i, value in y.items()})
        y = _smaller(rows, y, chosen, chain([sparse], _programs(few)))
        # A linear program for each member that is left out
        for member in sorted(y) if len(y) <= 30 else ():
            others = np.array([i for i in sorted(y) if i != member])
            if member in y and others.size:
                y = _smaller(rows, y, others, _programs(_part(rows, others)))
        return Conflict(rows, name, y, _is_irreducible(rows, y))


def _part(rows: LinearConstraints, chosen: Indices) -> LinearConstraints:
    """Return the chosen rows."""
    names = ("matrix", "q", "needs_rise", "needs_fall", "weights")
    return replace(rows, **{name: getattr(rows, name)[chosen] for name in names})


def _programs(rows: LinearConstraints) -> Iterator[FarkasProgram]:
    """Yield linear programs whose solutions are Farkas vectors of the rows, in units of their sides."""
    units = farkas.distinct_units(FarkasProgram(rows).sizes)
    yield from (FarkasProgram(rows, unit) for unit in units)


def _sparse_program(rows: LinearConstraints, y: RowWeights) -> FarkasProgram:
    """Return the linear program of the combination with least Σ|y_i| Σ_j |m_ij| that gives minus the heaviest row of y.

    Its solution has few rows. The combination of the largest margin mostly has as many rows as there are unknowns.
    """
    sizes = abs(rows.matrix) @ np.ones(rows.matrix.shape[1])
    heaviest = max(y, key=lambda i: abs(y[i]) * Fraction(float(sizes[i])))
    sought = np.zeros(sizes.size)
    sought[heaviest] = -1.0 if y[heaviest] > 0 else 1.0
    return FarkasProgram(replace(rows, q=sought, weights=np.where(sizes > 0.0, sizes, 1.0)))


def _smaller(
    rows: LinearConstraints, y: RowWeights, chosen: Indices, programs: Iterable[FarkasProgram]
) -> RowWeights:
    """Return the first multipliers of the chosen rows, by the programs, that are fewer than y, or as few and exact."""
    best, certificate = y, FarkasCertificate(rows, y)
    least = (len(y) if certificate.holds_near else rows.q.size + 1, not certificate.holds)
    for program in programs:
        if (answer := None if deadline.is_over() else program.solve()) is None:
            break
        vector = program.vector(answer.x)
        is_nonzero = np.abs(vector) > farkas.LP_TOLERANCE * np.abs(vector).max(initial=0.0)
        shorter = np.where(is_nonzero, vector, 0.0)
        for candidate in chain(program.candidates(vector), program.candidates(shorter)):
            other = {int(chosen[i]): Fraction(value) for i, value in enumerate(candidate) if value}
            proof = FarkasCertificate(rows, other)
            if (size := (len(other), not proof.holds)) < least and proof.holds_near:
                best, least = other, size
        if best is not y:
            break
    return best


def _is_irreducible(rows: LinearConstraints, y: RowWeights) -> bool:
    """Return whether the rows of y have only y as a dependence, by their rank modulo a prime or to rounding."""
    proof = FarkasCertificate(rows, y)
    members = exact.rational_rows(rows.matrix[sorted(y)])
    place = {j: k for k, j in enumerate(sorted({j for row in members for j in row}))}
    if not proof.holds_near or deadline.is_over() or len(members) * len(place) > exact.MOST_ENTRIES:
        return False
    if proof.holds:
        return len(exact.rank_profile(exact.integer_rows(members, place)[0])[0]) == len(members) - 1
    matrix = rows.matrix[sorted(y)][:, list(place)].toarray()
    values = np.linalg.svd(matrix / np.abs(matrix).max(1, keepdims=True), compute_uv=False)
    return int((values * farkas.WIDE > values[0]).sum()) == len(members) - 1
