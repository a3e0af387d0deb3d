"""The table and the figure of a paper: own matrix families, an own method next to ours, several sizes.

Put your families (a size in, (M, q) or an LCP out) and your method in place of these. The tables are Markdown; the
`points` of a row have every digit. The figure, error against work, is as wide as a page and
can be read in grey.

Here: a chain, a plate and a matrix without a grid; damped projected Jacobi against four others. The check at the end is
the same method as a loop in NumPy.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp
import typer

from lcp_plugin import LCP, study
from lcp_plugin.algorithms import Algorithm, Step

SIZES, TOLERANCE = (100, 400, 900, 1600), 1e-8


def chain(n: int) -> tuple[Any, Any]:
    """Return (M, q) with a tridiagonal matrix."""
    M = sp.diags_array([-1.0, 2.1, -1.0], offsets=[-1, 0, 1], shape=(n, n))
    return M, np.sin(0.3 * np.arange(n)) - 0.2


def plate(n: int) -> LCP:
    """Return an LCP with a five-point matrix on a square."""
    side = round(n**0.5)
    line = sp.diags_array([-1.0, 2.005, -1.0], offsets=[-1, 0, 1], shape=(side, side))
    return LCP(sp.kronsum(line, line), np.cos(np.arange(side**2)) - 0.3)


def scattered(n: int) -> tuple[Any, Any]:
    """Return (M, q) with five entries a row, anywhere, and a dominant diagonal."""
    generator = np.random.default_rng(0)
    others = sp.random_array((n, n), density=5 / n, rng=generator)
    return others + sp.diags_array(1.05 * others.sum(axis=1) + 0.1), generator.standard_normal(n)


@dataclass(frozen=True)
class DampedJacobi(Algorithm):
    """Damped projected Jacobi: z ← max(0, z − ω D⁻¹ (M z + q))."""

    name = "damped"
    omega: float = 0.7

    def iterates(self, problem: LCP, z0: Any) -> Iterator[Step]:
        """Yield the iterates."""
        z = z0
        while True:
            yield Step(z)
            z = np.clip(
                z - self.omega * problem.slack(z) / problem.diagonal, problem.lower, problem.upper
            )


def loop_in_numpy(M: Any, q: Any, omega: float = 0.7) -> int:
    """Return the sweeps until max |z − max(0, z − D⁻¹ (M z + q))| is 1e-8 of its value at 0."""
    z, d, start, sweeps = np.zeros(q.size), M.diagonal(), 0.0, 0
    while True:
        w = M @ z + q
        residual = abs(z - np.maximum(z - w / d, 0.0)).max()
        start = start or residual
        if residual <= TOLERANCE * start:
            return sweeps
        z = np.maximum(z - omega * w / d, 0.0)
        sweeps += 1


def main(out: Path = Path()) -> None:
    """Measure, print the tables and the growth of the work with n, and save the figure into the folder OUT."""
    methods = ["npsor", "psor", "multigrid", "auto", DampedJacobi()]
    results = study([chain, plate, scattered], methods, SIZES, repeats=2)
    for table in results.table("iterations"):
        print(table)
    for method in dict.fromkeys(row.method for row in results.rows if row.family != "polish"):
        work = [results.row(method, "chain", n).work for n in SIZES]
        power = np.polyfit(np.log(SIZES), np.log(work), 1)[0]
        print(f"{method:<12} the work on a chain grows like n^{power:.2f}")
    results.save(out / "paper_study.png", "work")

    ours = [
        row.iterations for row in results.rows if row.method == "damped" and row.problem != "plate"
    ]
    theirs = [loop_in_numpy(*family(n)) for family in (chain, scattered) for n in SIZES]
    apart = max(abs(a - b) for a, b in zip(ours, theirs, strict=True))
    print(f"check: a loop in NumPy takes as many sweeps up to {apart}")


if __name__ == "__main__":
    typer.run(main)
