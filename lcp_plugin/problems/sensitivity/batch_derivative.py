"""The derivatives of a batch: a compiled loop over what is small and plain, one by one what needs more digits."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any, Generic, TypeVar

import numpy as np
import scipy.sparse as sp

from ...core.checks import finite_vector, is_number, read_only, real_array, rectangular_matrix
from ...core.errors import InvalidProblem, LCPError, UnsuitableProblem
from ...core.kind import changes_by_name
from ...core.settings import Status
from ...systems.least_norm import FreeBlocks, products
from ...systems.linearised import Linearised
from ..batches.batch_groups import Group
from ..batches.batch_items import put
from ..batches.batch_run import BatchAnswers, BatchResult
from ..many.chunks import in_chunks

R = TypeVar("R", bound=BatchAnswers[Any])
CHANGES = ("dM", "dq", "dlower", "dupper")
NUMBERS = "dlower", "dupper", "dfriction"  # which may be one number
OF_ARRAYS = (
    "; of contacts as arrays write jvp(**data.changes(dfriction=…)), data that of contact_data"
)


class BatchPart(Linearised):
    """Problems of a batch that share a compiled loop.

    It settles those with `is_plain`: z and side are their solutions, and where each row is, `workspace` says how.
    """

    def __init__(self, group: Group, z: Any, is_solved: Any, threads: int) -> None:
        from ...methods.small.kernels.workspace import AT_UPPER, BETWEEN
        from .kernels import KINK, settle_all

        self.group, self.items, self.threads = group, group.items, threads
        self.z, self.side, self.is_plain = z, np.zeros(z.shape, np.int8), is_solved
        data, found = (
            (group.M, group.q, group.lower, group.upper),
            (self.z, self.side, self.is_plain),
        )
        in_chunks(lambda first, end: settle_all(*data, first, end, *found), len(z), threads)
        self.free, self.is_upper = self.side % KINK == BETWEEN, self.side % KINK == AT_UPPER
        self.degenerate = self.side >= KINK

    def changes(self, h: Any, lower: Any, upper: Any) -> list[Any]:
        """Return [dz], NaN where it is one-sided, or a block singular."""
        held = np.where(self.free, 0.0, np.where(self.is_upper, upper, lower))
        dz = self.tangent(np.broadcast_to(h, held.shape), held)
        dz[self.degenerate.any(axis=1)] = np.nan
        return [dz]

    def gradients(self, g: Any, by_w: Any) -> list[Any]:
        """Return those by q, lower and upper, by least norm where blocks are singular, NaN where that is in doubt."""
        g, by_w = (
            np.broadcast_to(g, self.z.shape),
            np.where(self.free, 0.0, by_w),
        )  # w stays 0 there
        by_q, by_bound, _ = self.adjoint(g, by_w)
        return [
            by_q,
            *(
                np.where(self.free | (self.is_upper != side), 0.0, by_bound)
                for side in (False, True)
            ),
        ]

    def _product(self, x: Any, *, transposed: bool = False) -> Any:
        return products(self.group.M.swapaxes(1, 2) if transposed else self.group.M, x)

    def _on_free(self, right: Any, *, transposed: bool = False) -> Any:
        from .kernels import solve_all

        M = (
            read_only(np.ascontiguousarray(self.group.M.swapaxes(1, 2)))
            if transposed
            else self.group.M
        )
        x, data = np.empty(self.z.shape), (M, self.side, read_only(np.array(right)))
        in_chunks(
            lambda first, end: solve_all(*data, first, end, x, self.is_plain), len(x), self.threads
        )
        singular = np.flatnonzero(self.is_plain & np.isnan(x[:, 0]))
        if transposed and singular.size:
            blocks = FreeBlocks(self.group.chosen(singular).M, self.free[singular])
            x[singular] = np.where(
                blocks.is_singular[:, np.newaxis],
                blocks.solve(right[singular], transposed=True),
                np.nan,
            )
        return x


class BatchGradient:
    """Gradients of functions of the solutions of a batch, with respect to the data.

    Parameters
    ----------
    q, lower, upper : array, shape (B, n), or a list of arrays where the sizes differ
        As those of :class:`~lcp_plugin.problems.sensitivity.Gradient`, one row a problem. NaN where `errors` of the
        derivative says why there is none; 0 where the function does not look at z and w.
    by_M : callable
        Gives M.
    """

    def __init__(self, q: Any, lower: Any, upper: Any, by_M: Callable[[], Any]) -> None:
        self.q, self.lower, self.upper, self._by_M = q, lower, upper, by_M

    @cached_property
    def M(self) -> Any:
        """The gradients by the entries of M, in the form in which M was given; computed when it is looked at.

        Shape (B, n, n), by all entries, for an M each. Where one M stands for all, their sum: shape (n, n), or a
        csr_array with the pattern of a sparse M. For a list of LCPs a list with a csr_array on each one's pattern.
        """
        return self._by_M()


class ManyDerivatives(Generic[R]):
    """The derivatives of many answers, ``found[k]`` that of answer k: of some together, of the rest one by one.

    Parameters
    ----------
    batch : BatchAnswers
    each : callable
        Gives that of one answer.

    Attributes
    ----------
    errors : dict
        Why item k has none.
    """

    _is_even = True  # whether all vectors are rows of an array

    def __init__(self, batch: R, each: Callable[[Any], Any]) -> None:
        self.batch, self._derivative_of = batch, each
        self._each: dict[int, Any] = {}
        self.errors: dict[int, LCPError] = {**batch.errors}
        self._is_solved = np.asarray(batch.status == Status.SOLVED, np.bool_)
        for k in sorted({*np.flatnonzero(~self._is_solved).tolist()} - set(self.errors)):
            status = batch.status[k]
            self.errors[k] = UnsuitableProblem(
                f"only a solution has a derivative, and {batch.ITEM} {k} ended {status.name}: {status.value}"
            )

    def __len__(self) -> int:
        return len(self.batch)

    def __getitem__(self, k: int) -> Any:
        k = range(len(self))[k]
        if k not in self._each:
            self._each[k] = self._derivative_of(self.batch[k])
        return self._each[k]

    @cached_property
    def _parts(self) -> Sequence[Any]:
        """Items together: their numbers `items`, and `is_plain`, which of them have what it gives."""
        raise NotImplementedError

    @cached_property
    def _left(self) -> list[int]:
        """The solved items that have it from no part."""
        is_left = self._is_solved.copy()
        for part in self._parts:
            is_left[part.items[part.is_plain]] = False
        return np.flatnonzero(is_left).tolist()

    def _fill(
        self,
        tables: Sequence[Any],
        of_part: Callable[[Any], Sequence[Any]],
        of_one: Callable[[int], Sequence[Any]],
    ) -> list[int]:
        """Write the rows of all items that have any, and return which of them were asked one by one.

        These are the ones left, and those whose first row is NaN in their part. What is wrong with one is noted.
        """
        alone = [*self._left]
        for part in self._parts:
            answers = of_part(part)
            is_done = part.is_plain & ~np.isnan(answers[0]).any(axis=1)
            for table, answer in zip(tables, answers, strict=True):
                put(table, part.items[is_done], answer[is_done])
            alone += part.items[part.is_plain & ~is_done].tolist()
        for k in alone:
            try:
                for table, answer in zip(tables, of_one(k), strict=True):
                    table[k][:] = 0
                    table[k][: answer.size] = answer
            except LCPError as error:
                self.errors[k] = error
        return alone

    def _forget_unasked(self, tables: Sequence[Any], *given: Any) -> None:
        """Write 0 for the items without a derivative of which functions with these gradients ask for none."""
        for k in self.errors:
            rows = [
                one[k] if not self._is_even or np.ndim(one) > 1 else one
                for one in given
                if one is not None
            ]
            if not any(np.any(np.asarray(row) != 0.0) for row in rows):
                for table in tables:
                    table[k][:] = 0.0

    def _given(self, values: Any, name: str, is_there: Any) -> Any:
        """Return an array like `is_there`, 0 where nothing is; the same for all where its first axis is left out."""
        shape, own = is_there.shape, is_there.shape[1:]
        letters = {"dM": "n, n", "dfriction": "k"}.get(name, "n")
        one = f"({letters})" if len(own) > 1 else f"({letters},)"
        need = f"{name} must have shape (B, {letters}) or {one}, here {shape} or {own}"
        given = real_array(values, need)
        if given.shape not in (shape, own, () if name in NUMBERS else own):
            raise InvalidProblem(f"{need}, got shape {given.shape}")
        given = np.broadcast_to(given, shape) if is_there.all() else np.where(is_there, given, 0.0)
        if not np.isfinite(given).all():
            at = tuple(np.argwhere(~np.isfinite(given))[0].tolist())
            raise InvalidProblem(
                f"{name} must be finite, but {name}{[*at]} = {given[at]}; repair that entry"
            )
        return given


class BatchDerivative(ManyDerivatives[BatchResult]):
    """The derivatives of the solutions of a batch with respect to the data, one for each problem.

    ``found[k]`` is the :class:`~lcp_plugin.problems.sensitivity.Derivative` of problem k, which says what is proved of
    it. What the arrays say of all problems equals what it says, to rounding.

    Parameters
    ----------
    batch : BatchResult
    each : callable
        Gives the Derivative of a Result.

    Attributes
    ----------
    errors : dict
        Why problem k has no derivative: an UnsuitableProblem where it is not solved, an InvalidProblem where it is
        none. What `vjp` and `jvp` meet is added, where that of :class:`~lcp_plugin.problems.sensitivity.Derivative` is
        refused. The rows of these problems are NaN, and cost the others nothing.

    Notes
    -----
    Small problems share one compiled loop, on as many threads as the batch had: the bits are the same for any number.
    Gradients where free blocks are singular take some ten times as long. Problems near a kink, with free blocks that
    lose half of the digits in elimination, or in need of a one-sided derivative are left to their Derivative, which
    takes a hundred times as long.
    """

    @cached_property
    def z(self) -> Any:
        """The solutions at which the derivatives are taken, shape (B, n) or a list; NaN where there is none."""
        z = self._table(np.nan)
        self._fill([z], lambda part: [part.z], lambda k: [self[k].z])
        return read_only(z) if self._is_even else z

    @cached_property
    def free(self) -> Any:
        """The rows that `vjp` takes as free, shape (B, n) or a list, of bool."""
        free = self._table(False)
        self._fill([free], lambda part: [part.free], lambda k: [self[k].free])
        return free

    @cached_property
    def degenerate(self) -> Any:
        """The rows that are at a bound and have w = 0, shape (B, n) or a list, of bool."""
        degenerate = self._table(False)
        self._fill(
            [degenerate],
            lambda part: [part.degenerate],
            lambda k: [np.isin(np.arange(degenerate[k].size), self[k].degenerate)],
        )
        return degenerate

    def jvp(
        self,
        *,
        dM: Any = None,
        dq: Any = None,
        dlower: Any = None,
        dupper: Any = None,
        **named: Any,
    ) -> Any:
        """Return how each z changes with its data, dz; one-sided where rows are degenerate.

        Parameters
        ----------
        dM : array, shape (B, n, n) or (n, n), or a sparse array for all, or a list, optional
            The change of M, on any pattern.
        dq : array, shape (B, n) or (n,), or a list, optional
        dlower, dupper : number or array, shape (B, n) or (n,), or a list, optional
            The change of the bounds; only those that hold matter.
        **named
            Of a list of problems that ``LCP.from_contacts`` made, those of :meth:`Derivative.jvp`, a number for all
            or a list. Of arrays ``**data.changes(dfriction=…)`` with the `data` of ``contact_data``.

        Returns
        -------
        array, shape (B, n), or a list of arrays where the sizes differ

        Raises
        ------
        InvalidProblem
            For another shape, or numbers that are not finite.
        InvalidOption
            For a name that these problems do not know.

        Examples
        --------
        >>> from lcp_plugin import derivative, solve_batch
        >>> found = derivative(solve_batch([[2, 1], [1, 2]], [[-5, 1], [1, -4]]))
        >>> found.jvp(dq=[1, 0], dlower=0.5)
        array([[-0.75,  0.5 ],
               [ 0.5 , -0.25]])
        """
        h, low, high = map(self._rows_of, (dq, dlower, dupper), ("dq", "dlower", "dupper"))
        if dM is not None:
            h = _sum(h, self._product(dM))
        h, dz = _sum(h, self._by_name(named)) if named else h, self._table(np.nan)
        self._fill(
            [dz],
            lambda part: part.changes(*(_chosen(rows, part.items) for rows in (h, low, high))),
            lambda k: [self[k].jvp(dq=h[k], dlower=low[k], dupper=high[k])],
        )
        return dz

    def vjp(self, g: Any, gw: Any = None) -> BatchGradient:
        """Return the gradients of functions L_k(z_k, w_k) of each solution by q, the bounds and the entries of M.

        Parameters
        ----------
        g : array, shape (B, n) or (n,), or a list
            ∂L/∂z.
        gw : array, shape (B, n) or (n,), or a list, optional
            ∂L/∂w.

        Returns
        -------
        BatchGradient

        Raises
        ------
        InvalidProblem
            For another shape, or numbers that are not finite.

        Examples
        --------
        >>> from lcp_plugin import derivative, solve_batch
        >>> gradient = derivative(solve_batch([[2, 1], [1, 2]], [[-5, 1], [1, -4]])).vjp([1, 1])
        >>> gradient.q, gradient.M
        (array([[-0.5,  0. ],
               [ 0. , -0.5]]), array([[-1.25,  0.  ],
               [ 0.  , -1.  ]]))
        """
        rows, by_w, tables = (
            self._rows_of(g, "g"),
            self._rows_of(gw, "gw"),
            [self._table(np.nan) for _ in range(3)],
        )
        left = self._fill(
            tables,
            lambda part: part.gradients(_chosen(rows, part.items), _chosen(by_w, part.items)),
            lambda k: [*self[k].vjp(rows[k], by_w[k])][:3],  # its M comes later
        )
        self._forget_unasked(tables, g, gw)
        by_q, by_lower, by_upper = tables
        return BatchGradient(by_q, by_lower, by_upper, lambda: self._by_M(by_q, left))

    def _by_M(self, by_q: Any, left: Sequence[int]) -> Any:
        z = self.z.copy() if self._is_even else [*self.z]
        for k in left:
            z[k] = self[k].z
        for k in self.errors:
            if not np.any(by_q[k]):  # nothing was asked of a problem without z
                z[k] = np.zeros_like(z[k])
        return self.batch.items.outer(by_q, z)

    @cached_property
    def _parts(self) -> list[BatchPart]:
        """The groups of small problems, settled."""
        z = self.batch.z
        return [
            BatchPart(
                group,
                z[group.items] if self._is_even else np.array([z[k] for k in group.items]),
                self._is_solved[group.items],
                self.batch.threads,
            )
            for group in self.batch.items.groups(every=True)
        ]

    @property
    def _is_even(self) -> bool:  # type: ignore[override]
        return isinstance(self.batch.z, np.ndarray)

    def _table(self, value: Any) -> Any:
        return (
            np.full(self.batch.z.shape, value)
            if self._is_even
            else [np.full(z.size, value) for z in self.batch.z]
        )

    def _rows_of(self, values: Any, name: str) -> Any:
        """Return a vector a problem; those of unsolved problems may be anything."""
        if self._is_even:
            is_there = np.broadcast_to(self._is_solved[:, np.newaxis], self.batch.z.shape)
            return self._given(
                np.zeros(is_there.shape[1]) if values is None else values, name, is_there
            )
        if values is None or (is_number(values) and name in NUMBERS):
            values = self._table(float(values or 0.0))
        self._require_one_each(values, name, "vectors")
        rows = self._table(0.0)
        for k in np.flatnonzero(self._is_solved):
            rows[k] = finite_vector(values[k], f"{name}[{k}]", rows[k].size)
        return rows

    def _require_one_each(self, values: Any, name: str, things: str) -> None:
        if not isinstance(values, Sequence) or len(values) != len(self):
            got = len(values) if isinstance(values, Sequence) else type(values).__name__
            raise InvalidProblem(
                f"{name} must be a list of {len(self)} {things}, one a problem, got {got}"
            )

    def _by_name(self, named: dict[str, Any]) -> Any:
        """Return dM z + dq of each problem, by changes of the data that it was made from."""
        for name, values in named.items():
            if not is_number(values):
                self._require_one_each(values, name, "changes")
        rows = self._table(0.0)
        for k in range(len(self)):
            own = {
                name: values if is_number(values) else values[k] for name, values in named.items()
            }
            origin = None if k in self.batch.errors else self.batch.items.problem(k).origin
            changes = changes_by_name(origin, own, CHANGES, OF_ARRAYS)
            if self._is_solved[k]:
                turned = changes["dM"] @ self.z[k] if "dM" in changes else 0.0
                rows[k] = turned + changes.get("dq", rows[k])
        return rows

    def _product(self, dM: Any) -> Any:
        """Return dM z of each problem."""
        if not self._is_even:
            self._require_one_each(dM, "dM", "matrices")
            rows = self._table(0.0)
            for k in np.flatnonzero(self._is_solved):
                rows[k] = (
                    rectangular_matrix(dM[k], f"dM[{k}]", rows[k].size, rows[k].size) @ self.z[k]
                )
            return rows
        n, z = self.batch.z.shape[1], self.z.copy()
        z[~self._is_solved] = 0.0
        if sp.issparse(dM) or np.ndim(dM) == 2:
            return (rectangular_matrix(dM, "dM", n, n) @ z.T).T
        is_there = np.broadcast_to(self._is_solved[:, np.newaxis, np.newaxis], (len(self), n, n))
        return products(self._given(dM, "dM", is_there), z)


def _sum(rows: Any, others: Any) -> Any:
    return (
        rows + others
        if isinstance(rows, np.ndarray)
        else [a + b for a, b in zip(rows, others, strict=True)]
    )


def _chosen(rows: Any, items: Any) -> Any:
    return rows[items] if isinstance(rows, np.ndarray) else np.array([rows[k] for k in items])
