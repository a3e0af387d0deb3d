"""``answer.plot()``: every kind of answer has a picture, into axes of the caller's or a figure of its own."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

from lcp_plugin import (
    LCP,
    BoundedLeastSquares,
    ConeProblem,
    EquilibriumProgram,
    FrictionalContact,
    InvalidOption,
    NonlinearProblem,
    QuadraticProgram,
    UnsuitableProblem,
    gallery,
    solve,
    trace,
)
from lcp_plugin.evidence.drawing import plot_answer

figure = pytest.importorskip("matplotlib.figure")
M, q = np.array([[2.0, 1.0], [1.0, 2.0]]), np.array([-5.0, 1.0])
PROGRAM = QuadraticProgram(M, q, G=[[1, 1]], h=[2.0], lower=0.0)
PAIR = QuadraticProgram(np.eye(2), [-2.0, -1.0], lower=0.0)


@pytest.fixture(autouse=True)
def without_a_screen(monkeypatch):
    """No window opens."""
    import matplotlib as mpl

    before = mpl.get_backend()
    mpl.use("Agg")
    yield
    mpl.use(before)


ANSWERS: dict[str, Callable[[], Any]] = {
    "many unknowns": lambda: solve(LCP(sp.eye_array(3000), -np.ones(3000))),
    "an LCP": lambda: solve(LCP(M, q)),
    "contact with friction": lambda: solve(FrictionalContact(np.eye(3), [-1.0, 3.0, 4.0], 0.5)),
    "contact in the plane": lambda: solve(FrictionalContact(np.eye(2), [[-1.0, 0.25]], 0.5)),
    "a cone": lambda: solve(ConeProblem(np.eye(3), [0.0, -2.0, 0.0], [("second_order", 3)])),
    "recorded": lambda: solve(LCP(M, q), "npsor", record=True),
    "empty": lambda: solve(LCP(np.zeros((0, 0)), [])),
    "nonlinear": lambda: solve(NonlinearProblem(lambda x: x**3 - 1.0, lower=0.0), x0=[2.0, 3.0]),
    "a program": lambda: solve(PROGRAM),
    "a recorded program": lambda: solve(PROGRAM, record=True),
    "least squares": lambda: solve(BoundedLeastSquares(M, q)),
    "an equilibrium": lambda: solve(EquilibriumProgram(PAIR, [0], [1])),
}


@pytest.mark.quick(1)
@pytest.mark.parametrize("name", ANSWERS)
def test_every_answer_has_a_picture(name, tmp_path):
    """One call draws a figure of its own with something in it, which can be saved; the same into axes of the caller."""
    answer = ANSWERS[name]()
    axes = answer.plot()
    axes.figure.savefig(tmp_path / "own.png")
    assert (tmp_path / "own.png").stat().st_size > 2000
    given = figure.Figure().subplots()
    assert answer.plot(axes=given) is given
    assert given.has_data() or name == "empty"


def test_a_grid_shows_a_map():
    """With its shape z is a map with rows and columns; of three axes the middle slice; other shapes are refused."""
    result = solve(gallery.obstacle_2d(size=12).problem)
    axes = result.plot(shape=(12, 12))
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("column", "row")
    np.testing.assert_array_equal(
        axes.collections[0].get_array().reshape(12, 12), result.z.reshape(12, 12)
    )
    np.testing.assert_array_equal(
        result.plot(shape=(3, 4, 12)).collections[0].get_array().reshape(4, 12),
        result.z.reshape(3, 4, 12)[1],
    )
    assert result.plot(shape=(144,)).get_xlabel() == "index"
    assert result.plot(shape=(1, 144)).get_xlabel() == "index"
    for shape, words in (
        ((12, 13), r"grid of the 144 unknowns, as .rows, columns., got \(12, 13\)"),
        ((0, 12), "grid of the 144"),
        ((1.5, 96), "grid of the 144"),
        ((), "grid of the 144"),
        ("12x12", "grid of the 144"),
    ):
        with pytest.raises(InvalidOption, match=words):
            result.plot(shape=shape)


def test_a_grid_is_found_and_indices_and_names_are_labels():
    """A matrix that couples neighbors of a grid makes a map; a dense one does not; ticks are whole numbers or names."""
    result = solve(gallery.obstacle_2d(size=12).problem)
    assert result.plot().get_xlabel() == "column"
    np.testing.assert_array_equal(
        result.plot().collections[0].get_array().reshape(12, 12), result.z.reshape(12, 12)
    )
    string = sp.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(9, 9))
    for M in (string, np.ones((9, 9)) + np.eye(9)):
        assert solve(LCP(M, -np.ones(9))).plot().get_xlabel() == "index"
    axes = solve(LCP(np.eye(3), [-1.0, 0.5, -1.0])).plot()
    assert all(float(tick).is_integer() for tick in axes.get_xticks())
    named = solve(LCP([[2.0, 1.0], [1.0, 2.0]], [-5.0, 1.0], names=["coal", "steel"]))
    assert [label.get_text() for label in named.plot().get_xticklabels()] == ["coal", "steel"]
    path = trace(named.certificate.problem, {"q": [1.0, -1.0]}, 0.0, 4.0).plot()
    assert [text.get_text() for text in path.get_legend().get_texts()] == ["coal", "steel"]


def test_what_cannot_be_drawn_is_refused_in_words():
    """No x, and what is not an answer."""
    nothing = QuadraticProgram(np.eye(2), [0.0, 0.0], A=[[1.0, 1.0]], b=[-1.0], lower=0.0)
    with pytest.raises(UnsuitableProblem, match="no x to draw: INFEASIBLE"):
        solve(EquilibriumProgram(nothing, [0], [1])).plot()
    with pytest.raises(InvalidOption, match="needs an answer of solve, got LCP"):
        plot_answer(LCP(M, q))


def test_impulses_are_drawn_in_their_cones():
    """Open, sticking and sliding contacts are told apart; one that slides lies on the circle."""
    b = [[-1.0, 3.0, 4.0], [-1.0, 0.1, 0.0], [1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]]
    axes = solve(FrictionalContact(np.eye(12), b, [0.5, 0.5, 0.5, 0.0])).plot()
    assert [one.get_text() for one in axes.get_legend().get_texts()] == [
        "2 stick",
        "1 slide",
        "1 open",
    ]
    sliding = axes.collections[1].get_offsets()
    np.testing.assert_allclose(sliding, [[-0.6, -0.8]], atol=1e-7)
