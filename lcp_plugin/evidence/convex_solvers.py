"""A convex program asked of solvers through cvxpy, their answers judged by `certify`, and programs to ask."""

from __future__ import annotations

import contextlib
import io
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

from ..checks import FloatVector
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
        return self.x is not None and self.certification is not None and self.certification.verdict == "proved"

    def save(self, path: Path) -> None:
        """Write x, the multipliers where the solver has told them, and the solver's name into an ``.npz`` file."""
        from ..problem.files import write_whole

        vectors: dict[str, Any] = {"x": self.x, **(self.multipliers or {}), "solver": np.array(self.solver)}
        write_whole({path: lambda file: np.savez_compressed(file, **vectors)})

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
            return Reply((str(error).splitlines() or [type(error).__name__])[0], time.perf_counter() - began)
    seconds = time.perf_counter() - began
    found = {name: _finite(row.dual_value) for name, row in rows.items()}
    multipliers = {"inequality": np.zeros(0), "equality": np.zeros(0)} | found
    return Reply(
        str(problem.status), seconds, _finite(x.value),
        None if any(value is None for value in found.values()) else multipliers,
        tuple(sorted({str(one.message).splitlines()[0] for one in caught})),
    )


def _finite(value: Any) -> Any:
    return None if value is None or not np.isfinite(value).all() else np.asarray(value, dtype=np.float64)


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


# --- Small programs of the kinds that people solve, data from fixed seeds ---------------------------------------


def portfolio() -> QuadraticProgram:
    """Return the risk of 60 assets in five factors, less their return; weights ≥ 0 of sum 1."""
    rng = np.random.default_rng(1)
    factors = rng.normal(size=(60, 5))
    P = factors @ factors.T + np.diag(rng.uniform(0.1, 1.0, 60))
    return QuadraticProgram(P, -rng.uniform(0.0, 1.0, 60), A=np.ones((1, 60)), b=[1.0], lower=0.0)


def support_vectors() -> QuadraticProgram:
    """Return the dual of a support vector machine: 60 points in four dimensions, so that P is singular."""
    rng = np.random.default_rng(2)
    label = np.where(np.arange(60) % 2, 1.0, -1.0)
    points = np.round(64.0 * (rng.normal(size=(60, 4)) + 0.5 * label[:, None])) / 64.0
    signed = label[:, None] * points
    return QuadraticProgram(signed @ signed.T, -np.ones(60), A=label[None, :], b=[0.0], lower=0.0, upper=1.0)


def convex_fit() -> QuadraticProgram:
    """Return the least squares fit of a convex sequence to 60 values: a chain of second differences."""
    rng, n = np.random.default_rng(3), 60
    values = np.linspace(-1.0, 1.0, n) ** 2 + 0.1 * rng.normal(size=n)
    bend = sp.diags_array([-np.ones(n), 2.0 * np.ones(n), -np.ones(n)], offsets=[0, 1, 2], shape=(n - 2, n))
    return QuadraticProgram(sp.eye_array(n, format="csr"), -values, G=bend.tocsr(), h=np.zeros(n - 2))


def unstable_control() -> QuadraticProgram:
    """Return twenty steps of a state that grows by a fifth a step, held by bounded forces."""
    steps = 20
    grow = sp.diags_array([np.ones(steps), np.full(steps - 1, -1.2)], offsets=[0, -1])
    start = np.zeros(steps)
    start[0] = 1.2 * 0.9
    return QuadraticProgram(
        sp.diags_array(np.repeat([1.0, 0.1], steps)), np.zeros(2 * steps),
        A=sp.hstack([grow, -sp.eye_array(steps)], format="csr"), b=start,
        lower=np.repeat([-np.inf, -0.25], steps), upper=np.repeat([np.inf, 0.25], steps),
    )


def transport() -> QuadraticProgram:
    """Return the cheapest transport from six places to eight: a linear program with many bases."""
    rng = np.random.default_rng(4)
    rows = sp.vstack([
        sp.kron(sp.eye_array(6), np.ones((1, 8))), sp.kron(np.ones((1, 6)), sp.eye_array(8)),
    ], format="csr")
    amounts = np.concatenate([np.full(6, 8.0), np.full(8, 6.0)])
    return QuadraticProgram(sp.csr_array((48, 48)), rng.integers(1, 10, 48).astype(float), A=rows, b=amounts, lower=0.0)


def badly_scaled() -> QuadraticProgram:
    """Return a program whose rows and columns are in units from 1e-4 to 1e4."""
    rng = np.random.default_rng(5)
    columns, rows = 10.0 ** rng.uniform(-4.0, 4.0, 20), 10.0 ** rng.uniform(-4.0, 4.0, 12)
    factor, x = rng.normal(size=(20, 20)), rng.normal(size=20)
    G = rng.normal(size=(12, 20))
    return QuadraticProgram(
        columns[:, None] * (factor @ factor.T) * columns, columns * rng.normal(size=20),
        G=rows[:, None] * G * columns, h=rows * (G @ x + rng.uniform(0.0, 1.0, 12)),
    )


def contradiction() -> QuadraticProgram:
    """Return a program whose constraints contradict by a thousandth."""
    rng = np.random.default_rng(6)
    G = np.round(8.0 * rng.normal(size=(3, 6)))
    return QuadraticProgram(np.eye(6), np.ones(6), G=np.vstack([G, -G.sum(axis=0)]), h=[1.0, 2.0, 3.0, -6.001])


def endless_descent() -> QuadraticProgram:
    """Return a program whose objective falls for ever where two variables grow together."""
    return QuadraticProgram(np.diag([0.0, 0.0, 1.0]), [1.0, -2.0, 0.0], A=[[1.0, -1.0, 0.0]], b=[0.0], lower=0.0)


SAMPLES: dict[str, Callable[[], QuadraticProgram]] = {
    "portfolio": portfolio, "support vectors": support_vectors, "convex fit": convex_fit,
    "unstable control": unstable_control, "transport": transport, "badly scaled": badly_scaled,
    "contradiction": contradiction, "endless descent": endless_descent,
}
