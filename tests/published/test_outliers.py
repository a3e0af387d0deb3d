"""Some of each kind of the campaign with numbers that users write, and what its judge says of known answers."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from campaigns.outliers import (
    FALSE,
    KINDS,
    OPEN,
    REFUSED,
    RIGHT,
    ExactLCP,
    ExactProgram,
    judged_lcp,
    judged_program,
    run,
)

NO_BOUNDS = np.full(2, -np.inf), np.full(2, np.inf)
HEAVY = [[1e-8, -1e-8, 0], [-1e-8, 1 + 1e-8, -1], [0, -1, 1 + 1e-8]]
HALF_SPACES = [
    np.diag([2.0, 2.0]),
    [-300.0, -500.0],
    [[3.0, 1.0], [1.0, 4.0]],
    [10.0, 10.0],
    np.zeros((0, 2)),
    [],
]


@pytest.mark.few(1)
@pytest.mark.parametrize("kind", KINDS)
def test_no_answer_is_false(kind: str, draws: Callable[[int], range]) -> None:
    """No SOLVED beside the conditions and every judge, no proof beside a solution, no exception."""
    found = [(k, run(kind, 69, k)) for k in draws(60)]
    assert [(k, outcome.text) for k, outcome in found if outcome.what == FALSE] == []
    assert sum(outcome.what == RIGHT for _, outcome in found) >= len(found) // 2


@pytest.mark.parametrize(
    ("M", "q", "z", "status", "verdict"),
    [
        ([[1, -2], [3, 1e-9]], [-3, -1], [3.0, 0.0], "SOLVED", RIGHT),
        ([[1, -2], [3, 1e-9]], [-3, -1], [1.672, 0.0], "SOLVED", FALSE),
        ([[1, -2], [3, 1e-9]], [-3, -1], [0.0, 0.0], "INFEASIBLE", FALSE),
        ([[1, -2], [3, 1e-9]], [-3, -1], [0.0, 0.0], "STALLED", REFUSED),
        ([[1e-9, 1], [-1, 0]], [-1, -1], [0.0, 1.1e16], "SOLVED", FALSE),
        ([[1e-9, 1], [-1, 0]], [-1, -1], [0.0, 0.0], "INFEASIBLE", RIGHT),
        ([[1e-9, 1], [-1, 0]], [-1, -1], [0.0, 0.0], "STALLED", OPEN),
        (HEAVY, [-0.04905, 0, 0], [4905000.0, 0.0, 0.0], "SOLVED", FALSE),
        (HEAVY, [-0.04905, 0, 0], [9810000.0, 4905000.0, 4905000.0], "SOLVED", RIGHT),
        ([[1e-9, -1], [1, 1e-9]], [-1e-9, 0], [6.0, 5e-9], "SOLVED", FALSE),
        ([[2e-6, 1], [-1, 1e-11]], [-1, -2e-11], [2e-12, 1.0], "SOLVED", FALSE),
    ],
)
def test_the_judge_of_complementarity(M: list, q: list, z: list, status: str, verdict: str) -> None:
    """What is known to be false is told so, what is right is not."""
    assert (
        judged_lcp(ExactLCP(np.array(M), np.array(q)), _Named(status), np.array(z), np.inf, "").what
        == verdict
    )


class _Named:
    """A status by its name."""

    def __init__(self, name: str) -> None:
        self.name = name


@pytest.mark.parametrize(
    ("x", "status", "verdict"),
    [
        ([30 / 11, 20 / 11], "SOLVED", RIGHT), ([150.0, 250.0], "SOLVED", FALSE), ([0.0, 2.5], "SOLVED", FALSE),
        ([0.0, 0.0], "INFEASIBLE", FALSE), ([0.0, 0.0], "STALLED", REFUSED),
    ],
)  # fmt: skip
def test_the_judge_of_programs(x: list[float], status: str, verdict: str) -> None:
    """By value and violations, whatever the multipliers."""
    none = {
        "inequality": np.zeros(2),
        "equality": np.zeros(0),
        "lower": np.zeros(2),
        "upper": np.zeros(2),
    }
    P, c, G, h, A, b = HALF_SPACES
    data = [P, np.array(c), np.array(G), np.array(h), A, np.array(b), *NO_BOUNDS]
    assert judged_program(data, status, np.array(x), none, np.inf, "").what == verdict
    optimum = ExactProgram(*data).optimum()
    assert optimum is not None
    np.testing.assert_allclose([float(value) for value in optimum], [30 / 11, 20 / 11])
