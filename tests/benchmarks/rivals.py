"""Ours against quadratic program solvers, from (M, q) to an answer with natural residual 1e-8, its check included."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np
import scipy.sparse as sp

from lcp_plugin.api import solve
from lcp_plugin.core.checks import FloatVector
from lcp_plugin.core.lcp import LCP
from lcp_plugin.gallery.stencil import stencil_matrix
from lcp_plugin.methods.interior_point import InteriorPoint

from .timing import Timed, medians, timed

TARGET_RESIDUAL = 1e-8
PRECISIONS = (1e-6, 1e-8, 1e-10, 1e-12)
TOO_SLOW = 20.0  # seconds; who takes longer without arriving is not asked for a higher precision
LONG = 5.0  # seconds; who takes longer is measured once
REPEATS = 7
LARGEST_DENSE = 5000
SEED = 5


@dataclass(frozen=True)
class Case:
    """A problem as its user has it, M dense unless it is sparse by nature; bounds where they are not 0 and ∞."""

    name: str
    M: Any
    q: FloatVector
    lower: Any = 0.0
    upper: Any = np.inf

    @property
    def bounds(self) -> tuple[FloatVector, FloatVector]:
        """Lower and upper bounds, shape (n,) each."""
        return np.broadcast_to(self.lower, self.q.shape).copy(), np.broadcast_to(
            self.upper, self.q.shape
        ).copy()

    @property
    def dense(self) -> FloatVector:
        """M as an array, where it is small enough."""
        if sp.issparse(self.M) and self.q.size > LARGEST_DENSE:
            raise MemoryError
        M: FloatVector = self.M.toarray() if sp.issparse(self.M) else self.M
        return M

    def residual(self, z: FloatVector) -> float:
        """‖z − mid(lower, upper, z − w)‖∞."""
        return float(np.max(np.abs(z - np.clip(z - (self.M @ z + self.q), self.lower, self.upper))))


Answer = tuple[FloatVector, str]  # z within its bounds, and a note


@dataclass(frozen=True)
class Solver:
    """Who is asked: the package behind it, and what it makes of a case, a precision and a limit in seconds."""

    package: str
    ask: Callable[[Case, float, float], tuple[Any, str]]

    def answer(self, case: Case, precision: float, limit: float = 20.0) -> Answer:
        """Return z, clipped to the bounds, and a note."""
        x, note = self.ask(case, precision, limit)
        return np.clip(np.asarray(x, dtype=np.float64), case.lower, case.upper), note


def spectrum(n: int, condition: float, active: float, seed: int = SEED) -> Case:
    """Return a dense SPD problem, eigenvalues evenly spread in the logarithm, a share `active` of z* at its bound."""
    rng = np.random.default_rng(seed)
    vectors, _ = np.linalg.qr(rng.standard_normal((n, n)))
    M = (vectors * np.geomspace(1.0, 1.0 / condition, n)) @ vectors.T
    M = 0.5 * (M + M.T)
    return Case(
        f"SPD n = {n}, κ = {condition:.0e}, {active:.0%} active", M, _offset(M, active, rng)
    )


def contact(n: int, seed: int = SEED) -> Case:
    """Return the Delassus matrix J W Jᵀ of n contacts among n/4 bodies in a row of cells, rank-deficient."""
    rng = np.random.default_rng(seed)
    bodies = max(2, n // 8)
    J = np.zeros((n, 6 * bodies))
    for i in range(n):
        first = int(rng.integers(bodies))
        second = first + int(rng.integers(1, 5))  # beyond the last body there is the ground
        normal = rng.standard_normal(3)
        normal /= np.linalg.norm(normal)
        for body, sign in ((first, 1.0), (second, -1.0)):
            if body < bodies:
                arm = 0.5 * rng.standard_normal(3)
                J[i, 6 * body : 6 * body + 6] = sign * np.concatenate(
                    [normal, np.cross(arm, normal)]
                )
    mass = np.repeat(np.exp(rng.standard_normal(bodies)), 6)
    M = (J / mass) @ J.T
    return Case(f"contact n = {n}", M, _offset(M, 0.4, rng))


def obstacle(n: int) -> Case:
    """Return a sparse H₊ problem: the five-point matrix with 4.5 on its diagonal, half of z* at its bound."""
    rng = np.random.default_rng(SEED)
    side = round(n**0.5)
    M = stencil_matrix((side, side), 4.5, (-1.0, -1.0), (-1.0, -1.0))
    return Case(f"sparse H₊ n = {side * side}", M, _offset(M, 0.5, rng))


def _offset(M: Any, active: float, rng: np.random.Generator) -> FloatVector:
    """Return q = w* − M z*, the answer chosen first."""
    n = M.shape[0]
    is_active = rng.random(n) < active
    z, w = np.where(is_active, 0.0, rng.random(n)), np.where(is_active, rng.random(n), 0.0)
    offset: FloatVector = w - M @ z
    return offset


def cases(*, quick: bool) -> Iterator[Case]:
    """Yield the nine cases of the table, or three small ones."""
    shares = (0.3, 0.5, 0.7)
    for k, n in enumerate((60,) if quick else (200, 1000, 2000)):
        for j, condition in enumerate((1e2, 1e6)):
            yield spectrum(n, condition, shares[(k + j) % 3])
    for n in (40,) if quick else (150, 550):
        yield contact(n)
    yield obstacle(400 if quick else 100_000)


def run(*, quick: bool = False) -> Iterator[str]:
    """Yield one block a case: every solver's median time at its cheapest setting that reaches the residual."""
    solvers = {
        name: solver
        for name, solver in (OURS | RIVALS).items()
        if find_spec(solver.package) is not None
    }
    for name in RIVALS.keys() - solvers.keys():
        yield f"{name} is not installed and left out"
    first, behind, count = 0, 1.0, 0
    for case in cases(quick=quick):
        seconds, notes = _measured(case, solvers, repeats=2 if quick else REPEATS)
        yield f"{case.name}: everything from (M, q) to the checked answer, 1 thread, median of {REPEATS}"
        own = seconds.get("auto", np.inf)
        for name, note in notes.items():
            if name in seconds:
                yield f"  {name:<14} {seconds[name]:10.5f} s   ÷ auto {seconds[name] / own:8.2f}   {note}"
            else:
                yield f"  {name:<14} {note}"
        best = min((value for name, value in seconds.items() if name not in OURS), default=np.inf)
        count += 1
        first += own <= best
        behind = max(behind, own / best)
    yield f"first on {first} of {count}; nowhere more than {behind:.2f} × behind   target ≥ 7 of 9, ≤ 2 ×"


def _measured(
    case: Case, solvers: dict[str, Solver], repeats: int
) -> tuple[dict[str, float], dict[str, str]]:
    """Return the median seconds of those that reach the residual, and a note on every solver."""
    calls: dict[str, Callable[[], object]] = {}
    notes: dict[str, str] = {}
    once: dict[str, float] = {}
    for name, solver in solvers.items():
        for precision in PRECISIONS:
            call = partial(_checked, case, solver, precision)
            try:
                one: Timed = timed(call)
            except Exception as error:  # a rival's own error, of whatever class, is a result
                notes[name] = f"fails: {type(error).__name__}"
                break
            residual, note = one.answer
            if residual <= TARGET_RESIDUAL:
                notes[name] = f"residual {residual:.0e} at precision {precision:.0e} {note}"
                if one.seconds > LONG:
                    once[name] = one.seconds
                    notes[name] += " (measured once)"
                else:
                    calls[name] = call
                break
            notes[name] = f"not in reach: residual {residual:.0e} at precision {precision:.0e}"
            if one.seconds > TOO_SLOW:
                break
    return once | medians(calls, repeats), notes


def _checked(case: Case, solver: Solver, precision: float) -> tuple[float, str]:
    z, note = solver.answer(case, precision, TOO_SLOW)
    return case.residual(z), note


def _auto(case: Case, precision: float, limit: float) -> Answer:
    result = solve(LCP(case.M, case.q), tolerance=precision)
    return result.z, f"({result.algorithm})"


def _interior_point(case: Case, precision: float, limit: float) -> Answer:
    return solve(LCP(case.M, case.q), InteriorPoint(), tolerance=precision).z, ""


def _piqp(case: Case, precision: float, limit: float, *, is_dense: bool) -> tuple[Any, str]:
    piqp: Any = import_module("piqp")

    solver = piqp.DenseSolver() if is_dense else piqp.SparseSolver()
    settings = solver.settings
    settings.eps_abs = settings.eps_rel = settings.eps_duality_gap_abs = (
        settings.eps_duality_gap_rel
    ) = precision
    P = np.asfortranarray(case.dense) if is_dense else sp.csc_matrix(case.M)
    lower, upper = case.bounds
    solver.setup(P=P, c=case.q, x_l=lower, x_u=upper)
    status = solver.solve()
    return solver.result.x, str(status).rpartition(".")[2]


def _osqp(case: Case, precision: float, limit: float) -> tuple[Any, str]:
    osqp: Any = import_module("osqp")

    solver = osqp.OSQP()
    lower, upper = case.bounds
    solver.setup(
        P=sp.triu(sp.csc_matrix(case.M), format="csc"),
        q=case.q,
        A=sp.eye(case.q.size, format="csc"),
        l=lower,
        u=upper,
        verbose=False,
        eps_abs=precision,
        eps_rel=precision,
        max_iter=200_000,
        polishing=True,
        time_limit=limit,
    )
    answer = solver.solve(raise_error=False)
    return answer.x, answer.info.status


def _proxqp(case: Case, precision: float, limit: float) -> tuple[Any, str]:
    proxqp: Any = import_module("proxsuite").proxqp

    solver = proxqp.dense.QP(case.q.size, 0, 0, True)
    solver.settings.eps_abs, solver.settings.eps_rel = precision, 0.0
    lower, upper = case.bounds
    solver.init(case.dense, case.q, None, None, None, None, None, lower, np.minimum(upper, 1e20))
    solver.solve()
    return solver.results.x, ""


def _clarabel(case: Case, precision: float, limit: float) -> tuple[Any, str]:
    clarabel: Any = import_module("clarabel")

    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_threads = False, 1
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = precision
    n = case.q.size
    solver = clarabel.DefaultSolver(
        sp.triu(sp.csc_matrix(case.M), format="csc"),
        case.q,
        -sp.eye(n, format="csc"),
        -case.bounds[0],
        [clarabel.NonnegativeConeT(n)],
        settings,
    )
    return solver.solve().x, ""


def _daqp(case: Case, precision: float, limit: float) -> tuple[Any, str]:
    daqp: Any = import_module("daqp")

    n = case.q.size
    lower, upper = case.bounds
    x, *_ = daqp.solve(
        np.ascontiguousarray(case.dense),
        case.q,
        np.zeros((0, n)),
        np.minimum(upper, 1e30),
        lower,
        np.zeros(n, dtype=np.int32),
        primal_tol=precision,
        dual_tol=precision,
        iter_limit=100_000,
    )
    return x, ""


def _psor(case: Case, precision: float, limit: float) -> tuple[Any, str]:
    """Plain projected Gauss–Seidel, compiled, its residual looked at every ten sweeps."""
    from lcp_plugin.core.kernels import splitting_sweeps as kernels

    problem = LCP(case.M, case.q)
    rows = kernels.packed(problem.q, problem.lower, problem.upper, 1.0 / problem.diagonal)
    csr, split, z = (
        problem.csr,
        kernels.row_splits(problem.csr, backward=False),
        np.zeros(problem.n),
    )
    began = time.perf_counter()
    while time.perf_counter() - began < limit:
        for _ in range(10):
            change, _ = kernels.relaxation_sweep(
                csr.indptr, split, csr.indices, csr.data, rows, 1.0, False, z
            )
        if change <= precision:
            break
    return z, ""


OURS = {"auto": Solver("numba", _auto), "interior_point": Solver("numba", _interior_point)}
RIVALS = {
    "PIQP dense": Solver("piqp", partial(_piqp, is_dense=True)),
    "PIQP sparse": Solver("piqp", partial(_piqp, is_dense=False)),
    "ProxQP": Solver("proxsuite", _proxqp),
    "DAQP": Solver("daqp", _daqp),
    "Clarabel": Solver("clarabel", _clarabel),
    "OSQP": Solver("osqp", _osqp),
    "compiled PGS": Solver("numba", _psor),
}
