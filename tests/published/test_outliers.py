"""Some of each kind of the campaign with numbers that users write, and what its judge says of known answers."""

from __future__ import annotations

import numpy as np
import pytest
from campaigns.outliers import FALSE, KINDS, REFUSED, RIGHT, judged_program, run
from oracles.exact_program import ExactProgram

NO_BOUNDS = np.full(2, -np.inf), np.full(2, np.inf)
HALF_SPACES = [
    np.diag([2.0, 2.0]),
    [-300.0, -500.0],
    [[3.0, 1.0], [1.0, 4.0]],
    [10.0, 10.0],
    np.zeros((0, 2)),
    [],
]


@pytest.mark.quick(1)
@pytest.mark.parametrize("kind", KINDS)
def test_no_answer_is_false(kind, draws):
    """No SOLVED beside the conditions and every judge, no proof beside a solution, no exception."""
    found = [(k, run(kind, 69, k)) for k in draws(60)]
    assert [(k, outcome.text) for k, outcome in found if outcome.what == FALSE] == []
    assert sum(outcome.what == RIGHT for _, outcome in found) >= len(found) // 2


@pytest.mark.parametrize("kind", ["noisy rows", "units"])
def test_noise_in_a_row_excuses_no_other(kind, draws):
    """All linear programs with 1e-17 … 1e-9 in places of zeros, also in mixed units, are solved and right."""
    found = [run(kind, 69, k) for k in draws(120)]
    assert [outcome.text for outcome in found if outcome.what != RIGHT] == []


@pytest.mark.parametrize(
    ("x", "status", "verdict"),
    [
        ([30 / 11, 20 / 11], "SOLVED", RIGHT), ([150.0, 250.0], "SOLVED", FALSE), ([0.0, 2.5], "SOLVED", FALSE),
        ([0.0, 0.0], "INFEASIBLE", FALSE), ([0.0, 0.0], "STALLED", REFUSED),
    ],
)  # fmt: skip
def test_the_judge_of_programs(x, status, verdict):
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
