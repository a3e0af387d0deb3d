"""Sweeps and multigrid on rows over MPI ranks.

A sweep runs on all ranks at once, with the ghost values from before the sweep: a splitting with fewer entries of
L. NP sweeps converge so on H₊-matrices; projected relaxation does with ω ≤ 1, and on symmetric positive definite
matrices with the pivots of :func:`~lcp_plugin.ranks.methods.pivot_weight`.

Multigrid is classical algebraic multigrid, truncated to the free unknowns. Each rank chooses coarse unknowns among its
local unknowns, without regard to the couplings of other ranks. Interpolation, Galerkin products and truncation equal
the serial operations, because a rank also stores the rows of adjacent ghost unknowns. A smoother sweeps on all ranks at
once, with larger pivots if M is symmetric.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from inspect import signature
from typing import Any

import numpy as np
import scipy.sparse as sp

from ..core.checks import AnyMatrix, Array, Vector, read_only
from ..core.errors import InvalidOption, UnknownAlgorithm, UnsuitableMatrix
from ..core.kernels.splitting_sweeps import relaxation_sweep, splitting_sweep
from ..core.splittings import NPAOR, NPGS, NPJ, NPSOR, ProjectedType, step_unit
from ..core.sweep_data import split_rows
from ..methods.multigrid import ProjectedCycles
from ..systems.hierarchy import kernels, levels
from ..systems.hierarchy.grids import Grid, Hierarchy, Operator, Transfer, blocks_of, pivots
from ..systems.hierarchy.truncation import Truncation
from .halo import NOBODY, Halo
from .problem import RowsOnRanks

LARGEST_GROWTH, LARGEST_COMPLEXITY = 2.0, 8.0


def hierarchy_on_ranks(matrix: AnyMatrix, halo: Halo, *, scales_rows: bool) -> Hierarchy:
    """Return the hierarchy of the local rows, shape (own, own + foreign), with a positive diagonal.

    It has one grid if coarser grids cost too much.

    With `scales_rows` the restriction is Pᵀ D⁻¹ in place of Pᵀ, for matrices that are not symmetric.
    """
    rows = matrix.indptr, matrix.indices, matrix.data
    count, ranks = matrix.shape[0], halo
    if not halo.is_empty:
        rows, ranks = halo.overlapped(rows, halo.ghosts, NOBODY)
    grid = _grid(Operator(*rows), ranks, count, scales_rows)
    shares = levels.positive_shares(Operator(*grid.local_rows), grid.split)
    strength = levels.strength_of(halo.total(float(shares.sum())) / max(halo.n, 1))
    grids, transfers, has_jumps = [grid], list[Transfer](), None
    entries = stored = halo.total(float(grid.local_rows[0][-1]))
    size = halo.total(grid.n)
    while size > levels.COARSEST:
        coarser = _coarser(grid, strength, has_jumps, scales_rows)
        if coarser is None:
            break
        transfer, below, has_jumps = coarser
        now = halo.total(float(below.local_rows[0][-1]))
        is_large = halo.total(below.n) > levels.LARGEST_GRID_SHARE * size
        stored += now
        if is_large or now > LARGEST_GROWTH * entries or stored > LARGEST_COMPLEXITY * entries:
            return Hierarchy((grids[0],), (), 0.0, is_helpful=False)
        grid, size = below, halo.total(below.n)
        grids.append(grid)
        transfers.append(transfer)
    return Hierarchy(tuple(grids), tuple(transfers), 0.0, is_helpful=len(grids) > 1)


def pivot_weight(rows: Array, halo: Halo, relaxation: float) -> Vector:
    """Return the weights added to the pivots d_i of a sweep on all ranks at once, shape (own,).

    Notes
    -----
    With σ_i = Σ |m_ij| √(d_i/d_j) over the ghost columns j the weight is ω_i = max(0, (r σ_i − (1 − r/2) d_i)/2),
    r the relaxation. For M symmetric positive definite the splitting 𝓜 has
    𝓜 + 𝓜ᵀ − M = (2/r − 1) D + (2/r) Ω − (the ghost columns of M), and that is positive definite, because
    2 |m_ij x_i x_j| ≤ |m_ij| (s x_i² + x_j²/s) with s = √(d_i/d_j). For an H₊-matrix and r ≤ 1 any ω ≥ 0 does.
    """
    count = rows.shape[0]
    diagonal = rows.diagonal()
    whole = np.abs(halo.whole(diagonal))[count:]
    coupling = np.sqrt(np.abs(diagonal)) * (abs(rows[:, count:]) @ (1.0 / np.sqrt(whole)))
    weight = np.maximum(0.0, 0.5 * relaxation * coupling - 0.25 * (2.0 - relaxation) * diagonal)
    return np.where(np.isfinite(weight), weight, 0.0)


def _grid(matrix: Operator, halo: Halo, count: int, scales_rows: bool) -> Grid:
    indptr, indices, data = matrix.arrays
    first = Operator(indptr[: count + 1], indices[: indptr[count]], data[: indptr[count]])
    split, inverse = pivots(first, kernels.INVERTIBLE)
    weight = np.zeros(count)
    if not (halo.is_empty or scales_rows):
        arrays, shape = (first.data, first.indices, first.indptr), (count, count + halo.foreign)
        weight = pivot_weight(sp.csr_array(arrays, shape), halo, 1.0)
        inverse = np.where(inverse > 0.0, 1.0 / (1.0 / inverse + weight), 0.0)
    blocks = blocks_of(first.arrays, count, may_cut=halo.is_empty and not scales_rows)
    return Grid(matrix, split, blocks, read_only(inverse), halo, weight)


def _coarser(
    grid: Grid, strength: float, has_jumps: bool | None, scales_rows: bool
) -> tuple[Transfer, Grid, bool] | None:
    """Return the way to a coarser grid, that grid, and whether couplings jump from edge to edge; None if there is none.

    There is none if no unknowns are coupled, or if its numbers are not finite. Unknowns of any rank interpolate. If
    couplings jump, each rank also makes the second pass of Ruge and Stüben among its unknowns.
    """
    indptr, indices, data = grid.local_rows
    n, halo = grid.n, grid.halo
    square = np.pad(indptr, (0, grid.width - n), "edge")  # the rows of ghosts are empty

    def spread(choice: Any) -> Any:
        choice = np.concatenate([choice, np.zeros(halo.foreign, choice.dtype)])
        halo.fetch_flags(choice)
        return choice

    chosen, P, lonely = levels.interpolation_of(
        (square, indices, data), n, strength, second_pass=bool(has_jumps), spread=spread
    )
    is_coarse = read_only(chosen[:n])
    below = Halo(halo.comm, int(np.count_nonzero(is_coarse)))
    if below.n == 0:
        return None
    if has_jumps is None and halo.total(lonely) > levels.NOTEWORTHY_LONELY * halo.n:
        return _coarser(grid, strength, True, scales_rows)
    number = halo.whole(below.first - 1.0 + np.cumsum(is_coarse))[chosen]
    end = int(P.indptr[n])
    rows = P.indptr[: n + 1], number[P.indices[:end]].astype(indices.dtype), P.data[:end]
    p_indptr, columns, p_data = halo.with_foreign_rows(rows)  # of P, in columns of all ranks
    others, count = below.outside(columns), below.own
    p_indices = below.local(columns, others)
    fine = grid.matrix.indptr.size - 1  # local unknowns, and ghosts with stored rows
    P = sp.csr_array((p_data, p_indices, p_indptr), shape=(p_indptr.size - 1, count + others.size))
    R = P[:fine, :count].T.tocsr()
    if scales_rows:
        R.data *= halo.whole(grid.inverse)[R.indices]
        if not halo.everywhere(np.isfinite(R.data)):
            return None
    prolongation = Operator(p_indptr, p_indices, p_data)
    restriction = Operator(R.indptr, R.indices, R.data)
    rows = kernels.galerkin(grid.matrix, prolongation, restriction, count + others.size).arrays
    if not halo.is_empty:
        met = p_indices[: int(p_indptr[grid.n])]
        further = others[np.unique(met[met >= count]) - count]
        rows, below = below.overlapped(rows, others, further)
        # Rows of P of distant unknowns may have any number.
        prolongation = Operator(p_indptr, below.local(columns, below.ghosts), p_data)
    coarser = _grid(Operator(*rows), below, count, scales_rows)
    return Transfer(prolongation, restriction, is_coarse), coarser, bool(has_jumps)


Iterates = Iterator[tuple[Vector, float]]  # z, shape (own,), and passes over M since the last


def relaxation_points(problem: RowsOnRanks, z: Vector, relaxation: float = 1.0) -> Iterates:
    """Yield iterates of projected relaxation, z_i ← mid(l_i, u_i, z_i − ω w_i/d_i)."""
    halo, M = problem.halo, problem.rows
    pivots = _positive_diagonal(problem)
    if problem.is_symmetric and not halo.is_empty:
        pivots = pivots + pivot_weight(M, halo, relaxation)
    rows = np.column_stack([problem.q, problem.lower, problem.upper, 1.0 / pivots])
    arrays, x = split_rows(M), halo.whole(z)
    yield x[: problem.own], 0.0
    while True:
        halo.fetch(x)
        relaxation_sweep(*arrays, rows, relaxation, False, x)
        yield x[: problem.own], 1.0


def projected_type(problem: RowsOnRanks, z: Vector, algorithm: ProjectedType) -> Iterates:
    """Yield iterates of NPAOR, (D/α + D + 2S⁻¹ − (β/α) L)(z⁺ − z) = −2 S⁻¹ r(z), with S = 1/d."""
    alpha, beta = algorithm.weights()
    halo, step = problem.halo, 1.0 / problem.residual_scale
    pivot = step * problem.diagonal * (1.0 / alpha + 1.0) + 2.0
    if not halo.everywhere(pivot > 0.0):
        raise UnsuitableMatrix("an NP sweep needs m_ii/(α d_i) + m_ii/d_i + 2 > 0 in every row")
    bounds = problem.lower, problem.upper
    rows = np.column_stack([problem.q, *bounds, step, step, 1.0 / pivot])
    arrays, x = split_rows(problem.rows), halo.whole(z)
    yield x[: problem.own], 0.0
    lower, upper = map(read_only, bounds)
    unit = step_unit(halo.largest(np.abs(problem.q * step)))
    new, points = x.copy(), algorithm.extrapolations(x, lower, upper, halo.total)
    while True:
        halo.fetch(x)
        new[problem.own :] = x[problem.own :]
        _, squares = splitting_sweep(*arrays, rows, beta / alpha, True, unit, False, x, new)
        x, new = (new, x) if points is None else points.send((new, x, squares))
        yield x[: problem.own], 1.0


def multigrid(problem: RowsOnRanks, z: Vector) -> Iterates:
    """Yield z after each sweep and correction: truncated V-cycles, or Krylov steps if those are slow.

    A cold start comes from the coarser grids (nested iteration). The run ends after idle cycles.
    """
    _positive_diagonal(problem)
    symmetric = problem.is_symmetric
    hierarchy = hierarchy_on_ranks(problem.rows, problem.halo, scales_rows=not symmetric)
    run = ProjectedCycles(problem, Truncation(hierarchy), is_symmetric=symmetric)
    fine = run.problems[0]
    whole = fine.grid.halo.whole(z)  # the hierarchy has a different order of the ghosts
    local = slice(problem.own)
    yield whole[local], 0.0
    if not hierarchy.is_helpful:
        return
    if problem.halo.everywhere(z == problem.nearest_to_zero):
        whole[:] = 0.0
        run.add_coarse_solution(fine.q, fine.lower, fine.upper, whole)
        run.truncation.start_at(0)
    least, before, idle, work = np.inf, np.inf, 0, 0.0
    while True:
        fine.sweep(whole, backward=False)
        largest, changed = run.look(0, whole)
        run.work += 2.0 * fine.entries
        yield whole[local], work + run.take_work()
        idle = 0 if largest < 0.9 * least else idle + 1  # a cycle that gains less is idle
        least = min(least, largest)
        # A residual a hundred times the least, or a dozen idle cycles, end the run
        if not largest <= 100.0 * least or idle >= 12:
            return
        work = 0.0
        if largest > 0.1 * before and changed <= max(1e-3 * problem.n, 1.0):
            work = sum(step.work for step in run.krylov_steps(whole, is_settled=not changed))
        else:
            run.correct(0, whole)
        before = largest
        fine.sweep(whole, backward=True)


def _positive_diagonal(problem: RowsOnRanks) -> Vector:
    if not problem.halo.everywhere(problem.diagonal > 0.0):
        raise UnsuitableMatrix('the algorithm needs a positive diagonal; try algorithm="npsor"')
    return problem.diagonal


Methods = dict[str, Callable[..., Iterates]]
METHODS: Methods = {
    "multigrid": multigrid,
    "pgs": relaxation_points,
    "psor": relaxation_points,
    "npsor": lambda problem, z, relaxation=1.7, momentum="auto": projected_type(
        problem, z, NPSOR(relaxation=relaxation, momentum=momentum)
    ),
    "npaor": lambda problem, z, relaxation=1.7, acceleration=1.0, momentum="auto": projected_type(
        problem, z, NPAOR(relaxation=relaxation, acceleration=acceleration, momentum=momentum)
    ),
    "npgs": lambda problem, z, momentum="auto": projected_type(problem, z, NPGS(momentum=momentum)),
    "npj": lambda problem, z, momentum="auto": projected_type(problem, z, NPJ(momentum=momentum)),
}


def chain(
    algorithm: str, options: dict[str, Any], more: Methods, *, is_positive: bool
) -> list[tuple[str, Callable[..., Iterates]]]:
    """Return the methods that a name means, in order: multigrid, `more`, and then sweeps for "auto"."""
    methods = METHODS | more
    if algorithm == "auto":
        if options:
            raise InvalidOption(f'algorithm="auto" has no options, got {sorted(options)}')
        names = ("multigrid", *more, "pgs") if is_positive else (*more, "npsor")
        return [(name, methods[name]) for name in names]
    if not isinstance(algorithm, str) or algorithm not in methods:
        raise UnknownAlgorithm(f"{algorithm!r} cannot run on ranks; use auto, {', '.join(methods)}")
    method = methods[algorithm]
    _, _, *known = signature(method).parameters
    if unknown := options.keys() - {*known}:
        raise InvalidOption(f"{algorithm} has no such options: {sorted(unknown)}")
    return [(algorithm, partial(method, **options))]
