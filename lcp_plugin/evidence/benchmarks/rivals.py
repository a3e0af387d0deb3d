"""Ours against quadratic program solvers, from (M, q) to an answer with natural residual 1e-8, its check included."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np
import scipy.sparse as sp

from ...algorithms.interior_points.interior_point import InteriorPoint
from ...checks import FloatVector
from ...problem.lcp import LCP
from ...solving.driver import solve
from .timing import medians

TARGET_RESIDUAL = 1e-8
PRECISIONS = (1e-6, 1e-8, 1e-10, 1e-12)
TOO_SLOW = 20.0  # seconds; who takes longer without arriving is not asked for a higher precision
LONG = 5.0  # seconds; who takes longer is measured once
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
REPEATS = 7
LARGEST_DENSE = 5000
SEED = 5


@dataclass(frozen=True)
class Case:
    """A problem with known answer: M and q as its user has them, M dense unless it is sparse by nature."""

    name: str
    M: Any
    q: FloatVector

    def residual(self, z: FloatVector) -> float:
        """‖min(z, M z + q)‖∞."""
        return float(np.max(np.abs(np.minimum(z, self.M @ z + self.q))))


def spectrum(n: int, condition: float, active: float, seed: int = SEED) -> Case:
    """Return a dense SPD problem, eigenvalues evenly spread in the logarithm, a share `active` of z* at its bound."""
    rng = np.random.default_rng(seed)
    vectors, _ = np.linalg.qr(rng.standard_normal((n, n)))
    M = (vectors * np.geomspace(1.0, 1.0 / condition, n)) @ vectors.T
    M = 0.5 * (M + M.T)
    return Case(f"SPD n = {n}, κ = {condition:.0e}, {active:.0%} active", M, _offset(M, active, rng))


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
                J[i, 6 * body : 6 * body + 6] = sign * np.concatenate([normal, np.cross(arm, normal)])
    mass = np.repeat(np.exp(rng.standard_normal(bodies)), 6)
    M = (J / mass) @ J.T
    return Case(f"contact n = {n}", M, _offset(M, 0.4, rng))


def obstacle(n: int) -> Case:
    """Return a sparse H₊ problem: the five-point matrix with 4.5 on its diagonal, half of z* at its bound."""
    rng = np.random.default_rng(SEED)
    side = round(n**0.5)
    line = sp.diags_array([-1.0, -1.0], offsets=[-1, 1], shape=(side, side))
    grid = sp.kron(sp.eye_array(side), line) + sp.kron(line, sp.eye_array(side)) + 4.5 * sp.eye_array(side * side)
    M = sp.csr_array(grid)
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
    if not quick and any(os.environ.get(name) != "1" for name in ONE_THREAD):
        yield from _alone()
        return
    rivals = dict(installed())
    for name in RIVALS:
        if name not in rivals:
            yield f"{name} is not installed and left out"
    first, behind, count = 0, 1.0, 0
    for case in cases(quick=quick):
        seconds, notes = _measured(case, rivals, repeats=2 if quick else REPEATS)
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


def _alone() -> Iterator[str]:
    """Run in a process of its own where every library has one thread from the start."""
    code = f"from {__name__} import run\nfor line in run(): print(line, flush=True)"
    environment = os.environ | dict.fromkeys(ONE_THREAD, "1") | {"NUMBA_NUM_THREADS": "1"}
    with subprocess.Popen([sys.executable, "-c", code], env=environment, stdout=subprocess.PIPE, text=True) as child:
        for line in child.stdout or ():
            yield line.rstrip("\n")


def _measured(
    case: Case, rivals: dict[str, Callable[..., Any]], repeats: int
) -> tuple[dict[str, float], dict[str, str]]:
    """Return the median seconds of those that reach the residual, and a note on every solver."""
    calls: dict[str, Callable[[], object]] = {}
    notes: dict[str, str] = {}
    once: dict[str, float] = {}
    for name, solver in (OURS | rivals).items():
        for precision in PRECISIONS:
            call = _checked(case, solver, precision)
            began = time.perf_counter()
            try:
                residual, note = call()
            except Exception as error:  # a rival's own error, of whatever class, is a result
                notes[name] = f"fails: {type(error).__name__}"
                break
            took = time.perf_counter() - began
            if residual <= TARGET_RESIDUAL:
                notes[name] = f"residual {residual:.0e} at precision {precision:.0e} {note}"
                if took > LONG:
                    once[name] = took
                    notes[name] += " (measured once)"
                else:
                    calls[name] = call
                break
            notes[name] = f"not in reach: residual {residual:.0e} at precision {precision:.0e}"
            if took > TOO_SLOW:
                break
    return once | medians(calls, repeats), notes


def _checked(case: Case, solver: Callable[..., Any], precision: float) -> Callable[[], tuple[float, str]]:
    def call() -> tuple[float, str]:
        z, note = solver(case.M, case.q, precision)
        return case.residual(np.asarray(z)), note

    return call


def _auto(M: Any, q: FloatVector, precision: float) -> tuple[FloatVector, str]:
    result = solve(LCP(M, q), tolerance=precision)
    return result.z, f"({result.algorithm})"


def _interior_point(M: Any, q: FloatVector, precision: float) -> tuple[FloatVector, str]:
    return solve(LCP(M, q), InteriorPoint(), tolerance=precision).z, ""


def _dense(M: Any) -> FloatVector:
    if sp.issparse(M) and M.shape[0] > LARGEST_DENSE:
        raise MemoryError
    dense: FloatVector = M.toarray() if sp.issparse(M) else M
    return dense


def _piqp(M: Any, q: FloatVector, precision: float, *, is_dense: bool) -> tuple[FloatVector, str]:
    piqp: Any = import_module("piqp")

    solver = piqp.DenseSolver() if is_dense else piqp.SparseSolver()
    settings = solver.settings
    settings.eps_abs = settings.eps_rel = settings.eps_duality_gap_abs = settings.eps_duality_gap_rel = precision
    P = np.asfortranarray(_dense(M)) if is_dense else sp.csc_matrix(M)
    solver.setup(P=P, c=q, x_l=np.zeros(q.size))
    solver.solve()
    return np.maximum(solver.result.x, 0.0), ""


def _piqp_dense(M: Any, q: FloatVector, precision: float) -> tuple[FloatVector, str]:
    return _piqp(M, q, precision, is_dense=True)


def _piqp_sparse(M: Any, q: FloatVector, precision: float) -> tuple[FloatVector, str]:
    return _piqp(M, q, precision, is_dense=False)


def _osqp(M: Any, q: FloatVector, precision: float) -> tuple[FloatVector, str]:
    osqp: Any = import_module("osqp")

    solver = osqp.OSQP()
    n = q.size
    solver.setup(
        P=sp.triu(sp.csc_matrix(M), format="csc"), q=q, A=sp.eye(n, format="csc"), l=np.zeros(n), u=np.full(n, np.inf),
        verbose=False, eps_abs=precision, eps_rel=precision, max_iter=200_000, polishing=True, time_limit=TOO_SLOW,
    )
    return np.maximum(solver.solve(raise_error=False).x, 0.0), ""


def _proxqp(M: Any, q: FloatVector, precision: float) -> tuple[FloatVector, str]:
    proxqp: Any = import_module("proxsuite").proxqp

    n = q.size
    solver = proxqp.dense.QP(n, 0, 0, True)
    solver.settings.eps_abs, solver.settings.eps_rel = precision, 0.0
    solver.init(_dense(M), q, None, None, None, None, None, np.zeros(n), np.full(n, 1e20))
    solver.solve()
    return np.maximum(solver.results.x, 0.0), ""


def _clarabel(M: Any, q: FloatVector, precision: float) -> tuple[FloatVector, str]:
    clarabel: Any = import_module("clarabel")

    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_threads = False, 1
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = precision
    n = q.size
    solver = clarabel.DefaultSolver(
        sp.triu(sp.csc_matrix(M), format="csc"), q, -sp.eye(n, format="csc"), np.zeros(n),
        [clarabel.NonnegativeConeT(n)], settings,
    )
    return np.maximum(np.array(solver.solve().x), 0.0), ""


def _daqp(M: Any, q: FloatVector, precision: float) -> tuple[FloatVector, str]:
    daqp: Any = import_module("daqp")

    n = q.size
    x, *_ = daqp.solve(
        np.ascontiguousarray(_dense(M)), q, np.zeros((0, n)), np.full(n, 1e30), np.zeros(n),
        np.zeros(n, dtype=np.int32), primal_tol=precision, dual_tol=precision, iter_limit=100_000,
    )
    return np.maximum(x, 0.0), ""


def _psor(M: Any, q: FloatVector, precision: float) -> tuple[FloatVector, str]:
    """Plain projected Gauss–Seidel, compiled, its residual looked at every ten sweeps."""
    from ...kernels import splitting_sweeps as kernels

    problem = LCP(M, q)
    rows = kernels.packed(problem.q, problem.lower, problem.upper, 1.0 / problem.diagonal)
    csr, split, z = problem.csr, kernels.row_splits(problem.csr, backward=False), np.zeros(q.size)
    began = time.perf_counter()
    while time.perf_counter() - began < TOO_SLOW:
        for _ in range(10):
            change, _ = kernels.relaxation_sweep(csr.indptr, split, csr.indices, csr.data, rows, 1.0, False, z)
        if change <= precision:
            break
    return z, ""


OURS: dict[str, Callable[..., Any]] = {"auto": _auto, "interior_point": _interior_point}
RIVALS: dict[str, tuple[str, Callable[..., Any]]] = {
    "PIQP dense": ("piqp", _piqp_dense),
    "PIQP sparse": ("piqp", _piqp_sparse),
    "ProxQP": ("proxsuite", _proxqp),
    "DAQP": ("daqp", _daqp),
    "Clarabel": ("clarabel", _clarabel),
    "OSQP": ("osqp", _osqp),
    "compiled PGS": ("numba", _psor),
}


def installed() -> Iterator[tuple[str, Callable[..., Any]]]:
    """Yield the rivals whose package is there."""
    for name, (package, solver) in RIVALS.items():
        if find_spec(package) is not None:
            yield name, solver
