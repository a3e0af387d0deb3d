"""The quadratic program behind a problem, where there is one, and what convex solvers answer to it.

| M | reference |
|---|---|
| symmetric positive semidefinite, to rounding | min ½ zᵀMz + qᵀz over the bounds |
| symmetric part positive semidefinite | gap program: min zᵀ(Mz + q) − lᵀa + uᵀb, Mz + q = a − b, a, b ≥ 0 |
| otherwise | none: a stationary point of a nonconvex program proves nothing |

Both conditions are checked by a factorisation, never assumed. The solvers get the problem in the unknown
y = D^½ z / unit, whose matrix has a diagonal of at most 1: their tolerances are absolute. Their answers are judged
on the caller's data.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy.sparse as sp

from ..core.certificates.criterion import reference_residual
from ..core.certificates.residuals import Certificate
from ..core.certificates.row_residuals import scaled_residual
from ..core.checks import FloatVector
from ..core.errors import InvalidOption, did_you_mean
from ..core.kernels.floats import EPSILON
from ..core.lcp import LCP
from ..problems.programs.program import QuadraticProgram, asymmetry_of
from ..systems.definiteness import factorised, symmetric_part
from ..systems.factors import factorise
from .convex_solvers import asked

ACCURATE = 1e-7
POLISH_ROUNDS = 3

PLAIN, GAP = "quadratic program", "gap quadratic program"


@dataclass(frozen=True)
class Solver:
    """A solver cvxpy knows: its name there, options that make it accurate, the option for its time limit, its n."""

    name: str
    options: Mapping[str, Any]
    time_limit: str | None
    largest: float = np.inf


_TIGHT = {"eps_abs": 1e-10, "eps_rel": 1e-10}

# In the order in which they are asked: the most accurate natural residual first. Interior-point methods come last:
# they leave z_i w_i ≈ tolerance where both vanish, hence a residual of its square root before the polish.
SOLVERS = {
    "daqp": Solver("DAQP", {}, None, largest=200),
    "osqp": Solver("OSQP", {**_TIGHT, "max_iter": 1_000_000}, "time_limit"),
    "scs": Solver("SCS", {**_TIGHT, "max_iters": 1_000_000}, "time_limit_secs"),
    "piqp": Solver("PIQP", _TIGHT, None),
    "clarabel": Solver(
        "CLARABEL", {"tol_gap_abs": 1e-11, "tol_gap_rel": 1e-11, "tol_feas": 1e-11}, "time_limit"
    ),
    "highs": Solver("HIGHS", {}, "time_limit", largest=2000),
}


@dataclass(frozen=True, eq=False)
class Equilibrated:
    """The problem in y = weight · z / unit: A = D^−½ M D^−½, c = D^−½ q / unit, with bounds in y."""

    problem: LCP
    weight: FloatVector
    unit: float
    A: Any
    c: FloatVector
    lower: FloatVector
    upper: FloatVector

    @classmethod
    def of(cls, problem: LCP) -> Equilibrated:
        """Return the problem with rows and columns divided by √d_i, in the unit of its own residual."""
        weight = np.sqrt(np.where(problem.diagonal > 0.0, problem.diagonal, problem.residual_scale))
        if sp.issparse(problem.M):
            inverse = sp.diags_array(1.0 / weight)
            A = (inverse @ problem.csr @ inverse).tocsr()
        else:
            A = problem.M / weight[:, None] / weight
        unit = _unit(problem, weight)
        c = problem.q / weight / unit
        return cls(
            problem,
            weight,
            unit,
            A,
            c,
            weight * problem.lower / unit,
            weight * problem.upper / unit,
        )

    def answer(self, y: FloatVector) -> FloatVector:
        """Return z of y, moved onto the bounds that it violates by rounding."""
        problem = self.problem
        z: FloatVector = np.clip(y * self.unit / self.weight, problem.lower, problem.upper)
        return z


def _unit(problem: LCP, weight: FloatVector) -> float:
    """Return the size of D^½ r(z°), else of the data, else 1."""
    z = problem.nearest_to_zero
    residual = scaled_residual(problem, z, problem.slack(z), weight * weight)
    sizes = (
        float(np.max(np.abs(v), initial=0.0))
        for v in (weight * residual, problem.q / weight, weight * z)
    )
    return next((size for size in sizes if 0.0 < size < np.inf), 1.0)


def accuracy(certificate: Certificate) -> float:
    """Return the relative residual, or the square of the term residual where that is larger, as SOLVED compares them.

    Where z° is the answer nothing is relative to it: each r_i beside the larger of |z_i| and |w_i|/d_i.
    """
    problem, z, w = certificate.problem, certificate.z, certificate.w
    if reference_residual(problem) > 0.0:
        return max(certificate.relative_residual, certificate.term_residual**2)
    residual = np.abs(scaled_residual(problem, z, w))
    beside = np.maximum(np.abs(z), np.abs(w) / problem.residual_scale)
    return float(
        np.divide(residual, beside, out=np.zeros(z.size), where=residual > 0.0).max(initial=0.0)
    )


# --- Is there a convex program? -----------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Formulation:
    """Which convex program the problem is, and the evidence.

    Attributes
    ----------
    kind : str or None
        ``"quadratic program"``, ``"gap quadratic program"``, or None where there is no convex program.
    evidence : str
        Why, in one line.
    shift : float
        What was added to the diagonal, which is at most 1, before the factorisation that proved semidefiniteness.
    """

    kind: str | None
    evidence: str
    scaled: Equilibrated = field(repr=False)
    shift: float = 0.0

    @classmethod
    def of(cls, problem: LCP) -> Formulation:
        """Return the formulation that symmetry and a factorisation of the symmetric part allow."""
        scaled = Equilibrated.of(problem)
        place = asymmetry_of(scaled.A)[1]
        if place is None:
            matrix = "M is symmetric"
        else:
            i, j = place
            matrix = (
                f"M is not symmetric (M[{i}, {j}] and M[{j}, {i}] differ); its symmetric part is"
            )
        negative = np.flatnonzero(problem.diagonal < 0.0)
        if negative.size:
            i = int(negative[0])
            return cls(None, f"{matrix} indefinite: M[{i}, {i}] = {problem.diagonal[i]:g}", scaled)
        # Entries of A above 1 are skew ones: their rounding stays behind when the symmetric part cancels them.
        shift = 4.0 * (problem.n + 2) * EPSILON * max(1.0, float(abs(scaled.A).max()))
        if factorised(symmetric_part(scaled.A), shift) is None:
            return cls(
                None,
                f"{matrix} indefinite: a pivot is negative at shift {shift:.1e}",
                scaled,
                shift,
            )
        kind = PLAIN if place is None else GAP
        return cls(
            kind, f"{matrix} positive semidefinite: factorised at shift {shift:.1e}", scaled, shift
        )


# --- Asking a convex solver ---------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class ReferenceRun:
    """What one reference gave: its certificate on the caller's data (None: no answer), seconds, and a note."""

    name: str
    certificate: Certificate | None = field(repr=False)
    seconds: float
    note: str = ""

    @property
    def residual(self) -> float:
        """The relative residual; ∞ where there is no answer."""
        found = np.inf if self.certificate is None else accuracy(self.certificate)
        return np.inf if np.isnan(found) else found

    @property
    def is_accurate(self) -> bool:
        """True where the relative residual is at most 1e-7."""
        return self.residual <= ACCURATE

    def __str__(self) -> str:
        said = "no answer" if self.certificate is None else f"relative residual {self.residual:.1e}"
        return f"{self.name}: {said}, {self.seconds:.2g} s" + (
            f" ({self.note})" if self.note else ""
        )


def attempts(
    formulation: Formulation, reference: str, max_seconds: float
) -> Iterator[ReferenceRun]:
    """Yield what the references give, one by one, the most accurate solver first; "auto" asks all that n permits."""
    for name, solver in SOLVERS.items():
        if reference == name or (
            reference == "auto" and formulation.scaled.problem.n <= solver.largest
        ):
            yield attempt(formulation, name, max_seconds)


def check_reference(reference: object) -> None:
    """Raise InvalidOption where there is no such reference."""
    if not isinstance(reference, str) or (reference != "auto" and reference not in SOLVERS):
        raise InvalidOption(
            f"unknown reference {reference!r}{did_you_mean(reference, ['auto', *SOLVERS])}"
        )


def attempt(formulation: Formulation, name: str, max_seconds: float) -> ReferenceRun:
    """Return what one reference gives; whatever goes wrong there becomes a note."""
    from cvxpy import installed_solvers

    began = time.perf_counter()
    scaled, solver = formulation.scaled, SOLVERS[name]
    if solver.name not in installed_solvers():
        return ReferenceRun(name, None, 0.0, "not installed")
    program = (quadratic_program if formulation.kind == PLAIN else gap_program)(scaled)
    limit = {solver.time_limit: max_seconds} if solver.time_limit else {}
    reply = asked(program, solver.name, verbose=False, **solver.options, **limit)
    # That an inexact answer may be inexact is what its certificate measures.
    notes = [line[:120] for line in reply.warnings if "inaccurate" not in line]
    if reply.status != "optimal":
        notes.insert(0, f"status {reply.status}"[:120])
    certificate = None
    if reply.x is not None:
        rough = Certificate.of(scaled.problem, scaled.answer(reply.x[: scaled.c.size]))
        certificate = polished(rough) if accuracy(rough) > 1e-12 else rough
        if certificate is not rough:
            notes.append(f"{accuracy(rough):.1e} before we solved the equations on its active set")
    return ReferenceRun(name, certificate, time.perf_counter() - began, "; ".join(notes))


def quadratic_program(scaled: Equilibrated) -> QuadraticProgram:
    """Return min ½ yᵀAy + cᵀy over the bounds, A symmetric positive semidefinite."""
    return QuadraticProgram(
        symmetric_part(scaled.A), scaled.c, lower=scaled.lower, upper=scaled.upper
    )


def gap_program(scaled: Equilibrated) -> QuadraticProgram:
    """Return the gap min yᵀ(Ay + c) − lᵀa + uᵀb with Ay + c = a − b, a ≥ 0, b ≥ 0, in the unknowns (y, a, b).

    a and b are there only where the bound is finite. The optimum is 0, where y solves the problem.
    """
    unit = sp.eye_array(scaled.c.size, format="csc")
    low, high = (np.flatnonzero(np.isfinite(bound)) for bound in (scaled.lower, scaled.upper))
    slacks = low.size + high.size
    return QuadraticProgram(
        sp.block_diag(
            [2.0 * sp.csc_array(symmetric_part(scaled.A)), sp.csc_array((slacks, slacks))],
            format="csc",
        ),
        np.concatenate([scaled.c, -scaled.lower[low], scaled.upper[high]]),
        A=sp.hstack([sp.csr_array(scaled.A), -unit[:, low], unit[:, high]], format="csr"),
        b=-scaled.c,
        lower=np.concatenate([scaled.lower, np.zeros(slacks)]),
        upper=np.concatenate([scaled.upper, np.full(slacks, np.inf)]),
    )


def polished(certificate: Certificate) -> Certificate:
    """Return the solution of the equations on the certificate's own active set, where that is better."""
    best = certificate
    for _ in range(POLISH_ROUNDS):
        z = _on_active_set(best)
        found = best if z is None else Certificate.of(best.problem, z)
        if not found.scaled_residual < best.scaled_residual:
            break
        best = found
    return best


def _on_active_set(certificate: Certificate) -> FloatVector | None:
    """Return z with the active rows on their bounds and w = 0 on the others; None where that is singular."""
    problem, step = certificate.problem, certificate.w / certificate.problem.residual_scale
    z = certificate.z.copy()
    at_lower, at_upper = z - problem.lower <= step, problem.upper - z <= -step
    z[at_lower], z[at_upper] = problem.lower[at_lower], problem.upper[at_upper]
    free = np.flatnonzero(~(at_lower | at_upper))
    if free.size == 0:
        return z
    factor = factorise(problem.csr[free][:, free])
    if factor is None:
        return None
    z[free] -= factor.solve(problem.slack(z)[free])
    return z if np.isfinite(z).all() else None
