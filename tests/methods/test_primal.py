"""Descents on dense programs with bounds only."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lcp_plugin import LCP, solve
from lcp_plugin.core.settings import Status
from lcp_plugin.methods.interior_point import ConvexProgram, InteriorPoint
from lcp_plugin.methods.primal import Descent


def dense(kind: str, n: int, rng: np.random.Generator) -> LCP:
    """A symmetric monotone problem that has a solution."""
    if kind == "half rank":
        B = rng.standard_normal((n, n // 2))
        M = B @ B.T
        return LCP(
            M, rng.random(n) * (rng.random(n) < 0.5) - M @ np.maximum(rng.standard_normal(n), 0.0)
        )
    basis = np.linalg.qr(rng.standard_normal((n, n)))[0]
    M = (basis * np.logspace(0.0, -8.0 if kind == "condition 1e8" else -1.0, n)) @ basis.T
    M = 0.5 * (M + M.T)
    if kind == "units":
        size = np.ldexp(1.0, rng.integers(-20, 21, n))
        M = size[:, np.newaxis] * M * size
    boxes = {"lower": -np.ones(n), "upper": np.ones(n)} if kind == "boxes" else {}
    return LCP(M, rng.standard_normal(n), **boxes)


@pytest.mark.parametrize("kind", ["half rank", "condition 1e8", "units", "boxes"])
def test_descents_alone_end_at_the_answer(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """No engine is asked where a dense symmetric problem is monotone, singular and graded ones included."""
    monkeypatch.setattr(InteriorPoint, "_engines", lambda *_: iter(()))
    for n in (5, 60, 300):
        result = solve(dense(kind, n, np.random.default_rng(n)), InteriorPoint(), tolerance=1e-10)
        assert result.status is Status.SOLVED, (n, str(result))


def test_descents_take_fewer_passes_than_an_engine() -> None:
    """Of 400 unknowns half of whose directions cost nothing: a third of what the steps of an engine take."""
    problem = dense("half rank", 400, np.random.default_rng(1))
    for algorithm in ("auto", "interior_point"):
        assert solve(problem, algorithm).work < 700.0  # 460 measured, some 1 500 by PIQP


@pytest.mark.parametrize("P", [np.zeros((2, 2)), -np.eye(2), np.array([[1.0, 2.0], [2.0, 1.0]])])
def test_a_search_ends_where_nothing_is_convex(P: Any) -> None:
    """Zero, negative, a saddle: a few points within the bounds, and an end."""
    points = list(Descent(P, np.array([-1.0, 1.0]), np.zeros(2), np.full(2, 3.0)).points())
    assert all((x >= 0.0).all() and (x <= 3.0).all() for x in points)


def test_the_objective_falls() -> None:
    """No point is higher than the one before."""
    program = ConvexProgram.of(dense("half rank", 200, np.random.default_rng(2)))
    P, c, *_, lower, upper = program.statement
    values = [float(x @ (0.5 * P @ x + c)) for x in Descent(P, c, lower, upper).points()]
    assert len(values) > 1
    assert np.diff(values).max() <= 1e-12 * abs(values[0])
