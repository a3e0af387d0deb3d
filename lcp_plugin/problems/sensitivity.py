"""Derivative of a solution with respect to the data (:mod:`lcp_plugin.systems.free_systems`).

Within one active set z is smooth in M, q and the bounds. The free rows are strictly between their bounds, all other
rows are at a bound with w ≠ 0. A row at a bound with w = 0 is degenerate. z then has one-sided derivatives, each
the solution of a small LCP on the free and the degenerate rows.

If the free rows are singular, the change is the least one. A batch has stacked systems, and single ones in doubt.

References
----------
J. S. Pang, D. Ralph, *Piecewise smoothness, local invertibility, and parametric analysis of normal maps*,
Math. Oper. Res. 21 (1996), doi:10.1287/moor.21.2.401.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass
from functools import partial
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from ..core import checks
from ..core.checks import AnyMatrix, Array, BoolVector, Vector, derived_property
from ..core.cone_stack import ConeStack
from ..core.entries import residual_scales
from ..core.errors import InvalidOption, InvalidProblem, LCPError, UnsuitableProblem, public
from ..core.kernels.floats import EPSILON, HALF_OF_DIGITS
from ..core.lcp import LCP
from ..core.names import format_count, listed
from ..core.problem_classes import foreign_function, refusal
from ..core.settings import Status
from ..proofs.bounds import ActiveRows, settled_rows
from ..proofs.uniqueness import directions_of_solutions, moving
from ..solving.lcp_solver import solve_lcp
from ..solving.result import Result
from ..systems.free_systems import CONSISTENT, FreeBlocks, FreeSystem, LinearizedSystem, matvecs
from ..systems.graph import outer_on_pattern
from .batches.batch_run import BatchAnswers
from .batches.instances import ContactInstances, Group, RightSides, Stacked, stack_of
from .batches.program_batch import ProgramBatch
from .cones.data import Blocks
from .cones.derivative import ConeDerivative, StackDerivative
from .cones.newton import whole_systems
from .cones.solving import ConeResult
from .least_squares.solving import LeastSquaresResult
from .many import item_number, run_in_chunks
from .march import March, MarchDerivative
from .programs.derivative import ProgramArrays, ProgramDerivative, least_squares_data, program_data
from .programs.result import QuadraticProgramResult

STEPS = 6  # active-set iterations; from a solved problem 1 or 2 classify all rows
SCALAR_CHANGES = "dlower", "dupper", "dfriction"  # data whose change may be one number


class BatchPart(LinearizedSystem):
    """Small problems of a batch in arrays, with one stacked system.

    Each solution is computed again on its free rows until it changes only by rounding error, and its rows are
    classified. Rows at a bound with w = 0 are fixed, or free if only this makes the block regular. A problem is not
    plain if rounding error leaves a row undecided, or if its block is neither regular nor clearly singular.

    Parameters
    ----------
    group : Group
    z : array, shape (k, n)
    is_solved : array of bool, shape (k,)

    Attributes
    ----------
    points : array, shape (k, n)
        The refined solutions.
    """

    def __init__(self, group: Group, z: Array, is_solved: Array) -> None:
        self.group, self.items, self.points = group, group.items, z
        M, (q, lower, upper) = group.M, group.vectors("q", "lower", "upper")
        sizes = np.abs(M)
        largest = sizes.max(axis=2, initial=0.0)
        diagonal = np.diagonal(M, axis1=1, axis2=2)
        scale, terms = residual_scales(diagonal, largest), EPSILON * ((M != 0.0).sum(axis=2) + 2)
        is_exact, is_open = np.zeros(len(z), np.bool_), is_solved & np.isfinite(z).all(axis=1)
        z[~is_open] = 0.0
        for step in range(1, STEPS + 1):
            w, size = matvecs(M, z) + q, matvecs(sizes, np.abs(z)) + np.abs(q)
            at_lower = (z - lower) * scale <= w
            at_upper = ~at_lower & ((z - upper) * scale >= w)
            free, bound = ~(at_lower | at_upper), np.where(at_upper, upper, lower)
            if step == STEPS:  # rounding of the largest unknown, if no solve reduces it
                size = size + largest * np.abs(z).max(axis=1, initial=0.0)[:, np.newaxis]
            is_right = np.where(free, np.abs(w) <= terms * size, z == bound)
            is_exact = is_open & is_right.all(axis=1)
            wrong = np.flatnonzero(is_open & ~is_exact)
            if not wrong.size or step == STEPS:
                break
            blocks = FreeBlocks(M if len(M) == 1 else M[wrong], free[wrong])
            step_of_free = blocks.solve(-w[wrong])
            z[wrong] = np.where(free[wrong], z[wrong] + step_of_free, bound[wrong])
        within, slack = np.minimum(z - lower, upper - z), np.abs(w)
        distance = within * scale
        is_nearer = free & (upper - z < z - lower)
        self.is_upper = np.where(lower == upper, w < 0.0, at_upper | is_nearer)
        is_sized = diagonal >= 2.0**-10 * largest
        kink = (np.maximum(slack, distance) <= terms * size) & is_sized & (lower < upper)
        # a multiplier has no diagonal entry: the rows that it enters have its unit
        is_far = distance > HALF_OF_DIGITS * size
        if (diagonal == 0.0).any():
            seen = np.fmax.reduce(sizes / size[:, :, np.newaxis], axis=1)
            is_seen = (diagonal == 0.0) & (seen > 0.0)
            is_far = np.where(is_seen, within * seen > HALF_OF_DIGITS, is_far)
        is_clear = kink | (lower == upper) | np.where(free, is_far, slack > HALF_OF_DIGITS * size)
        self.degenerate, self.free = kink, free & ~kink
        self.blocks = FreeBlocks(M, self.free)
        is_doubtful = kink.any(axis=1) & ~self.blocks.is_regular
        if is_doubtful.any():
            is_freed = is_doubtful & FreeBlocks(M, free | kink).is_regular
            self.free |= kink & is_freed[:, np.newaxis]
            self.blocks = FreeBlocks(M, self.free)
        self.is_plain = is_exact & is_clear.all(axis=1)
        self.is_plain &= self.blocks.is_regular | self.blocks.is_singular

    def changes(self, h: Array, lower: Array, upper: Array) -> list[Any]:
        """Return [dz], NaN if it is one-sided or a block is singular."""
        held = np.where(self.free, 0.0, np.where(self.is_upper, upper, lower))
        dz = self.tangent(np.broadcast_to(h, held.shape), held)
        dz[self.degenerate.any(axis=1)] = np.nan
        return [dz]

    def gradients(self, g: Array, by_w: Array) -> list[Any]:
        """Return the gradients by q, lower and upper, of least norm if blocks are singular."""
        return gradients_by_data(self, g, by_w, self.free, self.is_upper)

    def _product(self, x: Array, *, transposed: bool = False) -> Any:
        return matvecs(self.group.M.swapaxes(1, 2) if transposed else self.group.M, x)

    def _solve_free(self, right: Array, *, transposed: bool = False) -> Any:
        x = self.blocks.solve(right, transposed=transposed)
        if not transposed:
            x[self.blocks.is_singular] = np.nan
        return x


def gradients_by_data(
    system: LinearizedSystem, g: Array, by_w: Array, free: Array, is_upper: Array
) -> list[Any]:
    """Return the gradients by q, lower and upper of a function with the gradients g by z and by_w by w."""
    # w stays 0 in free rows, and its part would cancel only up to rounding
    by_q, by_bound, _ = system.adjoint(g, np.where(free, 0.0, by_w))
    return [by_q, *(np.where(free | (is_upper != side), 0.0, by_bound) for side in (False, True))]


@dataclass(frozen=True, eq=False, repr=False)
class BatchGradient:
    """Gradients of functions of the solutions of a batch, with respect to the data.

    Attributes
    ----------
    q, lower, upper : array, shape (B, n)
        Gradients for each problem, see :class:`~lcp_plugin.problems.sensitivity.Gradient`. Contact problems have q (by
        b) and friction, shape (B, k). Rows are NaN if `errors` of the derivative contains an error, and 0 for absent
        contacts or if the function does not depend on the problem.
    """

    _matrix: Callable[[], Any]
    q: Array
    lower: Array = None
    upper: Array = None
    friction: Array = None

    @derived_property
    def M(self) -> Any:
        """Gradients by the entries of M, in the format of M; computed on first access.

        Shape (B, n, n), by all entries, if each problem has its M. If all problems share M, the sum of the
        gradients: shape (n, n), or a csr_array with the pattern of a sparse M. For a list of LCPs a list of
        csr_arrays with the patterns of the matrices.
        """
        return self._matrix()


class ManyDerivatives:
    """Derivatives of a batch; ``derivatives[k]`` is the derivative of result k.

    Small problems share stacked systems, other problems are treated individually.

    Parameters
    ----------
    batch : BatchAnswers

    Attributes
    ----------
    errors : dict
        Error of each item without a derivative: UnsuitableProblem if it is not solved, InvalidProblem if its data are
        invalid, and those that calls of `vjp` and `jvp` raise. Rows of these items are NaN, and do not affect other
        items. The arguments of calls are checked as by :class:`~lcp_plugin.problems.sensitivity.Derivative`.
    """

    names: tuple[str, ...]  # of the data other than M

    def __init__(self, batch: Any) -> None:
        self.batch = batch
        self._each: dict[int, Any] = {}
        self.errors: dict[int, LCPError] = {**batch.errors}
        self._is_solved = np.asarray(batch.status == Status.SOLVED, np.bool_)
        for k in sorted({*np.flatnonzero(~self._is_solved).tolist()} - self.errors.keys()):
            status = batch.status[k]
            ended = f"{batch.item} {k} ended {status.name}: {status.value}"
            self.errors[k] = UnsuitableProblem(f"only a solution has a derivative, and {ended}")

    def __len__(self) -> int:
        return len(self.batch.status)

    def __getitem__(self, k: int) -> Any:
        k = item_number(k, len(self))
        if k not in self._each:
            self._each[k] = self._derive(k)
        return self._each[k]

    def _derive(self, k: int) -> Any:
        return derivative(self.batch[k])

    @derived_property
    def _parts(self) -> Sequence[Any]:
        """Stacks of items: indices `items`, and the mask `is_plain` of items with a derivative."""
        raise NotImplementedError

    @derived_property
    def _unstacked(self) -> list[int]:
        """Solved items without a derivative in any stack."""
        is_unstacked = self._is_solved.copy()
        for part in self._parts:
            is_unstacked[part.items[part.is_plain]] = False
        return np.flatnonzero(is_unstacked).tolist()

    def _fill(self, rows: Any, of_part: Callable[[Any], Any], of_one: Callable[[int], Any]) -> None:
        """Write the rows of items with a derivative; some are treated individually.

        These are the items outside of all stacks, and items with NaN in the first row of their stack. Errors are
        stored in `errors`.
        """
        alone = [*self._unstacked]
        for part in self._parts:
            answers = of_part(part)
            is_done = part.is_plain & ~np.isnan(answers[0]).any(axis=1)
            for table, answer in zip(rows, answers, strict=True):
                table[part.items[is_done]] = answer[is_done]
            alone += part.items[part.is_plain & ~is_done].tolist()
        for k in alone:
            try:
                for table, answer in zip(rows, of_one(k), strict=True):
                    table[k][:] = 0
                    table[k][: answer.size] = answer
            except LCPError as error:
                self.errors[k] = error

    @derived_property
    def z(self) -> Any:
        """Solutions at which the derivatives are evaluated, shape (B, n); NaN if missing."""
        z = np.full(self.batch.z.shape, np.nan)
        self._fill([z], lambda part: [part.points], lambda k: [self[k].z])
        return checks.read_only(z)

    @derived_property
    def degenerate(self) -> Any:
        """Rows with w = 0 at a bound, bool, shape (B, n), or degenerate contacts, shape (B, k)."""
        kinks = np.zeros(self._is_there(self.names[-1]).shape, np.bool_)

        def of_one(k: int) -> Any:
            return [np.isin(np.arange(kinks.shape[1]), self[k].degenerate)]

        self._fill([kinks], lambda part: [part.degenerate], of_one)
        return kinks

    def _is_there(self, name: str) -> Any:
        """Return the mask of the rows, or contacts, of solved problems."""
        return np.broadcast_to(self._is_solved[:, np.newaxis], self.batch.z.shape)

    def _rows(self, values: object, name: str) -> Any:
        """Return a vector for each problem, 0 by default; rows of unsolved problems are ignored."""
        is_there = self._is_there(name)
        values = np.zeros(is_there.shape[1]) if values is None else values
        return self._checked(values, name, is_there)

    def _changed(self, dM: AnyMatrix, dq: Array) -> Any:
        """Return dM z + dq of each problem."""
        change = self._rows(dq, "dq")
        if dM is None:
            return change
        n, z = change.shape[1], np.where(self._is_solved[:, np.newaxis], self.z, 0.0)
        is_row = self._is_there("dM")
        if sp.issparse(dM) or np.ndim(dM) == 2:
            moved = (checks.rectangular_matrix(dM, "dM", n, n) @ z.T).T
            return np.where(is_row, moved, 0.0) + change
        is_there = is_row[:, :, np.newaxis] & is_row[:, np.newaxis]
        return matvecs(self._checked(dM, "dM", is_there), z) + change

    def _jvp(self, dM: AnyMatrix, dq: Array, **others: Any) -> Any:
        """Return the changes dz for changes of the data, shape (B, n)."""
        changes = {"dq": self._changed(dM, dq)}
        changes |= {name: self._rows(values, name) for name, values in others.items()}
        there = {name: self._is_there(name) for name in changes}
        dz = np.full(changes["dq"].shape, np.nan)

        def alone(k: int) -> Any:
            of_item = {name: rows[k, there[name][k]] for name, rows in changes.items()}
            return [self[k].jvp(**of_item)]

        tables = changes.values()
        self._fill([dz], lambda part: part.changes(*(rows[part.items] for rows in tables)), alone)
        return dz

    def vjp(self, g: Array, gw: Array = None) -> BatchGradient:
        """Return the gradients of functions L_k(z_k, w_k) of each solution by the data.

        Parameters
        ----------
        g : array, shape (B, n) or (n,)
            ∂L/∂z.
        gw : array, shape (B, n) or (n,), optional
            ∂L/∂w; w are the velocities of contacts.

        Returns
        -------
        BatchGradient

        Examples
        --------
        >>> from lcp_plugin import derivative, solve_batch
        >>> gradient = derivative(solve_batch([[2, 1], [1, 2]], [[-5, 1], [1, -4]])).vjp([1, 1])
        >>> gradient.q, gradient.M
        (array([[-0.5,  0. ],
               [ 0. , -0.5]]), array([[-1.25,  0.  ],
               [ 0.  , -1.  ]]))
        """
        by_z, by_w, there = self._rows(g, "g"), self._rows(gw, "gw"), self._is_there("g")
        tables = [np.full(self._is_there(name).shape, np.nan) for name in self.names]

        def alone(k: int) -> list[Any]:
            gradient = self[k].vjp(by_z[k, there[k]], by_w[k, there[k]])  # its M comes later
            return [getattr(gradient, name) for name in self.names]

        self._fill(tables, lambda part: part.gradients(by_z[part.items], by_w[part.items]), alone)
        weights = [rows for rows in (g, gw) if rows is not None]
        does_depend = sum(np.any(rows, axis=-1) for rows in weights) + np.zeros(len(self))
        for table in tables:
            table[[k for k in self.errors if not does_depend[k]]] = 0.0
        by = dict(zip(self.names, tables, strict=True))
        return BatchGradient(lambda: self._by_M(tables[0]), **by)

    def _by_M(self, by_q: Any) -> Any:
        """Return the gradients by M; 0 if the gradient by q is 0, also for an item without a z."""
        z = np.where(by_q.any(axis=1)[:, np.newaxis], self.z, 0.0)
        return self.batch.problems.outer(by_q, z)

    def _checked(self, values: object, name: str, is_there: BoolVector) -> Any:
        """Return an array like `is_there`, 0 for absent entries; one row applies to all."""
        shape, row_shape = is_there.shape, is_there.shape[1:]
        row = {"dM": "n, n", "dfriction": "k,"}.get(name, "n,")
        shapes = f"(B, {row.strip(',')}) or ({row}), here {shape} or {row_shape}"
        need = f"{name} must have shape {shapes}"
        array = checks.real_array(values, need)
        if array.shape not in (shape, row_shape, () if name in SCALAR_CHANGES else row_shape):
            raise InvalidProblem(f"{need}, got shape {array.shape}")
        array = np.broadcast_to(array, shape) if is_there.all() else np.where(is_there, array, 0.0)
        checks.require_finite(array, name)
        return array


class BatchDerivative(ManyDerivatives):
    """The derivatives of the solutions of a batch with respect to the data of each problem.

    Item k is the :class:`~lcp_plugin.problems.sensitivity.Derivative` of problem k, with its proofs. The arrays
    for all problems agree with it to rounding error.

    Parameters
    ----------
    batch : BatchAnswers

    Notes
    -----
    Small problems are solved as one stack. A problem is passed to its Derivative, which takes a hundred times as long,
    if it is close to a kink, if its free block may be singular, or if it needs a one-sided derivative. A batch of
    several sizes has no derivative: write ``[derivative(answer) for answer in batch]``.
    """

    names = "q", "lower", "upper"

    @derived_property
    def free(self) -> Any:
        """Rows that `vjp` treats as free, bool, shape (B, n)."""
        free = np.zeros(self.batch.z.shape, np.bool_)
        self._fill([free], lambda part: [part.free], lambda k: [self[k].free])
        return free

    @checks.changes_by_name
    def jvp(self, *, dM: Any = None, dq: Any = None, dlower: Any = None, dupper: Any = None) -> Any:
        """Return the change dz of each z for changes of the data; one-sided if rows are degenerate.

        Parameters
        ----------
        dM : array, shape (B, n, n) or (n, n), or a sparse array for all, optional
            The change of M, on any pattern.
        dq : array, shape (B, n) or (n,), optional
        dlower, dupper : number or array, shape (B, n) or (n,), optional
            Changes of the bounds; only active bounds matter.

        Returns
        -------
        array, shape (B, n)

        Examples
        --------
        >>> from lcp_plugin import derivative, solve_batch
        >>> derivatives = derivative(solve_batch([[2, 1], [1, 2]], [[-5, 1], [1, -4]]))
        >>> derivatives.jvp(dq=[1, 0], dlower=0.5)
        array([[-0.75,  0.5 ],
               [ 0.5 , -0.25]])
        """
        return self._jvp(dM, dq, dlower=dlower, dupper=dupper)

    @derived_property
    def _parts(self) -> list[BatchPart]:
        """The groups of small problems, with classified rows."""
        groups = self.batch.problems.groups()
        z, is_solved = self.batch.z, self._is_solved
        return [BatchPart(group, z[group.items], is_solved[group.items]) for group in groups]


class ConditionsBatchDerivative(BatchDerivative):
    """Derivatives of the conditions of a batch, with the errors of :class:`ConditionsDerivative`.

    Parameters
    ----------
    batch : SimpleNamespace
        LCPs as `problems`, their solutions z, and item, status and errors of the batch.
    data, is_strict
        As of :class:`ConditionsDerivative`.
    """

    def __init__(self, batch: Any, data: Any, *, is_strict: bool = True) -> None:
        super().__init__(batch)
        self.data, self.is_strict = data, is_strict

    def one_sided(self) -> ConditionsBatchDerivative:
        """Return the derivatives that accept degenerate rows."""
        return ConditionsBatchDerivative(self.batch, self.data, is_strict=False)

    def _derive(self, k: int) -> ConditionsDerivative:
        problem, z = self.batch.problems[k], self.batch.z[k]
        return ConditionsDerivative(problem, z, self.data, is_strict=self.is_strict)

    @derived_property
    def _parts(self) -> list[BatchPart]:
        parts = super()._parts
        for part in parts:
            part.is_plain &= part.blocks.is_regular
            if self.is_strict:
                part.is_plain &= ~part.degenerate.any(axis=1)
        return parts

    @property
    def degenerate_parts(self) -> Any:
        """Mask of the degenerate rows, shape (B, N)."""
        return self.degenerate

    @derived_property
    def is_unique(self) -> Any:
        """Problems with a derivative, bool, shape (B,)."""
        are_unique = np.zeros(len(self), np.bool_)
        for part in self._parts:
            are_unique[part.items] = part.is_plain & ~part.degenerate.any(axis=1)
        are_unique[self._unstacked] = [self[k].is_unique for k in self._unstacked]
        return are_unique


class ProgramBatchDerivative(ProgramDerivative):
    """The derivatives of the solutions of a batch of programs, or of least squares problems.

    Item k is the :class:`~lcp_plugin.problems.programs.derivative.ProgramDerivative` of problem k; `jvp` and
    `vjp` are as there, for all problems at once.
    """

    def __init__(self, data: Any, conditions: ConditionsBatchDerivative, batch: Any) -> None:
        super().__init__(data, conditions)
        self.batch = batch

    def __len__(self) -> int:
        return len(self.batch)

    def __getitem__(self, k: int) -> ProgramDerivative:
        item: ProgramDerivative = derivative(self.batch[k])
        return item if self.conditions.is_strict else item.one_sided()


INSTANCES_TOGETHER = 512  # instances whose arrays fit into the cache


class ContactPart(StackDerivative):
    """Derivatives of some instances, with an inverse of each system."""

    def __init__(self, stack: ConeStack, z: Array, items: Array, is_solved: Array) -> None:
        super().__init__(stack, stack.pattern.wide(z))
        self.items = items
        self.is_plain = is_solved & (self.system.is_regular | self.system.is_singular)

    @derived_property
    def system(self) -> FreeBlocks:
        """The inverses on the free rows."""
        free = np.repeat(self.is_free, self.stack.pattern.sizes, axis=1)
        return FreeBlocks(whole_systems(self.stack, self.by_z, self.by_w), free)

    @property
    def points(self) -> Any:
        """The refined impulses, shape (B, n)."""
        return self.stack.pattern.flat(self.z)

    def changes(self, change: Array, slopes: Array) -> list[Any]:
        """Return [dz], a row per instance, for changes of W z + b and friction; NaN at a kink."""
        sizes = self.stack.pattern.sizes
        slopes = np.pad(slopes, ((0, 0), (0, sizes.size - slopes.shape[1])))  # equations have none
        more = self.by_friction * np.repeat(slopes, sizes, axis=1)
        dz = self.tangent(change, None, more)
        dz[self.degenerate.any(axis=1)] = np.nan
        return [dz]

    def gradients(self, g: Array, by_w: Array) -> Any:
        """Return the gradients by q and friction."""
        by_q, _, by_friction = super().gradients(g, by_w)
        return by_q, by_friction[:, : np.count_nonzero(self.stack.pattern.sizes > 1)]

    def _solve_free(self, right: Array, *, transposed: bool = False) -> Any:
        return self.system.solve(right, transposed=transposed)


class ContactBatchDerivative(ManyDerivatives):
    """Derivatives of the impulses of a batch of contact problems with respect to W, b and friction.

    Item k is the :class:`~lcp_plugin.problems.cones.derivative.ConeDerivative` of instance k. The arrays for
    all instances agree with it to rounding error.

    Parameters
    ----------
    batch : BatchAnswers

    Notes
    -----
    The first call inverts the systems of all instances, with the number of threads of the batch. Every later `vjp` and
    `jvp` is a product. An instance is passed to its ConeDerivative, which takes a hundred times as long, if its system
    may be singular, or for `jvp` if it has degenerate contacts.

    Examples
    --------
    How the impulse of a block that slides depends on friction, on the push, and on W:

    >>> from lcp_plugin import FrictionalContact, derivative, solve_batch
    >>> batch = solve_batch(FrictionalContact.worlds(np.eye(3), [[-1.0, 3.0, 4.0], [-1.0, 0.3, 0.0]], 0.5))
    >>> derivatives = derivative(batch)
    >>> (derivatives.jvp(dfriction=1.0).round(6) + 0.0).tolist()
    [[0.0, -0.6, -0.8], [0.0, 0.0, 0.0]]
    >>> gradient = derivatives.vjp([1.0, 0.0, 0.0])
    >>> (gradient.q.round(6) + 0.0).tolist(), (gradient.friction.round(6) + 0.0).tolist(), gradient.M.shape
    ([[-1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]], [[0.0], [0.0]], (2, 3, 3))
    """

    names = "q", "friction"

    @property
    def instances(self) -> Any:
        """The FrictionalContactBatch."""
        return self.batch.problems.instances

    @derived_property
    def is_unique(self) -> list[bool | None]:
        """Uniqueness of each derivative: False at degenerate blocks or if z is not unique, else None (not proved)."""
        return [self[k].is_unique if self._is_solved[k] else False for k in range(len(self))]

    @derived_property
    def _parts(self) -> list[ContactPart]:
        """Derivatives of the instances, in groups."""
        instances, z, is_solved = self.instances, self.batch.z, self._is_solved[:, np.newaxis]
        parts: list[Any] = [None] * max(-(-len(self) // INSTANCES_TOGETHER), 1)

        def derive(first: int, end: int) -> None:
            for k in range(first, end):
                part = slice(k * INSTANCES_TOGETHER, (k + 1) * INSTANCES_TOGETHER)
                W = np.where(is_solved[part, :, np.newaxis], instances.W[part], np.eye(instances.n))
                data = instances.b, z, instances.friction
                b, at, mu = (np.where(is_solved[part], rows[part], 0.0) for rows in data)
                stack = stack_of(*self.batch.problems.data(W, b, mu))
                parts[k] = ContactPart(stack, at, np.arange(len(self))[part], self._is_solved[part])

        run_in_chunks(derive, len(parts), self.batch.threads)
        return parts

    @checks.changes_by_name
    def jvp(self, *, dq: Array = None, dM: AnyMatrix = None, dfriction: Array = None) -> Any:
        """Return the changes dz for changes of the data, shape (B, n); one-sided at a kink.

        Parameters
        ----------
        dq : array, shape (B, n) or (n,), optional
            db.
        dM : array, shape (B, n, n) or (n, n), optional
            dW.
        dfriction : number or array, shape (B, k) or (k,), optional
        """
        return self._jvp(dM, dq, dfriction=dfriction)

    def dw(self, dz: ArrayLike, *, dq: Array = None, dM: AnyMatrix = None) -> Any:
        """Return the changes of the velocities w = W z + b for changes dz of z, shape (B, n)."""
        dw = matvecs(self.instances.W, self._rows(dz, "dz")) + self._changed(dM, dq)
        dw[[*self.errors]] = np.nan
        return dw

    def _is_there(self, name: str) -> Any:
        """Return the mask of the rows, or contacts, of solved instances."""
        instances, is_mu = self.instances, name.endswith("friction")
        size = instances.friction.shape[1] if is_mu else instances.n
        counts = np.where(self._is_solved, instances.contacts if is_mu else instances.sizes, 0)
        return np.arange(size) < counts[:, np.newaxis]


NO_INVERSE = "M is singular on the free rows, too many for a generalised inverse; regularise M"


def words_on_singular(system: FreeSystem) -> str:
    """Return a warning about a derivative if M is singular on the free rows."""
    inverse = system.pseudo_inverse
    if inverse is None:
        return NO_INVERSE
    rank = round(float(np.trace(inverse @ system.block)))
    alike = "the same" if np.all(system.determined_slack) else "not the same"
    return (
        f"M has rank {rank} on the {system.rows.size} free rows: z is one of several solutions, w {alike} for all of "
        "them, and this the derivative of the least change"
    )


def solution(system: FreeSystem, right: Vector, *, transposed: bool = False) -> Vector:
    """Return the solution, with least norm if the block is singular."""
    x = system.least_solution(right, transposed=transposed)
    if x is None:
        raise UnsuitableProblem(NO_INVERSE)
    if system.is_singular and not transposed:
        part, right = x[system.rows], right[system.rows]
        # An entry of 1e-17 stands for 0: next to its terms, the residual of its row is large
        sizes = np.maximum(np.abs(part), 1e-5 * np.abs(part).max(initial=0.0))
        terms = abs(system.block) @ sizes + np.abs(right)
        if (np.abs(right - system.block @ part) > CONSISTENT * terms).any():
            raise UnsuitableProblem(
                f"M is singular on the {part.size} free rows, and after this change no z solves them: there is no "
                "derivative in this direction; regularise M, or change q within what M z can give"
            )
    return x


def one_sided(problem: LCP, rows: ActiveRows, h: Vector, moved: Vector) -> Vector:
    """Return the one-sided derivative: the solution of an LCP on the free and the degenerate rows.

    Rows fixed at a bound have d = db, which is `moved`, and free rows have (M d + h)_i = 0. Degenerate rows at a lower
    bound have d ≥ db and (M d + h) ≥ 0, complementary, and the mirror image at an upper bound.
    """
    lower = np.where(rows.free | (rows.degenerate & rows.is_upper), -np.inf, moved)
    upper = np.where(rows.free | (rows.degenerate & ~rows.is_upper), np.inf, moved)
    part = np.flatnonzero(rows.free | rows.degenerate)
    dz = np.where(rows.at_lower | rows.at_upper, moved, 0.0)
    M = problem.M
    small = LCP(M[part][:, part], (h + M @ dz)[part], lower=lower[part], upper=upper[part])
    result = solve_lcp(small)
    if not result.is_solved:
        raise UnsuitableProblem(
            f"{part.size} free and degenerate rows have no computed one-sided derivative: their LCP ended "
            f"{result.status.name}; the block of M on them is no P-matrix, and z may jump or have branches"
        )
    dz[part] = settled_rows(small, result.z, result.w).z
    return dz


class Gradient(NamedTuple):
    """Gradient of a function of the solution, with respect to the data of the problem.

    Attributes
    ----------
    q, lower, upper : ndarray, shape (n,)
        Gradients with respect to q and the bounds; 0 for an inactive bound. If lower = upper, the gradient belongs to
        the bound selected by the sign of w. If both bounds move together, use the sum.
    M : csr_array, shape (n, n)
        Gradient with respect to the entries of M, on the sparsity pattern of M.
    """

    q: Vector
    lower: Vector
    upper: Vector
    M: sp.csr_array


@np.errstate(all="ignore")
def derivative(result: Any) -> Any:
    """Return the derivative of the solution of an LCP, a program, a batch or steps in time with respect to the data.

    For a cvxpy problem with complementarities, solved by ``method="LCP"``, the derivative is with respect to its
    parameters; see ``help("lcp_plugin.modeling")``.

    Parameters
    ----------
    result : Result or BatchAnswers or March
        SOLVED result of an LCP or of a NonlinearProblem, for which dq is a change of F. The derivative uses the
        hierarchy of M built in the run, and M is not copied: do not change its entries between the solve and this
        call.
        For a QuadraticProgram or BoundedLeastSquares see
        :class:`~lcp_plugin.problems.programs.derivative.ProgramDerivative`.
        For cones see :class:`~lcp_plugin.problems.cones.derivative.ConeDerivative`.

    Returns
    -------
    Derivative or BatchDerivative or ContactBatchDerivative or MarchDerivative or ProgramDerivative
        All quantities are computed on first access. ``errors`` of a batch derivative lists the problems without one.

    Raises
    ------
    UnsuitableProblem
        If a Result is not SOLVED, or a march was not solved to its end.
    InvalidOption
        If the argument is none of these, or is a march over cones: use ``derivative(done[k])`` for each step. For a
        list of problems over cones use ``derivative(answers[k])``.

    Examples
    --------
    >>> from lcp_plugin import LCP, solve
    >>> slope = derivative(solve(LCP([[2, 1], [1, 2]], [-5, 1])))
    >>> slope.jvp(dq=[1, 0]), slope.is_unique
    (array([-0.5,  0. ]), True)
    >>> gradient = slope.vjp([1, 1])
    >>> gradient.q, gradient.lower
    (array([-0.5,  0. ]), array([0. , 0.5]))
    >>> gradient.M.toarray()
    array([[-1.25,  0.  ],
           [ 0.  ,  0.  ]])
    """
    if isinstance(result, BatchAnswers):
        return _derivative_of_batch(result)
    if isinstance(result, March):
        if isinstance(result.problem, Blocks):
            raise InvalidOption(
                "a march over cones is not differentiable; derivative(done[k]) differentiates step k by its q"
            )
        return MarchDerivative(result, Derivative)
    if (derivative_of := foreign_function("derivative", result)) is not None:
        return derivative_of(result)
    if not isinstance(result, (Result, QuadraticProgramResult, LeastSquaresResult)):
        raise InvalidOption(refusal("derivative", result))
    if not result.is_solved:
        why = f"this run ended {result.status.name}: {result.advice}"
        raise UnsuitableProblem(f"only a solution has a derivative, and {why}")
    if isinstance(result, ConeResult):
        return ConeDerivative(result.problem, result.z)
    if isinstance(result, QuadraticProgramResult):
        solution = result.solution
        z = np.concatenate([result.x, solution.inequality, solution.equality])
        return _derivative_of_program(program_data(result.program), z)
    if isinstance(result, LeastSquaresResult):
        return _derivative_of_program(least_squares_data(result.problem, result.x), result.x)
    return Derivative(result.certificate.problem, result.z, result.w)


def _derivative_of_batch(batch: BatchAnswers) -> Any:
    problems = batch.problems
    if isinstance(problems, ContactInstances):
        return ContactBatchDerivative(batch)
    z = batch._run.tables().get("z")  # on the host
    if problems.are_lcps and isinstance(z, np.ndarray):
        return BatchDerivative(checks.fill(copy(batch), z=z))
    if isinstance(problems, ProgramBatch):
        valid = (problems[k] for k in range(len(batch)) if k not in batch.errors)
        example = problems.base or next(valid, None)
        if example is None:
            raise batch.errors[0]
        arrays = {name: getattr(problems, name) for name in "PGA"}
        for name, rows in problems.rows.items():
            arrays[name] = np.broadcast_to(rows, (len(batch), rows.shape[1]))
        data: Any = ProgramArrays(example, arrays)
        z = np.concatenate([batch.x, batch.inequality, batch.equality], axis=1)
        return _derivative_of_program(data, z, batch)
    sides = problems if isinstance(problems, RightSides) else RightSides.of([*problems])
    if sides is not None:
        data = least_squares_data(sides.stack(slice(None)), batch.x)
        return _derivative_of_program(data, batch.x, batch)
    raise InvalidOption(
        "the derivative of a batch takes problems of one size, and of least squares those by problem.with_vectors; "
        "otherwise write [derivative(answer) for answer in batch]"
    )


def _derivative_of_program(data: Any, z: Array, batch: Any = None) -> ProgramDerivative:
    """Return the derivative of a program or least squares problem, or of a batch, at the z of its conditions."""
    problem = data.problem(partial(Stacked, z0=None))
    if batch is None:
        return ProgramDerivative(data, ConditionsDerivative(problem, z, data))
    facts = {"item": batch.item, "status": batch.status, "errors": problem.errors | batch.errors}
    conditions = SimpleNamespace(problems=problem, z=z, **facts)
    return ProgramBatchDerivative(data, ConditionsBatchDerivative(conditions, data), batch)


class Derivative(LinearizedSystem):
    """The derivative of a solution z with respect to the data of its problem.

    Parameters
    ----------
    problem : LCP
    z, w : array, shape (n,)
        Solution and slack of the problem.
        The linearization at z of a nonlinear problem: dq is then a change dF of F, and nothing is proved.
    before : Derivative, optional
        Derivative for a problem with the same M, whose factorization is used again.

    Notes
    -----
    The solution is computed again on its free rows, with w in twice the working precision. The rows are then
    classified reliably, and ∂z/∂M is evaluated at the solution of the stored data instead of a z within the tolerance.

    If M is singular on the free rows, z is one of several solutions. The derivative is then the least change, in a
    scaling computed from M, by the Moore–Penrose inverse of at most 500 rows. Quantities common to all solutions,
    such as contact velocities with undetermined impulses, have the same derivative for every solution. In this case
    dM is not available, vjp requires a symmetric M, and jvp requires that no row is degenerate.
    """

    def __init__(
        self, problem: LCP, z: Vector, w: Vector, *, before: Derivative | None = None
    ) -> None:
        self.problem = problem
        self._solution = z, w, None if before is None else before._rows.system

    @derived_property
    def _rows(self) -> ActiveRows:
        return settled_rows(self.problem, *self._solution)

    @property
    def z(self) -> Vector:
        """The solution at which the derivative is evaluated, shape (n,)."""
        return self._rows.z

    @property
    def free(self) -> BoolVector:
        """Rows that `vjp` treats as free, (n,); degenerate rows only to make a block regular."""
        return self._system.free

    @property
    def degenerate(self) -> NDArray[np.intp]:
        """Rows at a bound with w = 0, up to the rounding error of the data.

        Rows without a bound that only prescribe z, such as boundary values as identity rows, do not count.
        """
        return np.flatnonzero(self._rows.degenerate)

    @derived_property
    def is_unique(self) -> bool:
        """True if the derivative exists, so that jvp is linear and vjp the only gradient.

        False if rows are degenerate, or if M is singular on the free rows, up to the rounding error of the data.
        """
        return not (self._rows.degenerate.any() or self._system.is_singular)

    @derived_property
    def _system(self) -> FreeSystem:
        """System of the free rows, with the degenerate rows only if these make it regular."""
        rows = self._rows
        if rows.system is not None and np.array_equal(rows.system.free, rows.free):
            return rows.system
        system = FreeSystem(self.problem.matrix, rows.free)
        if rows.degenerate.any() and system.is_singular:
            freed = FreeSystem(self.problem.matrix, rows.free | rows.degenerate)
            return system if freed.is_singular else freed
        return system

    @property
    def determined(self) -> BoolVector:
        """Mask of the z_i that are the same in all solutions near z, (n,), for a monotone M.

        False in free and degenerate rows if these are more than 500 and M is singular there.
        """
        mask = np.ones(self.problem.n, np.bool_)
        if self.is_unique:
            return mask
        directions = directions_of_solutions(self.problem, self._rows)
        if directions is not None:
            mask[moving(directions)] = False
        elif self._system.is_singular:
            mask = ~(self._rows.free | self._rows.degenerate)
        return mask

    @derived_property
    def advice(self) -> str:
        """Warning that the derivative is not unique, as text; "" if it is unique."""
        system, rows = self._system, self.degenerate
        other = np.flatnonzero(~self.determined)
        names = listed(map(self.problem.names.unknown, other.tolist()))
        several = f"other solutions differ in {names}" if other.size else ""
        singular = words_on_singular(system) if system.is_singular else ""
        kink = ""
        if rows.size:
            numbers = listed(map(str, rows.tolist()))
            kink = (
                f"w = 0 at a bound in {format_count(rows.size, 'row')} ({numbers}): jvp is one-sided, and vjp the "
                "gradient of one of the pieces that meet there"
            )
        return "; ".join(filter(None, (kink, singular, several)))

    @np.errstate(all="ignore")
    @checks.changes_by_name
    def jvp(
        self, *, dM: AnyMatrix = None, dq: Array = None, dlower: Array = None, dupper: Array = None
    ) -> Vector:
        """Return the change dz of z for changes of the data; one-sided if rows are degenerate.

        Parameters
        ----------
        dM : array or sparse array, shape (n, n), optional
            The change of M, on any pattern.
        dq : array, shape (n,), optional
        dlower, dupper : number or array, shape (n,), optional
            Changes of the bounds; only active bounds matter.

        Returns
        -------
        array, shape (n,)
            Unit of z per unit of the data.

        Raises
        ------
        InvalidProblem
            For another shape, or numbers that are not finite.
        UnsuitableProblem
            If no z solves the free rows after the change, if more than 500 free rows are singular, or if no one-sided
            derivative exists.

        Examples
        --------
        >>> from lcp_plugin import LCP, solve
        >>> kink = derivative(solve(LCP([[2.0]], [0.0])))
        >>> kink.is_unique, kink.degenerate, kink.jvp(dq=[-1.0]), kink.jvp(dq=[1.0])
        (False, array([0]), array([0.5]), array([0.]))
        """
        h, moved = checks.change_of_slack(dM, dq, self.z), self._moved(dlower, dupper)
        if self._rows.degenerate.any():
            return one_sided(self.problem, self._rows, h, moved)
        return self.tangent(h, np.where(self._rows.free, 0.0, moved))

    def dw(self, dz: ArrayLike, *, dM: AnyMatrix = None, dq: Array = None) -> Vector:
        """Return the change of w = M z + q for a change dz of z, shape (n,)."""
        dz = checks.checked_vector(dz, "dz", self.problem.n)
        return self._product(dz) + checks.change_of_slack(dM, dq, self.z)

    @public
    def vjp(self, g: ArrayLike, gw: ArrayLike | None = None) -> Gradient:
        """Return the gradients of a function L(z, w) by q, the bounds and the entries of M.

        If rows are degenerate, this is the gradient of one of the pieces that meet there (an element of the
        B-subdifferential), in which the rows in `free` are free.

        Parameters
        ----------
        g : array, shape (n,)
            ∂L/∂z.
        gw : array, shape (n,), optional
            ∂L/∂w.

        Raises
        ------
        InvalidProblem
            For another shape, or numbers that are not finite.
        UnsuitableProblem
            If the block of M on more than 500 free rows is singular.
        """
        problem, n = self.problem, self.problem.n
        g, by_w = checks.checked_vector(g, "g", n), checks.change_of_vector(gw, "gw", n)
        sides = self.free, self._rows.is_upper
        by_q, lower, upper = gradients_by_data(self, g, by_w, *sides)
        return Gradient(by_q, lower, upper, outer_on_pattern(problem.matrix, by_q, self.z))

    def _moved(self, dlower: ArrayLike | None, dupper: ArrayLike | None) -> Vector:
        """Return the change of the active or, for free rows, the nearer bound."""
        n = self.problem.n
        lower = checks.change_of_vector(dlower, "dlower", n, may_be_number=True)
        upper = checks.change_of_vector(dupper, "dupper", n, may_be_number=True)
        return np.where(self._rows.is_upper, upper, lower)

    def _product(self, x: Vector, *, transposed: bool = False) -> Vector:
        M = self.problem.matrix.array
        return (M.T if transposed else M) @ x

    def _solve_free(self, right: Vector, *, transposed: bool = False) -> Vector:
        return solution(self._system, right, transposed=transposed)


class ConditionsDerivative(Derivative):
    """The derivative at a solution of a program's conditions, which raises an error where it is not unique.

    Parameters
    ----------
    problem : LCP
    z : array, shape (n,)
    data : ProgramArrays or LeastSquaresData
        The first unknowns are x, the others multipliers.
    is_strict : bool
        Whether degenerate rows raise an error as well.
    """

    def __init__(self, problem: LCP, z: Vector, data: Any, *, is_strict: bool = True) -> None:
        super().__init__(problem, z, problem.slack(z))
        self.data, self.is_strict = data, is_strict

    def one_sided(self) -> ConditionsDerivative:
        """Return the derivative that accepts degenerate rows."""
        return ConditionsDerivative(self.problem, self._solution[0], self.data, is_strict=False)

    @property
    def degenerate_parts(self) -> list[str]:
        """Names of the parts of the program that are active with multiplier 0."""
        sides = np.where(self._rows.is_upper, "upper", "lower")
        return [self.data.name_of(k, sides[k]) for k in self.degenerate.tolist()]

    def jvp(self, **changes: Any) -> Vector:
        """Return the change dz; see :meth:`Derivative.jvp`. Only x must have a derivative, in this direction."""
        with suppress(UnsuitableProblem):
            if (dz := self._smooth_change(changes)) is not None:
                return dz
        self._require_unique()
        return super().jvp(**changes)

    def _smooth_change(self, changes: dict[str, Any]) -> Vector | None:
        """Return dz if x, the first unknowns, has one change in this direction and its negative, else None."""
        n = self.data.ends[0]
        if not (self.is_strict and self.degenerate.size):
            return super().jvp(**changes) if self.determined[:n].all() else None
        ahead = super().jvp(**changes)
        back = super().jvp(**{name: -np.asarray(change) for name, change in changes.items()})
        size = np.maximum(np.abs(ahead), np.abs(back))[:n].max(initial=0.0)
        is_smooth = np.abs(ahead + back)[:n].max(initial=0.0) <= CONSISTENT * size
        return ahead if is_smooth else None

    def vjp(self, g: ArrayLike, gw: ArrayLike | None = None) -> Gradient:
        """Return the gradients; see :meth:`Derivative.vjp`."""
        self._require_unique()
        return super().vjp(g, gw)

    def _require_unique(self) -> None:
        """Raise UnsuitableProblem, with the names of the parts of the program for which no derivative exists."""
        if self.is_strict and self.degenerate.size:
            raise UnsuitableProblem(
                f"x has a kink here: {listed(self.degenerate_parts)} active with multiplier 0; "
                "derivative(result).one_sided() has one-sided changes, and the gradient of one piece"
            )
        if self._system.is_singular:
            others = np.flatnonzero(~self.determined).tolist()
            names = listed(map(self.data.name_of, others)) or "linearly dependent rows"
            raise UnsuitableProblem(
                f"x or its multipliers have several values: {names}; "
                "make P, or by a ridge AᵀA, definite there, or leave out dependent rows"
            )
