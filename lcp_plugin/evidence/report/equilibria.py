"""The best of all solutions: how the proved gap falls with time, on random leaders with a monotone follower."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from ...conversions.equilibrium_program import EquilibriumProgram
from ...conversions.program import QuadraticProgram
from ..drawing import COLOURS, new_figure, styled
from .section import Collected, Compute, Effort, Finding, Say, Section, brief, figure, many, seconds

SMALL, LARGE = (10, 20), (10, 20, 40)  # pairs
LEADERS = 5  # pairs for each variable of the leader
LEAST_GAP = 1e-9  # that is drawn


class BestEquilibria(Section):
    """Programs with complementarity constraints by branch and bound."""

    kind = anchor = "equilibria"
    place = 9
    title = "The best of all solutions"
    short = "Best equilibria"
    table = "best_equilibria.csv"

    def work(self, effort: Effort) -> dict[str, Compute]:
        """Return one part a problem."""
        sizes = SMALL if effort.is_quick else LARGE
        kinds = [(pairs, is_linear) for pairs in sizes for is_linear in (True, False)]
        return {f"{pairs} pairs, {'linear' if is_linear else 'quadratic'}": partial(_solved, pairs, is_linear, effort)
                for pairs, is_linear in kinds}

    def tell(self, collected: Collected) -> Iterator[Finding]:
        """Yield how many are proved."""
        found = self.rows(collected)
        proved = sum(row["status"] == "SOLVED" for row in found)
        slowest = max((row["seconds"] for row in found), default=0.0)
        wrong, most = sum(not row["verified"] for row in found), max(row["pairs"] for row in found)
        yield Finding("The best of all solutions", (
            f"Of {many(len(found), 'random leader')} with up to {most} followers {proved} "
            f"are proved to be best to 1e-6; the slowest search took {seconds(slowest)}. Checked again from the data, "
            f"the bounds of {wrong or 'none'} did not hold."
        ))

    def draw(self, collected: Collected) -> dict[str, Any]:
        """Return the table, and the gap against time."""
        found = collected.of(self.kind)
        with styled():
            drawn, axes = new_figure()
            for colour, one in zip(COLOURS.values(), found, strict=False):
                times, gaps = zip(*((time, max(gap, LEAST_GAP)) for time, gap in one["gaps"]), strict=True)
                axes.step(times, gaps, where="post", label=one["name"], color=colour)
            axes.set(xscale="log", yscale="log", xlabel="seconds", ylabel="proved gap")
            axes.legend(fontsize="small")
        rows = [
            [row["name"], row["status"], f"{row['value']:.6g}", brief(row["gap"]), str(row["nodes"]),
             seconds(row["seconds"])] for row in self.rows(collected)
        ]
        return {"rows": rows, "gaps": figure(drawn, "equilibria", "Proved gap against time")}

    def rows(self, collected: Collected) -> list[dict[str, Any]]:
        """Return a row a problem."""
        return [{name: value for name, value in one.items() if name != "gaps"} for one in collected.of(self.kind)]


def random_leader(pairs: int, is_linear: bool, seed: int = 0) -> EquilibriumProgram:
    """Return a leader in a box whose followers solve a complementarity problem with a positive definite matrix.

    Parameters
    ----------
    pairs : int
    is_linear : bool
        Whether the objective is.
    seed : int
    """
    random, leaders = np.random.default_rng([36, seed, pairs]), max(2, pairs // LEADERS)
    n = leaders + 2 * pairs
    square, skew = random.standard_normal((2, pairs, pairs))
    M = square @ square.T / pairs + 0.1 * np.eye(pairs) + 0.5 * (skew - skew.T) / np.sqrt(pairs)
    P, c = np.zeros((n, n)), np.zeros(n)
    root = random.standard_normal((n - pairs, n - pairs))
    if not is_linear:
        P[: n - pairs, : n - pairs] = root @ root.T / (n - pairs)
    c[: n - pairs] = random.standard_normal(n - pairs)
    A = np.hstack([random.standard_normal((pairs, leaders)), M, -np.eye(pairs)])
    lower, upper = np.zeros(n), np.full(n, np.inf)
    lower[:leaders], upper[:leaders] = -1.0, 1.0
    program = QuadraticProgram(P, c, A=A, b=-random.standard_normal(pairs), lower=lower, upper=upper)
    followers = np.arange(leaders, leaders + pairs)
    return EquilibriumProgram(program, followers, followers + pairs)


def _solved(pairs: int, is_linear: bool, effort: Effort, say: Say) -> dict[str, Any]:
    from ...solving.equilibria.branch_and_bound import minimize_over_solutions

    gaps: list[tuple[float, float]] = []

    def watch(search: Any) -> None:
        gap = (search.value - search.lower_bound) / max(1.0, abs(search.value))
        if np.isfinite(gap):
            gaps.append((search.clock.read(), float(gap)))
        say(f"{search.nodes} nodes")

    result = minimize_over_solutions(
        random_leader(pairs, is_linear), max_seconds=effort.run_seconds, callback=watch
    )
    gaps.append((result.seconds, float(result.gap)))
    return {
        "name": f"{pairs} pairs, {'linear' if is_linear else 'quadratic'}", "pairs": pairs,
        "status": result.status.name, "value": float(result.value),
        "gap": float(result.gap), "nodes": result.nodes, "seconds": result.seconds,
        "verified": result.verify(), "gaps": [one for one in gaps if np.isfinite(one[1])],
    }
