"""Published complementarity problems and the paper's examples: their answers, by every way in."""

from __future__ import annotations

from typing import Any

import cvxpy as cp
import numpy as np
import pytest
from applications.flows import paper
from inputs.published_problems import COMPLEMENTARITY, FOLDER, errors_of_lcp, read

from lcp_plugin import LCP, box, complements, load_problem, march, solve, solve_batch

TOLERANCE = 1e-6
Published = dict[str, Any]


def sparse(of: Published, name: str) -> np.ndarray:
    return solve(LCP(of["M"], of["q"], lower=of["lower"], upper=of["upper"])).z


def dense(of: Published, name: str) -> np.ndarray:
    """No bound is written as ±1e20."""
    bounds = {"lower": np.maximum(of["lower"], -1e20), "upper": np.minimum(of["upper"], 1e20)}
    return solve(LCP(of["M"].toarray(), of["q"], **bounds)).z


def as_a_file(of: Published, name: str) -> np.ndarray:
    return solve(load_problem(str(FOLDER / f"{name}.npz"))).z


def in_a_batch(of: Published, name: str) -> np.ndarray:
    """Beside itself with q a little larger."""
    qs = np.array([of["q"], 1.5 * of["q"]])
    return solve_batch(of["M"].toarray(), qs, lower=of["lower"], upper=of["upper"]).z[0]


def in_a_list(of: Published, name: str) -> np.ndarray:
    """Behind a problem of another size."""
    problem = LCP(of["M"], of["q"], lower=of["lower"], upper=of["upper"])
    return solve_batch([LCP([[2.0]], [-1e9]), problem])[1].z


def in_cvxpy(of: Published, name: str) -> np.ndarray:
    """A lower bound alone says F ≥ 0, no bound F = 0, two bounds say both in one box."""
    z, low, high = cp.Variable(of["q"].size), of["lower"], of["upper"]
    F = of["M"] @ z + of["q"]
    if np.isfinite(high).any():
        pairs = [complements(box(z, low, high), F)]
    else:
        bounded = np.flatnonzero(np.isfinite(low))
        free = np.setdiff1d(np.arange(low.size), bounded)
        pairs = [complements(z[bounded] >= low[bounded], F[bounded] >= 0)] + [F[free] == 0] * bool(
            free.size
        )
    cp.Problem(cp.Minimize(0), pairs).solve(method="LCP")
    return z.value


@pytest.mark.quick(6)
@pytest.mark.parametrize("way", [sparse, dense, as_a_file, in_a_batch, in_a_list, in_cvxpy])
@pytest.mark.parametrize("name", COMPLEMENTARITY)
def test_answers_are_those_published(name, way):
    """Within the bounds, every w_i right beside its own terms, and z (of singular M: w) as published."""
    of = read(name)
    z, reference = way(of, name), of["z_reference"]
    assert errors_of_lcp(of, z) <= TOLERANCE
    M = of["M"].toarray()
    if np.linalg.matrix_rank(M) == len(M):
        assert abs(z - reference).max() <= TOLERANCE * abs(reference).max()
    assert abs(M @ (z - reference)).max() <= TOLERANCE * abs(of["q"]).max()


@pytest.mark.quick(11)
@pytest.mark.parametrize(
    "way", ["auto", "msor", "npsor", "mgs", "npgs", "newton", "multigrid", "batch", "march"]
)
@pytest.mark.parametrize("side", [10, 30, 50])
@pytest.mark.parametrize("example", [1, 2])
def test_the_paper_s_answers(example, side, way):
    """The planted z = (1, 2, 1, 2, …) to 1e-6, by the methods of its tables and by ours."""
    case = paper(example, side)
    M, q, right = case.M, case.q, case.answer
    if way == "batch":
        found = solve_batch(M, np.array([q, 2 * q])).z[1] / 2
    elif way == "march":
        found = march(LCP(M, q), np.array([q - right, q - right]), 1.0, z0=right).z[-1]
    else:
        found = solve(LCP(M, q), way).z
    assert abs(found - right).max() <= TOLERANCE
