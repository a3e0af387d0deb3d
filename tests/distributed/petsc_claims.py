"""Claims about problems of PETSc matrices; every rank runs them, and rank 0 prints the name of each one that holds."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

with suppress(ImportError):
    import dolfinx_solver  # noqa: F401  (finds the library of petsc4py)
import numpy as np
import pytest
import scipy.sparse as sp
from petsc4py import PETSc

from lcp_plugin import LCP, InvalidProblem, Status, certify, gallery

COMM = PETSc.COMM_WORLD


def on_petsc(M: Any, q: Any, lower: Any = 0.0, upper: Any = np.inf) -> Any:
    """Return the problem of a matrix that every rank has, as a user of PETSc states it."""
    M, n = sp.csr_array(M), len(q)
    first, last = n * COMM.rank // COMM.size, n * (COMM.rank + 1) // COMM.size
    own, sizes = M[first:last], ((last - first, n), (last - first, n))
    A = PETSc.Mat().createAIJ(sizes, csr=(own.indptr, own.indices, own.data), comm=COMM)

    def vector(values: Any) -> Any:
        vector = A.createVecRight()
        vector.setArray(np.broadcast_to(values, n)[first:last])
        return vector

    return LCP.from_petsc(A, vector(q), lower=vector(lower), upper=vector(upper))


def positive_definite(seed: int, n: int = 60) -> LCP:
    """Return a nonsymmetric problem with a positive definite symmetric part and a large skew part."""
    random = np.random.default_rng(seed)
    B, K = random.normal(size=(2, n, n))
    return LCP(B @ B.T / n + 0.1 * np.eye(n) + 3.0 * (K - K.T), random.normal(size=n))


def saddle(n: int = 400, m: int = 20) -> LCP:
    """Return the conditions of min xᵀP x/2 + cᵀx with G x ≤ h, x free: no positive diagonal."""
    random = np.random.default_rng(1)
    P = sp.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(n, n))
    G = sp.random_array((m, n), density=0.1, rng=random, data_sampler=random.normal)
    M = sp.block_array([[P, G.T], [-G, None]], format="csr")
    q = np.r_[random.normal(size=n), random.uniform(0.1, 1.0, m)]
    return LCP(M, q, lower=np.r_[np.full(n, -np.inf), np.zeros(m)])


def the_obstacle_is_solved_as_without_petsc() -> None:
    """The methods on ranks solve it; vectors come as Vec, and `certify` measures any of them."""
    plain = gallery.build("obstacle_2d", size=40).problem
    problem = on_petsc(plain.csr, plain.q, plain.lower, plain.upper)
    result = problem.solve()
    assert (result.status, result.algorithm) == (Status.SOLVED, "multigrid")
    assert isinstance(result.z, PETSc.Vec)
    assert certify(problem, result.z).verdict == "proved"
    assert problem.solve(z0=result.z).iterations <= 1
    result.z.shift(0.1)
    assert certify(problem, result.z).verdict == "disproved"
    assert problem.with_q(result.z).solve().is_solved
    assert problem.solve("petsc").is_solved


def random_positive_definite_matrices_are_solved() -> None:
    """Multigrid and sweeps fail on them; the method of PETSc's solvers is next."""
    for seed in range(12):
        plain = positive_definite(seed)
        result = on_petsc(plain.M, plain.q).solve()
        assert result.is_solved, (seed, result)
        assert result.algorithm.endswith("petsc"), result.algorithm


def a_saddle_point_and_cyclic_matrices_are_solved() -> None:
    """A saddle point has no positive diagonal; on cyclic P-matrices sweeps and block steps run in a circle."""
    cyclic = np.eye(3) + 2.0 * np.roll(np.eye(3), 1, axis=0)
    many = sp.block_diag([sp.csr_array(cyclic)] * 10, format="csr")
    for plain in (saddle(), LCP(cyclic, -np.ones(3)), LCP(many, -np.ones(30))):
        result = on_petsc(plain.csr, plain.q, plain.lower, plain.upper).solve()
        assert result.is_solved, result


def another_matrix_is_refused() -> None:
    """The message names what is needed."""
    with pytest.raises(InvalidProblem, match="Mat of petsc4py"):
        LCP.from_petsc(np.eye(3), np.zeros(3))


if __name__ == "__main__":
    for claim in (
        the_obstacle_is_solved_as_without_petsc,
        random_positive_definite_matrices_are_solved,
        a_saddle_point_and_cyclic_matrices_are_solved,
        another_matrix_is_refused,
    ):
        claim()
        PETSc.Sys.Print(claim.__name__)
