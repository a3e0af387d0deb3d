"""Doors by their old names to what several ranks share; the extra ``lcp_plugin[petsc]``.

A problem on ranks is an :class:`lcp_plugin.LCP`, made by its `from_rows`, `from_problem` or `load`.
"""

from __future__ import annotations

from os import PathLike
from typing import Any

from .errors import InvalidOption

try:
    import petsc4py  # noqa: F401
    from mpi4py import MPI
except (ImportError, RuntimeError) as error:  # mpi4py without an MPI library raises the latter
    raise InvalidOption(
        f"several ranks need mpi4py and petsc4py ({error}); install them with pip install 'lcp_plugin[petsc]' as the "
        "README's section on several machines describes"
    ) from None

from .certificates.error_bounds import error_bound
from .certificates.residuals import Certificate as DistributedCertificate
from .certificates.sweep_contraction import HPlusCertificate, h_plus_certificate
from .problem.lcp import LCP
from .solving.driver import solve

__all__ = [
    "DistributedCertificate",
    "DistributedLCP",
    "HPlusCertificate",
    "error_bound",
    "h_plus_certificate",
    "solve",
]


class DistributedLCP(LCP):
    """`LCP`; where no communicator is given, `load` too takes that of the whole job."""

    @classmethod
    def load(cls, path: str | PathLike[str], comm: Any = None) -> LCP:
        """Return the problem of a folder of chunks or a PETSc binary file, each rank reading its own part."""
        return LCP.load(path, MPI.COMM_WORLD if comm is None else comm)
