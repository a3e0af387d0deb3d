"""The path of a solution over one parameter: pieces, values, derivatives, and what was certified of them."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ...core.checks import FloatVector, is_number
from ...core.errors import InvalidOption, LCPError, NotConverged
from ...core.representation import in_words
from ...core.settings import PROVEN, Status
from .families import Family, PathPoint, Piece

SHOWN = 8  # breakpoints in a paragraph
JOINED = 1e-9  # beside the unknowns there: by how much two pieces that join may differ


@dataclass(frozen=True, eq=False)
class Slope:
    """How the solution changes with the parameter.

    Attributes
    ----------
    x : ndarray, shape (n,)
    w : ndarray, shape (n,), or None
        Of an LCP.
    multipliers : ndarray or None
        Of the rows of G and A of a program.
    objective : float or None
    """

    x: FloatVector
    w: FloatVector | None = None
    multipliers: FloatVector | None = None
    objective: float | None = None


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
        SOLVED where it came to stop and every end of a piece is SOLVED; then the points between are, too, which are
        means of those. Else that of the worst end, or of the problem just beyond `reached`. An end is SOLVED by the
        criterion of its kind; or, as numbers that vanish there are left to rounding, by the criterion just inside the
        piece and, at the end, within rounding of the terms that cancel.
    jumps : list of float
        Where the solution jumps, as that of a matrix that is not monotone may.
    segments : list of float
        Where a whole segment of solutions leads from one piece to the next, as between two vertices of a linear program
        that are both best.
    beyond : result or None
        What `solve` says just beyond `reached`, with its proof, where the path ends before stop.
    seconds : float
        Of the trace, its certificates included.
    """

    def __init__(
        self,
        family: Family,
        start: float,
        stop: float,
        pieces: list[Piece],
        jumps: list[float],
        segments: list[float],
        beyond: Any,
        reached: float,
        starts: int,
    ) -> None:
        self.family, self.start, self.stop, self.reached = family, start, stop, reached
        self.pieces, self.jumps, self.segments = pieces, jumps, segments
        self.beyond, self.starts = beyond, starts
        self.seconds = 0.0
        self._toward = 1.0 if stop >= start else -1.0
        self._begins = np.array([self._toward * piece.begin for piece in pieces])

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
    def _judged(self) -> list[tuple[float, Piece]]:
        """The ends of all pieces, once where they join, and the piece of each."""
        found: list[tuple[float, Piece]] = []
        for k, piece in enumerate(self.pieces):
            if not k or not _join(self.pieces[k - 1], piece):
                found.append((piece.begin, piece))
            found.append((piece.end, piece))
        return found

    @cached_property
    def ends(self) -> tuple[FloatVector, list[FloatVector]]:
        """The ends of all pieces, once where they join: θ, and the unknowns that were followed."""
        return np.array([theta for theta, _ in self._judged]), [
            piece.z_at(theta) for theta, piece in self._judged
        ]

    @cached_property
    def statuses(self) -> list[Status]:
        """What is said of each of `ends`."""
        found = self.family.judge_all(*self.ends) if self.pieces else []
        return [
            status
            if status is Status.SOLVED or not self.family.is_solved_beside(theta, piece)
            else Status.SOLVED
            for status, (theta, piece) in zip(found, self._judged, strict=True)
        ]

    @property
    def points(self) -> list[PathPoint]:
        """The solutions at the breakpoints; where pieces do not join, the one before and the one behind."""
        return [self._point(theta, piece) for theta, piece in self._judged]

    def _point(self, theta: float, piece: Piece) -> PathPoint:
        return replace(self.family.point(theta, piece.z_at(theta)), _piece=piece)

    @cached_property
    def status(self) -> Status:
        """SOLVED, or why not."""
        if self.beyond is not None:
            return Status(self.beyond.status) if not self.beyond.is_solved else Status.STALLED
        for status in (Status.STALLED, Status.PRECISION_LIMIT):
            if status in self.statuses:
                return status
        return Status.SOLVED if self.reached == self.stop else Status.STALLED

    @property
    def is_solved(self) -> bool:
        """True where the status is SOLVED."""
        return self.status is Status.SOLVED

    @property
    def has_no_solution(self) -> bool:
        """True where a proof says that there is no solution just beyond `reached`."""
        return self.status in PROVEN

    @property
    def proof(self) -> Any:
        """What proves that there is no solution just beyond `reached`; None where nothing does."""
        return None if self.beyond is None else self.beyond.proof

    def require_solved(self) -> Path:
        """Return this path, or raise NotConverged with `explain` where it is not solved."""
        if not self.is_solved:
            raise NotConverged(self.explain())
        return self

    # --- values -------------------------------------------------------------------------------------------

    def at(self, theta: float) -> PathPoint:
        """Return the solution at θ: x, multipliers, objective, status; behind a jump where there is one.

        Raises
        ------
        InvalidOption
            Where θ is outside of what was traced.
        """
        return self._point(float(theta), self.piece_at(theta))

    def x(self, thetas: ArrayLike) -> FloatVector:
        """Return x at many values, shape (k, n)."""
        values = np.atleast_1d(np.asarray(thetas, dtype=np.float64))
        made: FloatVector = np.empty((values.size, self.pieces[0].x0.size if self.pieces else 0))
        for k, theta in enumerate(values):
            piece = self.piece_at(theta)
            made[k] = piece.x0 + theta * piece.x1
        return made

    def objective(self, thetas: ArrayLike) -> FloatVector:
        """Return the objective at many values, shape (k,); NaN for an LCP, which has none."""
        every = [
            self.at(theta).objective
            for theta in np.atleast_1d(np.asarray(thetas, dtype=np.float64))
        ]
        return np.array([np.nan if value is None else value for value in every])

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
        theta = float(theta)
        piece = self.piece_at(theta, is_behind=side == "behind")
        point, family = self.family.point(theta, piece.z_at(theta)), self.family
        rates = piece.z1[piece.x1.size :]
        w = family.slope_of_slack(piece.x1)
        return Slope(
            piece.x1, w, rates if rates.size else None, family.slope_of_objective(point, piece.x1)
        )

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
        return self.pieces[max(int(np.searchsorted(self._begins, along, side=side)) - 1, 0)]  # type: ignore[call-overload]

    # --- words, tables, pictures --------------------------------------------------------------------------

    def explain(self) -> str:
        """Return in a few lines what was traced, and how well."""
        count = len(self.pieces)
        if self.is_solved:
            first = (
                f"SOLVED: from {self.start:.6g} to {self.stop:.6g} in {in_words(count, 'piece')}, "
            )
            first += "each end is certified; between breakpoints all is linear in the parameter."
        elif self.beyond is not None and not self.pieces:
            first = f"{self.status.name}: there is no path from {self.start:.6g}: {self._why}."
        elif self.beyond is not None:
            first = (
                f"{self.status.name}: the path ends at {self.reached:.9g}, before {self.stop:.6g}; just beyond: "
                f"{self._why}."
            )
        elif self.reached != self.stop and all(status is Status.SOLVED for status in self.statuses):
            first = f"STALLED: {self.reached:.9g} was reached on the way to {self.stop:.6g}, then the path was lost."
        else:
            worst = self.ends[0][self.statuses.index(self.status)]
            first = f"{self.status.name}: the solution at {worst:.9g} is not within the tolerance."
        lines = [first]
        if count:
            inner = self.breakpoints[1:-1]
            shown = ", ".join(f"{value:.6g}" for value in inner[:SHOWN])
            rest = f", and {inner.size - SHOWN} more" if inner.size > SHOWN else ""
            lines.append(f"breakpoints: {shown or 'none'}{rest}")
        lines += [f"the solution jumps at {value:.9g}" for value in self.jumps]
        if self.segments:
            joints = {piece.begin: (one, piece) for one, piece in itertools.pairwise(self.pieces)}
            moving = [
                value
                for value in self.segments
                if value not in joints or _differ_in_x(*joints[value])
            ]
            resting = [value for value in self.segments if value not in moving]
            for values, words in (
                (moving, "all points between two solutions are solutions"),
                (
                    resting,
                    "the multipliers jump, and all between two of them are right; x does not",
                ),
            ):
                if values:
                    lines.append(
                        f"at {', '.join(f'{value:.6g}' for value in values[:SHOWN])} {words}"
                    )
        begun = in_words(self.starts, "solve")
        lines.append(f"{begun} to begin with, then one change a breakpoint; {self.seconds:.3g} s")
        return "\n".join(lines)

    @property
    def _why(self) -> str:
        """What keeps the path from going on, in words."""
        if self.beyond.is_solved:
            return "it has a solution, which determines no way on, a singular case; solve_batch solves at given values"
        return str(self.beyond.advice)

    def to_dataframe(self, thetas: ArrayLike | None = None) -> Any:
        """Return a pandas DataFrame: θ, objective and x at the breakpoints, or at given values.

        Raises
        ------
        LCPError
            Where pandas is missing.
        """
        try:
            import pandas as pd
        except ImportError as error:
            raise LCPError(
                "to_dataframe needs pandas: pip install pandas; path.x(thetas) has the numbers"
            ) from error
        values = (
            self.breakpoints
            if thetas is None
            else np.atleast_1d(np.asarray(thetas, dtype=np.float64))
        )
        x = self.x(values)
        columns: dict[str, Any] = {"parameter": values, "objective": self.objective(values)}
        columns |= {f"x[{j}]": x[:, j] for j in range(x.shape[1])}
        return pd.DataFrame(columns)

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
            f"Path({self.status.name}, {in_words(len(self.pieces), 'piece')}, "
            f"{self.start:.6g} to {self.reached:.6g}, {self.seconds:.3g} s)"
        )

    def __str__(self) -> str:
        return self.explain()


def _differ_in_x(one: Piece, other: Piece) -> bool:
    """Return whether x is another one behind the end of a piece."""
    here, there = (piece.x0 + other.begin * piece.x1 for piece in (one, other))
    return bool(
        np.abs(here - there).max(initial=0.0) > JOINED * (1.0 + np.abs(here).max(initial=0.0))
    )


def _join(one: Piece, other: Piece) -> bool:
    """Return whether a piece begins where the one before ends, in θ and in the unknowns."""
    if one.end != other.begin:
        return False
    here = one.z_at(one.end)
    off = np.abs(here - other.z_at(other.begin)).max(initial=0.0)
    return bool(off <= JOINED * np.abs(here).max(initial=0.0))
