"""Doors by their old names to what several ranks share; the extra ``lcp_plugin[petsc]``.

A problem on ranks is an :class:`lcp_plugin.LCP`, made by its `from_rows`, `from_problem` or `load`.
"""

from __future__ import annotations

from os import PathLike
from typing import Any

from .certificates.error_bounds import error_bound
from .certificates.residuals import Certificate as DistributedCertificate
from .peers.ranks.collective import as_mpi
from .problem.lcp import LCP
from .solving.driver import solve

__all__ = [
    "DistributedCertificate",
    "DistributedLCP",
    "error_bound",
    "solve",
]


class DistributedLCP(LCP):
    """`LCP`; where no communicator is given, `load` too takes that of the whole job."""

    @classmethod
    def load(cls, path: str | PathLike[str], comm: Any = None) -> LCP:
        """Return the problem of a folder of chunks or a PETSc binary file, each rank reading its own part."""
        return LCP.load(path, as_mpi(comm))
