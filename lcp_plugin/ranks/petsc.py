"""LCPs of PETSc's matrices and vectors: the data of the ranks, and Newton steps by PETSc's linear solvers.

Only a Newton step imports petsc4py, which the matrix of the caller has loaded already.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp

from ..core.checks import AnyMatrix, Array, Vector
from ..core.errors import InvalidProblem
from ..methods.newton import LinearizedPhi, fischer_burmeister
from .methods import Iterates
from .problem import RowsOnRanks
from .solving import ResultOnRanks

ACCURACY, MOST_STEPS = 1e-9, 200  # of GMRES
LEAST_FALL, SHORTEST_STEP = 1e-4, 1e-9  # of the squares, and length of a step


def newton(problem: Any, z: Vector) -> Iterates:
    """Yield points whose Fischer–Burmeister equations have ever smaller squares.

    A step on the free rows is taken if it reduces the squares, or else a part of Newton's step for the equations. If M
    is a P₀-matrix, for example positive semidefinite, no other point than a solution is stationary.
    """
    z = np.clip(np.where(np.isfinite(z), z, 0.0), problem.lower, problem.upper)
    following: Vector | None = z
    while following is not None:
        z = following
        yield np.clip(z, problem.lower, problem.upper), 2.0
        phi = fischer_burmeister(problem, z, problem.slack(z))
        following = searched(problem, z, phi, newton_step(problem, natural_map(problem, z)), 1.0)
        if following is None:
            following = searched(problem, z, phi, newton_step(problem, phi), SHORTEST_STEP)


def searched(
    problem: Any, z: Vector, phi: LinearizedPhi, step: Vector | None, shortest: float
) -> Vector | None:
    """Return the first of z + s, z + s/2, … with smaller squares of Φ; None if none of these steps reduces them."""
    squares, length = problem.halo.total(phi.norm**2), 1.0
    while step is not None and length >= shortest:
        new = z + length * step
        at_new = fischer_burmeister(problem, new, problem.slack(new))
        if problem.halo.total(at_new.norm**2) <= (1.0 - LEAST_FALL * length) * squares:
            return new
        length *= 0.5
    return None


def natural_map(problem: Any, z: Vector) -> LinearizedPhi:
    """Return z − mid(lower, upper, z − w/d), linearized: an unknown is at its bound, or its row is w_i = 0."""
    slack = problem.slack(z) / problem.residual_scale
    target = np.clip(z - slack, problem.lower, problem.upper)
    is_free = target == z - slack
    value = np.where(is_free, slack, z - target)
    return LinearizedPhi(value, (~is_free).astype(np.float64), is_free.astype(np.float64))


def newton_step(problem: Any, phi: LinearizedPhi) -> Vector | None:
    """Return the step s with (diag(by_z) + diag(by_w/d) M) s = −Φ; None if PETSc fails.

    Unknowns with by_w ≈ 0 are at bounds. The other rows, divided by by_w/d, are M plus a diagonal matrix.
    """
    from petsc4py import PETSc

    halo, A = problem.halo, problem.A
    is_free = phi.by_w > 1e-10 * phi.by_z  # an unknown at a bound
    step = np.where(is_free, 0.0, -phi.value / phi.by_z)
    count = halo.total(float(np.count_nonzero(is_free)))
    if not count:
        return step
    weight = phi.by_w / problem.residual_scale
    right = -phi.value / weight - problem.rows @ halo.whole(step)
    numbers = (np.flatnonzero(is_free) + halo.first).astype(PETSc.IntType)
    rows = PETSc.IS().createGeneral(numbers, comm=A.getComm())
    block = A.createSubMatrix(rows, rows)
    block.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
    vector, solution = block.createVecLeft(), block.createVecRight()
    vector.setArray((phi.by_z / weight)[is_free])
    block.setDiagonal(vector, PETSc.InsertMode.ADD_VALUES)
    vector.setArray(right[is_free])
    solver = PETSc.KSP().create(A.getComm())
    solver.setOperators(block)
    solver.setTolerances(rtol=ACCURACY, max_it=MOST_STEPS)
    kinds = [("preonly", "lu" if halo.size == 1 else "redundant")]
    if count > 20_000:  # more free rows are first solved by GMRES with multigrid
        kinds.insert(0, ("gmres", "gamg"))
    for krylov, preconditioner in kinds:
        solver.setType(krylov)
        solver.getPC().setType(preconditioner)
        solver.solve(vector, solution)
        if solver.getConvergedReason() > 0:
            break
    step[is_free] = solution.array_r
    for item in (solver, block, vector, solution, rows):
        item.destroy()
    return step if halo.everywhere(np.isfinite(step)) else None


class RowsOnPETSc(RowsOnRanks):
    """The LCP of a PETSc matrix on its communicator; z and w of a result are PETSc vectors.

    Build it by :meth:`lcp_plugin.LCP.from_petsc`. A must not change as long as the problem is in use.
    """

    A: AnyMatrix
    methods: ClassVar[dict[str, Any]] = {"petsc": newton}

    @classmethod
    def from_petsc(cls, A: Any, q: Any, lower: Array = 0.0, upper: Array = np.inf) -> RowsOnPETSc:
        """Return the problem of a PETSc matrix on its communicator.

        Parameters
        ----------
        A : petsc4py.PETSc.Mat
            Square, with equal parts of rows and columns. It must not change as long as the problem is in use.
        q : petsc4py.PETSc.Vec
        lower, upper : number or petsc4py.PETSc.Vec

        Raises
        ------
        InvalidProblem
            On every rank, if A is not such a matrix.
        """
        # The ranges of all ranks: each rank rejects the same matrices.
        if not hasattr(A, "getValuesCSR") or not np.array_equal(
            A.getOwnershipRanges(), A.getOwnershipRangesColumn()
        ):
            raise InvalidProblem(
                f"A must be a square Mat of petsc4py with equal parts of rows and columns, got {type(A).__name__}"
            )
        stored = A if "aij" in A.getType() else A.convert("aij", type(A)())
        indptr, indices, data = stored.getValuesCSR()
        rows = sp.csr_array((data, indices, indptr), shape=(indptr.size - 1, A.getSize()[1]))
        vectors = (_local_part(vector) for vector in (q, lower, upper))
        problem = cls.from_rows(A.getComm().tompi4py(), rows, *vectors)
        problem.A = stored
        return problem

    def with_q(self, q: Array) -> RowsOnPETSc:
        """Return the problem with another q, a Vec or its local part."""
        return self.from_petsc(self.A, q, self.lower, self.upper)

    def own_part(self, z: Array, name: str = "z", *, is_finite: bool = True) -> Vector:
        """Return the checked local part of a Vec or an array, shape (own,)."""
        return super().own_part(_local_part(z), name, is_finite=is_finite)

    def vector(self, values: Vector) -> Any:
        """Return a Vec with these local values."""
        vector = self.A.createVecRight()
        vector.setArray(values)
        return vector

    def solve(self, algorithm: str = "auto", **options: Any) -> ResultOnRanks:
        """Return the solution, z and w as PETSc vectors; see :func:`lcp_plugin.ranks.solving.solve_on_ranks`."""
        result = super().solve(algorithm, **options)
        return replace(result, z=self.vector(result.z), w=self.vector(result.w))


def _local_part(vector: object) -> Any:
    """Return the local values of a Vec, without its ghosts; other objects are returned unchanged."""
    return np.array(vector.array_r) if hasattr(vector, "array_r") else vector
