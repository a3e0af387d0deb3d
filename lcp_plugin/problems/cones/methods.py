"""Methods for complementarity over cones: block Gauss–Seidel, semismooth Newton, a fixed point over convex programs."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp

from ...core.algorithm import Algorithm, Step, check_positive
from ...core.checks import FloatVector
from ...core.errors import InvalidOption, UnsuitableProblem
from ...core.matrix.matrix import fact
from ...core.rounding import fresh_copies, read_only_views
from ...systems.factors import factor_fits, factorise
from .central_path import CentralPath
from .certificate import criterion_of, relative_residual
from .data import Blocks, closed_matrix

SWEEPS_A_STEP = 10
MEMORY = 5  # residuals that a step of Newton may rise to the largest of
SHORTEST = 14  # halvings of a step
DECREASE = 1e-4  # of the residual, times the length of the step
PATIENCE = 60  # steps of Newton without a residual that is so much smaller than the best before
GAIN = 0.9
PROGRAMS = 5  # convex ones without
NEAR, LAST_STEPS = (
    1e-5,
    30,
)  # the residual from where Newton's steps follow the central path, and how many do
MOST_STEPS, NO_GAIN = 80, 12  # of the central path, and those without a new best
PROXIMAL, LEAST_PROXIMAL = 1e-3, 1e-12  # of d, in the systems of Newton's steps
SPREAD = 1.0
ACCURATE = (
    1e-4  # what a factor may leave of the right-hand side: a system that leaves more is singular
)
EXACT = 2.0**-46  # the relative residual that a last linear system hardly makes smaller
HARDER, EASIER = (
    100.0,
    0.01,
)  # times the proximal term: of a singular system, and after a full step with no GAIN


@dataclass(frozen=True, kw_only=True)
class ConeAlgorithm(Algorithm):
    """A method whose problem has blocks."""

    is_for_cones: ClassVar[bool] = True


def _check_sweeps(method: Any) -> None:
    if isinstance(method.sweeps, bool) or not isinstance(method.sweeps, int) or method.sweeps < 1:
        raise InvalidOption(
            f"{method.name}: sweeps must be a whole number ≥ 1, got {method.sweeps!r}"
        )


@dataclass(frozen=True, kw_only=True)
class NPGS(ConeAlgorithm):
    """Nonsmooth block projected Gauss–Seidel: each block in turn is solved with the others as they are.

    A contact in space is solved exactly (open, stick, or the angle of sliding), any other cone by projections.

    Parameters
    ----------
    sweeps : int
        Sweeps a step.
    """

    name = "npgs"
    needs = "blocks on the diagonal that are positive definite"
    solves = (
        "cones without friction, M symmetric positive definite (descent by blocks); else observed"
    )
    cost = "one product with M a sweep"
    reference = "Jourdan, Alart, Jean 1998, doi:10.1016/S0045-7825(97)00137-1"
    is_monotone = False
    is_watched = True

    sweeps: int = SWEEPS_A_STEP

    def __post_init__(self) -> None:
        _check_sweeps(self)

    def iterates(self, problem: Any, z0: FloatVector) -> Iterator[Step]:
        """Yield the start, then a step every few sweeps."""
        from .kernels import sweep

        z, M = z0, closed_matrix(problem)
        diagonal, steps = diagonal_blocks(problem)
        yield Step(z, residual=relative_residual(problem, z))
        while True:
            moved = sweep(
                *problem.arrays,
                M.indptr,
                M.indices,
                M.data,
                problem.q,
                diagonal,
                steps,
                z,
                self.sweeps,
            )
            yield Step(
                z,
                residual=relative_residual(problem, z),
                increment=float(moved),
                work=self.sweeps + 1.0,
            )


@dataclass(frozen=True, kw_only=True)
class Newton(ConeAlgorithm):
    """Semismooth Newton on the natural map R(z) = z − P(z − ŵ/d), with a nonmonotone line search on ‖R‖₂.

    A step solves (R_z + R_w (M + ε D)) s = −R, D = diag(d): the proximal ε keeps the system regular where several
    impulses make the same motion, and falls with the residual. Open contacts, and rows at bounds, leave the system.

    Parameters
    ----------
    proximal : float
        ε at the most; a tenth of the relative residual later on.
    seed : int
        With one > 0 the start is moved at random, by SPREAD times the mean of its |z_i|: the same for the same seed.
    """

    name = "newton"
    needs = "a factor that fits"
    solves = "locally, where the generalised derivatives are regular"
    cost = "one factor of the blocks that are not open"
    reference = "Alart, Curnier 1991, doi:10.1016/0045-7825(91)90022-X"
    is_monotone = False

    proximal: float = PROXIMAL
    seed: int = 0

    def __post_init__(self) -> None:
        check_positive(self, "proximal")
        if isinstance(self.seed, bool) or not isinstance(self.seed, int) or self.seed < 0:
            raise InvalidOption(f"newton: seed must be a whole number ≥ 0, got {self.seed!r}")

    def iterates(self, problem: Any, z0: FloatVector) -> Iterator[Step]:
        """Yield the start, then a step a system; end where none gains any more."""
        z = z0
        if self.seed:
            spread = SPREAD * float(np.abs(z).mean())
            z = problem.projected(
                z + spread * np.random.default_rng(self.seed).standard_normal(z.size)
            )
        system = NewtonSystem(problem)
        w, R, largest, size = system.measured(z)
        sizes, best, since, most = [size], size, 0, self.proximal
        yield Step(z, residual=largest)
        while since < PATIENCE and math.isfinite(size):
            proximal = max(min(most, 0.1 * largest), LEAST_PROXIMAL)
            work, step = system.step(z, w, R, proximal)
            if step is None:
                return
            length, allowed = 1.0, max(sizes[-MEMORY:])
            for _ in range(SHORTEST):
                new = z + length * step
                w, R, largest, size = system.measured(new)
                work += 1.0
                if size <= (1.0 - DECREASE * length) * allowed:
                    break
                length *= 0.5
            if length < 1.0 or size >= sizes[-1]:
                most = self.proximal
            elif size > GAIN * sizes[-1]:
                most = EASIER * proximal  # the term itself keeps the step short
            z = new
            sizes.append(size)
            best, since = (size, 0) if size < GAIN * best else (best, since + 1)
            yield Step(z, residual=largest, work=work)


class NewtonSystem:
    """The systems of Newton's steps on one matrix."""

    def __init__(self, problem: Blocks) -> None:
        self.problem, self.M = problem, closed_matrix(problem)
        m, k = int(problem.sizes.max(initial=1)), problem.slope.size
        self.by_z, self.by_w = np.empty((k, m, m)), np.empty((k, m, m))
        self.entries, self.indices = (
            np.empty(self.M.nnz),
            np.empty(self.M.nnz, self.M.indices.dtype),
        )
        self.known = (
            *problem.arrays,
            self.M.indptr,
            self.M.indices,
            self.M.data,
            *read_only_views(problem.q),
            *fresh_copies(problem.scale, criterion_of(problem).weights),
        )

    def measured(self, z: FloatVector) -> tuple[FloatVector, FloatVector, float, float]:
        """Return w, R, the largest ‖R_k‖ beside its reference, and their Euclidean norm."""
        from .kernels import measured

        w, R = np.empty(z.size), np.empty(z.size)
        return w, R, *measured(*self.known, *fresh_copies(z), w, R)

    def step(
        self, z: FloatVector, w: FloatVector, R: FloatVector, proximal: float
    ) -> tuple[float, FloatVector | None]:
        """Return the work in products with M, and the step; None where every system is singular."""
        problem, work, epsilon = self.problem, 1.0, proximal
        while epsilon <= 1.0:
            J, rows = self.rows(z, w, epsilon)
            if not factor_fits(J):
                return work, None
            held = -R  # open blocks: z_k + s_k is the apex, or the bound
            held[rows] = 0.0
            by_held = self.times(self.M @ held) if held.any() else held
            factor = factorise(J, has_symmetric_pattern=True)
            if factor is not None:
                right = (-R - by_held)[rows]
                found = factor.solve(right)
                work += (factor.work + factor.solve_work) / max(problem.nonzeros, 1)
                left = float(np.abs(right - J @ found).max(initial=0.0))
                if left <= ACCURATE * float(np.abs(right).max(initial=0.0)):
                    held[rows] = found
                    return work, held
            epsilon = max(HARDER * epsilon, LEAST_PROXIMAL)
        return work, None

    def rows(self, z: FloatVector, w: FloatVector, proximal: float) -> tuple[Any, Any]:
        """Return R_z + R_w (M + ε D) of the rows that are not open, as CSR, and which these are."""
        from .kernels import derivatives, newton_rows

        problem, M = self.problem, self.M
        derivatives(*problem.arrays, *fresh_copies(z, w, problem.scale), self.by_z, self.by_w)
        is_free: Any = self.by_w.any(axis=(1, 2))
        rows = np.flatnonzero(is_free[problem.block_of_row])
        place, indptr = np.full(problem.n, -1), np.empty(rows.size + 1, M.indptr.dtype)
        place[rows] = np.arange(rows.size)
        newton_rows(
            problem.starts,
            self.by_z,
            self.by_w,
            *self.known[5:8],
            proximal * problem.scale,
            place,
            indptr,
            self.indices,
            self.entries,
        )
        entries, indices = self.entries[: indptr[-1]], self.indices[: indptr[-1]]
        return sp.csr_array((entries, indices, indptr), shape=(rows.size, rows.size)), rows

    def times(self, v: FloatVector, *, transposed: bool = False) -> FloatVector:
        """Return R_w v, or R_wᵀ v, at the point of the latest rows."""
        from .kernels import block_products

        found = np.empty(v.size)
        block_products(self.problem.starts, self.by_w, transposed, *read_only_views(v), found)
        return found


@dataclass(frozen=True, kw_only=True)
class FixedPoint(ConeAlgorithm):
    """A fixed point over convex programs: with s = μ‖w_T‖ held, min ½ zᵀM z + (q + s e_N)ᵀz over K, then s anew.

    Each program goes to Clarabel, an interior point on cones. Of an M that is not symmetric its symmetric part is
    taken, and the rest of M z is held as s is. Without friction, and for symmetric M, one program is the answer.
    """

    name = "fixed_point"
    needs = "a symmetric part of M that is positive semidefinite"
    solves = "cones without friction, M symmetric positive semidefinite"
    cost = "one conic program, some ten to thirty factors"
    reference = "Acary, Cadoux, Lemaréchal, Malick 2011, doi:10.1002/zamm.201000073"
    is_monotone = False

    def iterates(self, problem: Any, z0: FloatVector) -> Iterator[Step]:
        """Yield the start, then a step a program until five gain nothing, then Newton's from the best."""
        engine = ConvexProgram(problem)
        z, best, least, since = z0, z0, relative_residual(problem, z0), 0
        yield Step(z, residual=least)
        while since < PROGRAMS and (found := engine.minimised(z)) is not None:
            z, residual = found, relative_residual(problem, found)
            best, least, since = (
                (z, residual, 0) if residual < GAIN * least else (best, least, since + 1)
            )
            yield Step(z, residual=residual, work=20.0)
            if engine.is_final:
                return
        yield from islice(Newton().iterates(problem, best), LAST_STEPS)


class ConvexProgram:
    """The convex programs of one problem over cones, as Clarabel takes them."""

    def __init__(self, problem: Blocks) -> None:
        try:
            import clarabel
        except ImportError as error:  # pragma: no cover - cvxpy installs it
            raise UnsuitableProblem(
                "fixed_point needs Clarabel; install it with: pip install clarabel"
            ) from error
        self.problem, self.clarabel = problem, clarabel
        M = sp.csc_array(problem.rows.csr)
        self.symmetric = sp.csc_array(0.5 * (M + M.T))
        self.rest = sp.csr_array(M - self.symmetric)
        rows, limits, cones = conic_rows(problem, clarabel)
        self.rows, self.limits, self.cones = sp.csc_array(rows), limits, cones
        self.upper_half = sp.csc_array(sp.triu(self.symmetric))

    @property
    def is_final(self) -> bool:
        """Whether nothing is held: another program would be the same."""
        return not (self.problem.has_friction or self.rest.count_nonzero())

    def minimised(self, z: FloatVector) -> FloatVector | None:
        """Return the minimiser where what depends on z is held; None where there is none."""
        problem = self.problem
        q = problem.q + self.rest @ z
        if problem.has_friction:
            w = problem.slack(z)
            w[problem.starts[:-1]] = 0.0
            q[problem.starts[:-1]] += problem.slope * problem.norms(w)
        found = self.solve(self.upper_half, q, self.rows, self.limits, self.cones)
        z = np.asarray(found.x)
        return problem.projected(z) if z.size == problem.n and np.isfinite(z).all() else None

    def solve(self, P: Any, c: FloatVector, A: Any, b: FloatVector, cones: list[Any]) -> Any:
        """Return what Clarabel makes of min ½ zᵀP z + cᵀz over b − A z ∈ cones."""
        settings = self.clarabel.DefaultSettings()
        settings.verbose = False
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-12
        return self.clarabel.DefaultSolver(
            sp.csc_matrix(P), c, sp.csc_matrix(A), b, cones, settings
        ).solve()


def conic_rows(problem: Blocks, clarabel: Any) -> tuple[Any, FloatVector, list[Any]]:
    """Return A, b and cones such that z ∈ K says b − A z ∈ cones."""
    rows: list[Any] = []
    limits: list[FloatVector] = []
    cones: list[Any] = []
    identity = sp.eye_array(problem.n, format="csr")
    single = np.flatnonzero(problem.sizes == 1)
    single = problem.starts[:-1][single]
    for sign, bound in ((-1.0, problem.lower), (1.0, problem.upper)):
        has = single[np.isfinite(bound[single])]
        if has.size:
            rows.append(sign * identity[has])
            limits.append(sign * bound[has])
            cones.append(clarabel.NonnegativeConeT(has.size))
    slopes = np.ones(problem.n)
    slopes[problem.starts[:-1]] = np.where(problem.sizes > 1, problem.slope, 1.0)
    for k in np.flatnonzero(problem.sizes > 1):
        first, end = int(problem.starts[k]), int(problem.starts[k + 1])
        if problem.slope[k] > 0.0:
            rows.append(-sp.diags_array(slopes[first:end]) @ identity[first:end])
            cones.append(clarabel.SecondOrderConeT(end - first))
        else:
            rows.append(-identity[first:end])
            cones += [clarabel.NonnegativeConeT(1), clarabel.ZeroConeT(end - first - 1)]
        limits.append(np.zeros(end - first))
    if not rows:
        return sp.csr_array((0, problem.n)), np.zeros(0), []
    return sp.vstack(rows), np.concatenate(limits), cones


@dataclass(frozen=True, kw_only=True)
class InteriorPoint(ConeAlgorithm):
    """Primal–dual interior point on De Saxcé's cones, scaled after Nesterov and Todd; Newton's steps end it."""

    name = "interior_point"
    needs = "contacts with friction, and a factor that fits"
    solves = "observed: also where many contacts make the same motion"
    cost = "one factor of all blocks a step, some 15 to 40 of them"
    reference = "Acary, Armand, Nguyen, Shpakovych 2024, doi:10.1080/10556788.2023.2296438"
    is_monotone = False

    def iterates(self, problem: Any, z0: FloatVector) -> Iterator[Step]:
        """Yield the start, then a step a factor, then Newton's steps from the best point."""
        if not problem.has_friction:
            raise UnsuitableProblem(
                'interior_point takes contacts with friction; try algorithm="fixed_point"'
            )
        best, residual, since = z0, math.inf, 0
        yield Step(z0, residual=relative_residual(problem, z0))
        path = CentralPath(problem, closed_matrix(problem))
        for _ in range(MOST_STEPS):
            work = path.step()
            if work is None or residual <= NEAR or since > NO_GAIN:
                break
            z = path.point
            new = relative_residual(problem, z)
            best, residual, since = (z, new, 0) if new < residual else (best, residual, since + 1)
            yield Step(z, residual=new, work=work)
        yield from islice(Newton().iterates(problem, best), LAST_STEPS)


METHODS: dict[str, type[ConeAlgorithm]] = {
    one.name: one for one in (NPGS, Newton, InteriorPoint, FixedPoint)
}


@fact
def diagonal_blocks(problem: Blocks) -> tuple[Any, FloatVector]:
    """Return the blocks M_kk, shape (k, m, m), and 1/‖M_kk‖ of each, shape (k,)."""
    M, of_row = sp.coo_array(problem.rows.csr), problem.block_of_row
    inside = of_row[M.row] == of_row[M.col]
    row, column, block = M.row[inside], M.col[inside], of_row[M.row[inside]]
    m = int(problem.sizes.max(initial=1))
    blocks = np.zeros((problem.slope.size, m, m))
    blocks[block, row - problem.starts[block], column - problem.starts[block]] = M.data[inside]
    with np.errstate(all="ignore"):
        sizes = np.sqrt((blocks**2).sum(axis=(1, 2)))
    return blocks, np.where(sizes > 0.0, 1.0 / np.where(sizes > 0.0, sizes, 1.0), 0.0)
