"""Published complementarity problems and quadratic programs, solved by several packages.

``python tests/benchmarks public result.json > page.md`` writes every outcome and prints the page. A residual computed
here in numpy decides, not the solver's status. To add a solver: write a function of an :class:`Item` that returns x
and whether the solver claims a solution, or None if it does not accept the problem; add it to `SOLVERS`.
"""

from __future__ import annotations

import json
import math
import os
import platform
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from importlib import import_module
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp
from collection import all_entries
from inputs.membranes import parse
from inputs.published_problems import COMPLEMENTARITY, PROGRAMS, PublishedProgram, read

from lcp_plugin import LCP, QuadraticProgram, Status, solve

SECONDS, SHIFT, ENOUGH = 5.0, 1e-3, 1e-6  # limit; of the geometric mean; the residual of a solution
TIGHT = {"eps_abs": 1e-8, "eps_rel": 1e-8}  # as Clarabel and PIQP by default
GALLERY = (
    *("paper_example_1:n=900", "paper_example_1:n=10000", "paper_example_2:n=900"),
    *("obstacle_2d:size=30", "obstacle_2d:size=100", "journal_bearing", "convection_diffusion"),
    "half_active:n=900",
)
INFINITE = 1e20  # of SCIP
FIELDS = ("M", "q", "lower", "upper")
Point = tuple[Any, bool] | None


@dataclass(frozen=True, eq=False)
class Item:
    """A problem by its data M, q, lower, upper, or a published program."""

    name: str
    lcp: tuple[Any, ...] = ()
    published: PublishedProgram | None = None

    @cached_property
    def program(self) -> tuple[Any, ...] | None:
        """P, c, rows, low, high, lower, upper of a convex program with this solution; None if there is none."""
        if self.published is not None:
            return (self.published.P, self.published.q, *self.published.split())
        M, q, lower, upper = self.lcp
        values = np.linalg.eigvalsh((M + M.T).toarray()) if q.size <= 1500 else np.full(2, -1.0)
        if values[0] < -1e-12 * abs(values).max():
            return None
        if abs(M - M.T).max() == 0.0:
            return M, q, sp.csr_array((0, q.size)), np.zeros(0), np.zeros(0), lower, upper
        if lower.any() or np.isfinite(upper).any():
            return None
        return M + M.T, q, M, -q, np.full(q.size, np.inf), lower, upper

    @cached_property
    def one_sided(self) -> tuple[Any, ...]:
        """G, h, A, b of the rows of the program."""
        _, _, rows, low, high, *_ = self.program or ()
        rows, equal = sp.csr_array(rows), low == high
        below, above = np.isfinite(low) & ~equal, np.isfinite(high) & ~equal
        G, h = sp.vstack([rows[above], -rows[below]]), np.append(high[above], -low[below])
        return sp.csc_matrix(G), h, sp.csc_matrix(rows[equal]), low[equal]

    def residual(self, x: Any) -> float:
        """The natural residual relative to the one at 0; for programs, the error of the value or the violation."""
        if self.published is not None:
            of = self.published
            value, row = 0.5 * x @ (of.P @ x) + of.q @ x + of.r, of.A @ x
            outside = np.maximum(of.l - row, row - of.u) / np.maximum(1.0, abs(row))
            return max(abs(value - of.value) / max(1.0, abs(of.value)), float(outside.max()))
        M, q, lower, upper = self.lcp
        largest = abs(M).max(axis=1).toarray().ravel()

        def norm(z: Any) -> float:
            step = (M @ z + q) / np.where(largest > 0.0, largest, 1.0)
            return float(abs(z - np.clip(z - step, lower, upper)).max())

        return norm(x) / (norm(np.clip(np.zeros(q.size), lower, upper)) or 1.0)


def items(*, quick: bool) -> Iterator[tuple[str, list[Item]]]:
    """Yield the sets of problems, each with its title; nothing is random."""
    stated = [
        (one.name, one.problem)
        for one in all_entries()
        if one.truth == "solvable" and "made for this collection" not in one.source
    ]
    grids = [(name, parse(name).problem) for name in GALLERY[: 1 if quick else None]]
    files = [(name, read(name)) for name in COMPLEMENTARITY[: 1 if quick else None]]
    yield "textbooks and articles", [_as_item(*one) for one in stated[: 5 if quick else None]]
    yield "grids", [_as_item(*one) for one in grids]
    yield "Siconos", [_as_item(*one) for one in files]
    programs = [name for name, n in PROGRAMS.items() if n < (100 if quick else 20000)]
    programs = [Item(name, (), PublishedProgram.read(name)) for name in programs]
    yield "Maros and Mészáros: quadratic programs", programs


def _as_item(name: str, of: Any) -> Item:
    M, *vectors = map(of.get if isinstance(of, dict) else partial(getattr, of), FIELDS)
    return Item(name, (sp.csr_array(M), *vectors))


def ours(item: Item) -> Point:
    """Solve by lcp_plugin with its defaults."""
    if item.published is None:
        problem = LCP(**dict(zip(FIELDS, item.lcp, strict=True)))
    else:
        P, c, *_, lower, upper = item.program or ()
        problem = QuadraticProgram(P, c, *item.one_sided, lower, upper)
    result = solve(problem)
    return result.x, result.status is Status.SOLVED


def quantecon(item: Item) -> Point:
    """Solve by the compiled Lemke of QuantEcon: dense, z ≥ 0."""
    M, q, lower, upper = item.lcp or [np.full(2001, np.inf)] * 4
    if q.size > 2000 or lower.any() or np.isfinite(upper).any():
        return None
    lemke = import_module("quantecon.optimize.lcp_lemke").lcp_lemke
    found = lemke(M.toarray(), np.array(q, np.float64), max_iter=10**5)
    return found.z, bool(found.success)


def scipy(item: Item) -> Point:
    """Solve the natural equation by scipy's root (Powell's hybrid method)."""
    if item.published or item.lcp[1].size > 150:
        return None
    M, q, lower, upper = item.lcp
    root = import_module("scipy.optimize").root
    found = root(lambda z: z - np.clip(z - (M @ z + q), lower, upper), np.clip(0 * q, lower, upper))
    return np.clip(found.x, lower, upper), bool(found.success)


def convex(name: str, options: dict[str, float], item: Item) -> Point:
    """Solve the convex program by an engine that qpsolvers calls."""
    if item.program is None:
        return None
    (P, c), (G, h, A, b), bounds = item.program[:2], item.one_sided, item.program[5:]
    qpsolvers = import_module("qpsolvers")
    of_rows = (G, h) if h.size else (None, None), (A, b) if b.size else (None, None)
    problem = qpsolvers.Problem(sp.csc_matrix(P), c, *of_rows[0], *of_rows[1], *bounds)
    found = qpsolvers.solve_problem(problem, name, **options)
    return found.x, bool(found.found)


def scip(item: Item) -> Point:
    """Solve by SCIP: z − lower and w are an SOS1 pair, and so are upper − z and −w."""
    if item.published or item.lcp[1].size > 100:
        return None
    M, q, lower, upper = item.lcp
    M, model = M.toarray(), import_module("pyscipopt").Model()
    model.hideOutput()
    model.setParams({"timing/clocktype": 1, "limits/time": SECONDS})  # processor seconds
    ends = np.clip(np.column_stack([lower, upper]), -INFINITE, INFINITE).tolist()
    z = [model.addVar(lb=low, ub=high) for low, high in ends]
    for i, pair in enumerate(ends):
        up, down = (model.addVar(ub=None if abs(end) < INFINITE else 0.0) for end in pair)
        w = sum(float(M[i, j]) * z[j] for j in np.flatnonzero(M[i])) + float(q[i])
        model.addCons(w - up + down == 0.0)
        for end, sign, part in ((pair[0], 1.0, up), (pair[1], -1.0, down)):
            if abs(end) < INFINITE:
                gap = model.addVar()
                model.addCons(gap - sign * (z[i] - end) == 0.0)
                model.addConsSOS1([gap, part])
    model.optimize()
    if model.getNSols() == 0:
        return np.zeros(q.size), False
    best = model.getBestSol()
    return np.array([best[one] for one in z]), True


SOLVERS: dict[str, tuple[str, Callable[[Item], Point]]] = {  # column: package, function
    "lcp_plugin": ("lcp_plugin", ours),
    "QuantEcon": ("quantecon", quantecon),
    "scipy root": ("scipy", scipy),
    "OSQP": ("osqp", partial(convex, "osqp", TIGHT | {"max_iter": 20000})),
    "Clarabel": ("clarabel", partial(convex, "clarabel", {})),
    "PIQP": ("piqp", partial(convex, "piqp", {})),
    "SCIP": ("pyscipopt", scip),
}


def measure(solver: Callable[[Item], Point], item: Item) -> dict[str, Any] | None:
    """Return outcome, seconds and residual of the quicker of two runs; None if the problem is not accepted."""
    seconds = math.inf
    for _ in range(2):
        began = time.process_time()
        try:
            with warnings.catch_warnings(action="ignore"):
                found = solver(item)
        except Exception as error:  # of any package
            return {"outcome": "error", "seconds": SECONDS, "message": str(error)[:100]}
        if found is None:
            return None
        seconds = min(seconds, time.process_time() - began)
        x, claims = found
        if not claims:
            break
    if not claims or seconds > SECONDS:
        return {"outcome": "unsolved", "seconds": seconds}
    residual = item.residual(x)
    outcome = "solved" if residual <= ENOUGH else "wrong"  # NaN is wrong
    return {"outcome": outcome, "seconds": seconds, "residual": residual}


def run(*, quick: bool = False, files: Sequence[str | Path] = ()) -> Iterator[str]:
    """Yield the page; write all outcomes to the first file."""
    present = {name: one for name, one in SOLVERS.items() if find_spec(one[0]) is not None}
    versions = {package: version(package) for package, _ in present.values()}
    machine = f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    yield f"Measured with {', '.join(' '.join(pair) for pair in versions.items())} on {machine}."
    outcomes: dict[str, Any] = {}
    for title, problems in items(quick=quick):
        for item in problems:
            _ = item.program and item.one_sided  # no solver's time
        table = {
            name: {item.name: measure(solver, item) for item in problems}
            for name, (_, solver) in present.items()
        }
        outcomes[title] = table
        yield from _table(title, table, len(problems))
    if files:
        whole = {"versions": versions, "machine": machine, "limit": SECONDS, "outcomes": outcomes}
        Path(files[0]).write_text(json.dumps(whole, indent=1) + "\n", encoding="utf-8")


def _table(title: str, table: dict[str, Any], count: int) -> Iterator[str]:
    yield f"\n## {title[0].upper()}{title[1:]}: {count} problems\n"
    yield "| solver | accepts | solved | wrong | unsolved | error | time | lcp_plugin on these | faster | only it |"
    yield "|---|---|---|---|---|---|---|---|---|---|"
    base = table["lcp_plugin"]
    for name, found in table.items():
        taken = {key: one for key, one in found.items() if one is not None}
        if not taken:
            continue
        kinds = [one["outcome"] for one in taken.values()]
        counts = [kinds.count(kind) for kind in ("solved", "wrong", "unsolved", "error")]
        solved = [key for key, one in taken.items() if one["outcome"] == "solved"]
        both = [key for key in solved if base[key]["outcome"] == "solved"]
        faster = sum(2.0 * taken[key]["seconds"] < base[key]["seconds"] for key in both)
        means = (f"{1e3 * _mean([of[key] for key in taken]):.3g} ms" for of in (taken, base))
        cells = [name, len(taken), *counts, *means, faster, len(solved) - len(both)]
        yield f"| {' | '.join(map(str, cells))} |"


def _mean(found: list[dict[str, Any]]) -> float:
    """Return the shifted geometric mean of the seconds; what is not solved counts as the limit."""
    seconds = [one["seconds"] if one["outcome"] == "solved" else SECONDS for one in found]
    return float(np.exp(np.mean(np.log(np.array(seconds) + SHIFT)))) - SHIFT
