"""A vector may be a column, a row, a matrix of numpy or cvxopt, a Series; a table of text names its column."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lcp_plugin import LCP, BoundedLeastSquares, InvalidProblem, QuadraticProgram, solve

M, VALUES = np.array([[2.0, 1.0], [1.0, 2.0]]), [-5.0, 1.0]
FORMS = {
    "column": lambda v: np.reshape(v, (2, 1)),
    "row": lambda v: np.reshape(v, (1, 2)),
    "list of lists": lambda v: [[one] for one in v],
    "np.matrix": lambda v: np.reshape(v, (2, 1)).view(np.matrix),
    "cvxopt": lambda v: pytest.importorskip("cvxopt").matrix(v),
    "Series": lambda v: pytest.importorskip("pandas").Series(v, index=["a", "b"]),
    "DataFrame": lambda v: pytest.importorskip("pandas").DataFrame({"demand": v}),
    "Int64": lambda v: pytest.importorskip("pandas").Series([int(x) for x in v], dtype="Int64"),
}


@pytest.mark.parametrize("form", FORMS)
def test_a_vector_of_any_form_gives_the_same_solution(form):
    """The size decides: (2, 1) and (1, 2) are vectors of length 2, as data and as bounds."""
    given = FORMS[form]
    for problem, x in (
        (LCP(M, given(VALUES), lower=given([0.0, 0.0]), upper=given([9.0, 9.0])), 2.5),
        (QuadraticProgram(M, given(VALUES), lower=given([0.0, 0.0])), 2.5),
        (BoundedLeastSquares(M, given([5.0, 2.0])), 2.4),
    ):
        np.testing.assert_allclose(solve(problem).x, [x, 0.0], atol=1e-9)


def test_tables_of_pandas_are_matrices_and_names():
    """Whole numbers of the type Int64 are numbers, and an index is a list of names."""
    pandas = pytest.importorskip("pandas")
    table = pandas.DataFrame({"a": pandas.array([2, 1], dtype="Int64"), "b": [1.0, 2.0]})
    problem = LCP(table, pandas.Series(VALUES), names=table.columns)
    assert solve(problem).z.tolist() == [2.5, 0.0]
    assert problem.names.row(1) == "b"


@pytest.mark.parametrize(
    ("column", "words"),
    [
        (["x", "y"], r"column 'b' has others, got .*dtype str"),
        ([1.0, None], r"M\[1, 1\] = nan"),
        ([1.0 + 1.0j, 2.0], "column 'b' has others, got complex"),
    ],
)
def test_a_table_with_a_wrong_entry_names_its_column_or_entry(column: list[Any], words: str):
    pandas = pytest.importorskip("pandas")
    table = pandas.DataFrame({"a": pandas.array([2, 1], dtype="Int64"), "b": column})
    with pytest.raises(InvalidProblem, match=words):
        LCP(table, VALUES)
    with pytest.raises(InvalidProblem, match="column 'demand' has others"):
        LCP(M, pandas.Series(["high", "low"], name="demand"))
