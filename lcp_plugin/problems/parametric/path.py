"""The path of a solution over one parameter: pieces, values, derivatives, and what was certified of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ...core.checks import FloatVector, is_number
from ...core.errors import InvalidOption, NotConverged
from ...core.representation import format_count
from ...core.settings import PROVEN, Status
from .families import Family, PathPoint, Piece

SHOWN = 8  # breakpoints in a paragraph
INSIDE = 1e-6, 1e-5  # of half a piece, at both ends: where it is judged
MIDST = 0.3819660112501051  # of a piece: no simple fraction, at which integers cancel
WORST_FIRST = Status.STALLED, Status.PRECISION_LIMIT, Status.SOLVED
JOINED = 1e-9  # beside the unknowns there: by how much two pieces that join may differ


@dataclass(frozen=True, eq=False)
class Slope:
    """How the solution changes with the parameter.

    Attributes
    ----------
    x : ndarray, shape (n,)
    multipliers : ndarray or None
        Of the rows of G and A of a program.
    """

    x: FloatVector
    multipliers: FloatVector | None = None


class Path:
    """The solution of a family of problems along one parameter; what `trace` returns.

    Attributes
    ----------
    pieces : list of Piece
        In the order of the trace; the solution is affine on each.
    start, stop : float
        Where it was to begin and to end.
    reached : float
        How far it came.
    status : Status
        SOLVED if it came to stop and each piece is SOLVED just inside its two ends and in its midst, by the criterion
        of its kind; the points between are means of those. INFEASIBLE if bounds cross on the way. Else that
        of the worst piece, or of the problem just beyond `reached`.
    jumps : list of float
        Where the solution jumps, as that of a matrix that is not monotone may.
    segments : list of float
        Where a whole segment of solutions leads from one piece to the next, as between two vertices of a linear program
        that are both best.
    beyond : result or None
        What `solve` says just beyond `reached`, with its proof, where the path ends before stop.
    crossed : str
        Which bounds cross at `reached`, if some do.
    seconds : float
        Of the trace, its certificates included.
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

    @cached_property
    def breakpoints(self) -> FloatVector:
        """Where pieces begin and end, from start to `reached`, the ends included."""
        if not self.pieces:
            return np.zeros(0)
        return np.array([self.pieces[0].begin, *(piece.end for piece in self.pieces)])

    @cached_property
    def statuses(self) -> list[Status]:
        """The worst status of each piece, in its midst and just inside its two ends."""
        found = []
        for piece in self.pieces:
            middle = piece.begin + MIDST * (piece.end - piece.begin)
            known = [self.at(middle, piece).status]
            if known[0] is Status.SOLVED:
                known = [self._inside(piece, end, middle) for end in (piece.begin, piece.end)]
            found.append(next(one for one in WORST_FIRST if one in known))
        return found

    def _inside(self, piece: Piece, end: float, middle: float) -> Status:
        """Return the status just inside an end, at the first place that is not left to rounding."""
        status = Status.SOLVED
        for share in INSIDE:
            status = self.at(end + share * (middle - end), piece).status
            if status is Status.SOLVED:
                break
        return status

    @property
    def points(self) -> list[PathPoint]:
        """The solutions at the breakpoints; where pieces do not join, the one before and the one behind."""
        found = []
        for k, piece in enumerate(self.pieces):
            if not k or not _join(self.pieces[k - 1], piece):
                found.append(self.at(piece.begin, piece))
            found.append(self.at(piece.end, piece))
        return found

    @cached_property
    def status(self) -> Status:
        """SOLVED, or why not."""
        if self.beyond is not None:
            return Status(self.beyond.status) if not self.beyond.is_solved else Status.STALLED
        if self.crossed:
            return Status.INFEASIBLE
        if self.reached != self.stop:
            return Status.STALLED
        return next(one for one in WORST_FIRST if one in self.statuses)

    @property
    def is_solved(self) -> bool:
        """True if the status is SOLVED."""
        return self.status is Status.SOLVED

    @property
    def has_no_solution(self) -> bool:
        """True if a proof says that no solution exists just beyond `reached`."""
        return self.status in PROVEN

    @property
    def proof(self) -> Any:
        """What proves that no solution exists just beyond `reached`; None if nothing does."""
        return None if self.beyond is None else self.beyond.proof

    def require_solved(self) -> Path:
        """Return this path, or raise NotConverged with `explain` where it is not solved."""
        if not self.is_solved:
            raise NotConverged(self.explain())
        return self

    # --- values -------------------------------------------------------------------------------------------

    def at(self, theta: float, piece: Piece | None = None) -> PathPoint:
        """Return the solution at θ: x, multipliers, objective, status; behind a jump where there is one.

        Raises
        ------
        InvalidOption
            Where θ is outside of what was traced.
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
        """Return how the solution at θ changes with θ.

        Parameters
        ----------
        theta : float
        side : {"ahead", "behind"}
            At a breakpoint: of the piece that begins there, as the path is traced, or of the one that ends there.
        """
        if side not in ("ahead", "behind"):
            raise InvalidOption(f'side must be "ahead" or "behind", got {side!r}')
        piece = self.piece_at(float(theta), is_behind=side == "behind")
        rates = piece.z1[piece.x1.size :]
        return Slope(piece.x1, rates if rates.size else None)

    def piece_at(self, theta: float, *, is_behind: bool = False) -> Piece:
        """Return the piece that θ lies on; where two meet the later one, or the earlier one."""
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

    # --- words, tables, pictures --------------------------------------------------------------------------

    def explain(self) -> str:
        """Return in a few lines what was traced, and how well."""
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
        """What keeps the path from continuing, in words."""
        if self.beyond is None:
            return self.crossed
        if self.beyond.is_solved:
            return "it has a solution, which determines no way on, a singular case; solve_batch solves at given values"
        return str(self.beyond.advice)

    def plot(self, *, axes: Any = None, rows: Sequence[int] | None = None) -> Any:
        """Return matplotlib's axes with x over θ, and below it the objective and how many rows act.

        Parameters
        ----------
        axes : Axes, optional
            To draw x into alone.
        rows : sequence of int, optional
            Which unknowns to draw; the forty that change most by default.
        """
        from ...evidence.path_plots import plot_path

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


def _join(one: Piece, other: Piece) -> bool:
    """Return whether a piece begins where the one before ends, in θ and in the unknowns."""
    if one.end != other.begin:
        return False
    here = one.z_at(one.end)
    off = np.abs(here - other.z_at(other.begin)).max(initial=0.0)
    return bool(off <= JOINED * np.abs(here).max(initial=0.0))
