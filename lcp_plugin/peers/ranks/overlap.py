"""Rows of foreign unknowns behind the own ones: what a rank needs to coarsen its part as if there were no ranks."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...checks import FloatVector
from ..alone import Arrays
from .layout import Layout

Integers = NDArray[Any]


class ForeignRows(NamedTuple):
    """Rows that others own: entries a row, global columns, values, and the places of the entries at their owner's."""

    counts: Integers
    columns: Integers
    values: FloatVector
    places: Integers


def foreign_rows(
    layout: Layout, wanted: Integers, indptr: Integers, data: FloatVector, columns: Callable[[Integers], Integers]
) -> ForeignRows:
    """Return the rows `wanted`, global indices in any order; all ranks call.

    Parameters
    ----------
    layout : Layout
        Of the rows.
    wanted : array of int
        Foreign rows.
    indptr, data : arrays
        The own rows in CSR, which others may want.
    columns : callable
        Gives the global columns of the entries at the places it is called with.
    """
    owners = layout.owners(wanted)
    order = np.argsort(owners, kind="stable")
    ends = np.searchsorted(owners[order], np.arange(layout.comm.size + 1))
    asked = [
        wanted[order[ends[rank] : ends[rank + 1]]] - layout.starts[rank] for rank in range(layout.comm.size)
    ]
    replies = []
    for rows in layout.comm.alltoall(asked):
        counts = (indptr[rows + 1] - indptr[rows]).astype(np.int64)
        places = _ranges(indptr[rows].astype(np.int64), counts)
        replies.append((counts, columns(places).astype(np.int64), data[places], places))
    parts = [np.concatenate(part) for part in zip(*layout.comm.alltoall(replies), strict=True)]
    counts = np.empty(wanted.size, np.int64)
    counts[order] = parts[0]
    begins = np.empty(wanted.size, np.int64)
    begins[order] = np.cumsum(parts[0]) - parts[0]
    take = _ranges(begins, counts)
    return ForeignRows(counts, parts[1][take], parts[2][take], parts[3][take])


def overlapped(
    layout: Layout, rows: Arrays, ghosts: Integers, further: Integers
) -> tuple[Arrays, Integers, Integers | None]:
    """Return the own rows with those of the foreign unknowns next to them behind, and whom all these rows meet.

    Parameters
    ----------
    layout : Layout
    rows : CSR arrays
        The own rows, sorted; column own + k stands for the unknown ghosts[k].
    ghosts : array of int
        Ascending; not all of them need be met.
    further : array of int
        Foreign unknowns to be met in any case.

    Returns
    -------
    rows : CSR arrays
    ghosts : array of int
        The foreign unknowns met: those whose rows are here, then the others.
    entries : array of int, shape (k, 2), or None
        Rank and place there of each entry of the foreign rows; None where there is nothing to send.

    Notes
    -----
    Next to the own unknowns is whoever an own row meets, or whose row meets an own unknown.
    """
    own = layout.own
    indptr, indices, data = rows
    at = np.flatnonzero(indices >= own)
    met = ghosts[indices[at] - own]
    near = np.union1d(met, _dependents(layout, np.searchsorted(indptr, at, side="right") - 1 + layout.first, met))
    if not any(layout.comm.allgather(near.size + further.size)):
        return rows, near, None
    if not np.array_equal(near, ghosts):  # both ascend: the rows stay sorted
        indices = indices.copy()
        indices[at] = own + np.searchsorted(near, met)

    def global_columns(places: Integers) -> Integers:
        columns = indices[places].astype(np.int64)
        is_foreign = columns >= own
        columns[~is_foreign] += layout.first
        columns[is_foreign] = near[columns[is_foreign] - own]
        return columns

    found = foreign_rows(layout, near, indptr, data, global_columns)
    far = np.setdiff1d(np.concatenate([found.columns[layout.is_foreign(found.columns)], further]), near)
    all_ghosts = np.concatenate([near, far])
    local = layout.local(found.columns, all_ghosts)
    order = np.lexsort((local, np.repeat(np.arange(near.size), found.counts)))
    entries = np.stack([np.repeat(layout.owners(near), found.counts), found.places], axis=1)[order]
    overlapping = (
        np.concatenate([indptr, indptr[-1] + np.cumsum(found.counts, dtype=indptr.dtype)]),
        np.concatenate([indices, local[order]]), np.concatenate([data, found.values[order]]),
    )
    return overlapping, all_ghosts, entries


def _dependents(layout: Layout, rows: Integers, met: Integers) -> Integers:
    """Return the foreign unknowns whose rows meet an own one; `rows` meet the foreign unknowns `met`."""
    owners = layout.owners(met)
    sent = [np.unique(rows[owners == rank]) for rank in range(layout.comm.size)]
    return np.concatenate(layout.comm.alltoall(sent))


def _ranges(begins: Integers, counts: Integers) -> Integers:
    """Return begins[0], begins[0] + 1, … counts[0] of them, then the same for the next."""
    places: Integers = np.repeat(begins - (np.cumsum(counts) - counts), counts) + np.arange(int(counts.sum()))
    return places
