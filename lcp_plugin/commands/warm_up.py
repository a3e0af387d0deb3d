"""What `lcp-plugin warm-up` does: compile every kernel once, so that no later run has to."""

from __future__ import annotations

import time

from ..problem.lcp import LCP


def warm_up() -> str:
    """Compile whatever is not in the cache yet; return a line that says where it lies and what it took."""
    from ..algorithms import REGISTRY, create
    from ..algorithms.rehearsal import rehearse
    from ..certificates.error_bounds import error_bound
    from ..evidence import gallery
    from ..kernels.compilation import cache_folder
    from ..solving.driver import solve

    began = time.perf_counter()
    scene = gallery.build("obstacle_2d", size=20)
    for name in REGISTRY:
        rehearse(create(name, {}), scene.problem)
    dense = LCP(scene.problem.csr[:9, :9].toarray(), scene.problem.q[:9], lower=-1.0, upper=1.0)
    for problem in (scene.problem, dense):
        for name in ("multigrid", "lemke", "newton", "auto"):
            error_bound(problem, solve(problem, name).z)
    return f"kernels compiled in {time.perf_counter() - began:.1f} s; they lie in {cache_folder()}"
