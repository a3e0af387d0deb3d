"""Processor time of `LCP.from_petsc` and of PETSc's SNESVI with GAMG on obstacle problems of 257² nodes.

python tests/distributed/petsc_times.py, on one rank
"""

from __future__ import annotations

import time
from typing import Any

from petsc_claims import PETSc, np, on_petsc, sp

from lcp_plugin import LCP, certify

m = 257
line = sp.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(m, m))
upwind = sp.diags_array([-0.3, 0.3], offsets=[-1, 0], shape=(m, m))
grid = sp.kron(line, sp.eye_array(m)) + sp.kron(sp.eye_array(m), line)
x, y = np.indices((m, m)).reshape(2, -1) / (m + 1) - 0.5
cases = {
    "bump": (grid, 1.0, 0.2 - 3.0 * (x**2 + y**2)),
    "flat": (grid, 8.0, -0.1),
    "flat, with convection": (grid + sp.kron(upwind, sp.eye_array(m)), 8.0, -0.1),
}


def by_petsc(problem: Any, q: Any, bounds: Any) -> Any:
    """Return the point of SNESVI in the reduced space, from 0."""
    A, snes, z = problem.A, PETSc.SNES().create(), q.duplicate()

    def residual(snes: Any, z: Any, out: Any) -> None:
        A.mult(z, out)
        out.axpy(1.0, q)

    snes.setType("vinewtonrsls")
    snes.setFunction(residual, q.duplicate())
    snes.setJacobian(lambda *_: None, A)
    snes.setVariableBounds(*bounds)
    snes.setTolerances(rtol=1e-9, atol=0.0, max_it=400)
    snes.ksp.setType("gmres")
    snes.ksp.pc.setType("gamg")
    snes.ksp.setTolerances(rtol=1e-6)
    snes.solve(None, z)
    return z


for name, (M, load, lower) in cases.items():
    problem = on_petsc(M, np.full(m * m, load / (m + 1) ** 2), lower)
    vectors = [
        problem.vector(one) for one in (problem.q, problem.lower, np.full(problem.own, 1e30))
    ]
    q, *bounds = vectors
    problem.solve()  # compiles
    begun = time.process_time()
    z = LCP.from_petsc(problem.A, q, lower=bounds[0]).solve().z
    half = time.process_time()
    other = by_petsc(problem, q, bounds)
    seconds, others = half - begun, time.process_time() - half
    verdicts = [certify(problem, point, tolerance=1e-8).verdict for point in (z, other)]
    print(f"{name}: from_petsc {seconds:.1f} s, SNESVI {others:.1f} s,", *verdicts)
