"""The methods that run on rows spread over ranks: projected sweeps on all ranks at once, and multigrid.

A sweep uses what its own rank has already updated and what the others had before the sweep. Such a splitting
M = 𝓜 − 𝓝 has fewer entries of L in 𝓜 than the sweep over all rows. The proof for the projected-type methods holds
for every such choice (0 ≤ β ≤ α; row scaling 1/d), and so does that for H₊-matrices and in-place methods with a
relaxation ≤ 1. Where M is symmetric the latter add to the pivots what they need to converge for every positive definite
one, see `pivot_weight`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields
from typing import Any

import numpy as np

from ..algorithms import create
from ..algorithms.base import Algorithm, Step
from ..algorithms.multigrid_run import MultigridRun
from ..checks import FloatVector
from ..errors import InvalidOption, UnknownAlgorithm, UnsuitableMatrix, did_you_mean
from ..kernels import splitting_sweeps as sweep_kernels
from ..peers.ranks.collective import together, total
from ..peers.ranks.rows import Rows
from .hierarchy import build_hierarchy
from .pivots import pivot_weight
from .problem import DistributedLCP

PROJECTED_TYPE = ("npj", "npgs", "npsor", "npaor")
IN_PLACE = ("pgs", "psor")
NAMES = ("multigrid", *PROJECTED_TYPE, *IN_PLACE)
OPTIONS = ("relaxation", "acceleration", "nested", "smoother", "coarsest")
SYMMETRIC = 1e-10
MULTIGRID_FAILED = "multigrid came to an end: projected sweeps"


def chosen(algorithm: Any, options: dict[str, Any]) -> Algorithm:
    """Return the algorithm of that name, one that runs on several ranks.

    Raises
    ------
    UnknownAlgorithm, InvalidOption
    """
    if isinstance(algorithm, Algorithm):
        if options:
            raise InvalidOption(f"options {sorted(options)} were given beside an algorithm object; set them in it")
        name = algorithm.name
    else:
        name = str(algorithm)
    if name == "auto":
        if options:
            raise InvalidOption(f'algorithm="auto" has no options, got {sorted(options)}; name an algorithm as well')
        name = "multigrid"
    if name not in NAMES:
        raise UnknownAlgorithm(f"{name!r} does not run on several ranks{did_you_mean(name, ('auto', *NAMES))}")
    if name == "psor" and "relaxation" not in options and not isinstance(algorithm, Algorithm):
        options = {"relaxation": 1.0, **options}
    made = algorithm if isinstance(algorithm, Algorithm) else create(name, options)
    default = type(made)()
    for option in fields(made):
        if option.name not in OPTIONS and getattr(made, option.name) != getattr(default, option.name):
            raise InvalidOption(f"{name}: {option.name} cannot be chosen on several ranks; leave it as it is")
    if name == "psor" and isinstance(made.relaxation, str):  # type: ignore[attr-defined]
        raise InvalidOption("psor: on several ranks the relaxation must be a number in (0, 2)")
    return made


def iterates(problem: DistributedLCP, algorithm: Any, start: FloatVector) -> Iterator[Step]:
    """Yield the start, then one step an iteration; all ranks call.

    Raises
    ------
    UnsuitableMatrix
        On every rank, where a diagonal entry is not positive.
    """
    together(problem.comm, lambda: _require_positive_diagonal(problem, algorithm.name))
    if algorithm.name == "multigrid":
        is_symmetric = is_symmetric_matrix(problem)
        hierarchy = build_hierarchy(problem, algorithm.coarsest, is_symmetric=is_symmetric)
        yield from MultigridRun(algorithm, problem, hierarchy, is_symmetric=is_symmetric).iterates(start)
        return
    yield from (_projected_type if algorithm.name in PROJECTED_TYPE else _in_place)(problem, algorithm, start)


def _projected_type(problem: DistributedLCP, algorithm: Any, start: FloatVector) -> Iterator[Step]:
    alpha, beta = algorithm.splitting()
    rows, own = problem.rows, problem.layout.own
    step = np.full(own, 1.0) / problem.diagonal
    pivot = np.full(own, 1.0 / (1.0 / alpha + 3.0))  # of the matrix scaled to unit diagonal
    packed = sweep_kernels.packed(
        problem.q, problem.lower, problem.upper, 1.0 / problem.residual_scale, step, pivot
    )
    split = _splits(rows)
    z, new = rows.new_vector(), rows.new_vector()
    z[:own] = start
    work = 1.0
    while True:
        rows.halo.fetch(z)
        residual, _ = sweep_kernels.splitting_sweep(
            rows.indptr, split, rows.indices, rows.data, packed, beta / alpha, True, False, z, new
        )
        yield Step(z[:own], residual=rows.halo.largest(float(residual)), work=work)
        z, new = new, z


def _in_place(problem: DistributedLCP, algorithm: Any, start: FloatVector) -> Iterator[Step]:
    relaxation = float(algorithm.fixed_relaxation())
    rows, own = problem.rows, problem.layout.own
    pivot = problem.diagonal
    if is_symmetric_matrix(problem):
        foreign_diagonal = rows.filled(pivot)[own:].copy()
        pivot = pivot + pivot_weight(pivot, rows.as_csr()[:, own:], foreign_diagonal, relaxation)
    packed = sweep_kernels.packed(problem.q, problem.lower, problem.upper, 1.0 / pivot)
    split = _splits(rows)
    z = rows.new_vector()
    z[:own] = start
    yield Step(z[:own], work=0.0)
    while True:
        rows.halo.fetch(z)
        change, _ = sweep_kernels.relaxation_sweep(
            rows.indptr, split, rows.indices, rows.data, packed, relaxation, False, z
        )
        yield Step(z[:own], increment=rows.halo.largest(float(change)), work=1.0)


def _splits(rows: Rows) -> Any:
    split = np.empty(rows.count, rows.indptr.dtype)
    sweep_kernels.split_rows(rows.indptr, rows.indices, False, split)
    split.flags.writeable = False
    return split


@np.errstate(all="ignore")
def is_symmetric_matrix(problem: DistributedLCP) -> bool:
    """Return whether M is symmetric up to rounding, by products of D^(−1/2) M D^(−1/2) with two arbitrary vectors.

    For such x and y, xᵀ M y = yᵀ M x happens by chance with probability 0. A wrong answer would cost speed, not
    correctness: every z is judged by its residual.
    """
    matrix, rows = problem.rows.as_csr(), problem.rows
    unit = 1.0 / np.sqrt(problem.diagonal)
    x, y = (unit * _arbitrary(problem.first, problem.last, seed) for seed in (1, 2))
    x_product = matrix @ rows.filled(x)
    y_product = matrix @ rows.filled(y)
    forward, backward, size = total(
        problem.comm, float(y @ x_product), float(x @ y_product), float(np.sum((unit * x_product) ** 2))
    )
    return bool(abs(forward - backward) <= SYMMETRIC * np.sqrt(size * problem.n)) and bool(np.isfinite(size))


def _arbitrary(first: int, last: int, seed: int) -> FloatVector:
    """Return numbers in (−1, 1) that depend on the index and the seed only, shape (last − first,)."""
    bits = np.arange(first, last, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(seed << 32)
    for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):  # the mixing steps of SplitMix64
        bits = (bits ^ (bits >> np.uint64(shift))) * np.uint64(factor)
    return (bits >> np.uint64(11)).astype(np.float64) * 2.0**-52 - 1.0


def _require_positive_diagonal(problem: DistributedLCP, name: str) -> None:
    bad = np.flatnonzero(~(problem.diagonal > 0.0))
    if bad.size:
        i = int(bad[0])
        raise UnsuitableMatrix(
            f"{name} on several ranks needs a positive diagonal, but M[{problem.first + i}, {problem.first + i}] = "
            f"{problem.diagonal[i]}; solve such a problem on one machine"
        )
