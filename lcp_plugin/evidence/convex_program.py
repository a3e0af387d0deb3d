"""The convex program of a complementarity problem, and the answer of a convex solver through cvxpy.

| M | program |
|---|---|
| symmetric positive semidefinite, to rounding | min ½ zᵀMz + qᵀz over the bounds |
| symmetric part positive semidefinite | gap program: min zᵀ(Mz + q) − lᵀa + uᵀb, Mz + q = a − b, a, b ≥ 0 |
| otherwise | none: a stationary point of a nonconvex program proves nothing |

A factorization checks both conditions. The solver gets the problem in the unknown y = D^½ z / unit, whose matrix has a
diagonal of at most 1, because the tolerances of convex solvers are absolute.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from ..core.certificates.criterion import scaled_residual
from ..core.checks import FloatVector
from ..core.errors import InvalidOption, did_you_mean
from ..core.kernels.floats import EPSILON
from ..core.lcp import LCP
from ..core.matrix.scaling import scale_by
from ..problems.programs.program import QuadraticProgram, asymmetry_of
from ..systems.definiteness import factorised, symmetric_part

PLAIN, GAP = "quadratic program", "gap quadratic program"
TIME_LIMITS = {
    **dict.fromkeys(("CLARABEL", "HIGHS", "OSQP"), "time_limit"),
    "SCS": "time_limit_secs",
}


@dataclass(frozen=True, eq=False)
class ReferenceProgram:
    """The convex program of an LCP in equilibrated unknowns y = weight · z / unit.

    Attributes
    ----------
    kind : str
        PLAIN, GAP, or "" if no convex program exists.
    evidence : str
        The reason in one line.
    problem : LCP
    weight : ndarray, shape (n,)
        √d_i.
    unit : float
        Size of D^½ r(z°), of the data if that is 0.
    """

    kind: str
    evidence: str
    problem: LCP
    weight: FloatVector = field(repr=False)
    unit: float
    matrix: Any = field(repr=False)

    @classmethod
    def of(cls, problem: LCP) -> ReferenceProgram:
        """Return the program that symmetry and a factorization of the symmetric part allow."""
        weight = np.sqrt(np.where(problem.diagonal > 0.0, problem.diagonal, problem.residual_scale))
        A = scale_by(problem.M, 1.0 / weight, 1.0 / weight)
        place = asymmetry_of(A)[1]
        matrix = "M is symmetric"
        if place is not None:
            i, j = place
            matrix = f"M[{i}, {j}] and M[{j}, {i}] differ; the symmetric part of M is"
        kind, evidence = "", f"{matrix} indefinite: a diagonal entry is negative"
        if not (problem.diagonal < 0.0).any():
            # Skew entries above 1 leave their rounding behind when the symmetric part cancels them.
            shift = 4.0 * (problem.n + 2) * EPSILON * max(1.0, float(abs(A).max()))
            evidence = f"{matrix} indefinite: a pivot is negative at shift {shift:.1e}"
            if factorised(symmetric_part(A), shift) is not None:
                kind = PLAIN if place is None else GAP
                evidence = f"{matrix} positive semidefinite: factorized at shift {shift:.1e}"
        return cls(kind, evidence, problem, weight, _unit(problem, weight), A)

    def program(self) -> QuadraticProgram:
        """Return the quadratic program in y, or in (y, a, b) if it is the gap program.

        a and b exist only for finite bounds. The optimum of the gap program is 0 if y solves the problem.
        """
        problem, A = self.problem, self.matrix
        c = problem.q / self.weight / self.unit
        lower, upper = (self.weight * bound / self.unit for bound in (problem.lower, problem.upper))
        if self.kind == PLAIN:
            return QuadraticProgram(symmetric_part(A), c, lower=lower, upper=upper)
        low, high = (np.flatnonzero(np.isfinite(bound)) for bound in (lower, upper))
        unit, slacks = sp.eye_array(c.size, format="csc"), low.size + high.size
        twice = 2.0 * sp.csc_array(symmetric_part(A))
        return QuadraticProgram(
            sp.block_diag([twice, sp.csc_array((slacks, slacks))], format="csc"),
            np.concatenate([c, -lower[low], upper[high]]),
            A=sp.hstack([sp.csr_array(A), -unit[:, low], unit[:, high]], format="csr"),
            b=-c,
            lower=np.concatenate([lower, np.zeros(slacks)]),
            upper=np.concatenate([upper, np.full(slacks, np.inf)]),
        )

    def point(self, x: FloatVector) -> FloatVector:
        """Return z of the unknowns of `program`, within the bounds."""
        problem = self.problem
        z: FloatVector = np.clip(
            x[: problem.n] * self.unit / self.weight, problem.lower, problem.upper
        )
        return z


def _unit(problem: LCP, weight: FloatVector) -> float:
    z = problem.nearest_to_zero
    residual = scaled_residual(problem, z, problem.slack(z), weight * weight)
    sizes = (
        float(np.max(np.abs(v), initial=0.0))
        for v in (weight * residual, problem.q / weight, weight * z)
    )
    return next((size for size in sizes if 0.0 < size < np.inf), 1.0)


# --- A convex solver through cvxpy ----------------------------------------------------------------------------


class SolverOutput(NamedTuple):
    """cvxpy's status or the message of an exception, seconds with cvxpy's part, and z or None."""

    status: str
    seconds: float
    z: FloatVector | None


def solver_name(reference: Any) -> str:
    """Return cvxpy's name of an installed solver of quadratic programs, or raise InvalidOption."""
    from cvxpy import installed_solvers

    name = reference.upper() if isinstance(reference, str) else repr(reference)
    known = [one for one in installed_solvers() if one != "LCP"]
    if name not in known:
        raise InvalidOption(f"cvxpy has no solver {reference!r}{did_you_mean(name, known)}")
    return name


def solve_by(
    name: str, convex: ReferenceProgram, max_seconds: float, options: Any = ()
) -> SolverOutput:
    """Solve the program by a convex solver; an exception becomes the status."""
    import cvxpy as cp

    began, program = time.perf_counter(), convex.program()
    limit = {TIME_LIMITS[name]: max_seconds} if name in TIME_LIMITS else {}
    x = cp.Variable(program.n, bounds=[program.lower, program.upper])
    # Without assume_PSD cvxpy makes P dense to check it.
    curved = 0.5 * cp.quad_form(x, program.P, assume_PSD=True) if abs(program.P).sum() else 0.0
    rows = [program.A @ x == program.b] if program.b.size else []
    problem = cp.Problem(cp.Minimize(curved + program.c @ x), rows)
    try:
        problem.solve(solver=name, **limit | dict(options))
    except Exception as error:  # solvers fail with exceptions of any class
        status = (str(error).splitlines() or [type(error).__name__])[0]
        return SolverOutput(status, time.perf_counter() - began, None)
    seconds = time.perf_counter() - began
    is_point = x.value is not None and np.isfinite(x.value).all()
    return SolverOutput(str(problem.status), seconds, convex.point(x.value) if is_point else None)
