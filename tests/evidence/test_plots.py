"""``answer.plot()``: every kind of answer has a picture, into axes of the caller's or a figure of its own."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
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
    QuadraticProgramBatch,
    UnsuitableProblem,
    gallery,
    march,
    solve,
    solve_batch,
)
from lcp_plugin.evidence.plots import plot_answer

figure = pytest.importorskip("matplotlib.figure")
M, q = np.array([[2.0, 1.0], [1.0, 2.0]]), np.array([-5.0, 1.0])
PROGRAM = QuadraticProgram(M, q, G=[[1, 1]], h=[2.0], lower=0.0)
CONTRADICTION = QuadraticProgram(M, q, G=[[1.0, 0.0], [-1.0, 0.0]], h=[-1.0, 0.0])
PAIR = QuadraticProgram(np.eye(2), [-2.0, -1.0], lower=0.0)


@pytest.fixture(autouse=True)
def without_a_screen(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """No window opens, and no figure is left."""
    import matplotlib as mpl

    before = mpl.get_backend()
    mpl.use("Agg")
    from matplotlib import pyplot

    yield
    pyplot.close("all")
    mpl.use(before)


def heat(steps: int, n: int) -> Any:
    """A rod on an obstacle, which it sinks onto."""
    L = sp.diags_array([-np.ones(n - 1), 2 * np.ones(n), -np.ones(n - 1)], offsets=[-1, 0, 1])
    return march(LCP(sp.eye_array(n) + L, np.zeros(n)), np.full((steps, n), 0.1), z0=np.ones(n))


ANSWERS: dict[str, Callable[[], Any]] = {
    "an LCP": lambda: solve(LCP(M, q)),
    "contact with friction": lambda: solve(FrictionalContact(np.eye(3), [-1.0, 3.0, 4.0], 0.5)),
    "contact in the plane": lambda: solve(FrictionalContact(np.eye(2), [[-1.0, 0.25]], 0.5)),
    "a cone": lambda: solve(ConeProblem(np.eye(3), [0.0, -2.0, 0.0], [("second_order", 3)])),
    "recorded": lambda: solve(LCP(M, q), "npsor", record=True),
    "empty": lambda: solve(LCP(np.zeros((0, 0)), [])),
    "infeasible": lambda: solve(LCP([[0.0]], [-1.0])),
    "nonlinear": lambda: solve(NonlinearProblem(lambda x: x**3 - 1.0, lower=0.0), x0=[2.0, 3.0]),
    "a program": lambda: solve(PROGRAM),
    "a recorded program": lambda: solve(PROGRAM, record=True),
    "without a point": lambda: solve(CONTRADICTION),
    "least squares": lambda: solve(BoundedLeastSquares(M, q)),
    "an equilibrium": lambda: solve(EquilibriumProgram(PAIR, [0], [1])),
    "a march": lambda: heat(8, 30),
    "a long march": lambda: heat(3, 2500),
    "one step": lambda: heat(1, 2),
    "a batch": lambda: solve_batch([M, -M, M], [q, q, [np.nan, 1.0]]),
    "programs": lambda: solve_batch(QuadraticProgramBatch(M, [q, -q])),
    "a list": lambda: solve_batch([PROGRAM, CONTRADICTION]),
}


@pytest.mark.sampled(1)
@pytest.mark.parametrize("name", ANSWERS)
def test_every_answer_has_a_picture(name: str, tmp_path: Path) -> None:
    """One call draws a figure of its own with something in it, which can be saved; the same into axes of the caller."""
    answer = ANSWERS[name]()
    axes = answer.plot()
    axes.figure.savefig(tmp_path / "own.png")
    assert (tmp_path / "own.png").stat().st_size > 2000
    given = figure.Figure().subplots()
    assert answer.plot(axes=given) is given
    assert given.has_data() or name == "empty"


def test_a_grid_shows_a_map() -> None:
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
        ((12, 13), r"shape \(12, 13\) is that of 156 unknowns, and the problem has 144"),
        ((0, 12), "whole numbers > 0"),
        ((1.5, 96), "whole numbers > 0"),
        (144, "whole numbers"),
        ((), "whole numbers"),
        ("12x12", "whole numbers"),
    ):
        with pytest.raises(InvalidOption, match=words):
            result.plot(shape=shape)


def test_a_march_over_a_grid_shows_slices() -> None:
    """One map for each of some steps, the last one the last step."""
    done = heat(9, 30)
    axes = done.plot(shape=(5, 6))
    assert len([one for one in axes.figure.axes if one.get_xlabel() == "column"]) == 4
    np.testing.assert_array_equal(
        axes.collections[0].get_array().reshape(5, 6), done.z[-1].reshape(5, 6)
    )


def test_long_vectors_are_no_solid_block() -> None:
    """Without a grid 90 000 values are a histogram of free and held ones, which says how to draw them in place."""
    result = solve(gallery.obstacle_2d(size=300).problem)
    axes = result.plot()
    assert sum(patch.get_height() for patch in axes.patches) == result.z.size
    assert "plot(shape=…) or plot(mesh=…)" in axes.get_title(loc="left")
    edges = [patch.get_x() for patch in axes.patches]
    assert min(edges) == pytest.approx(result.z.min())


def quads(size: int) -> tuple[np.ndarray, np.ndarray]:
    """The nodes of a square grid and its cells, in the order of obstacle_2d's unknowns."""
    points = (
        np.stack(np.meshgrid(np.arange(size), np.arange(size)), axis=-1)
        .reshape(-1, 2)
        .astype(float)
    )
    corner = (np.arange(size - 1)[:, None] * size + np.arange(size - 1)).ravel()
    return points, np.stack([corner, corner + 1, corner + size + 1, corner + size], axis=1)


def test_a_mesh_shows_the_values_of_its_points() -> None:
    """Of triangles and quadrilaterals; of several unknowns a point one of them, or the norm of all."""
    result = solve(gallery.obstacle_2d(size=12).problem)
    points, cells = quads(12)
    for given in (cells, np.concatenate([cells[:, :3], cells[:, [0, 2, 3]]])):
        axes = result.plot(mesh=(points, given))
        assert axes.collections[0].get_array().tolist() == result.z.tolist()
        assert len(axes.lines[0].get_xdata()) == np.count_nonzero(
            result.z == result.certificate.problem.lower
        )
    axes = result.plot(mesh=quads(6), component=1)
    assert axes.collections[0].get_array().tolist() == result.z.reshape(36, 4)[:, 1].tolist()
    axes = result.plot(mesh=quads(6))
    np.testing.assert_allclose(
        axes.collections[0].get_array(), np.linalg.norm(result.z.reshape(36, 4), axis=1)
    )


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"mesh": quads(5)}, "a divisor of the 144 unknowns"),
        ({"mesh": 3}, "got int"),
        ({"mesh": (quads(12)[0].T, quads(12)[1])}, "transpose what is stored by columns"),
        ({"mesh": (quads(12)[0], quads(12)[1] + 1)}, "numbers of points, from 0 to 143, got 144"),
        (
            {"mesh": quads(6), "component": 4},
            "component must be 'norm' or a whole number from 0 to 3, got 4",
        ),
    ],
)
def test_what_a_mesh_must_be(given: dict[str, Any], words: str) -> None:
    """Points, and cells of their numbers; anything else is refused in words."""
    with pytest.raises(InvalidOption, match=words):
        solve(gallery.obstacle_2d(size=12).problem).plot(**given)


def test_a_search_shows_its_bound() -> None:
    """Beside x the proved bound, which never falls and ends at that of the result."""
    from benchmarks.best_equilibria import random_leader

    result = solve(random_leader(10, True), prove=True)
    beside = result.plot().figure.axes[1]
    bounds = beside.lines[0].get_ydata()
    assert (np.diff(bounds) >= 0.0).all()
    assert bounds[-1] == pytest.approx(result.lower_bound, abs=1e-6)


def test_what_cannot_be_drawn_is_refused_in_words() -> None:
    """No step, a shape of a batch, what is no answer."""
    with pytest.raises(InvalidOption, match=r"shape goes with one answer: answers\[k\]\.plot"):
        solve_batch([M], [q]).plot(shape=(1, 2))
    with pytest.raises(UnsuitableProblem, match="no step to draw"):
        march(LCP(M, q), np.zeros((0, 2))).plot()
    with pytest.raises(InvalidOption, match="needs what solve returns, got LCP"):
        plot_answer(LCP(M, q))


def test_impulses_are_drawn_in_their_cones() -> None:
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


def test_contacts_in_the_plane_are_drawn_by_their_number() -> None:
    """There is one tangent: the second axis counts contacts, and limits are at ±1."""
    axes = solve(FrictionalContact(np.eye(4), [[-1.0, 0.25], [-1.0, 2.0]], 0.5)).plot()
    assert axes.get_ylabel() == "contact"
    stick, slide, _ = axes.collections
    np.testing.assert_allclose(stick.get_offsets(), [[-0.5, 0.0]], atol=1e-7)
    np.testing.assert_allclose(slide.get_offsets(), [[-1.0, 1.0]], atol=1e-7)
    assert [text.get_text() for text in axes.get_legend().get_texts()] == [
        "1 stick",
        "1 slide",
        "0 open",
    ]
