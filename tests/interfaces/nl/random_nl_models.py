"""Models in ``.nl`` files by chance, and what the executable's answers to them are held against.

Small integers, so that infeasible, unbounded and degenerate ones are among them: objectives (none, constant,
linear, convex, not convex, nonlinear, two of them), equations, inequalities, ranges, complementarities of all four
kinds whose bounds are those of the variable or not, fixed and integer variables, defined variables, names, starts.
"""

from __future__ import annotations

import traceback
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp
from binary_nl import write_form
from tools.nl_files import evaluated, read_sol

from lcp_plugin import LCPError
from lcp_plugin.commands import ampl
from lcp_plugin.interfaces.nl import read_nl
from lcp_plugin.interfaces.nl.reading import NLContent, Token, Trees
from lcp_plugin.problems.statement import STATUS_ELSEWHERE

INF = np.inf
MET = 1e-5  # of the size of a row or a variable
FAILURE, TOO_LATE = 500, 401
WORDS = (
    "", "", "", "tolerance=1e-10", "tolerance=1e-4", "max_iterations=1", "max_seconds=1e-9", "threads=1",
    "algorithm=psor", "algorithm=lemke", "algorithm=interior_point", "absolute_tolerance=1e-6",
)  # fmt: skip
Tokens = list[tuple[int, float, int]]


def number(value: float) -> Tokens:
    return [(Token.NUMBER, float(value), 0)]


def variable(j: int) -> Tokens:
    return [(Token.VARIABLE, float(j), 0)]


def applied(operator: int, *operands: Tokens) -> Tokens:
    return [
        (Token.OPERATOR, float(operator), len(operands)),
        *(token for one in operands for token in one),
    ]


def total(*terms: Tokens) -> Tokens:
    found = number(0.0)
    for one in terms:
        found = applied(0, found, one)
    return found


def trees_of(rows: list[Tokens]) -> Trees:
    flat = np.array([token for row in rows for token in row], dtype=np.float64).reshape(-1, 3)
    starts = np.cumsum([0, *map(len, rows)]).astype(np.int64)
    return Trees(
        flat[:, 0].astype(np.uint8), flat[:, 1].copy(), flat[:, 2].astype(np.int64), starts
    )


def bent(rng: Any, variables: int) -> Tokens:
    """A nonlinear term, now and then one that is not taken."""
    x, y = (variable(int(rng.integers(variables))) for _ in range(2))
    return [
        lambda: applied(44, x), lambda: applied(2, x, y), lambda: applied(5, x, number(2.0)), lambda: applied(41, x),
        lambda: applied(43, applied(0, applied(5, x, number(2.0)), number(1.0))), lambda: applied(5, x, number(3.0)),
        lambda: applied(3, x, applied(0, applied(5, y, number(2.0)), number(1.0))), lambda: applied(15, x),
        lambda: applied(43, x), lambda: applied(39, x),
    ][rng.choice(10, p=[0.2, 0.2, 0.15, 0.1, 0.1, 0.1, 0.06, 0.03, 0.03, 0.03])]()  # fmt: skip


def whole(rng: Any, *shape: int, most: int = 3, share: float = 0.6) -> np.ndarray:
    return rng.integers(-most, most + 1, shape) * (rng.random(shape) < share).astype(float)


def objective(rng: Any, n: int, variables: int) -> tuple[np.ndarray, Tokens]:
    """A gradient and a tree: constant, linear, convex, of any curvature, or nonlinear."""
    kind, linear = int(rng.choice(6, p=[0.05, 0.3, 0.4, 0.1, 0.1, 0.05])), whole(rng, n)
    tree = number(float(rng.integers(-3, 4)))
    if kind == 0:
        return np.zeros(n), tree
    if kind == 2:
        factor = whole(rng, int(rng.integers(1, n + 1)), n, most=2)
        rows = [
            [applied(2, number(row[j]), variable(j)) for j in np.flatnonzero(row)] for row in factor
        ]
        squares = [
            applied(5, total(*row, number(float(rng.integers(-2, 3)))), number(2.0)) for row in rows
        ]
        return linear, total(tree, *squares)
    if kind == 3:
        return linear, applied(2, variable(int(rng.integers(n))), variable(int(rng.integers(n))))
    return linear, tree if kind == 1 else bent(rng, variables)


def random_model(rng: Any) -> NLContent:
    """Return a model, more often of one kind than of all at once."""
    n, is_bent = int(rng.integers(1, 6)), rng.random() < 0.3
    m = int(rng.integers(0, n + 3))
    pairs = int(rng.integers(0, min(m, n) + 1)) if rng.random() < 0.7 else 0
    is_square = pairs and rng.random() < 0.5
    m = max(m, pairs)
    d = int(rng.integers(0, 3)) if rng.random() < 0.2 else 0
    lower = np.where(rng.random(n) < 0.3, -INF, rng.integers(-2, 2, n).astype(float))
    upper = np.where(
        rng.random(n) < 0.6, INF, np.where(np.isfinite(lower), lower, 0.0) + rng.integers(0, 4, n)
    )
    kinds = rng.integers(0, 5, m)  # no limit, at least, at most, range, equation
    first = rng.integers(-4, 5, m).astype(float)
    row_lower = np.where((kinds == 0) | (kinds == 2), -INF, first)
    row_upper = np.where(
        (kinds == 0) | (kinds == 1), INF, first + np.where(kinds == 3, rng.integers(1, 5, m), 0)
    )
    partners, told = np.full(m, -1), np.zeros(m, dtype=np.int64)
    columns = rng.permutation(n)[:pairs]
    partners[:pairs], row_lower[:pairs], row_upper[:pairs] = columns, -INF, INF
    own = np.isfinite(lower[columns]) + 2 * np.isfinite(upper[columns])
    told[:pairs] = np.where(rng.random(pairs) < 0.85, own, rng.integers(0, 4, pairs))
    if is_square:  # as many equations as other variables, most of these free
        others = np.setdiff1d(np.arange(n), columns)
        m = pairs + others.size
        partners, told = (
            np.append(partners[:pairs], np.full(others.size, -1)),
            np.append(told[:pairs], others * 0),
        )
        row_lower = np.append(row_lower[:pairs], rng.integers(-3, 4, others.size).astype(float))
        row_upper = np.append(row_upper[:pairs], row_lower[pairs:])
        is_free = rng.random(others.size) < 0.8
        lower[others[is_free]], upper[others[is_free]] = -INF, INF
    matrix = whole(rng, m, n)
    if pairs and rng.random() < 0.6:
        matrix[np.arange(pairs), columns] += np.abs(matrix[:pairs]).sum(axis=1) + 1.0
    rows = [number(float(rng.integers(-4, 5))) for _ in range(m)]
    for i in range(m):
        if is_bent and rng.random() < 0.4:
            rows[i] = applied(0, rows[i], bent(rng, n + d))
        elif d and rng.random() < 0.4:
            rows[i] = applied(0, rows[i], variable(n + int(rng.integers(d))))
    o = int(rng.choice(3, p=[0.4, 0.55, 0.05]))
    objectives = [objective(rng, n, n + d) for _ in range(o)]
    has_start = rng.random(n) < 0.3
    return NLContent(
        lower=lower, upper=upper, row_lower=row_lower, row_upper=row_upper, partners=partners, partner_bounds=told,
        linear=sp.csr_array(matrix), trees=trees_of(rows), is_maximized=rng.random(o) < 0.4,
        objective_linear=sp.csr_array(np.array([one[0] for one in objectives]).reshape(o, n)),
        objective_trees=trees_of([one[1] for one in objectives]),
        defined_linear=sp.csr_array(np.hstack([whole(rng, d, n), np.zeros((d, d))])),
        defined_trees=trees_of([bent(rng, n) if rng.random() < 0.5 else number(1.0) for _ in range(d)]),
        is_integer=np.arange(n) >= n - (rng.random() < 0.05),
        start=np.where(has_start, rng.integers(-2, 3, n), 0.0), has_start=has_start,
        **({"names": [f"x[{j}]" for j in range(n)], "row_names": [f"r{i}" for i in range(m)]}
                        if rng.random() < 0.3 else {}),
    )  # fmt: skip


def judged(content: NLContent, words: list[str], stub: Path) -> str:
    """Return the code by which the executable answers a model, or in capitals what is wrong with that."""
    write_form(content, stub.with_suffix(".nl"), binary=len(words) % 2 == 1)
    answer = stub.with_suffix(".sol")
    answer.unlink(missing_ok=True)
    call = [
        *(["max_seconds=5"] if not any("max_seconds" in word for word in words) else []),
        *words,
    ]
    try:
        ended = ampl.main([str(stub), "-AMPL", *call])
    except BaseException:
        return f"TRACEBACK {traceback.format_exc(limit=-2)}"
    if ended or not answer.exists():
        return f"NO ANSWER, exit code {ended}"
    found = read_sol(answer)
    if found.code not in {*(one[0] for one in STATUS_ELSEWHERE.values()), FAILURE}:
        return f"UNKNOWN CODE {found.code}"
    settings = ampl.assigned(" ".join(call))
    try:
        same = read_nl(stub.with_suffix(".nl")).solve(**settings)
    except LCPError as error:
        is_told = found.code == FAILURE and " ".join(str(error).split()) in " ".join(
            found.message.split()
        )
        return "refused" if is_told else f"REFUSED AS {error}, answered {found.message}"
    if same.code != found.code and TOO_LATE not in (same.code, found.code):
        return f"CODE {found.code} BUT {same.code}: {found.message}"
    if found.code:
        return str(found.code)
    if found.values is None or not np.isfinite(found.values).all():
        return f"SOLVED WITHOUT VALUES: {found.message}"
    return missed(content, found.values) or "0"


def missed(content: NLContent, x: np.ndarray) -> str:
    """Return what does not hold at x; rows evaluated by Python's own functions."""
    rows = evaluated(content, x)[0]
    sizes = 1.0 + np.abs(rows) + abs(content.linear) @ np.abs(x)
    beyond = np.maximum(content.lower - x, x - content.upper) / (1.0 + np.abs(x))
    if (beyond > MET).any():
        return f"BOUNDS MISSED BY {beyond.max():.1e}"
    is_pair = content.partners >= 0
    excess = (
        np.where(is_pair, 0.0, np.maximum(content.row_lower - rows, rows - content.row_upper))
        / sizes
    )
    is_limited = np.isfinite(content.row_lower) | np.isfinite(content.row_upper)
    if not (np.where(is_limited, excess, 0.0) <= MET).all():
        return f"ROWS MISSED BY {np.nanmax(excess):.1e}"
    pairs = np.flatnonzero(is_pair)
    has_objective = (
        content.objective_linear.nnz or (content.objective_trees.kinds != Token.NUMBER).any()
    )
    # Without an objective all bounds of a variable belong to its complementarity, stated there or not.
    told = (
        content.partner_bounds[pairs]
        if has_objective or content.is_integer.any()
        else np.full(pairs.size, 3)
    )
    z = x[content.partners[pairs]]
    low = np.where(told & 1, content.lower[content.partners[pairs]], -INF)
    high = np.where(told & 2, content.upper[content.partners[pairs]], INF)
    residual = np.abs(z - np.clip(z - rows[pairs] / sizes[pairs], low, high)) / (1.0 + np.abs(z))
    return "" if (residual <= MET).all() else f"PAIRS MISSED BY {residual.max():.1e}"


def drawn_words(rng: Any) -> list[str]:
    """Return assignments of a call to different options, mostly none."""
    words = rng.choice(WORDS, int(rng.integers(0, 3)), replace=False).tolist()
    return [*{word.partition("=")[0]: word for word in words if word}.values()]
