"""Why a program is not SOLVED: measures of each attempt, the unknowns that add to the gap, the next step."""

from __future__ import annotations

import numpy as np
import pytest

from lcp_plugin import QuadraticProgram, Status, certify, solve

DRAWN = np.random.default_rng(0)
A = DRAWN.normal(size=(12, 12))
WELL_SCALED = QuadraticProgram(
    A @ A.T, DRAWN.normal(size=12), DRAWN.normal(size=(8, 12)), np.ones(8)
)


def test_a_tolerance_below_rounding_is_called_that():
    """With tolerance=0 the data are not to blame: the advice names the rounding level and a tolerance above it."""
    result = solve(WELL_SCALED, tolerance=0.0)
    assert result.status is Status.PRECISION_LIMIT
    assert "the tolerance 0e+00 is below the rounding level" in result.advice
    assert "next: set a tolerance above" in result.advice
    assert "rescale" not in result.explain()


def test_each_attempt_shows_its_scaling_and_both_measures():
    """No attempt repeats another: their lines differ, and state no share of work, because none is counted."""
    lines = [
        line
        for line in solve(WELL_SCALED, tolerance=0.0).explain().splitlines()
        if "piqp, " in line
    ]
    assert len({line.rsplit(";", 1)[0] for line in lines}) == len(lines) > 1  # without the seconds
    for line in lines:
        assert all(words in line for words in ("scaling: ", "rows ", "gap ", "reports ", " s"))
        assert "of the work" not in line


@pytest.mark.parametrize("names", [None, ["wind", "coal"]])
def test_worst_ranks_the_unknowns_that_add_to_the_gap(names):
    """At x = (1, 1) of min ½ x₁² + ½ x₂² − x₁ − 3 x₂ only the second gradient, −2, is not 0."""
    program = QuadraticProgram(np.eye(2), [-1.0, -3.0], lower=0.0, upper=9.0, names=names)
    (worst,) = certify(program, [1.0, 1.0]).worst(3)
    assert worst.name == ("x[1]" if names is None else "coal")
    assert worst.violation == 2.0
    assert "adds" in worst.text
    assert not certify(program, [1.0, 3.0]).worst(3)


def test_rescaling_is_advised_only_where_coefficients_differ():
    """Coefficients from 1e-7 to 1e4 are named with their sizes."""
    units = np.geomspace(1e-4, 1e2, 12)
    program = QuadraticProgram(
        units[:, None] * (A @ A.T) * units, units * WELL_SCALED.c, lower=-1.0
    )
    result = solve(program, tolerance=0.0)
    assert result.status is Status.PRECISION_LIMIT
    assert "rescale the data, whose coefficients are" in result.advice
