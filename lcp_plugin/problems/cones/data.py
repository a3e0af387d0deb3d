"""Complementarity over cones: the data, checked.

K ∋ z ⟂ w ∈ K*, w = M z + q, K a product of blocks: one row between bounds (free, nonnegative, a box), or several rows
in a cone {‖z_T‖ ≤ μ z_N}, whose dual is {w_N ≥ μ‖w_T‖}. Contact with friction has û = w + μ‖w_T‖ e_N in place of w (De
Saxcé): Coulomb's law, impulses r for z, velocities u for w; `frictional_contact` states it. Convex programs over cones
have the form of Clarabel.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import copy
from functools import cached_property
from importlib.util import find_spec
from operator import attrgetter
from os import PathLike
from typing import Any, Self

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from ...core import checks, deadline
from ...core.checks import AnyMatrix, Vector, is_number, read_only, real_array
from ...core.errors import InvalidProblem, did_you_mean
from ...core.files import MATRIX_KEYS, save_arrays
from ...core.lcp import LCP
from ...core.names import format_count
from ...core.problem import Problem
from .factors import cone_stack_of

CONES = ("free", "nonnegative", "box", "second_order")
NEED_CONES = (
    'cones must be a sequence of ("free", rows), ("nonnegative", rows), ("box", lower, upper) and '
    '("second_order", rows)'
)
Starts = NDArray[np.int64]


class Blocks(Problem):
    """Common data of both problems: M, q, and the blocks of rows.

    Attributes
    ----------
    rows : LCP
        M and q with the bounds of the rows outside cones; rows of cones have no bounds.
    starts : array of int, shape (k + 1,)
        Block i has the rows starts[i] … starts[i + 1] − 1; a block of one row is not a cone.
    slope : ndarray, shape (k,)
        μ of the cones; 0 elsewhere.
    has_friction : bool
        Whether the slack of a cone is û.
    """

    offset = "q"  # its name in messages
    origin: Any = None
    bodies: Any = None  # Bodies, if contacts are defined by bodies
    equations = 0  # next to contacts, the last rows

    def __init__(self, rows: LCP, starts: Starts, slope: Vector, *, has_friction: bool) -> None:
        self.rows, self.has_friction = rows, has_friction
        self.starts, self.slope = read_only(starts), read_only(slope)
        self._facts: dict[Any, Any] = {}  # properties of M: problems that differ in q share them

    n = property(attrgetter("rows.n"), doc="Number of unknowns.")
    q = property(attrgetter("rows.q"), doc="Offset, shape (n,).")
    lower = property(attrgetter("rows.lower"), doc="Lower bounds, shape (n,): −∞ in cones.")
    upper = property(attrgetter("rows.upper"), doc="Upper bounds, shape (n,): ∞ in cones.")
    matrix = property(attrgetter("rows.matrix"), doc="The matrix with its facts.")
    nonzeros = property(attrgetter("rows.nonzeros"), doc="Number of entries of the matrix.")
    nearest_to_zero = property(attrgetter("rows.nearest_to_zero"), doc="Point of K nearest to 0.")

    def slack(self, z: ArrayLike) -> Vector:
        """Return w = M z + q, shape (n,): velocities, of impulses."""
        return self.rows.slack(z)

    @cached_property
    def sizes(self) -> Starts:
        """Rows of each block, shape (k,)."""
        return np.diff(self.starts)

    @cached_property
    def block_of_row(self) -> Starts:
        """The block of each row, shape (n,)."""
        return np.repeat(np.arange(self.slope.size), self.sizes)

    def residual(self, z: Vector, w: Vector) -> Vector:
        """Return R = z − P_K(z − ŵ/d), shape (n,)."""
        stack = cone_stack_of(self)
        wide, flat = stack.pattern.wide, stack.pattern.flat
        return flat(stack.residual(wide(z[None]), wide(w[None]))[0])[0]

    def part(self, blocks: NDArray[np.bool_]) -> Blocks:
        """Return the problem of the selected blocks, bool, shape (k,), which must be entire components."""
        rows = blocks[self.block_of_row]
        M, lower, upper = self.rows.csr[rows][:, rows], self.lower[rows], self.upper[rows]
        part_rows = LCP(M, self.q[rows], lower=lower, upper=upper)
        starts = np.cumsum(np.append(0, self.sizes[blocks]))
        part = Blocks(part_rows, starts, self.slope[blocks], has_friction=self.has_friction)
        if self.bodies is not None:
            part.bodies = self.bodies._replace(rows=self.bodies.rows[rows])
        return part

    def with_q(self, q: ArrayLike) -> Self:
        """Return the problem with another q, shape (n,), b of contacts; it shares the cached properties of M."""
        other = copy(self)
        vector = np.ravel(real_array(q, f"{self.offset} must be a vector"))
        vector = checks.checked_vector(vector, self.offset, self.n)
        other.rows = self.rows.with_q(vector)
        if self.bodies is not None:  # b does not determine their velocities
            other.bodies = self.bodies._replace(velocities=None)
        return other

    def save(self, path: str | PathLike[str]) -> None:
        """Write the problem to a ``.npz`` file, which ``load_problem(path)`` and ``lcp-plugin solve`` read.

        If the problem was built from bodies, the file has W and b.

        Raises
        ------
        UnreadableFile
            If the file cannot be written, or has another extension.
        """
        matrix = {name: getattr(self.rows.csr, name) for name in MATRIX_KEYS}
        save_arrays(path, {**matrix, "q": self.q, **self._shape()}, "a problem over cones")

    def _shape(self) -> dict[str, Any]:
        """Return the arrays that describe the blocks in a file."""
        raise NotImplementedError


class ConeProblem(Blocks):
    """Find z in a product K of cones such that w = M z + q lies in the dual cone and is orthogonal to z.

    Parameters
    ----------
    M : array or sparse array, shape (n, n)
    q : array, shape (n,)
    cones : sequence
        The blocks of z in order: ``("free", rows)``, ``("nonnegative", rows)``, ``("box", lower, upper)`` with numbers
        or vectors, ±1e20 and beyond for none, ``("second_order", rows)`` for {‖z_T‖₂ ≤ z_0}, z_T the other rows.

    Raises
    ------
    InvalidProblem
        If the arguments do not define such a problem.

    Examples
    --------
    The point of a cone nearest to (0, 2, 0):

    >>> from lcp_plugin import solve
    >>> result = solve(ConeProblem(np.eye(3), [0.0, -2.0, 0.0], [("second_order", 3)]))
    >>> result.status.name, result.z.round(6), result.w.round(6)
    ('SOLVED', array([1., 1., 0.]), array([ 1., -1.,  0.]))
    """

    def __init__(self, M: AnyMatrix, q: ArrayLike, cones: Sequence[Any]) -> None:
        rows = LCP(M, q)
        sizes, lower, upper, self.cones = _blocks(cones, rows.n)
        rows = rows.with_q(rows.q, lower=lower, upper=upper)
        starts = np.cumsum([0, *sizes], dtype=np.int64)
        slope = (np.asarray(sizes) > 1).astype(np.float64)
        super().__init__(rows, starts, slope, has_friction=False)

    M = property(attrgetter("rows.M"), doc="The stored matrix, dense or CSR.")

    def _shape(self) -> dict[str, Any]:
        kinds = [CONES.index(cone[0]) for cone in self.cones]
        sizes = (
            np.broadcast(*rest).size if name == "box" else rest[0] for name, *rest in self.cones
        )
        rows = [*map(int, sizes)]
        of_cones = {"cone_kinds": np.array(kinds, np.int64), "cone_rows": np.array(rows, np.int64)}
        return {**of_cones, "lower": self.lower, "upper": self.upper}

    def __repr__(self) -> str:
        cones = format_count(int((self.sizes > 1).sum()), "second-order cone")
        return f"ConeProblem(n={self.n}, {cones}, {self.nonzeros} nonzeros)"


def _box(bounds: Sequence[Any], name: str) -> tuple[Vector, Vector]:
    """Return lower and upper bounds of each row of a box; raise InvalidProblem for other shapes."""
    need = f"lower and upper of {name} must be real numbers or vectors of the box's rows"
    sides = map(checks.without_none, bounds, ("lower", "upper"))
    low, high = (np.atleast_1d(real_array(side, need)) for side in sides)
    if max(low.ndim, high.ndim) > 1 or len({low.size, high.size} - {1}) > 1:
        raise InvalidProblem(
            f"{need}, got shapes {low.shape} and {high.shape}; write np.ravel(lower), np.ravel(upper) of one length"
        )
    low, high = np.broadcast_arrays(low, high)
    names = f"lower of {name}", f"upper of {name}"
    return checks.checked_bounds(low, high, low.size, names=names)


def _blocks(cones: object, n: int) -> tuple[list[int], Vector, Vector, tuple[Any, ...]]:
    """Return the rows of each block, the bounds of the rows, and the cones in the caller's form."""
    if isinstance(cones, (str, bytes)) or not isinstance(cones, Sequence):
        raise InvalidProblem(f"{NEED_CONES}, got {cones!r}")
    sizes: list[int] = []
    lower, upper = [np.empty(0)], [np.empty(0)]
    for number, cone in enumerate(cones):
        name, *arguments = cone if isinstance(cone, (tuple, list)) and cone else (cone,)
        rows, fault = arguments[0] if arguments else 0, ""
        if isinstance(cone, str):
            fault = f'is a text; write a list of tuples, such as cones=[("nonnegative", {n})]'
        elif not isinstance(name, str) or name not in CONES:
            fault = f"is not a cone{did_you_mean(name, CONES)}"
        elif len(arguments) != (2 if name == "box" else 1):
            fault = f"has {len(arguments)} numbers behind its name"
        elif name == "box":
            low, high = _box(arguments, f"cones[{number}]")
            rows = low.size
        elif not is_number(rows) or not 0 <= rows < np.inf or rows != int(rows):
            fault = "must name an integer of rows ≥ 0"
        else:
            rows = int(rows)
            is_half = name == "nonnegative" or (name == "second_order" and rows == 1)
            low, high = np.full(rows, 0.0 if is_half else -np.inf), np.full(rows, np.inf)
        if fault:
            raise InvalidProblem(f"cones[{number}] = {cone!r} {fault}; {NEED_CONES}")
        sizes += [rows] if name == "second_order" and rows > 1 else [1] * rows
        lower.append(low)
        upper.append(high)
    if (total := sum(sizes)) != n:
        which = "too few" if total < n else "too many"
        raise InvalidProblem(f"the cones have {total} rows and M has {n}: {which}; {NEED_CONES}")
    return sizes, np.concatenate(lower), np.concatenate(upper), tuple(tuple(cone) for cone in cones)


def minimizers(problem: Blocks, z: Vector) -> Iterator[Vector]:
    """Yield the minimizers of convex programs, each with the terms that depend on z fixed at the last minimizer.

    None if Clarabel is not installed.
    """
    if find_spec("clarabel") is None:
        return
    M = sp.csc_array(problem.rows.csr)
    symmetric = sp.csc_array(0.5 * (M + M.T))
    skew, P, first = sp.csr_array(M - symmetric), sp.triu(symmetric), problem.starts[:-1]
    rows, limits, cones = conic_rows(problem)
    is_final, stack = not (problem.has_friction or skew.count_nonzero()), cone_stack_of(problem)
    while True:
        q = problem.q + skew @ z
        if problem.has_friction:
            w = problem.slack(z)
            w[first] = 0.0
            q[first] += problem.slope * np.sqrt(np.add.reduceat(w * w, first))
        z = np.asarray(solve_conic(P, q, rows, limits, cones).x)
        if z.size != problem.n or not np.isfinite(z).all():
            return
        z = stack.pattern.flat(stack.project(stack.pattern.wide(z[None])))[0]
        yield z
        if is_final:  # another program would be the same
            return


def solve_conic(P: AnyMatrix, c: Vector, A: AnyMatrix, b: Vector, cones: list[Any]) -> Any:
    """Return Clarabel's solution of min ½ zᵀP z + cᵀz over b − A z ∈ cones."""
    import clarabel  # not for problems that other methods solve

    settings = clarabel.DefaultSettings()
    settings.verbose, settings.time_limit = False, deadline.left()
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-12
    P, A = sp.csc_matrix(P), sp.csc_matrix(A)
    return clarabel.DefaultSolver(P, c, A, b, cones, settings).solve()


def conic_rows(problem: Blocks) -> tuple[Any, Vector, list[Any]]:
    """Return A, b and cones such that z ∈ K is equivalent to b − A z ∈ cones."""
    import clarabel  # not for problems that other methods solve

    rows, limits, cones = list[Any](), list[Vector](), list[Any]()
    identity, is_cone = sp.eye_array(problem.n, format="csr"), problem.sizes > 1
    first = problem.starts[:-1]
    single, slopes = first[~is_cone], np.ones(problem.n)
    for sign, bound in ((-1.0, problem.lower), (1.0, problem.upper)):
        has = single[np.isfinite(bound[single])]
        if has.size:
            rows.append(sign * identity[has])
            limits.append(sign * bound[has])
            cones.append(clarabel.NonnegativeConeT(has.size))
    slopes[first] = np.where(problem.slope > 0.0, problem.slope, 1.0)
    in_cones = np.flatnonzero(is_cone[problem.block_of_row])
    rows.append(-(sp.csr_array(sp.diags_array(slopes)))[in_cones])
    limits.append(np.zeros(in_cones.size))
    for size, slope in zip(problem.sizes[is_cone].tolist(), problem.slope[is_cone], strict=True):
        ray = [clarabel.NonnegativeConeT(1), clarabel.ZeroConeT(size - 1)]
        cones += [clarabel.SecondOrderConeT(size)] if slope > 0.0 else ray
    return sp.vstack(rows), np.concatenate(limits), cones
