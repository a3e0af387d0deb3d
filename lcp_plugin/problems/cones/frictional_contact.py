"""Checked data of contact problems with quadratic Coulomb cones: one problem, or a batch in arrays."""

from __future__ import annotations

import math
from copy import copy
from functools import partial
from operator import attrgetter
from os import PathLike
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from ...core import checks
from ...core.checks import AnyMatrix, Vector, real_array
from ...core.errors import InvalidProblem, LCPError, public, warn
from ...core.files import save_arrays
from ...core.lcp import LCP
from ...core.names import format_count
from .. import contact
from ..contact import Bodies
from ..many import errors_of
from .data import Blocks

NEARLY_SYMMETRIC = 1e-2  # of the largest entry: few-digit contact data differ by up to 2.5e-3


class FrictionalContactBatch:
    """Many problems of at most k contacts each, for solve_batch and derivative: `FrictionalContact.worlds`.

    Parameters
    ----------
    W, b, friction : array, shapes (B, d k, d k) or (d k, d k), (B, d k) or (B, k, d), and (B, k), (k,) or a number
        A contiguous W is not copied: do not change its entries while you use the batch.
    contacts : array of int, shape (B,), optional
        Number of contacts of each instance, by default k. Later rows are ignored.
    dimension : int, optional
        See :class:`FrictionalContact`.
    gaps, time_step : optional
        Array, shape (k,) or (B, k), or number, in m; number, in s. gaps / time_step is added to the normal rows of b.
    equations : int
        Number p of equations of each instance, the last rows of W and b; then b has the shape (B, d k + p).

    Raises
    ------
    InvalidProblem
        If shapes do not fit together; ``batch[i]`` raises the error of an invalid instance i.

    Attributes
    ----------
    W, b, friction : array, shapes (B, d k, d k), (B, d k) and (B, k)
        Absent contacts have 1 on the diagonal of W, 1 in b and no friction.
    contacts : array of int, shape (B,)
    dimension, equations : int
        d and p.

    Examples
    --------
    The contact of the second instance sticks:

    >>> from lcp_plugin import solve_batch
    >>> b = [[-1.0, 3.0, 4.0], [-1.0, 0.3, 0.0]]
    >>> batch = solve_batch(FrictionalContact.worlds(np.eye(3), b, 0.5))
    >>> (batch.z.round(6) + 0.0).tolist(), batch.motion.sticks.ravel().tolist()
    ([[1.0, -0.3, -0.4], [1.0, -0.3, 0.0]], [False, True])
    """

    @partial(public, name="FrictionalContact.worlds")
    def __init__(
        self,
        W: AnyMatrix,
        b: ArrayLike,
        friction: ArrayLike,
        *,
        contacts: ArrayLike | None = None,
        dimension: int | None = None,
        gaps: ArrayLike | None = None,
        time_step: float | None = None,
        equations: int = 0,
    ) -> None:
        self.equations = p = contact.checked_count(equations)
        shapes = f"(B, d k + {p})" if p else "(B, d k) or (B, k, d)"
        need = f"b must have shape {shapes}, d = 3 in space and 2 in the plane"
        offsets = real_array(b, need)
        if offsets.ndim != 2 and (p or offsets.ndim != 3):
            raise InvalidProblem(f"{need}, got shape {offsets.shape}")
        if offsets.ndim == 3 and offsets.shape[2] == 1:  # columns
            offsets = offsets[:, :, 0]
        if offsets.ndim == 3:
            dimension, offsets = offsets.shape[2], offsets.reshape(len(offsets), -1)
        count, n = offsets.shape
        mu = real_array(friction, "friction must be a number, or have shape (k,) or (B, k)")
        is_column = mu.shape == (count, 1) and n - p > 3
        self.dimension = d = dimension_of(dimension, () if is_column else mu.shape[-1:], n - p)
        k, matrices = (n - p) // d, real_array(W, f"W must have shape (B, {n}, {n}), {n} as b has")
        if matrices.shape not in ((n, n), (count, n, n)):
            raise InvalidProblem(
                f"W must have shape (B, {n}, {n}), B = {count} and {n} as b has, got {matrices.shape}"
            )
        if mu.shape not in ((), (k,), (count, 1), (count, k)):
            raise InvalidProblem(
                f"friction must be a number, or have shape ({k},) or (B, {k}), B = {count}, got {mu.shape}"
            )
        self.contacts = _checked_counts(contacts, count, k)
        if gaps is not None or time_step is not None:
            offsets = offsets.copy()
            offsets[:, : n - p : d] += contact.closing_speeds(gaps, time_step, k, count)
        arrays = (matrices, (count, n, n)), (offsets, (count, n)), (mu, (count, k))
        matrices, offsets, mu = (np.ascontiguousarray(np.broadcast_to(*pair)) for pair in arrays)
        is_there = np.arange(k) < self.contacts[:, np.newaxis]
        if not is_there.all():
            is_row = np.pad(np.repeat(is_there, d, axis=1), ((0, 0), (0, p)), constant_values=True)
            is_entry = is_row[:, :, np.newaxis] & is_row[:, np.newaxis]
            matrices = np.where(is_entry, matrices, np.eye(n))
            offsets = np.where(is_row, offsets, 1.0)
            mu = np.where(is_there, mu, 0.0)
        self.W, self.b, self.friction = map(checks.read_only, (matrices, offsets, mu))
        contact.warn_of_much_friction(np.nan_to_num(self.friction, posinf=0.0))
        with np.errstate(all="ignore"):
            difference = np.abs(self.W - self.W.swapaxes(1, 2)).max((1, 2), initial=0.0)
            largest = np.abs(self.W).max((1, 2), initial=0.0)
        are_finite = (largest < np.inf) & np.isfinite(self.b).all(1)
        are_coefficients = ((self.friction >= 0.0) & (self.friction < np.inf)).all(1)
        self._is_stated = (difference <= NEARLY_SYMMETRIC * largest) & are_finite & are_coefficients

    @property
    def n(self) -> int:
        """Rows of each, d k + p."""
        return int(self.b.shape[1])

    @property
    def sizes(self) -> NDArray[np.int64]:
        """Rows of each instance, shape (B,): of its contacts, or with equations all rows, absent contacts included."""
        return np.full(len(self), self.n) if self.equations else self.dimension * self.contacts

    @property
    def errors(self) -> dict[int, LCPError]:
        """The errors of invalid instances, by their number i."""
        return errors_of(self, self._is_stated)

    def save(self, path: str | PathLike[str]) -> None:
        """Write the batch to a ``.npz`` file, which ``load_problem(path)`` reads.

        Raises
        ------
        UnreadableFile
            If the file cannot be written, or has another extension.
        """
        arrays = {"W": self.W, "b": self.b, "mu": self.friction, "contacts": self.contacts}
        arrays |= {name: np.array(getattr(self, name)) for name in ("dimension", "equations")}
        save_arrays(path, arrays, "a batch of contact problems")

    __setstate__ = checks.restore_state

    def __len__(self) -> int:
        return len(self.b)

    def __getitem__(self, i: int) -> FrictionalContact:
        if not isinstance(i, int | np.integer):
            raise TypeError(
                f"an instance is batch[i], i an integer, got {i!r}; for several build a problem from W[…], b[…]"
            )
        rows, p = int(self.sizes[i]), self.equations
        count = (rows - p) // self.dimension
        instance_data = self.W[i, :rows, :rows], self.b[i, :rows], self.friction[i, :count]
        return FrictionalContact(*instance_data, dimension=self.dimension, equations=p)

    def __repr__(self) -> str:
        where = "space" if self.dimension == 3 else "the plane"
        k = self.friction.shape[1]
        return f"FrictionalContact({len(self)} instances of up to {k} contacts in {where})"


class FrictionalContact(Blocks):
    """Contacts with Coulomb friction: impulses r in the quadratic cones ‖r_T‖ ≤ μ r_N, velocities u = W r + b.

    Each contact is open (r = 0, u_N ≥ 0), or sticks (u = 0), or slides (u_N = 0, r_T of length μ r_N against u_T).
    The cones are not approximated by pyramids.

    Parameters
    ----------
    W : array or sparse array, shape (d k, d k), or three arrays (mass matrix, normals, tangents)
        Velocities by impulses, d rows per contact: its normal, then its d − 1 tangents, d = 3 in space and 2 in the
        plane; in 1/kg. Symmetric up to 1 % of its largest entry, as contact data often have few digits; it is
        used unchanged. Or bodies, as for :meth:`lcp_plugin.LCP.from_contacts`; if one of the arrays is sparse,
        W is sparse, and the tangents of all contacts are one matrix, (t k, v), t = d − 1, contact by contact.
    b : array, shape (d k,) or (k, d), or (v,) with a mass matrix
        Velocities at the end of the step without contact impulses, in m/s; with a mass matrix velocities of the bodies.
    friction : number or array, shape (k,)
        Coefficients μ ≥ 0.
    gaps, time_step : optional
        As in :meth:`lcp_plugin.LCP.from_contacts`.
    equations : int, or array, shape (p, v), with a mass matrix
        Number p of equations: the last p rows of W and b, shape (d k + p,), whose velocities w are 0 and whose impulses
        are free, as of hinges, motors and loops. With a mass matrix the rows that map the bodies' velocities to them,
        and b has the shape (v,), or (d k + p,) for other velocities than 0: b_i = J_i u − (required velocity).
        Dependent equations are allowed.
    dimension : int, optional
        d, if the shapes of b and `friction` do not determine it; 3 by default if the number of rows is a multiple of 3,
        with a ModelWarning if it is a multiple of 2 also.

    Raises
    ------
    InvalidProblem
        For a W that is not symmetric, μ < 0, a number of rows that is not a multiple of d, numbers that are not finite.

    Notes
    -----
    With friction the problem is not a convex program for any W: a solution need not be unique, and need not exist
    (Painlevé). A run that finds none ends STALLED, or INFEASIBLE if no impulses keep the contacts from closing.
    Solutions of a pile agree more often in the motion than in the impulses. Rolling and spinning friction are not
    supported: the limits ‖m‖ ≤ ν r_N and ‖r_T‖ ≤ μ r_N together do not form a second-order cone.

    ``result.motion`` has impulses and velocities contact by contact. For time steps with changing contacts, start from
    the impulses of the previous step, ``solve(FrictionalContact(W, b, friction), z0=r)``, with 0 for new contacts; for
    steps with one W use :func:`lcp_plugin.march`. :func:`lcp_plugin.load_problem` reads fclib's files.

    ``FrictionalContact.worlds`` builds a batch of problems from arrays.

    Examples
    --------
    A block of 1 kg on the ground is pushed along (3, 4). Friction is too weak to keep it at its place:

    >>> from lcp_plugin import solve
    >>> result = solve(FrictionalContact(np.eye(3), [[-1.0, 3.0, 4.0]], 0.5))
    >>> result.z.round(6), result.w.round(6), result.motion.sticks
    (array([ 1. , -0.3, -0.4]), array([0. , 2.7, 3.6]), array([False]))

    """

    matrix_names, vector_names = ("W",), ("b",)
    offset = "b"
    bodies: Bodies | None = None
    worlds = FrictionalContactBatch

    def __init__(
        self,
        W: AnyMatrix,
        b: ArrayLike,
        friction: ArrayLike,
        *,
        gaps: ArrayLike | None = None,
        time_step: float | None = None,
        dimension: int | None = None,
        equations: int = 0,
    ) -> None:
        need = "b must be a finite array of shape (d k,) or (k, d), d = 3 (space) or 2 (plane)"
        velocities = real_array(b, need)
        if contact.is_of_bodies(W):
            is_sparse = any(map(sp.issparse, W))
            statement = contact.contacts_of_bodies(W, velocities, equations)
            W, velocities, self.bodies, equations = statement
            if sp.issparse(W) and not is_sparse:
                W = W.toarray()
            dimension = self.bodies.dimension if dimension is None else dimension
        self.equations = p = contact.checked_count(equations)
        shape, width = getattr(W, "shape", ()), velocities.shape[1:]
        is_batch = velocities.ndim == 2 and shape == width * 2 != (velocities.size,) * 2
        if velocities.ndim not in (1, 2) or is_batch:
            raise InvalidProblem(
                f"{need}, got shape {velocities.shape}; for many problems use FrictionalContact.worlds"
            )
        if velocities.ndim == 2 and velocities.shape[1] == 1:  # a column
            velocities = velocities[:, 0]
        if velocities.ndim == 2:
            if dimension not in (None, *width):
                raise InvalidProblem(f"b has {width[0]} columns and dimension is {dimension}")
            dimension = velocities.shape[1]
        offset = checks.checked_vector(velocities.ravel(), "b", None)
        friction = real_array(friction, "friction must be a number, or one per contact")
        d = dimension_of(dimension, friction.shape, offset.size - p)
        k = (offset.size - p) // d
        self._closing = np.zeros(offset.size)
        self._closing[: d * k : d] = contact.closing_speeds(gaps, time_step, k)
        mu = contact.checked_friction(friction, k, f"one per contact of {d} rows")
        contact.warn_of_much_friction(mu)
        W = checks.rectangular_matrix(W, "W", offset.size, offset.size, is_copied=False)
        contact.check_symmetric(W, "W", NEARLY_SYMMETRIC)
        rows = LCP(W, offset + self._closing, lower=-np.inf, upper=np.inf)
        starts = np.append(np.arange(0, d * k, d), np.arange(d * k, offset.size + 1))
        super().__init__(rows, starts, np.append(mu, np.zeros(p)), has_friction=True)
        self.dimension = d

    def with_data(  # type: ignore[override]
        self, b: ArrayLike | None = None, W: AnyMatrix = None
    ) -> FrictionalContact:
        """Return the problem with another b, in any form that the constructor takes, or another array W; gaps stay."""
        other = copy(self)
        if b is not None:
            velocities = real_array(b, "b must be an array of velocities")
            if self.bodies is not None:
                velocities, other.bodies = self.bodies.moving(velocities, self.equations)
            offset = checks.checked_vector(velocities.ravel(), "b", self.n)
            other.rows = self.rows.with_q(offset + self._closing)
        if W is None:
            return other
        W = checks.rectangular_matrix(W, "W", self.n, self.n)  # bodies would read b anew
        shape = {"dimension": self.dimension, "equations": self.equations}
        return FrictionalContact(W, other.b, self.friction, **shape)

    W = property(attrgetter("rows.M"), doc="Stored matrix from impulses to velocities.")
    b = property(attrgetter("q"), doc="Velocities without impulses, shape (d k,).")

    @property
    def friction(self) -> Vector:
        """Coefficients, shape (k,)."""
        return self.slope[: self.slope.size - self.equations]

    def _shape(self) -> dict[str, Any]:
        shape = {"mu": self.friction, "equations": np.array(self.equations)}
        return shape if self.equations else {"mu": self.friction}

    def __repr__(self) -> str:
        count, where = self.friction.size, "space" if self.dimension == 3 else "the plane"
        also = f", {format_count(self.equations, 'equation')}" if self.equations else ""
        return f"FrictionalContact({format_count(count, 'contact')} in {where}{also}, {self.nonzeros} nonzeros)"


def _checked_counts(contacts: ArrayLike | None, count: int, k: int) -> NDArray[np.int64]:
    if contacts is None:
        return np.full(count, k)
    counts = np.asarray(contacts)
    is_whole = counts.shape == (count,) and counts.dtype.kind in "iu"
    if not is_whole or ((counts < 0) | (counts > k)).any():
        raise InvalidProblem(
            f"contacts must be {count} integers from 0 to {k}, one per instance, got {contacts!r}"
        )
    return counts.astype(np.int64)


def dimension_of(dimension: int | None, friction: tuple[int, ...], rows: int) -> int:
    """Return the rows per contact, 3 with a ModelWarning if both 3 and 2 are possible.

    Raises
    ------
    InvalidProblem
        If the shapes are inconsistent.
    """
    count = math.prod(friction)
    if dimension is None and not friction and rows and rows % 6 == 0:
        warn(
            f"{rows} rows and one number μ are read as {rows // 3} contacts in space, not as {rows // 2} "
            "in the plane; pass dimension=2 or dimension=3"
        )
    if dimension is None and friction and count and rows % count == 0:
        dimension = rows // count
    d = 3 if dimension is None and rows % 3 == 0 else 2 if dimension is None else dimension
    if isinstance(d, bool) or not isinstance(d, (int, np.integer)) or d not in (2, 3):
        got = f"got {d!r} ({rows} rows and {count} coefficients of friction)"
        raise InvalidProblem(
            f"dimension, the rows of a contact, must be 3, or 2 in the plane, {got}"
        )
    if rows % d:
        need = "3, nor, in the plane, of 2" if dimension is None else d
        raise InvalidProblem(f"{rows} rows are not a multiple of {need}: normal, then tangents")
    return int(d)
