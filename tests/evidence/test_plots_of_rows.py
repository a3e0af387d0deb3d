"""Pictures of some rows over their coordinates, as of a contact pressure over the place."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from lcp_plugin import LCP, solve
from lcp_plugin.core.errors import InvalidOption

plt = pytest.importorskip("matplotlib.pyplot")


@cache
def result() -> Any:
    return solve(LCP(np.diag([2.0, 1.0, 4.0, 1.0]), [-2.0, 1.0, -8.0, 3.0]))


def test_rows_are_drawn_over_their_coordinates() -> None:
    """A curve in the order of the coordinates, z and w a panel each; in the plane points with their values."""
    figure = result().plot(rows=[0, 2, 3], over=[3.0, 9.0, 1.0, 2.0]).figure
    of_z, of_w = (axes.lines[0].get_xydata().tolist() for axes in figure.axes)
    assert of_z == [[1.0, 2.0], [2.0, 0.0], [3.0, 1.0]]
    assert of_w == [[1.0, 0.0], [2.0, 3.0], [3.0, 0.0]]
    plt.close(figure)
    figure = result().plot(rows=[True, False, True, False], over=[[0.0, 1.0], [2.0, 3.0]]).figure
    assert figure.axes[0].collections[0].get_offsets().tolist() == [[0.0, 1.0], [2.0, 3.0]]
    assert figure.axes[0].collections[0].get_array().tolist() == [1.0, 2.0]
    plt.close(figure)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"rows": [4]}, "rows must be whole numbers from 0 to 3, or 4 truth values, got"),
        ({"over": np.zeros((4, 3))}, r"shape \(n,\) or \(n, 2\), got shape \(4, 3\)"),
        ({"over": "x"}, "over must hold real coordinates"),
        ({"rows": [0], "shape": (2, 2)}, "give it without rows and over"),
    ],
)
def test_what_rows_and_coordinates_must_be(given: dict[str, Any], message: str) -> None:
    """Numbers of rows, and a place for each: what is else is refused in words."""
    with pytest.raises(InvalidOption, match=message):
        result().plot(**given)
