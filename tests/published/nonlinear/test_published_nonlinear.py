"""Nonlinear complementarity problems of the literature are solved from their starts, as an outsider measures it."""

import numpy as np
import pytest
from published_problems import PUBLISHED, outsiders_residual

from lcp_plugin import solve

CASES = [(name, k) for name, one in PUBLISHED.items() for k in range(len(one.starts))]


@pytest.mark.quick(12)
@pytest.mark.parametrize(("name", "k"), CASES)
def test_a_published_problem_is_solved_or_refused(name, k):
    """SOLVED has an outsider's residual below 1e-6; without a solution no point is SOLVED."""
    one = PUBLISHED[name]
    result = solve(one.problem, x0=np.array(one.starts[k], dtype=float))
    assert result.is_solved == one.is_solvable, result.explain()
    if result.is_solved:
        assert outsiders_residual(one.problem, result.x) < 1e-6


@pytest.mark.parametrize(("name", "x", "is_right"), [
    ("kojima_shindo", [6**0.5 / 2, 0, 0, 0.5], True),
    ("kojima_shindo", [1, 0, 3, 0], True),
    ("kojima_shindo", [1, 0, 3, 1e-3], False),
    ("watson", [0, 0, 1, 2, 3], True),
    ("fukushima_10", [2, 2, 2, 2, 2, 0], False),
    ("shapley_shubik", [2.0], True),
    ("shapley_shubik", [1.9], False),
])  # fmt: skip
def test_the_outsider_knows_published_solutions(name, x, is_right):
    """The outsider's residual accepts published solutions and rejects points next to them."""
    residual = outsiders_residual(PUBLISHED[name].problem, np.array(x, dtype=float))
    assert (residual < 1e-9) == is_right
