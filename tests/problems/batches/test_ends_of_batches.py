"""Batches end with a status for each problem: without time, after an error, after a callback; they travel."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest

from lcp_plugin import (
    LCP,
    BoundedLeastSquares,
    FrictionalContact,
    NonlinearProblem,
    QuadraticProgram,
    Status,
    solve_batch,
)

RNG = np.random.default_rng(7)
A = RNG.normal(size=(40, 4, 4))
M = A @ A.transpose(0, 2, 1) + np.eye(4)
Q = RNG.normal(size=(40, 4))
FIT = BoundedLeastSquares(RNG.normal(size=(7, 3)), np.zeros(7))
PROGRAM = QuadraticProgram(np.eye(3), np.zeros(3), G=[[1, 1, 1]], h=[1], lower=0, constant=2.0)
PAIR = [LCP([[2.0, 1.0], [1.0, 2.0]], q) for q in ([-1.0, 2.0], [-3.0, -3.0])]
SLIDING = FrictionalContact(np.eye(3), [-1.0, 3.0, 4.0], 0.5)


BATCHES: dict[str, tuple[tuple[Any, ...], dict[str, Any]]] = {
    "arrays": ((M, Q), {}),
    "arrays with starts": ((M, Q), {"z0": np.ones(4)}),
    "one start per array": ((M, Q), {"z0": np.ones((40, 4))}),
    "a list with starts": ((PAIR,), {"z0": [np.ones(2), None]}),
    "a list that starts without a start": ((PAIR,), {"z0": [None, np.ones(2)]}),
    "one matrix": ((LCP(M[0], Q[0]), Q), {"upper": 1.0}),
    "a list": (([LCP(M[k], Q[k]) for k in range(9)] + [LCP([[2.0]], [-1.0])],), {}),
    "a named algorithm": ((M, Q), {"algorithm": "newton"}),
    "least squares": ((FIT, RNG.normal(size=(30, 7))), {}),
    "programs": ((PROGRAM, RNG.normal(size=(30, 3))), {}),
    "contacts": (
        (
            FrictionalContact.worlds(
                np.eye(6), RNG.normal(size=(20, 6)), 0.5, contacts=np.arange(20) % 3, dimension=3
            ),
        ),
        {},
    ),
    "all classes": (([SLIDING, FIT, PROGRAM, LCP(M[0], Q[0]), LCP([[1.0]], [-2.0])],), {}),
}


@pytest.mark.parametrize("name", BATCHES)
def test_a_batch_without_time_loses_no_problem(name):
    """With no time at all each problem ends with MAX_SECONDS or is solved."""
    given, options = BATCHES[name]
    late = solve_batch(*given, max_seconds=0.0, **options)
    assert {*late.status} <= {Status.SOLVED, Status.MAX_SECONDS}
    assert len(late) == len(late.status) == len(late.x)
    assert late[0].status is late.status[0]


@pytest.mark.parametrize("name", BATCHES)
def test_the_results_of_a_batch_travel_between_processes(name):
    """A process can return the results: unpickled, they have the same bits, statuses and single results."""
    given, options = BATCHES[name]
    here = solve_batch(*given, callback=lambda *_: None, **options)
    there = pickle.loads(pickle.dumps(here))
    assert list(there.status) == list(here.status)
    assert there.all_solved
    for one, other in zip(there.x, here.x, strict=True):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(there.objective, here.objective)
    np.testing.assert_array_equal(there[1].x, here[1].x)


def test_a_batch_without_a_valid_problem_has_only_errors():
    """The length is the number of problems, and each has its error."""
    answers = solve_batch(M[0], np.full((3, 4), np.nan))
    assert len(answers) == 3
    assert answers.errors.keys() == {0, 1, 2}


def test_a_callback_ends_a_batch():
    """Problems without a result are INTERRUPTED after the callback."""
    ended = solve_batch(M, Q, algorithm="newton", callback=lambda *_: True)
    assert {*ended.status} == {Status.INTERRUPTED, Status.SOLVED}


def _fails(x: Any) -> Any:
    raise ZeroDivisionError("demand 0")


def test_an_error_of_a_function_has_the_number_of_its_problem():
    """The exception passes as it is, with a note and the results before it."""
    problems = [NonlinearProblem(np.exp, lower=[0.0])] * 70
    with pytest.raises(ZeroDivisionError, match="demand 0") as caught:
        solve_batch([*problems, NonlinearProblem(_fails, lower=[0.0])])
    assert caught.value.__notes__ == ["in problem 70 of the batch"]
    finished = caught.value.finished  # type: ignore[attr-defined]
    assert finished.counts() == "70 SOLVED, 1 INTERRUPTED"


@pytest.mark.parametrize("name", ["w", "motion"])
@pytest.mark.parametrize("given", [(PROGRAM, Q[:2, :3]), (FIT, np.ones((2, 7))), ([FIT, PAIR[0]],)])
def test_an_array_that_the_problems_lack_is_an_error_of_batch_answers(name, given):
    """The message has the name of the public class and the arrays of the batch, not the name of an internal class."""
    answers = solve_batch(*given)
    with pytest.raises(
        AttributeError, match=f"BatchAnswers .* no {name}; its arrays include status, x"
    ):
        getattr(answers, name)
    with pytest.raises(AttributeError, match="has no motion"):
        _ = solve_batch(PAIR).motion
