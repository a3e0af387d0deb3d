"""stability_atlas(): each algorithm on stiff and extreme problems, compared with exact solutions."""

from __future__ import annotations

import math
import warnings
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields
from itertools import product
from os import PathLike
from typing import Any

import numpy as np

from ..algorithms import REGISTRY
from ..api import solve
from ..core.algorithm import Algorithm
from ..core.errors import InvalidOption, UnsuitableMatrix, UnsuitableProblem, did_you_mean
from ..interfaces.files import checked_path, write_whole
from .measurement import Method, methods_of
from .stresses import FAMILIES, StressCase, relative_error
from .study import csv_text

Progress = Callable[[int, int, str], Any]


@dataclass(frozen=True)
class Cell:
    """Result of one algorithm on one difficult problem.

    Attributes
    ----------
    algorithm : str
    stress, family : str
        Extreme property, with its number; the family of stresses.
    status : str
        A status of `solve`. REFUSED if the algorithm does not take this problem. ERROR if the run raised anything
        else, including a warning of overflow.
    residual : float
        Relative residual of z; NaN if z does not exist.
    true_error : float
        ‖z − z*‖∞ / ‖z*‖∞ in the units of the problem, z* exact; NaN if z or a unique z* does not exist.
    note : str
        Message of the error.
    """

    algorithm: str
    stress: str
    family: str
    status: str
    residual: float = math.nan
    true_error: float = math.nan
    note: str = ""

    def __str__(self) -> str:
        note = f"; {self.note}" if self.note else ""
        return (
            f"{self.status:<16} {self.algorithm:<15} {self.stress:<38} "
            f"residual {self.residual:.0e}, error {self.true_error:.0e}{note}"
        )


@dataclass(frozen=True)
class Atlas:
    """Status, residual and true error of each algorithm on each difficult problem.

    Attributes
    ----------
    cells : tuple of Cell
        One per algorithm and stress.
    """

    cells: tuple[Cell, ...]

    @property
    def unsolved(self) -> tuple[Cell, ...]:
        """The cells with any status but SOLVED."""
        return tuple(cell for cell in self.cells if cell.status != "SOLVED")

    @property
    def misleading(self) -> tuple[Cell, ...]:
        """The cells that are SOLVED with an error of more than a thousandth, because M is ill-conditioned."""
        return tuple(
            cell for cell in self.cells if cell.status == "SOLVED" and cell.true_error > 1e-3
        )

    def explain(self) -> str:
        """Return the counts, then a line for each cell that is not SOLVED, and for each misleading one."""
        counts = Counter(cell.status for cell in self.cells).most_common()
        told = ", ".join(f"{count} {status}" for status, count in counts)
        lines = [f"{len(self.cells)} cells: {told}", *map(str, self.unsolved)]
        lines += [f"a small residual hides the error: {cell}" for cell in self.misleading]
        return "\n".join(lines)

    def __str__(self) -> str:
        return self.explain()

    def save(self, path: str | PathLike[str]) -> None:
        """Write a .csv file with a line per cell."""
        place = checked_path(path)
        if place.suffix.lower() != ".csv":
            raise InvalidOption(f"an atlas is saved as .csv, got {place.name!r}")
        names = [field.name for field in fields(Cell)]
        rows = ([getattr(cell, name) for name in names] for cell in self.cells)
        write_whole({place: lambda file: file.write(csv_text([names, *rows]).encode("utf-8"))})


def stability_atlas(
    algorithms: Iterable[str | Algorithm] | None = None,
    stresses: Iterable[str] | None = None,
    *,
    quick: bool = False,
    progress: Progress | None = None,
) -> Atlas:
    """Return status, residual and true error of each algorithm on each kind of difficult data.

    Parameters
    ----------
    algorithms : iterable of str and Algorithm, optional
        As the methods of :func:`lcp_plugin.evidence.study.study`; all registered names and "auto" by default.
    stresses : iterable of str, optional
        Families: "stiffness", "scaling", "singularity", "degeneracy", "far starts", "sizes", "number range" and
        "cancellation". All by default.
    quick : bool
        Fewer iterations, without the problem of 10 000 unknowns.
    progress : callable, optional
        Called as ``progress(done, total, label)`` after every cell.

    Returns
    -------
    Atlas
        Table, the same for the same call, because no clock is read.

    Raises
    ------
    UnknownAlgorithm, InvalidOption
        If a name does not exist.

    Notes
    -----
    Within a run every warning of NumPy is an error, so that no overflow is silent.

    Examples
    --------
    >>> atlas = stability_atlas(["psor"], ["far starts"])
    >>> [cell.status for cell in atlas.cells]
    ['SOLVED', 'SOLVED', 'SOLVED']
    """
    if progress is not None and not callable(progress):
        raise InvalidOption(
            f"progress must be callable as progress(done, total, label), got {progress!r}"
        )
    entrants = methods_of(["auto", *REGISTRY] if algorithms is None else algorithms)
    if not isinstance(stresses, list | tuple | None):
        raise InvalidOption(f"stresses must be a list of names, got {stresses!r}")
    families = [*FAMILIES] if stresses is None else [*stresses]
    for name in families:
        if not isinstance(name, str) or name not in FAMILIES:
            raise InvalidOption(f"unknown stress {name!r}{did_you_mean(str(name), FAMILIES)}")
    cases = [(family, case) for family in families for case in FAMILIES[family]()]
    if quick:
        cases = [(family, case) for family, case in cases if case.problem.n <= 2500]
    cells: list[Cell] = []
    for (family, case), one in product(cases, entrants):
        cells.append(_cell(family, case, one, 5_000 if quick else 50_000))
        if progress is not None:
            progress(len(cells), len(cases) * len(entrants), f"{case.stress}: {one.label}")
    return Atlas(tuple(cells))


def _cell(family: str, case: StressCase, one: Method, limit: int) -> Cell:
    head = (one.label, case.stress, family)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            result = solve(case.problem, one.algorithm, z0=case.start, max_iterations=limit)
    except (UnsuitableMatrix, UnsuitableProblem) as refusal:
        return Cell(*head, "REFUSED", note=str(refusal))
    except Exception as failure:  # the atlas shows every exception of a run
        return Cell(*head, "ERROR", note=f"{type(failure).__name__}: {failure}")
    error = math.nan
    if case.exact is not None and np.isfinite(result.z).all():
        error = relative_error(result.z, case.exact, case.unit)
    return Cell(*head, result.status.name, result.certificate.relative_residual, error)
