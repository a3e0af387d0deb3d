"""Several solvers on one convex program, each answer judged by `certify`: a table solver × what is proved."""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..conversions.program import QuadraticProgram, refuse_nonconvex
from ..errors import InvalidOption, did_you_mean
from ..solving.certification import certify
from ..solving.program_proofs import Certification

OURS = "LCP"
LEVELS = (1e-6, 1e-3)  # to which an answer may be proved
CLAIMS = {
    "infeasible": "infeasible", "infeasible_inaccurate": "infeasible",
    "unbounded": "unbounded", "unbounded_inaccurate": "unbounded",
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
    """

    solver: str
    status: str
    seconds: float
    certification: Certification | None
    tolerance: float

    @property
    def verdict(self) -> str:
        """Return "proved to 1e-06", "proved to 0.001", "unproved", "refuted" or "no answer"."""
        if self.certification is None:
            return "no answer"
        said = self.certification.verdict
        return f"proved to {self.tolerance:.0e}" if said == "proved" else said

    def to_content(self) -> dict[str, Any]:
        """Return everything as a dictionary that JSON can hold."""
        said = {} if self.certification is None else vars(self.certification)
        return {"solver": self.solver, "status": self.status, "seconds": self.seconds, **said, "verdict": self.verdict}

    def __str__(self) -> str:
        said = self.certification
        values = [getattr(said, name, None) for name in NUMBERS]
        columns = "".join(f"{'–' if value is None else f'{value:.1e}':>11}" for value in values)
        reason = "" if said is None else said.reason
        return f"{self.solver:<10}{self.status[:24]:<20}{self.seconds:>9.3f}  {self.verdict:<16}{columns}  {reason}"


def judged_answers(
    program: QuadraticProgram, solvers: Sequence[str], *, tolerance: float | None = None,
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
            raise InvalidOption(f"no solver {name!r}{did_you_mean(name.upper(), known)}; its package must be installed")
    refuse_nonconvex(program)
    for name in solvers:
        yield _judged(program, name.upper(), LEVELS if tolerance is None else (tolerance,), max_seconds)


def _judged(
    program: QuadraticProgram, name: str, levels: Sequence[float], max_seconds: float | None
) -> JudgedAnswer:
    problem, x, rows = stated(program)
    began = time.perf_counter()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what is inaccurate is what we are about to find out
            problem.solve(solver=_solver(name))
        status = str(problem.status)
    except Exception as error:  # foreign code fails in every way there is, and none may end a comparison
        status = (str(error).splitlines() or [type(error).__name__])[0]
    seconds = time.perf_counter() - began
    claim = CLAIMS.get(status)
    if claim is None and (x.value is None or not np.isfinite(x.value).all()):
        return JudgedAnswer(name, status, seconds, None, levels[0])
    for level in levels:
        if claim is not None:
            said = certify(program, claim=claim, tolerance=level, max_seconds=max_seconds)
        else:
            said = certify(program, x.value, _multipliers(program, rows), tolerance=level, max_seconds=max_seconds)
        if said.verdict == "proved" or level == levels[-1]:
            break
    return JudgedAnswer(name, status, seconds, said, level)


def _solver(name: str) -> Any:
    if name != OURS:
        return name
    from ..modeling.qp_solver import QPSolver

    return QPSolver


def stated(program: QuadraticProgram) -> tuple[Any, Any, dict[str, Any]]:
    """Return (cvxpy problem, x, rows of G and A as constraints by name)."""
    import cvxpy as cp

    x = cp.Variable(program.n)
    curved = 0.5 * cp.quad_form(x, program.P, assume_PSD=True) if abs(program.P).sum() else 0.0
    rows = {}
    if program.h.size:
        rows["inequality"] = program.G @ x <= program.h
    if program.b.size:
        rows["equality"] = program.A @ x == program.b
    bounds = []
    for bound, sign in ((program.lower, -1.0), (program.upper, 1.0)):
        if (at := np.flatnonzero(np.isfinite(bound))).size:
            bounds.append(sign * x[at] <= sign * bound[at])
    return cp.Problem(cp.Minimize(curved + program.c @ x), [*rows.values(), *bounds]), x, rows


def _multipliers(program: QuadraticProgram, rows: dict[str, Any]) -> Any:
    """Return the multipliers of G and A that the solver left, None where one is missing."""
    found = {}
    for name, size in (("inequality", program.h.size), ("equality", program.b.size)):
        value = rows[name].dual_value if size else np.zeros(0)
        if value is None or not np.isfinite(value).all():
            return None
        found[name] = value
    return found
