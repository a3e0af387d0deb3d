"""The path of a solution over one parameter: segments, values, derivatives and statuses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ...core.checks import FloatVector, derived_property, is_number
from ...core.errors import InvalidOption, NotConverged
from ...core.representation import format_count
from ...core.settings import Status
from ...core.solving.base_result import Outcome
from .families import Family, PathPoint, Piece

SHOWN = 8  # breakpoints in a paragraph
INSIDE = 1e-5  # of a part of a segment: distance from its begin and end at which it is checked
MIDST = 0.3819660112501051  # of a segment: integers would cancel at a simple fraction
WORST_FIRST = Status.STALLED, Status.PRECISION_LIMIT, Status.SOLVED


@dataclass(frozen=True, eq=False)
class Slope:
    """Rate of change of the solution with the parameter.

    Attributes
    ----------
    x : ndarray, shape (n,)
    multipliers : ndarray or None
        Rates of the multipliers of the rows of G and A of a program.
    """

    x: FloatVector
    multipliers: FloatVector | None = None


class Path(Outcome):
    """The solution of a family of problems along one parameter, returned by `trace`.

    Attributes
    ----------
    pieces : list of Piece
        Segments in the order of the trace; the solution is affine on each.
    start, stop : float
        Requested first and last value of θ.
    reached : float
        Last value of θ on the path.
    status : Status
        SOLVED if the path reached `stop` and each segment is SOLVED in its interior and just inside its begin and end,
        by the criterion of the problem class. Points between these are convex combinations. INFEASIBLE if bounds cross
        on the way. Otherwise the worst status of a segment, or the status of the problem just beyond `reached`.
    jumps : list of float
        Values of θ at which the solution jumps. A jump requires a matrix that is not monotone.
    segments : list of float
        Values of θ at which two segments are connected by a line of solutions, for example between two optimal
        vertices of a linear program.
    beyond : result or None
        Result of `solve` just beyond `reached`, with its proof, if the path ends before stop.
    crossed : str
        Names of the bounds that cross at `reached`, or "".
    seconds : float
        Wall-clock time of the trace, certificates included.
    """

    def __init__(self, family: Family, start: float, stop: float) -> None:
        self.family, self.start, self.stop, self.reached = family, start, stop, start
        self.pieces: list[Piece] = []
        self.jumps: list[float] = []
        self.segments: list[float] = []
        self.beyond: Any = None
        self.crossed, self.starts, self.seconds = "", 0, 0.0
        self._toward = 1.0 if stop >= start else -1.0

    @property
    def problem(self) -> Any:
        """The problem at θ = 0."""
        return self.family.problem

    @derived_property
    def breakpoints(self) -> FloatVector:
        """Values of θ at which segments begin and end, from start to `reached`, both included."""
        if not self.pieces:
            return np.zeros(0)
        return np.array([self.pieces[0].begin, *(piece.end for piece in self.pieces)])

    @derived_property
    def statuses(self) -> list[Status]:
        """The worst status of each segment, in its interior and just inside its begin and end."""
        found = []
        for piece in self.pieces:
            middle = piece.begin + MIDST * (piece.end - piece.begin)
            inner = (end + INSIDE * (middle - end) for end in (piece.begin, piece.end))
            known = [self.at(theta, piece).status for theta in (middle, *inner)]
            found.append(next(one for one in WORST_FIRST if one in known))
        return found

    @derived_property
    def status(self) -> Status:
        """SOLVED, or the reason why the path is not solved."""
        if self.beyond is not None:
            return Status(self.beyond.status) if not self.beyond.is_solved else Status.STALLED
        if self.crossed:
            return Status.INFEASIBLE
        if self.reached != self.stop:
            return Status.STALLED
        return next(one for one in WORST_FIRST if one in self.statuses)

    @property
    def proof(self) -> Any:
        """Proof that no solution exists just beyond `reached`, or None."""
        return None if self.beyond is None else self.beyond.proof

    def require_solved(self) -> Path:
        """Return this path, or raise NotConverged with `explain` if it is not solved."""
        if not self.is_solved:
            raise NotConverged(self.explain())
        return self

    # --- values -------------------------------------------------------------------------------------------

    def at(self, theta: float, piece: Piece | None = None) -> PathPoint:
        """Return x, multipliers, objective and status at θ; at a jump, the later solution.

        Raises
        ------
        InvalidOption
            If θ is not on the path.
        """
        piece = self.piece_at(theta) if piece is None else piece
        return self.family.point(float(theta), piece.z_at(float(theta)))

    def x(self, thetas: ArrayLike) -> FloatVector:
        """Return x at many values, shape (k, n)."""
        values = np.atleast_1d(np.asarray(thetas, dtype=np.float64))
        made: FloatVector = np.empty((values.size, self.pieces[0].x0.size if self.pieces else 0))
        for k, theta in enumerate(values):
            made[k] = self.piece_at(theta).x_at(theta)
        return made

    def derivative(self, theta: float, *, side: str = "ahead") -> Slope:
        """Return the derivative of the solution at θ with respect to θ.

        Parameters
        ----------
        theta : float
        side : {"ahead", "behind"}
            At a breakpoint: the later segment, in the order of the trace, or the earlier segment.
        """
        if side not in ("ahead", "behind"):
            raise InvalidOption(f'side must be "ahead" or "behind", got {side!r}')
        piece = self.piece_at(float(theta), is_behind=side == "behind")
        rates = piece.z1[piece.x1.size :]
        return Slope(piece.x1, rates if rates.size else None)

    def piece_at(self, theta: float, *, is_behind: bool = False) -> Piece:
        """Return the segment that contains θ; at a breakpoint the later (or earlier) segment."""
        if not is_number(theta):
            raise InvalidOption(f"θ must be a number, got {theta!r}")
        along = self._toward * float(theta)
        low, high = self._toward * self.start, self._toward * self.reached
        slack = 1e-12 * max(abs(low), abs(high))
        if not self.pieces or not low - slack <= along <= high + slack:
            there = f"from {self.start:.9g} to {self.reached:.9g}" if self.pieces else "nowhere"
            raise InvalidOption(f"θ = {theta!r} is not on the path, which goes {there}")
        side = "left" if is_behind else "right"
        begins = [self._toward * piece.begin for piece in self.pieces]
        return self.pieces[max(int(np.searchsorted(begins, along, side=side)) - 1, 0)]  # type: ignore[call-overload]

    # --- text, tables, figures ----------------------------------------------------------------------------

    def explain(self) -> str:
        """Return a summary of the path in a few lines."""
        count = len(self.pieces)
        if self.is_solved:
            first = (
                f"SOLVED: from {self.start:.6g} to {self.stop:.6g} in {format_count(count, 'piece')}, each of which is "
                "certified at both ends and linear in the parameter."
            )
        elif self.beyond is not None or self.crossed:
            place = f"the path ends at {self.reached:.9g}, before {self.stop:.6g}"
            place = place if count else f"there is no path from {self.start:.6g}"
            first = f"{self.status.name}: {place}; just beyond: {self._why}."
        elif self.reached != self.stop:
            first = f"STALLED: {self.reached:.9g} was reached on the way to {self.stop:.6g}, then the path was lost."
        else:
            worst = self.pieces[self.statuses.index(self.status)]
            first = (
                f"{self.status.name}: the piece from {worst.begin:.9g} is not within the tolerance."
            )
        lines = [first]
        if count:
            inner = self.breakpoints[1:-1]
            shown = ", ".join(f"{value:.6g}" for value in inner[:SHOWN])
            rest = f", and {inner.size - SHOWN} more" if inner.size > SHOWN else ""
            lines.append(f"breakpoints: {shown or 'none'}{rest}")
        lines += [f"the solution jumps at {value:.9g}" for value in self.jumps]
        if self.segments:
            values = ", ".join(f"{value:.6g}" for value in self.segments[:SHOWN])
            lines.append(f"at {values} all points between two solutions are solutions")
        lines.append(
            f"{format_count(self.starts, 'solve')}, then a factorization per breakpoint; {self.seconds:.3g} s"
        )
        return "\n".join(lines)

    @property
    def _why(self) -> str:
        """Reason why the path ends, as text."""
        if self.beyond is None:
            return self.crossed
        if self.beyond.is_solved:
            return "it has a solution, which determines no way on, a singular case; solve_batch solves at given values"
        return str(self.beyond.advice)

    def plot(self, *, axes: Any = None, rows: Sequence[int] | None = None) -> Any:
        """Return matplotlib's axes with x over θ, and below it the objective and the active rows.

        Parameters
        ----------
        axes : Axes, optional
            Axes for x. The other plots are then omitted.
        rows : sequence of int, optional
            Indices of the unknowns to draw; by default the forty that change most.
        """
        from ...evidence.drawing import plot_path

        return plot_path(self, axes=axes, rows=rows)

    def __len__(self) -> int:
        return len(self.pieces)

    def __repr__(self) -> str:
        return (
            f"Path({self.status.name}, {format_count(len(self.pieces), 'piece')}, "
            f"{self.start:.6g} to {self.reached:.6g}, {self.seconds:.3g} s)"
        )

    def __str__(self) -> str:
        return self.explain()
