"""stability_atlas(): each algorithm × each stress, judged in rational arithmetic."""

from __future__ import annotations

import math
import warnings
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, fields
from itertools import product
from typing import Any, ClassVar

import numpy as np

from ..algorithms import REGISTRY
from ..api import solve
from ..core.algorithm import Algorithm
from ..core.errors import (
    InvalidOption,
    UnsuitableMatrix,
    UnsuitableProblem,
    did_you_mean,
)
from ..core.solving.result import Result
from .contestants import checked_names, contestants
from .drawing import draw_maps
from .exact_answers import lie_in, relative_error
from .exporting import Exported
from .stresses import FAMILIES, StressCase

Progress = Callable[[int, int, str], Any]

EPSILON = 2.0**-52
WELL_POSED = (
    1e-9  # condition × machine epsilon below this: double precision holds nine digits of the answer
)
MAX_ITERATIONS, MAX_ITERATIONS_QUICK = 50_000, 5_000
MISLEADING = 1e-3
REFUSED, ERROR = "REFUSED", "ERROR"
RANGES, PROVED = "ranges", "proved ranges"
WRONG, HIDDEN = "wrong but SOLVED", "z off by condition × residual"
OUTCOMES = {  # colour and sign
    "right": ("#DDEBF7", ""),
    "says that it failed": ("#BDBDBD", "–"),
    "refused": ("#FFFFFF", "/"),
    "raised an error": ("#7A7A7A", "!"),
    HIDDEN: ("#FDD49E", "≈"),
    WRONG: ("#B2182B", "✗"),
}


@dataclass(frozen=True)
class Cell:
    """One algorithm on one kind of difficult data.

    Attributes
    ----------
    algorithm : str
    stress, family : str
        What is extreme, with its number; the kind of stress that it belongs to.
    condition : float
        Of the answer, see `exact_answers.condition_of_answer`; ∞ where the answer is not unique or does not exist.
    status : str
        A status of `solve`; REFUSED where the algorithm says before the first step that it cannot run on this matrix;
        ERROR where the run raised anything else, a warning of overflow included.
    true_error : float
        ‖z − z*‖∞ / ‖z*‖∞ in the units of the case, z* exact; NaN where there is no z*, or no z.
    residual : float
        The relative residual of z.
    certified : bool or None
        Whether a rigorous, finite bound of the error came with the answer; None where nothing about M allows one.
    digits_lost : float
        log₁₀ of true_error over condition · max(residual, 2⁻⁵²), at least 0: what the residual hid. NaN where one of
        them is missing.
    told_the_truth : bool
        No lie, see `exact_answers.lie_in`.
    note : str
        What the lie is, or why the run was refused, or how far 1 ulp moves the answer.
    """

    algorithm: str
    stress: str
    family: str
    condition: float
    status: str
    true_error: float
    residual: float
    certified: bool | None
    digits_lost: float
    told_the_truth: bool
    note: str = ""

    @property
    def is_well_posed(self) -> bool:
        """True where condition × machine epsilon < 1e-9."""
        return self.condition * EPSILON < WELL_POSED

    @property
    def outcome(self) -> str:
        """One of `OUTCOMES`, the colours of a map."""
        if self.status in (REFUSED, ERROR):
            return "refused" if self.status == REFUSED else "raised an error"
        is_off = self.status == "SOLVED" and self.true_error > MISLEADING
        if not self.told_the_truth or (
            is_off and (self.family == PROVED or self.digits_lost >= 1.0)
        ):
            return WRONG
        return HIDDEN if is_off else "right" if self.status == "SOLVED" else "says that it failed"


@dataclass(frozen=True)
class Atlas(Exported):
    """How each algorithm coped with each kind of difficult data.

    Attributes
    ----------
    cells : tuple of Cell
        One for each algorithm and stress.
    skipped : tuple of (str, str)
        What was left out, and why.
    """

    columns: ClassVar = tuple(field.name for field in fields(Cell))

    cells: tuple[Cell, ...]
    skipped: tuple[tuple[str, str], ...] = ()

    @property
    def lies(self) -> tuple[Cell, ...]:
        """The cells that did not tell the truth."""
        return tuple(cell for cell in self.cells if not cell.told_the_truth)

    @property
    def unsolved(self) -> tuple[Cell, ...]:
        """The cells with any status but SOLVED."""
        return tuple(cell for cell in self.cells if cell.status != "SOLVED")

    @property
    def well_posed(self) -> tuple[Cell, ...]:
        """The cells whose condition × machine epsilon is < 1e-9."""
        return tuple(cell for cell in self.cells if cell.is_well_posed)

    @property
    def misleading(self) -> tuple[Cell, ...]:
        """The cells that are SOLVED, as the residual has it, with an error of more than a thousandth."""
        return tuple(
            cell for cell in self.cells if cell.status == "SOLVED" and cell.true_error > MISLEADING
        )

    @property
    def solved_share(self) -> float:
        """Share of SOLVED among the well-posed cells, refusals and errors included; 1 where there are none."""
        well_posed = self.well_posed
        return (
            sum(cell.status == "SOLVED" for cell in well_posed) / len(well_posed)
            if well_posed
            else 1.0
        )

    def summary(self) -> str:
        """Return the counts, then in plain lines every lie, every other cell that is not SOLVED, every hidden error."""
        counts = Counter(cell.status for cell in self.cells)
        lines = [
            f"{len(self.cells)} cells: "
            + ", ".join(f"{count} {status}" for status, count in counts.most_common()),
            f"{len(self.lies)} lies",
            f"{self.solved_share:.1%} of the {len(self.well_posed)} cells with condition × 2^-52 < 1e-9 are SOLVED",
        ]
        lines += [f"LIE {_line(cell)}" for cell in self.lies]
        lines += [_line(cell) for cell in self.unsolved if cell.told_the_truth]
        lines += [f"a small residual hides the error: {_line(cell)}" for cell in self.misleading]
        lines += [f"left out: {what}: {reason}" for what, reason in self.skipped]
        return "\n".join(lines)

    def plot(self, *, family: str = RANGES, width: float | None = None) -> Any:
        """Return a figure with a map a method, how far each kind of stiffness may go; `save` writes it into a file.

        Parameters
        ----------
        family : {"ranges", "proved ranges"}
            SOLVED by the residual, as `solve` does it, or by a proved error, ``tolerance_on="error"``.
        width : float, optional
            Of the figure, inches.
        """
        maps: dict[str, dict[tuple[str, str], str]] = {}
        for cell in self.cells:
            if cell.family == family:
                kind, _, extent = cell.stress.partition(" 1e")
                maps.setdefault(cell.algorithm, {})[kind, extent] = cell.outcome
        if not maps:
            raise InvalidOption(
                f'this atlas has no {family!r}; make it with stability_atlas(names, ["{family}"])'
            )
        title = "SOLVED by the residual" if family == RANGES else "SOLVED by a proved error"
        return draw_maps(maps, OUTCOMES, title, width)

    def to_content(self) -> dict[str, Any]:
        """Return what JSON can hold: numbers that are not finite become the texts "inf" and "nan"."""
        cells = [{key: _plain(value) for key, value in asdict(cell).items()} for cell in self.cells]
        return {"cells": cells, "skipped": [list(entry) for entry in self.skipped]}

    def rows(self) -> list[tuple[Any, ...]]:
        """Return one row a cell, in the columns of the CSV."""
        return [tuple(asdict(cell).values()) for cell in self.cells]


def stability_atlas(
    algorithms: Iterable[str | Algorithm] | None = None,
    stresses: Iterable[str] | None = None,
    *,
    quick: bool = False,
    progress: Progress | None = None,
) -> Atlas:
    """Return how each algorithm copes with each kind of difficult data, compared with exact answers.

    Parameters
    ----------
    algorithms : iterable of str and Algorithm, optional
        As :func:`lcp_plugin.evidence.error_against_time.error_against_time` takes them; all registered names and "auto"
        by default.
    stresses : iterable of str, optional
        Families: "stiffness", "scaling", "singularity", "degeneracy", "far starts", "sizes", "number range",
        "cancellation", "one ulp", "ranges", "proved ranges" (the maps). All by default.
    quick : bool
        Fewer iterations, and a smaller large problem.
    progress : callable, optional
        Called as ``progress(done, total, label)`` after every cell.

    Returns
    -------
    Atlas
        The same call gives the same atlas: no clock is asked.

    Raises
    ------
    UnknownAlgorithm, InvalidOption
        Where a name does not exist.

    Notes
    -----
    Within a run every warning of NumPy is an error, so that no overflow is silent.

    Examples
    --------
    >>> atlas = stability_atlas(["psor"], ["far starts"])
    >>> [cell.status for cell in atlas.cells], atlas.lies
    (['SOLVED', 'SOLVED', 'SOLVED'], ())
    """
    if progress is not None and not callable(progress):
        raise InvalidOption(
            f"progress must be callable as progress(done, total, label), got {progress!r}"
        )
    entrants = contestants(["auto", *REGISTRY] if algorithms is None else algorithms)
    families = _families(stresses)
    cases = [(family, case) for family in families for case in FAMILIES[family](quick)]
    cells: list[Cell] = []
    skipped: list[tuple[str, str]] = []
    total = len(cases) * len(entrants)
    for done, ((family, case), one) in enumerate(product(cases, entrants), start=1):
        found = _cell(family, case, one.label, one.algorithm, quick)
        if isinstance(found, Cell):
            cells.append(found)
        else:
            skipped.append(found)
        if progress is not None:
            progress(done, total, f"{case.stress}: {one.label}")
    return Atlas(tuple(cells), tuple(skipped))


def _families(stresses: Any) -> list[str]:
    """Return the names of the families, all by default, or raise InvalidOption where one is none."""
    chosen = list(FAMILIES) if stresses is None else checked_names(stresses, "stresses")
    for name in chosen:
        if name not in FAMILIES:
            raise InvalidOption(f"unknown stress {name!r}{did_you_mean(name, FAMILIES)}")
    return chosen


def _cell(
    family: str, case: StressCase, name: str, algorithm: str | Algorithm, quick: bool
) -> Cell | tuple[str, str]:
    """Return the cell, or what was left out and why where the algorithm does not take this kind of problem."""
    is_true, certified, error, residual = False, None, math.nan, math.nan
    try:
        result = _strictly_solved(
            case, algorithm, MAX_ITERATIONS_QUICK if quick else MAX_ITERATIONS
        )
    except UnsuitableProblem as refusal:
        return f"{name} on {case.stress}", str(refusal)
    except UnsuitableMatrix as refusal:
        status, is_true, note = REFUSED, True, str(refusal)
    except Exception as failure:  # whatever a run raises belongs into the atlas
        status, note = ERROR, f"{type(failure).__name__}: {failure}"
    else:
        lie = lie_in(result, None if case.has_line else case.exact)
        status, is_true, note = result.status.name, not lie, lie or _movement(case)
        residual, bound = result.certificate.relative_residual, result.error_bound
        if case.exact is not None and np.isfinite(result.z).all():
            error = relative_error(result.z, case.exact, case.units, has_line=case.has_line)
        certified = (
            None
            if bound is None
            else bool(bound.kind == "rigorous" and math.isfinite(bound.infinity))
        )
    lost = _digits_lost(error, case.condition, residual)
    return Cell(
        name,
        case.stress,
        family,
        case.condition,
        status,
        error,
        residual,
        certified,
        lost,
        is_true,
        note,
    )


def _strictly_solved(case: StressCase, algorithm: str | Algorithm, limit: int) -> Result:
    with (
        warnings.catch_warnings(),
        np.errstate(over="warn", divide="warn", invalid="warn", under="ignore"),
    ):
        warnings.simplefilter("error")
        is_bounded = case.problem.n <= 2500  # a bound of more unknowns takes longer than the run
        return solve(
            case.problem,
            algorithm,
            z0=case.start,
            max_iterations=limit,
            error_bound=is_bounded,
            tolerance=case.tolerance,
            tolerance_on=case.tolerance_on,
        )


def _digits_lost(error: float, condition: float, residual: float) -> float:
    expected = condition * max(residual, EPSILON)
    if not (math.isfinite(error) and math.isfinite(expected)):
        return math.nan
    return max(0.0, math.log10(error / expected)) if error > 0.0 else 0.0


def _movement(case: StressCase) -> str:
    """Return how far one unit in the last place of the data moves the answer."""
    if case.reference is None or case.exact is None:
        return ""
    pairs = zip(case.exact, case.reference, strict=True)
    moved = max(abs(new - old) for new, old in pairs) / max(abs(value) for value in case.reference)
    return f"1 ulp of the data moved the answer by {float(moved):.1e}"


def _line(cell: Cell) -> str:
    note = f"; {cell.note}" if cell.note else ""
    return (
        f"{cell.status:<16} {cell.algorithm:<15} {cell.stress:<38} condition {cell.condition:.0e}, "
        f"residual {cell.residual:.0e}, error {cell.true_error:.0e}{note}"
    )


def _plain(value: Any) -> Any:
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value
