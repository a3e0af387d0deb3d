"""Batches of quadratic programs: answers known before, the same as one by one, judged on each program."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from inputs.planted import planted_program
from inputs.stacked_programs import programs_of
from tools.refusals import assert_refused, refusals

from lcp_plugin import (
    InvalidProblem,
    QuadraticProgram,
    Status,
    UnsupportedModel,
    solve,
    solve_batch,
)
from lcp_plugin.problems.batches.batch_run import BatchAnswers
from lcp_plugin.problems.programs.no_minimum import QPInfeasibility, QPUnboundedness

INF = np.inf
KINDS = ("definite", "semidefinite", "linear", "dependent", "graded")
NAMES = ("P", "c", "G", "h", "A", "b", "lower", "upper")


def planted(kind: str, count: int, seed: int = 0) -> tuple[list[QuadraticProgram], np.ndarray]:
    """Return stacked programs of a kind, and their least values, which were drawn first."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    n = int(rng.integers(2, 11))
    rows, equations = int(rng.integers(0, 2 * n + 3)), int(rng.integers(0, n // 2 + 1))
    rank = {"semidefinite": n // 2, "linear": 0}.get(kind, n + 2)
    drawn = [
        planted_program(n, rows, equations, rank, int(rng.integers(2**31))) for _ in range(count)
    ]
    data = {name: np.stack([getattr(program, name) for program, *_ in drawn]) for name in NAMES}
    if kind == "graded":
        for matrix, right in (("G", "h"), ("A", "b")):
            sizes = 10.0 ** rng.uniform(-5, 5, data[right].shape)
            data[matrix], data[right] = sizes[:, :, None] * data[matrix], sizes * data[right]
    if kind == "dependent":  # each row again, and one without a limit
        data["G"] = np.concatenate([data["G"], data["G"], data["P"][:, :1]], axis=1)
        data["h"] = np.hstack([data["h"], data["h"], np.full((count, 1), INF)])
    return programs_of(**data), np.array([value for *_, value in drawn])


def dense(count: int, n: int = 6, m: int = 12, seed: int = 0) -> tuple[Any, ...]:
    """Stacked P, c, G, h of strictly convex programs whose rows meet at a point."""
    rng = np.random.default_rng(seed)
    factor = rng.normal(size=(count, n, n))
    G = rng.normal(size=(count, m, n))
    x = rng.normal(size=(count, n))
    P = factor @ factor.transpose(0, 2, 1) + 0.1 * np.eye(n)
    h = np.einsum("kij,kj->ki", G, x) + rng.random((count, m))
    return (P + P.transpose(0, 2, 1)) / 2, 3.0 * rng.normal(size=(count, n)), G, h


def bits(answers: BatchAnswers) -> list[bytes]:
    """All numbers of a result."""
    names = ("x", "inequality", "equality", "lower", "upper", "objective", "residual", "iterations")
    return [getattr(answers, name).tobytes() for name in names]


# --- Answers -----------------------------------------------------------------------------------------------------


@pytest.mark.quick(1)
@pytest.mark.parametrize("kind", KINDS)
def test_planted_programs_are_solved_in_the_compiled_loop(kind):
    """Every kind of row and bound, P definite, semidefinite or 0: the least value that was known before."""
    for seed in range(6):
        programs, least = planted(kind, 25, seed)
        answers = solve_batch(programs)
        assert answers.all_solved
        np.testing.assert_allclose(answers.objective, least, rtol=1e-6, atol=1e-6)


# --- One bad item, and the others --------------------------------------------------------------------------------


def test_a_bad_program_costs_that_one_alone():
    """NaN, ∞ and crossed bounds have an error each, and the bits of the other programs stay the same."""
    (P, *_), c, (G, *_), (h, *_) = dense(12)
    program = QuadraticProgram(P, c[0], G, h, lower=-9.0, upper=9.0)
    given = [{"c": one} for one in c]
    before = solve_batch(program, given)
    wrong = {"c": (2, np.nan), "h": (1, -INF), "lower": (3, 10.0), "upper": (0, -INF)}
    for k, (name, (i, value)) in enumerate(wrong.items(), 1):
        given[k] = {name: np.where(np.arange(getattr(program, name).size) == i, value, 0.0)}
    answers, bad = solve_batch(program, given), [1, 2, 3, 4]
    assert sorted(answers.errors) == bad
    assert [k for k, status in enumerate(answers.status) if status is None] == bad
    assert {type(error) for error in answers.errors.values()} == {InvalidProblem}
    assert "h must be finite or inf, but h[1] = -inf" in str(answers.errors[2])
    with pytest.raises(InvalidProblem, match="c must be finite"):
        answers[1]
    bent = solve_batch([program, QuadraticProgram(P - 100.0 * np.eye(6), c[0], G, h), program])
    assert isinstance(bent.errors.pop(1), UnsupportedModel)
    assert not bent.errors
    assert np.isnan(answers.x[bad]).all()
    assert np.isnan(answers.objective[bad]).all()
    assert not answers.all_solved
    for k in (0, *range(5, 12)):
        assert answers.x[k].tobytes() == before.x[k].tobytes()
    assert "8 SOLVED" in repr(answers)
    assert "4 invalid" in repr(answers)


def test_programs_without_a_minimum_come_with_a_proof():
    """Contradicting rows, a slope without end, and one with a minimum; where no proof is wanted, none is looked for."""
    programs = programs_of(
        np.diag([1.0, 0.0]),
        [[0.0, 1.0], [0.0, -1.0], [0.0, 1.0]],
        G=[[-1.0, 0.0], [1.0, 0.0]],
        h=[[-1.0, 0.0], [1.0, 1.0], [1.0, 1.0]],
        lower=[-INF, 0.0],
    )
    answers = solve_batch(programs)
    assert answers.status.tolist() == [Status.INFEASIBLE, Status.UNBOUNDED, Status.SOLVED]
    assert isinstance(answers[0].proof, QPInfeasibility)
    assert isinstance(answers[1].proof, QPUnboundedness)
    assert answers[1].proof.verify()
    unproved = solve_batch(programs, prove_infeasibility=False)
    assert unproved.status.tolist() == [Status.STALLED, Status.STALLED, Status.SOLVED]


# --- Arrays, threads, clock --------------------------------------------------------------------------------------


def test_arrays_for_all_programs_are_broadcast():
    """Each of P, c, G, h, A, b and the bounds stacked or the same for all: the same bits, and the same programs."""
    rng, count = np.random.default_rng(1), 5
    (P,), (c,), (G,), (h,) = dense(1)
    A = rng.normal(size=(2, 6))
    one = {"P": P, "c": c, "G": G, "h": h + 5.0, "A": A, "b": A @ np.full(6, 0.1)}
    one |= {"lower": np.full(6, -2.0), "upper": 3.0}
    whole = bits(
        solve_batch(
            programs_of(
                **{
                    name: np.stack([np.full(6, values) if np.ndim(values) == 0 else values] * count)
                    for name, values in one.items()
                }
            )
        )
    )
    for name in ("P", "c", "G", "h", "A", "b", "lower"):
        programs = programs_of(**one | {name: np.stack([one[name]] * count)})
        assert len(programs) == count
        assert bits(solve_batch(programs)) == whole
        assert programs[-1].objective(np.ones(6)) == programs[0].objective(np.ones(6))
    alone = programs_of(**one)
    assert bits(solve_batch(alone[0], np.stack([c] * count))) == whole
    assert solve_batch(alone).all_solved


def test_programs_without_rows_or_variables():
    """No rows, no variables."""
    free = solve_batch(programs_of(2.0 * np.eye(2), [[2.0, -4.0]]))
    np.testing.assert_allclose(free.x, [[-1.0, 2.0]], rtol=1e-14)
    box = solve_batch(programs_of(np.zeros((2, 2)), [[2.0, -4.0]], lower=-1.0, upper=[1.0, 3.0]))
    assert box.x.tolist() == [[-1.0, 3.0]]
    np.testing.assert_allclose(box.lower, [[2.0, 0.0]], rtol=1e-14)
    np.testing.assert_allclose(box.upper, [[0.0, 4.0]], rtol=1e-14)
    assert solve_batch(programs_of(np.zeros((0, 0)), np.zeros((2, 0)))).all_solved


# --- Mistakes ----------------------------------------------------------------------------------------------------

ONE = (np.eye(2), [1.0, 2.0])


@refusals(r"""
solve_batch(one, [[1.0, 2.0]], z0=[0.0, 0.0]) → InvalidOption: takes no z0
solve_batch(one, [[1.0, 2.0]], lower=1.0) → InvalidOption: the vectors already contain
solve_batch([one, one], "lemke") → InvalidOption: algorithm='lemke'
solve_batch([LCP(np.eye(2), [1, -1])], "lemke") → InvalidOption: algorithm='lemke'
solve_batch(one, [[1.0, 2.0]], threads=0) → InvalidOption: threads
solve_batch(one, [[1.0, 2.0]], tolerance=-1.0) → InvalidOption: tolerance
solve_batch(one, [[1.0, 2.0]], algorithm="interior_pont") → UnknownAlgorithm: interior_point
solve_batch(QuadraticProgram([[1.0, 2.0], [2.0, 1.0]], [0, 0]), np.zeros((5, 2)))
    → UnsupportedModel: the smallest eigenvalue of P is -1
""")
def test_an_error_of_all_programs_is_raised_before_the_first(call, words):
    """Options that a batch of programs does not take, unknown algorithms, a P for all that is not convex."""
    assert_refused(call, words, {"one": QuadraticProgram(*ONE)})


def test_terms_that_cancel_excuse_an_error_beside_them_alone():
    """−x₁ + (1 − 10⁻¹⁰) x₂ over x₁ = x₂, 10⁶ ≤ x ≤ 10⁸: what is SOLVED is off by no more than 10⁻⁶ of its terms."""
    batch = programs_of(
        np.zeros((2, 2)), [[-1.0, 1.0 - 1e-10]] * 2, A=[[1.0, -1.0]], b=[0.0], lower=1e6, upper=1e8
    )
    answers = solve_batch(batch)
    for one, status in zip(answers, answers.status, strict=True):
        assert status == one.status
        terms = np.abs(batch[0].c * one.x).sum()
        assert status is not Status.SOLVED or one.objective == pytest.approx(
            -1e-2, abs=1e-6 * terms
        )


def test_programs_of_a_list_are_answered_together():
    """A list, or one program with many vectors, gives x, objective and status in rows."""
    rng, programs = np.random.default_rng(3), []
    for _ in range(5):
        factor, G = rng.normal(size=(4, 4)), rng.normal(size=(3, 4))
        programs.append(
            QuadraticProgram(factor @ factor.T + np.eye(4), rng.normal(size=4), G, rng.random(3))
        )
    listed = solve_batch(programs)
    changed = solve_batch(programs[0], [{"c": one.c} for one in programs])
    assert listed.x.shape == changed.x.shape == (5, 4)
    for k, one in enumerate(programs):
        for answers, program in ((listed, one), (changed, programs[0].with_vectors(c=one.c))):
            alone = solve(program)
            np.testing.assert_allclose(answers.x[k], alone.x, rtol=1e-9, atol=1e-12)
            assert answers.objective[k] == pytest.approx(alone.objective, rel=1e-9)
            assert answers[k].status is answers.status[k] is Status.SOLVED


def test_a_number_stands_for_a_vector_of_one():
    """A right-hand side of one row is written as a number; a wrong length is told by the advice of the batch."""
    program = QuadraticProgram(
        np.eye(2), [-1.0, 0.0], A=[[1.0, 1.0]], b=[1.0], G=[[1.0, 0.0]], h=[3.0]
    )
    answers = solve_batch(program, [{"b": 1}, {"b": 2, "h": 1}, {"b": [1, 2]}])
    np.testing.assert_allclose(answers.x[:2], [[1.0, 0.0], [1.0, 1.0]], atol=1e-9)
    assert (
        answers.advice
        == "program 2: no program: b must be a vector of length 1, got shape (2,): 1 too many"
    )
    assert solve_batch(program, [{"b": 1}]).advice == solve(program).status.value


def test_seconds_of_a_result_are_those_of_the_batch():
    """A second look at a result shows the same seconds as the first."""
    answers = solve_batch([QuadraticProgram(np.eye(2), [-1, k]) for k in (1, 2)])
    assert answers[0].seconds == answers[0].seconds <= answers.seconds
