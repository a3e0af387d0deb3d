"""Measure applications, and compare two tables.

If M has another scaling, pivots depend on the BLAS of the processor. If two processors differ, a row holds the larger
work, the larger error and the worse status.
"""

from __future__ import annotations

import csv
import io
import warnings
import zlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from lcp_plugin import LCP, UnsuitableMatrix, UnsuitableProblem, solve

from . import Application, entries
from .references import NoReference, active_sets

HERE = Path(__file__).parent
# one unknown, or all rows, or rows and columns, times powers of two
UNITS = ("own", "one", "rows", "both")
LARGEST_UNIT, ONE_UNIT = 20, 12  # exponents
NAMED = ("npsor", "psor", "newton", "multigrid", "interior_point", "lemke", "banded", "program")

MORE_WORK, LARGER_ERROR = 1.1, 10.0  # failure levels
NO_ERROR = 1e-12  # errors below are at rounding level
TOLERANCE = 1e-8  # the default of solve: a larger error below it is reported, and does not fail
FEW_PASSES = 5.0  # a pivot more or less is a matter of rounding: another processor's
FAR_BEHIND = 3.0  # times the best named method's work: often chaotic, so not compared
CHAOTIC = 100.0  # times that, for auto on scaled problems: pivots depend on rounding
FALSE_FROM = 1e-3  # SOLVED with such an error is false


# A run ends here; limits are steps, not seconds.
STEPS = {"auto": 10_000, "npsor": 2000, "psor": 2000, "multigrid": 150, "newton": 150, "interior_point": 100,
         "banded": 100}  # fmt: skip
ROWS = {
    "newton": 50_000,
    "interior_point": 30_000,
    "lemke": 500,
    "banded": 12_000,
    "program": 30_000,
}  # else hopeless
PLACES = {"newton": 2e6, "interior_point": 2e6}  # entries of M
BAND = 60  # rows from the diagonal, beyond 200 rows


class Key(NamedTuple):
    """Problem, method and scaling of a row."""

    problem: str
    method: str
    units: str


@dataclass(frozen=True)
class Measured:
    """A row: size, status, passes over M, error."""

    n: int
    status: str
    work: float
    error: float

    @property
    def is_solved(self) -> bool:
        return self.status == "SOLVED" and self.error < FALSE_FROM

    @property
    def rank(self) -> int:
        """0 for solved, 3 for called solved though it is not."""
        return (
            0
            if self.is_solved
            else 3
            if self.status == "SOLVED"
            else 1
            if self.status == "PRECISION_LIMIT"
            else 2
        )

    def __str__(self) -> str:
        return f"{'falsely ' * (self.rank == 3)}{self.status}, work {self.work:g}, error {self.error:.1e}"


Table = dict[Key, Measured]


class Case:
    """One size of an application, and its reference solution."""

    def __init__(self, name: str, arguments: Mapping[str, Any]) -> None:
        self.function = name
        self.name = self.name_of(name, arguments)
        self.stated: Application = entries()[name].build(**arguments)
        one, q = self.stated, np.array(self.stated.q, dtype=float)
        n = q.size
        lower, upper = (
            np.broadcast_to(np.asarray(bound, dtype=float), n) for bound in (one.lower, one.upper)
        )
        self.is_dense = isinstance(one.M, np.ndarray)
        self.data = (sp.csr_array(one.M), q, lower, upper)
        self._reference: Any = None

    @staticmethod
    def name_of(name: str, arguments: Mapping[str, Any]) -> str:
        """Return the name of the case in a table."""
        return " ".join([name, *(f"{key}={value}" for key, value in arguments.items())])

    @property
    def n(self) -> int:
        return self.data[1].size

    def in_units(self, units: str) -> tuple[LCP, Any]:
        """Return the problem in units, and the exponents of these of its unknowns."""
        M, q, lower, upper = self.data
        rng = np.random.default_rng(zlib.crc32(f"{self.name} {units}".encode()))
        r, c = rng.integers(-LARGEST_UNIT, LARGEST_UNIT + 1, size=(2, self.n))
        r, c = r * (units in ("rows", "both")), c * (units == "both")
        c[self.n // 2] += ONE_UNIT * (units == "one")
        moved = M.copy()
        moved.data = np.ldexp(M.data, np.repeat(r, np.diff(M.indptr)) + c[M.indices])
        problem = LCP(
            moved.toarray() if self.is_dense else moved,
            np.ldexp(q, r),
            lower=np.ldexp(lower, -c),
            upper=np.ldexp(upper, -c),
        )
        return problem, c

    def error(self, z: Any, starts: Iterable[Any]) -> float:
        """Return the error of unscaled z relative to the reference, found from these starts."""
        if self.stated.error is not None:
            return self.stated.error(z)
        found, exact = self.stated.determined(z), self.stated.determined(self.reference(starts))
        return max(
            float(abs(a - b).max() / abs(b).max()) for a, b in zip(found, exact, strict=True)
        )

    def reference(self, starts: Iterable[Any]) -> Any:
        if self._reference is None:
            answer = active_sets if self.stated.answer is None else self.stated.answer
            try:
                self._reference = answer(self.data, starts) if callable(answer) else answer
            except NoReference as error:
                raise NoReference(f"{self.name}: {error}") from error
        return self._reference

    def suits(self, method: str) -> bool:
        """Return whether a method is worth a try by size."""
        M, *_ = self.data
        if method == "program":
            return self.stated.program is not None
        if method == "banded" and self.n > 200:
            rows = np.repeat(np.arange(self.n), np.diff(M.indptr))
            if abs(rows - M.indices).max(initial=0) > BAND:
                return False
        if method == "multigrid" and self.is_dense:
            return False
        return self.n <= ROWS.get(method, np.inf) and M.nnz <= PLACES.get(method, np.inf)

    def run(self, method: str, units: str) -> tuple[Any, Any] | None:
        """Return the result and unscaled z, or None if the method rejects the problem."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                if method == "program":
                    result = solve(self.stated.program, max_iterations=STEPS["auto"])
                    return result, np.append(result.x, np.zeros(self.n - result.x.size))
                problem, c = self.in_units(units)
                options = {} if method == "auto" else {"prove_infeasibility": False}
                result = solve(problem, method, max_iterations=STEPS.get(method), **options)
            except (UnsuitableMatrix, UnsuitableProblem):
                return None
        return result, np.ldexp(result.z, c)

    def measure(self, wanted: Iterable[tuple[str, str]]) -> Iterator[tuple[Key, Measured]]:
        """Yield a row per (method, scaling): named methods if they solve, and false results."""
        runs = {}
        for method, units in wanted:
            if method == "auto" or self.suits(method):
                ran = self.run(method, units)
                if ran is not None:
                    runs[method, units] = ran
        starts = [
            z
            for result, z in sorted(runs.values(), key=lambda ran: ran[0].status.name != "SOLVED")
            if np.isfinite(z).all()
        ]
        for (method, units), (result, z) in runs.items():
            work = (
                sum(stage.work for stage in result.stages) if method == "program" else result.work
            )
            error = self._error_of(method, z, starts)
            row = Measured(self.n, result.status.name, float(f"{work:.5g}"), float(f"{error:.1e}"))
            if method == "auto" or (row.is_solved if units == "own" else row.rank == 3):
                yield Key(self.name, method, units), row

    def _error_of(self, method: str, z: Any, starts: Iterable[Any]) -> float:
        if method == "program":  # x alone
            size = self.stated.program.n
            exact = self.reference(starts)[:size]
            return float(abs(z[:size] - exact).max() / abs(exact).max())
        return self.error(z, starts)


def cases(*, full: bool, names: Iterable[str] = ()) -> Iterator[Case]:
    """Yield the small or the large cases of these applications, of all without names."""
    for name, entry in entries().items():
        if not (chosen := list(names)) or name in chosen:
            for arguments in entry.full if full else entry.small:
                yield Case(name, arguments)


def all_runs(*, full: bool) -> Iterator[tuple[str, str]]:
    """Yield the methods and scalings of a table; named ones on scaled data if quick."""
    yield from (("auto", units) for units in UNITS)
    yield from ((method, "own") for method in NAMED)
    if not full:
        yield from ((method, units) for method in NAMED[:-1] for units in UNITS[1:])


# --- the file ---------------------------------------------------------------------------------------------------

COLUMNS = ("problem", "method", "units", "n", "status", "work", "error")


def path_of(*, full: bool) -> Path:
    return HERE / ("full.csv" if full else "small.csv")


def read(text: str) -> Table:
    """Return the table that a file holds."""
    return {
        Key(row["problem"], row["method"], row["units"]): Measured(
            int(row["n"]), row["status"], float(row["work"]), float(row["error"])
        )
        for row in csv.DictReader(io.StringIO(text))
    }


def written(table: Table) -> str:
    """Return the file of a table, a line per row."""
    lines = [",".join(COLUMNS)]
    lines += [
        f"{','.join(key)},{row.n},{row.status},{row.work:g},{row.error:.1e}"
        for key, row in table.items()
    ]
    return "\n".join(lines) + "\n"


# --- comparisons ------------------------------------------------------------------------------------------------


def regressions(old: Table, new: Table) -> list[str]:
    """Return a line for each row of `old` that is worse in `new`, and for each that only `new` has falsely SOLVED."""
    lines = [
        f"{' '.join(key)}: {row}" for key, row in new.items() if row.rank == 3 and key not in old
    ]
    least = best_of_named(old)
    for key, before in old.items():
        after = new.get(key)
        if key.method != "auto" and (
            key.units != "own" or before.work > FAR_BEHIND * least[key.problem][1]
        ):
            continue
        if after is None:
            why = "no longer solved"
        elif after.rank > before.rank:
            why = "a worse status"
        elif after.rank < before.rank or after.rank > 0:
            continue  # better, or as unsolved as before
        elif after.work > max(MORE_WORK * before.work, before.work + FEW_PASSES) and not (
            key.units != "own"
            and before.work > CHAOTIC * max(least.get(key.problem, ("", np.inf))[1], 1.0)
        ):
            why = f"{after.work / before.work:.2f} × the work"
        elif after.error > max(LARGER_ERROR * before.error, TOLERANCE):
            why = "a larger error"
        else:
            continue
        lines.append(f"{' '.join(key)}: {before} → {after or 'nothing'}: {why}")
    return lines


def worse_of(a: Table, b: Table) -> Table:
    """Return the larger work and error of each row of both tables; the row of the worse status if these differ."""
    return {
        key: max(row, b[key], key=lambda one: one.rank)
        if row.rank != b[key].rank
        else replace(row, work=max(row.work, b[key].work), error=max(row.error, b[key].error))
        for key, row in a.items()
        if key in b
    }


def differences(old: Table, new: Table) -> Iterator[str]:
    """Yield a line for each row that changed, for a commit's message."""
    for key in {**old, **new}:
        before, after = old.get(key), new.get(key)
        if before and after and not _differ(before, after):
            continue
        told = ": a larger error, within the tolerance" * _is_less_exact(before, after)
        yield f"{' '.join(key)}: {before or 'nothing'} → {after or 'nothing'}{told}"


def _is_less_exact(before: Measured | None, after: Measured | None) -> bool:
    return (
        before is not None
        and after is not None
        and LARGER_ERROR * max(before.error, NO_ERROR) < after.error <= TOLERANCE
    )


def _differ(a: Measured, b: Measured) -> bool:
    small = max(a.error, NO_ERROR), max(b.error, NO_ERROR)
    return (a.status, a.rank, a.n, a.work) != (b.status, b.rank, b.n, b.work) or max(
        small
    ) > 2.0 * min(small)


def best_of_named(table: Table) -> dict[str, tuple[str, float]]:
    """Return the named method of least work on each solved unscaled problem, and this work.

    The work of external solvers is not counted: they are left out.
    """
    best: dict[str, tuple[str, float]] = {}
    for key, row in table.items():
        if (
            key.method != "auto"
            and key.units == "own"
            and 0.0 < row.work < best.get(key.problem, ("", np.inf))[1]
        ):
            best[key.problem] = key.method, row.work
    return best
