"""Contents of .nl files, and of the .sol files that answer them."""

from __future__ import annotations

import math
import operator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from lcp_plugin.interfaces.nl.expressions import NAMES, OPERATORS, evaluated_tree
from lcp_plugin.interfaces.nl.reading import WITH_TOLERANCE, NLContent, Tree, number_tree
from lcp_plugin.interfaces.nl.writing import OPTIONS_LINE

SUMS: dict[str, Any] = {"+": lambda *a: sum(a), "-": operator.sub, "unary -": operator.neg}


def content_of_rows(
    lower: Any, upper: Any, linear: Any, trees: list[Tree], limits: Any, partners: Any, bounds: Any
) -> NLContent:
    """Return the content of rows with limits, without an objective."""
    no = np.zeros(lower.size, dtype=bool)
    nothing = sp.csr_array((0, no.size)), list[Tree]()
    rows = lower, upper, *limits, partners, bounds, linear, trees
    return NLContent(*rows, no[:0], *nothing, *nothing, no, np.zeros(no.size), no)


def content_of(M: Any, q: Any, **changes: Any) -> NLContent:
    """Rows M x + q complementary to x ≥ 0."""
    n, goal = len(q), changes.pop("objective", None)
    free = np.full(n, np.inf)
    own: dict[str, Any] = {}
    if goal is not None:
        own = {"objective_trees": [number_tree(0.0)], "is_maximized": np.zeros(1, bool)}
        own["objective_linear"] = sp.csr_array([goal])
    content = content_of_rows(
        np.zeros(n),
        free,
        sp.csr_array(np.asarray(M, float)),
        [number_tree(float(value)) for value in q],
        (-free, free),
        np.arange(n),
        np.ones(n, dtype=np.int64),
    )
    return replace(content, **own | changes)


@np.errstate(all="ignore")
def evaluated(content: NLContent, x: Any) -> tuple[Any, Any]:
    """Return the values of the rows and of the objectives at x by plain arithmetic; NaN if one has no value."""
    values: list[float] = x.tolist()

    def leaf(kind: str, value: float) -> float:
        return value if kind == "n" else values[int(value)]

    def operation(number: int, operands: list[float]) -> float:
        rule = SUMS.get(NAMES[number]) or getattr(
            OPERATORS.get(number), "value", lambda *_: math.nan
        )
        found = float(rule(*map(np.float64, operands)))
        return found if math.isfinite(found) else math.nan

    def value(matrix: Any, tree: Tree, k: int) -> float:
        row = matrix[[k]].tocoo()
        terms = zip(row.data.tolist(), row.col.tolist(), strict=True)
        linear = sum(factor * values[j] for factor, j in terms)
        return evaluated_tree(tree, leaf, operation) + linear

    for k, tree in enumerate(content.defined_trees):
        values.append(value(content.defined_linear, tree, k))
    rows, objectives = (
        np.array([value(matrix, tree, k) for k, tree in enumerate(trees)])
        for matrix, trees in (
            (content.linear, content.trees),
            (content.objective_linear, content.objective_trees),
        )
    )
    return rows, objectives


class SolContent(NamedTuple):
    """The message, the first line of the ``.nl`` file, m and n, duals and values or None, and the code."""

    message: str
    options: tuple[int, ...]
    tolerance: float | None
    rows: int
    variables: int
    duals: Any
    values: Any
    code: int


def read_sol(path: Path) -> SolContent:
    """Return the content of a ``.sol`` file in text."""
    lines = path.read_text(encoding="utf-8").splitlines()
    begin = next(k for k, line in enumerate(lines) if line.strip() == OPTIONS_LINE)
    message = "\n".join(line for line in lines[:begin] if line.strip())
    rest = iter(lines[begin + 1 :])
    count, *options = (int(next(rest)) for _ in range(3))
    has_tolerance = options[1] == WITH_TOLERANCE
    count -= 2 * has_tolerance
    options += [int(next(rest)) for _ in range(count - 2)]
    m, m_given, n, n_given = (int(next(rest)) for _ in range(4))
    tolerance = float(next(rest)) if has_tolerance else None
    duals, values = (np.array([float(next(rest)) for _ in range(k)]) for k in (m_given, n_given))
    _, _, code = next(rest).split()
    return SolContent(
        message,
        (count, *options),
        tolerance,
        m,
        n,
        duals if m_given or not m else None,
        values if n_given or not n else None,
        int(code),
    )
