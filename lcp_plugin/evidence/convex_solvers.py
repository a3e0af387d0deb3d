"""A convex program asked of solvers through cvxpy, and their answers judged by `certify`."""

from __future__ import annotations

import contextlib
import io
import time
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..core.checks import FloatVector
from ..core.errors import InvalidOption, did_you_mean
from ..problems.programs.certification import Certification, certify
from ..problems.programs.convexity import refuse_nonconvex
from ..problems.programs.program import QuadraticProgram

OURS = "LCP"
LEVELS = (1e-6, 1e-3)  # to which an answer may be proved
CLAIMS = {
    "infeasible": "infeasible",
    "infeasible_inaccurate": "infeasible",
    "unbounded": "unbounded",
    "unbounded_inaccurate": "unbounded",
}

NUMBERS = ("violation", "gap", "distance")
HEAD = f"{'solver':<10}{'status':<20}{'seconds':>9}  {'verdict':<16}{''.join(f'{k:>11}' for k in NUMBERS)}  reason"


@dataclass(frozen=True, eq=False)
class JudgedAnswer:
    """What a solver said of a program, and what is proved of it.

    Attributes
    ----------
    solver : str
    status : str
        Of cvxpy, or the first line of the error.
    seconds : float
        Of the solver, through cvxpy.
    certification : Certification or None
        None where there is no answer.
    tolerance : float
        To which it was judged: the smaller of two where that is proved.
    x : ndarray, shape (n,), or None
        What was judged; None where the claim is that there is no minimum.
    multipliers : dict or None
        Of the rows of G and A.
    """

    solver: str
    status: str
    seconds: float
    certification: Certification | None
    tolerance: float
    x: FloatVector | None = None
    multipliers: dict[str, FloatVector] | None = None

    @property
    def is_proved_point(self) -> bool:
        """Whether there is an x, and it is proved to be best."""
        return (
            self.x is not None
            and self.certification is not None
            and self.certification.verdict == "proved"
        )

    def save(self, path: Path) -> None:
        """Write x, the multipliers where the solver returned them, and the solver's name into an ``.npz`` file."""
        from ..interfaces.files.files import write_whole

        vectors: dict[str, Any] = {
            "x": self.x,
            **(self.multipliers or {}),
            "solver": np.array(self.solver),
        }
        write_whole({path: lambda file: np.savez_compressed(file, **vectors)})

    @property
    def verdict(self) -> str:
        """Return "proved to 1e-06", "proved to 0.001", "unproved", "disproved" or "no answer"."""
        if self.certification is None:
            return "no answer"
        said = self.certification.verdict
        return f"proved to {self.tolerance:.0e}" if said == "proved" else said

    def to_content(self) -> dict[str, Any]:
        """Return everything as a dictionary that JSON can hold."""
        known = {} if self.certification is None else self.certification.__getstate__()
        said = {name: value for name, value in known.items() if not name.startswith("_")}
        return {
            "solver": self.solver,
            "status": self.status,
            "seconds": self.seconds,
            **said,
            "verdict": self.verdict,
        }

    def __str__(self) -> str:
        said = self.certification
        values = [getattr(said, name, None) for name in NUMBERS]
        columns = "".join(f"{'–' if value is None else f'{value:.1e}':>11}" for value in values)
        reason = "" if said is None else said.reason
        return f"{self.solver:<10}{self.status[:24]:<20}{self.seconds:>9.3f}  {self.verdict:<16}{columns}  {reason}"


def judged_answers(
    program: QuadraticProgram,
    solvers: Sequence[str],
    *,
    tolerance: float | None = None,
    max_seconds: float | None = None,
) -> Iterator[JudgedAnswer]:
    """Yield what each solver's answer is worth.

    Parameters
    ----------
    program : QuadraticProgram
    solvers : sequence of str
        cvxpy's names for them, in any case; "LCP" for ours.
    tolerance : float, optional
        To judge by; by default 1e-6, and where that is not proved 1e-3.
    max_seconds : float, optional
        Limit of seconds of each judgement.

    Raises
    ------
    InvalidOption
        For a solver that is not installed, or a tolerance that is no positive number.
    UnsupportedModel
        Where the program is not convex.
    """
    import cvxpy as cp

    known = {*cp.installed_solvers(), OURS}
    for name in solvers:
        if name.upper() not in known:
            raise InvalidOption(
                f"no solver {name!r}{did_you_mean(name.upper(), known)}; its package must be installed"
            )
    refuse_nonconvex(program)
    for name in solvers:
        yield _judged(
            program, name.upper(), LEVELS if tolerance is None else (tolerance,), max_seconds
        )


def _judged(
    program: QuadraticProgram, name: str, levels: Sequence[float], max_seconds: float | None
) -> JudgedAnswer:
    reply = asked(program, _solver(name))
    claim, said, level = CLAIMS.get(reply.status), None, levels[0]
    point = (None, None) if claim else (reply.x, reply.multipliers)
    for level in levels if claim or reply.x is not None else ():
        said = certify(program, *point, claim=claim, tolerance=level, max_seconds=max_seconds)
        if said.verdict == "proved":
            break
    return JudgedAnswer(name, reply.status, reply.seconds, said, level, *point)


def _solver(name: str) -> Any:
    if name != OURS:
        return name
    from ..modeling.qp_solver import QPSolver

    return QPSolver


# --- Asking through cvxpy -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Reply:
    """What a solver said of a program.

    Attributes
    ----------
    status : str
        Of cvxpy, or the first line of the error: foreign code fails in every way there is.
    seconds : float
        With cvxpy's part.
    x : ndarray, shape (n,), or None
        As the solver leaves it, whatever it calls that; None where it is not finite.
    multipliers : dict or None
        Those of G and A as "inequality" and "equality"; None where one is missing.
    warnings : tuple of str
        The first line of each.
    """

    status: str
    seconds: float
    x: FloatVector | None = None
    multipliers: dict[str, FloatVector] | None = None
    warnings: tuple[str, ...] = ()


def asked(program: QuadraticProgram, solver: Any, **options: Any) -> Reply:
    """Return what a solver that cvxpy knows says of a convex program; nothing is raised, warned or printed.

    Parameters
    ----------
    program : QuadraticProgram
    solver : str or solver of cvxpy
    **options
        Its own.
    """
    began = time.perf_counter()
    with warnings.catch_warnings(record=True) as caught, contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("always")
        try:
            problem, x, rows = stated(program)
            problem.solve(solver=solver, **options)
        except Exception as error:
            return Reply(
                (str(error).splitlines() or [type(error).__name__])[0], time.perf_counter() - began
            )
    seconds = time.perf_counter() - began
    found = {name: _finite(row.dual_value) for name, row in rows.items()}
    multipliers = {"inequality": np.zeros(0), "equality": np.zeros(0)} | found
    return Reply(
        str(problem.status),
        seconds,
        _finite(x.value),
        None if any(value is None for value in found.values()) else multipliers,
        tuple(sorted({str(one.message).splitlines()[0] for one in caught})),
    )


def _finite(value: Any) -> Any:
    return (
        None
        if value is None or not np.isfinite(value).all()
        else np.asarray(value, dtype=np.float64)
    )


def stated(program: QuadraticProgram) -> tuple[Any, Any, dict[str, Any]]:
    """Return (cvxpy problem, x, rows of G and A as constraints by name)."""
    import cvxpy as cp

    x = cp.Variable(program.n, bounds=[program.lower, program.upper])
    # Without assume_PSD cvxpy would make P dense to find out.
    curved = 0.5 * cp.quad_form(x, program.P, assume_PSD=True) if abs(program.P).sum() else 0.0
    rows = {}
    if program.h.size:
        rows["inequality"] = program.G @ x <= program.h
    if program.b.size:
        rows["equality"] = program.A @ x == program.b
    return cp.Problem(cp.Minimize(curved + program.c @ x), [*rows.values()]), x, rows
