"""The ranks of an MPI job, on mpi4py and petsc4py; the extra ``lcp_plugin[petsc]``."""

from __future__ import annotations

try:
    import petsc4py  # noqa: F401
    from mpi4py import MPI  # noqa: F401
except (ImportError, RuntimeError) as error:  # mpi4py without an MPI library raises the latter
    raise ImportError(
        f"several ranks need mpi4py and petsc4py ({error}); install them with pip install 'lcp_plugin[petsc]' as the "
        "examples/manual/many_machines.md describes"
    ) from None
