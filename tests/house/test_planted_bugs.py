"""assert_solves finds the classic bugs of solvers: each is planted alone into a correct toy, and must be found."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import Phase
from hypothesis import strategies as st

from lcp_plugin import strategies
from lcp_plugin.strategies import assert_solves, not_h_matrices, strictly_dominant_matrices

ENOUGH = 500
MANY = 120
SMALL = st.integers(1, 2)
DOMINANT = strictly_dominant_matrices(SMALL)
# The identity and a rotation that is larger: P-matrices that are no H-matrices.
Solver = Callable[..., Any]


def psor(M: Any, q: Any, lower: Any, upper: Any, omega: float = 1.0, sweeps: int = 200) -> Any:
    """Projected successive over-relaxation, which says by None that it did not get there."""
    z, d = np.clip(np.zeros(len(q)), lower, upper), M.diagonal()
    if (d <= 0.0).any():
        raise ValueError("PSOR needs a positive diagonal")
    for _ in range(sweeps):
        w = M @ z + q
        residual = abs(z - np.clip(z - w / d, lower, upper)).max()
        if residual <= 1e-8:
            return z
        for i in range(len(q)):
            z[i] = min(max(z[i] - omega * (M[i] @ z + q[i]) / d[i], lower[i]), upper[i])
    return None


def least_index(M: Any, q: Any, lower: Any, upper: Any) -> Any:
    """Murty's pivoting with bounds: solve for the free rows, and move the first row that is wrong."""
    state = np.where(np.isfinite(lower), -1, np.where(np.isfinite(upper), 1, 0))
    for _ in range(3 ** len(q)):
        free, z = state == 0, np.where(state < 0, lower, upper)
        z[free] = 0.0
        z[free] = np.linalg.solve(M[np.ix_(free, free)], -(M @ z + q)[free])
        w = np.where(free, 0.0, M @ z + q)
        low, high = z < lower - 1e-9, z > upper + 1e-9
        leave = ((state < 0) & (w < -1e-9)) | ((state > 0) & (w > 1e-9))
        wrong = np.flatnonzero(low | high | (leave & (lower < upper)))
        if not wrong.size:
            return z
        state[wrong[0]] = -1 if low[wrong[0]] else 1 if high[wrong[0]] else 0
    return None


def planted(solver: Solver, right: str, wrong: str) -> Solver:
    """The solver with one place of its source changed."""
    source = inspect.getsource(solver)
    assert source.count(right) == 1, right
    namespace: dict[str, Any] = {"np": np, "Any": Any}
    exec("from __future__ import annotations\n" + source.replace(right, wrong), namespace)
    changed: Solver = namespace[solver.__name__]
    return changed


CHECK = "if residual <= 1e-8:"
WILD = {"matrices": not_h_matrices(SMALL), "may_give_up": True}
# name: (solver, right place, planted bug, options of assert_solves, what the report must say)
BUGS: dict[str, tuple[Solver, str, str, dict[str, Any], str]] = {
    "w never checked": (least_index, "leave = ", "leave = False & ", {}, "w has the wrong sign"),
    "transposed matrix": (
        least_index,
        "state = ",
        "M = M.T\n    state = ",
        {},
        "wrong sign|not complementary",
    ),
    "status before check": (psor, "return None", "return z", WILD, "z is not|w has the wrong sign"),
    "wrong sign at the upper bound": (
        least_index,
        "(w > 1e-9)",
        "(w < -1e-9)",
        {"bounds": True},
        "w has the wrong sign|gave up",
    ),
    "tolerance relative to a huge q": (
        psor,
        CHECK,
        "if residual <= 1e-6 * abs(q).max():",
        {},
        "not complementary",
    ),
    "input modified": (
        psor,
        "z, d =",
        "M /= M.diagonal()[:, None]\n    z, d =",
        {},
        "modified its input M",
    ),
}


@pytest.fixture(autouse=True)
def as_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Problems are not made smaller here: that a bug is found is the claim, and shrinking takes most of the time."""
    monkeypatch.setattr(strategies, "PHASES", (Phase.generate,))


@pytest.mark.few(2)
@pytest.mark.parametrize("name", BUGS)
def test_planted_bugs_are_found(name: str) -> None:
    """One bug, put alone into a correct solver, is found within 500 problems of the class it is meant for."""
    solver, right, wrong, options, report = BUGS[name]
    with (
        pytest.raises(AssertionError, match=f"{solver.__name__}: .*({report})") as found,
        np.errstate(all="ignore"),
    ):
        assert_solves(
            planted(solver, right, wrong),
            **{"matrices": DOMINANT, "max_examples": ENOUGH, **options},
        )
    assert "problem = LCP([[" in str(found.value)


def damped(solver: Solver, omega: float = 0.15) -> Solver:
    return functools.wraps(solver)(functools.partial(solver, omega=omega))


@pytest.mark.full
def test_nan_that_passes_as_solved_is_found() -> None:
    """A sweep that diverges on free rows until z is NaN gives up; with a check that NaN passes it is found."""
    options = {"matrices": DOMINANT, "bounds": True, "may_give_up": True}
    passing = planted(psor, CHECK, "if not residual > 1e-8:")
    with np.errstate(all="ignore"):
        with pytest.raises(AssertionError, match="psor: z is not finite"):
            assert_solves(damped(passing, 40.0), max_examples=ENOUGH, **options)
        assert_solves(damped(psor, 40.0), max_examples=60, **options)


@pytest.mark.full
@pytest.mark.parametrize("solver", [psor, least_index])
def test_correct_solvers_pass(solver: Solver) -> None:
    """The toys without a bug pass many problems, with bounds too, and with problems that have no solution."""
    with np.errstate(all="ignore"):
        assert_solves(solver, matrices=DOMINANT, bounds=True, max_examples=MANY)
