"""The instances of a batch, a list or arrays with an axis for them, and the stacks of small instances."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from ...core.checks import AnyMatrix, Array, checked_start, read_only, real_array
from ...core.cone_stack import ConeStack, Pattern
from ...core.entries import clip
from ...core.errors import InvalidOption, InvalidProblem, LCPError
from ...core.lcp import LCP
from ...methods.small import (
    LOOP_FROM,
    LOOP_UP_TO,
    SMALL_DENSE,
    has_numba,
    is_small,
    solve_stack,
    suits_loop,
    takes_rounds,
)
from ...systems.free_systems import matvecs
from ...systems.graph import outer_on_pattern, sum_of_outer
from ..cones.data import Blocks
from ..cones.frictional_contact import FrictionalContact, FrictionalContactBatch
from ..cones.solving import solve_cone_stack
from ..contact import motion_of
from ..least_squares.data import BoundedLeastSquares, apply_to
from ..least_squares.solving import length_of_stack, solve_least_squares_stack, suits_stack
from ..many import bounds_of_a_batch, errors_of, length_of_all, rows_of_a_batch

WORK = 2**18  # problems times n² per stack of LCPs
SHORTEST = 1024  # problems: the Python code of a stack takes .2 ms
TOGETHER = 2048  # instances per stack: fewer cost more calls, more leave a second thread idle
CONES_UP_TO = 400  # rows of a problem over cones in a stack
#: Items, and a function that returns z, residual, iterations and is_solved of these.
Stacks = Iterator[tuple[Any, Callable[[], tuple[Any, Any, Any, Any]]]]


class Group(NamedTuple):
    """LCPs of one size as arrays; an array of length 1 applies to all problems.

    Attributes
    ----------
    items : array of int, shape (k,)
        Indices in the batch.
    M : array, shape (k or 1, n, n)
    q, lower, upper, starts : arrays, shape (k or 1, n)
        Without columns, `starts` means z°.
    """

    items: Array
    M: AnyMatrix
    q: Array
    lower: Array
    upper: Array
    starts: Array

    def select(self, rows: Array) -> Group:
        """Return the problems in these rows."""
        of_rows = (array if len(array) == 1 else array[rows] for array in self[1:])
        return Group(self.items[rows], *of_rows)

    def vectors(self, *names: str) -> list[Any]:
        """Return these vectors of all problems, each of shape (k, n)."""
        shape = self.items.size, self.M.shape[1]
        arrays = (getattr(self, name) for name in names)
        return [rows if rows.shape == shape else np.broadcast_to(rows, shape) for rows in arrays]

    def stacks(self, tolerance: float, *, is_path: bool = False) -> Stacks:
        """Yield stacks of at most 5 to 10 ms, eight or more in a large batch: each thread has a part.

        If `is_path`, the compiled loop takes any number of problems, as Lemke's method of that name.
        """
        n, count = self.M.shape[1], self.items.size
        size = max(min(WORK // n**2, max(SHORTEST, count // 8)), 1)
        for first in range(0, count if is_path or suits_loop(count, n) else 0, size):
            part = self.select(slice(first, first + size)) if size < count else self
            names = ("q", "lower", "upper", *(["starts"] if part.starts.shape[1] else []))
            data = part.M, *part.vectors(*names)
            yield part.items, partial(solve_stack, *data, tolerance=tolerance)


class Instances:
    """The instances of a batch."""

    item, are_lcps, is_cold = "problem", False, False
    #: Algorithms that stacks replace, and the fewest max_iterations with which they do.
    stacked_by: tuple[str, ...] = ("auto", "lemke")
    fewest_iterations = 200
    errors: Mapping[int, LCPError] = MappingProxyType({})

    def start(self, k: int) -> Any:
        """Return the start of problem k, or None."""

    def groups(self, suits: Callable[[LCP], bool] = is_small) -> Iterator[Group]:
        """Yield the LCPs for which `suits` is true, grouped by size."""
        return iter(())

    def stacks(self, tolerance: float, has_time: Callable[[], bool], threads: int) -> Stacks:
        """Yield stacks of small problems."""
        for group in self.groups(takes_rounds):
            yield from group.stacks(tolerance)

    def path_stacks(self, tolerance: float, has_time: Callable[[], bool], threads: int) -> Stacks:
        """Yield the LCPs for which "lemke" is the compiled path: without starts, at most 128 unknowns."""
        for group in self.groups() if self.is_cold and has_numba() else ():
            if group.M.shape[1] <= LOOP_UP_TO:
                yield from group.stacks(tolerance, is_path=True)

    def outer(self, left: Array, right: Array) -> Any:
        """Return products left_i right_j, shape (B, n, n)."""
        return left[:, :, np.newaxis] * right[:, np.newaxis]

    def row(self, result: Any) -> Any:
        """Return the row of a result in the table of points."""
        return np.empty(0) if result.x is None else result.x


class Listed(Instances):
    """Problems of any classes and sizes.

    Parameters
    ----------
    problems : sequence
    z0 : sequence or None
        Starts of LCPs.
    """

    def __init__(self, problems: Sequence[Any], z0: Array) -> None:
        self.problems, self.starts, self.is_cold = problems, z0, z0 is None
        is_list = hasattr(z0, "__len__") and not isinstance(z0, str)
        if z0 is not None and not (is_list and len(z0) == len(problems)):
            raise InvalidOption(f"z0 must be a list of {len(problems)} starts, or None")
        self.are_lcps = all(isinstance(item, LCP) for item in problems)

    def __len__(self) -> int:
        return len(self.problems)

    def __getitem__(self, k: int) -> Any:
        return self.problems[k]

    def start(self, k: int) -> Any:
        """Return the start of problem k, or None."""
        return None if self.starts is None else self.starts[k]

    @property
    def points(self) -> list[Any]:
        """The points at which LCPs begin, nothing for other problems."""
        return [
            checked_start(item, self.start(k)) if isinstance(item, LCP) else np.empty(0)
            for k, item in enumerate(self.problems)
        ]

    def slacks(self, z: Array) -> Any:
        """Return M z + q of each problem."""
        rows = [item.slack(at) for item, at in zip(self.problems, z, strict=True)]
        return np.array(rows).reshape(z.shape) if isinstance(z, np.ndarray) else rows

    def outer(self, left: Array, right: Array) -> Any:
        """Return left_i right_j at the entries of each M, a list of CSR arrays."""
        triples = zip(self.problems, left, right, strict=True)
        return [outer_on_pattern(item.matrix, a, b) for item, a, b in triples]

    def groups(self, suits: Callable[[LCP], bool] = is_small) -> Iterator[Group]:
        """Yield the LCPs for which `suits` is true, grouped by size."""
        by_size: dict[int, list[int]] = {}
        for k, item in enumerate(self.problems):
            if isinstance(item, LCP) and item.n and suits(item):
                by_size.setdefault(item.n, []).append(k)
        for items in by_size.values():
            chosen = [self.problems[k] for k in items]
            is_shared = all(item.matrix is chosen[0].matrix for item in chosen)
            M = np.array([item.matrix.toarray() for item in chosen[: 1 if is_shared else None]])
            vectors = vectors_of(chosen, LCP.vector_names).values()
            yield Group(np.array(items), *map(read_only, (M, *vectors, np.empty((1, 0)))))

    def stacks(self, tolerance: float, has_time: Callable[[], bool], threads: int) -> Stacks:
        """Yield small problems over the same cones, and small LCPs of one size."""
        if self.starts is not None:
            return
        alike: dict[Any, list[int]] = {}
        for k, item in enumerate(self.problems):
            if isinstance(item, Blocks) and 0 < item.n <= CONES_UP_TO:
                alike.setdefault((item.has_friction, item.starts.tobytes()), []).append(k)
        for items in alike.values():
            chosen = [self.problems[k] for k in items]
            M = np.stack([item.rows.matrix.toarray() for item in chosen])
            vectors = vectors_of(chosen, ("q", "slope", "lower", "upper")).values()
            data = chosen[0].has_friction, chosen[0].starts, M, *vectors
            yield np.array(items), partial(_solve_cones, data, None, tolerance, has_time)
        yield from super().stacks(tolerance, has_time, threads)


def vectors_of(problems: Sequence[Any], names: tuple[str, ...]) -> dict[str, Any]:
    """Return these vectors of problems of one shape, each of shape (B, size)."""
    return {name: np.array([getattr(item, name) for item in problems]) for name in names}


def stack_of(has_friction: bool, starts: Array, M: AnyMatrix, *vectors: Array) -> ConeStack:
    """Return problems over the same cones as a stack; M, q, slope and bounds have an axis for them."""
    return ConeStack(Pattern(M, starts), *vectors, has_friction=has_friction)


def _solve_cones(data: Any, start: Array, tolerance: float, has_time: Callable[[], bool]) -> Any:
    """Solve problems over the same cones as a stack, from the rows of `start` or from z°."""
    stack = stack_of(*data)
    pattern, is_warm = stack.pattern, start is not None
    begun = pattern.wide(start) if is_warm else stack.origin
    z, *others = solve_cone_stack(stack, begun, tolerance, has_time, is_warm=is_warm)
    return pattern.flat(z), *others


def have_values(lower: Array, upper: Array) -> Any:
    """Return the mask of the problems whose bounds have a value between them, shape (B,)."""
    return ((lower <= upper) & (lower < np.inf) & (upper > -np.inf)).all(axis=1)


class ArrayInstances(Instances):
    """Problems with one matrix, or with a stack of matrices, in arrays with an axis for the problems.

    `base` has the matrix of all. `problems`, if they exist already, are the items, or their errors.

    Parameters
    ----------
    vectors : dict of arrays
        Shape (B, n), or (n,) for all, a bound may be a number; None is left out.
    n, m : int
        Length of the vectors, and of b.
    counts : dict of int
        Numbers of other arrays with an axis for the problems.
    """

    base: Any = None
    problems: Sequence[Any] | None = None
    changing: tuple[str, ...] = ()  # vectors that differ from the vectors of `base`; () if all may

    def __init__(self, vectors: dict[str, Any], n: int, m: int, counts: dict[str, int]) -> None:
        vectors = {name: values for name, values in vectors.items() if values is not None}
        others = [name for name in vectors if name not in ("lower", "upper")]
        sizes = {name: m if name == "b" else n for name in others}
        rows = {name: rows_of_a_batch(vectors[name], name, size) for name, size in sizes.items()}
        rows["lower"], rows["upper"] = bounds_of_a_batch(vectors["lower"], vectors["upper"], n)
        several = {name: len(rows[name]) for name in rows if np.ndim(vectors[name]) == 2}
        self.rows, self.count = rows, length_of_all(several | counts)
        if "z0" in rows and not np.isfinite(rows["z0"]).all():
            raise InvalidOption("z0 must be finite, got NaN or infinite entries")

    def _find_errors(self, is_good: Any) -> None:
        """Keep the error of each problem that is not good; bounds must be consistent as well."""
        is_good = is_good & have_values(self.rows["lower"], self.rows["upper"])
        self.errors = errors_of(self, np.broadcast_to(is_good, self.count))

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, k: int) -> Any:
        """Return problem k, or raise its error."""
        if self.problems is None:
            names = self.changing or self.base.vector_names
            return self.base.with_vectors(**{name: self._row(name, k) for name in names})
        if isinstance(item := self.problems[k], LCPError):
            raise item
        return item

    @property
    def valid(self) -> Any:
        """Numbers of the problems without errors."""
        numbers = np.arange(self.count)
        return np.delete(numbers, [*self.errors]) if self.errors else numbers

    def _row(self, name: str, k: int) -> Any:
        rows = self.rows[name]
        return rows[k if len(rows) > 1 else 0]

    def start(self, k: int) -> Any:
        """Return the start of problem k, or None."""
        return self._row("z0", k) if "z0" in self.rows else None

    @property
    def points(self) -> Any:
        """The points at which the problems begin, shape (B, n)."""
        begun = clip(self.rows.get("z0", 0.0), self.rows["lower"], self.rows["upper"])
        return np.array(np.broadcast_to(begun, (self.count, begun.shape[1])))


class Stacked(ArrayInstances):
    """Arrays: M of shape (B, n, n), or one (n, n) or LCP for all; the vectors of shape (B, n), (n,) or numbers."""

    are_lcps = True

    def __init__(self, M: AnyMatrix, q: Array, lower: Array, upper: Array, z0: Array) -> None:
        need = "M must be an array of shape (B, n, n) or (n, n), or a list of LCPs"
        shared = M if isinstance(M, LCP) else None
        self.M = shared.matrix.array if shared else M if sp.issparse(M) else real_array(M, need)
        n = self.M.shape[-1] if self.M.ndim else 0
        if self.M.ndim not in (2, 3) or self.M.shape[-2] != n:
            raise InvalidProblem(f"M must have shape (B, n, n), or (n, n), got {self.M.shape}")
        if q is None:
            raise InvalidProblem("q is missing: an array of shape (B, n), or (n,) for all")
        counts = {"M": len(self.M)} if self.M.ndim == 3 else {}
        super().__init__({"q": q, "lower": lower, "upper": upper, "z0": z0}, n, 0, counts)
        self.base, self.is_cold = shared, z0 is None
        if shared is None and self.M.ndim == 2:
            self.base = LCP(self.M, np.zeros(n))
        is_good = np.isfinite(self.rows["q"]).all(1)
        if self.M.ndim == 3:
            is_good = is_good & np.isfinite(self.M.sum(axis=(1, 2)))
        self._find_errors(is_good)

    def __getitem__(self, k: int) -> Any:
        """Return problem k, or raise its error."""
        if self.base is not None:
            return super().__getitem__(k)
        return LCP(self.M[k], **{name: self._row(name, k) for name in LCP.vector_names})

    def slacks(self, z: Array) -> Any:
        """Return M z + q of each problem, shape (B, n)."""
        return (matvecs(self.M, z) if self.base is None else (self.M @ z.T).T) + self.rows["q"]

    def outer(self, left: Array, right: Array) -> Any:
        """Return products of shape (B, n, n), or their sum on the pattern of a shared M."""
        if self.base is None:
            return super().outer(left, right)
        if not sp.issparse(self.M):
            return left.T @ right
        return sum_of_outer(self.base.matrix.csr, left, right)

    def groups(self, suits: Callable[[LCP], bool] = is_small) -> Iterator[Group]:
        """Yield the problems without errors, if `suits` is true for their matrix."""
        n, items = self.M.shape[-1], self.valid
        is_suited = 0 < n <= SMALL_DENSE if self.base is None else suits(self.base)
        if not is_suited or not items.size:
            return
        M = np.ascontiguousarray(self.M) if self.base is None else self.base.matrix.toarray()[None]
        vectors = [self.rows[name] for name in LCP.vector_names]
        starts = np.empty((1, 0))
        if "z0" in self.rows:
            starts = np.clip(self.rows["z0"], self.rows["lower"], self.rows["upper"])
        whole = Group(np.arange(self.count), *map(read_only, (M, *vectors, starts)))
        yield whole if items.size == self.count else whole.select(items)


class RightSides(ArrayInstances):
    """One least squares problem with many vectors b, shape (B, m), bounds and l1, shapes (B, n) or (n,).

    `problems`, if they exist already, are the items.
    """

    def __init__(self, problem: BoundedLeastSquares, problems: Any = None, **vectors: Any) -> None:
        self.base, self.problems, (m, n) = problem, problems, problem.shape
        for name in problem.vector_names:
            if vectors.get(name) is None:
                vectors[name] = getattr(problem, name)
        super().__init__(vectors, n, m, {})
        self._find_errors(problem.is_in_range(self.rows["b"]))

    @classmethod
    def of(cls, problems: Sequence[Any]) -> RightSides | None:
        """Return least squares problems that share A, weights and ridge; None for others."""
        if not all(isinstance(item, BoundedLeastSquares) for item in problems):
            return None
        if len({(id(item.A), id(item.weights), item.ridge) for item in problems}) != 1:
            return None
        return cls(problems[0], problems, **vectors_of(problems, problems[0].vector_names))

    def stack(self, items: Array) -> BoundedLeastSquares:
        """Return these problems as a stack."""
        rows = {name: self.rows[name] for name in self.base.vector_names}
        parts = {name: row if len(row) == 1 else row[items] for name, row in rows.items()}
        return self.base.stack(**parts)

    def stacks(self, tolerance: float, has_time: Callable[[], bool], threads: int) -> Stacks:
        """Yield stacks of small problems, whose arrays stay in the cache."""
        items = self.valid
        is_many = items.size >= LOOP_FROM and has_numba()
        if "z0" in self.rows or not (is_many and suits_stack(self.stack(slice(None)))):
            return
        _, size = self.base.normal_equations, length_of_stack(self.base)  # shared by all stacks
        for first in range(0, items.size, size):
            part = items[first : first + size]
            yield part, partial(solve_least_squares_stack, self.stack(part), tolerance)

    def objectives(self, z: Array) -> Any:
        """Return the cost of each z, shape (B,)."""
        stack = self.stack(slice(None))
        return stack.cost(z, apply_to(stack.A, z) - stack.b)


class ContactInstances(Instances):
    """Contact problems in arrays, and their starts.

    Parameters
    ----------
    contacts : FrictionalContactBatch
    z0 : array, shape (B, n) or (n,), optional
    """

    item = "world"

    def __init__(self, contacts: FrictionalContactBatch, z0: ArrayLike | None) -> None:
        self.instances, self.is_warm, self.errors = contacts, z0 is not None, contacts.errors
        shape, n = contacts.b.shape, contacts.n
        need = f"z0 must have shape ({len(contacts)}, {n}) or ({n},)"
        starts = real_array(np.zeros(n) if z0 is None else z0, need)
        if starts.shape not in (shape, (n,)) or not np.isfinite(starts).all():
            raise InvalidOption(f"{need}, and be finite, got shape {starts.shape}")
        is_there = np.arange(n) < contacts.sizes[:, np.newaxis]
        self.starts = np.where(is_there, starts, 0.0)

    @property
    def points(self) -> Any:
        """The points at which the problems begin, shape (B, n)."""
        return self.starts.copy()

    def __len__(self) -> int:
        return len(self.instances)

    def __getitem__(self, k: int) -> FrictionalContact:
        return self.instances[k]

    def start(self, k: int) -> Any:
        """Return the start of instance k, or None."""
        return self.starts[k, : self.instances.sizes[k]] if self.is_warm else None

    def slacks(self, z: Array) -> Any:
        """Return velocities after the impulses, shape (B, n)."""
        return np.einsum("bij,bj->bi", self.instances.W, z) + self.instances.b

    def data(self, W: AnyMatrix, b: Array, friction: Array) -> tuple[Any, ...]:
        """Return the arguments of `stack_of` for instances with these data."""
        d, n, p = self.instances.dimension, self.instances.n, self.instances.equations
        starts, none = np.r_[: n - p : d, n - p : n + 1], np.full((1, n), np.inf)
        return True, starts, W, b, np.pad(friction, ((0, 0), (0, p))), -none, none

    def motion(self, z: Array, w: Array) -> Any:
        """Return impulses and velocities contact by contact."""
        return motion_of(z, w, self.instances.b, self.instances.dimension, self.instances.equations)

    def stacks(self, tolerance: float, has_time: Callable[[], bool], threads: int) -> Stacks:
        """Yield stacks of small instances."""
        instances = self.instances
        for first in range(0, len(self) if 0 < instances.n <= CONES_UP_TO else 0, TOGETHER):
            part = slice(first, first + TOGETHER)
            data = self.data(instances.W[part], instances.b[part], instances.friction[part])
            start = self.starts[part] if self.is_warm else None
            solve_some = partial(_solve_cones, data, start, tolerance, has_time)
            yield np.arange(len(self))[part], solve_some
