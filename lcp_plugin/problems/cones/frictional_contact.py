"""Contact with Coulomb friction as it is, one problem or many worlds in arrays: the data, checked."""

from __future__ import annotations

import math
from collections.abc import Iterator
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...core.checks import (
    FloatVector,
    checked_vector,
    read_only,
    real_array,
    rectangular_matrix,
    restored,
)
from ...core.errors import InvalidProblem, LCPError
from ...core.lcp import LCP
from ...core.representation import in_words
from ..contact import (
    Bodies,
    are_of_bodies,
    check_symmetric,
    checked_contacts,
    checked_distances,
    checked_friction,
    is_of_bodies,
    warn_of_much_friction,
)
from .data import Blocks, with_other_q

NEARLY_SYMMETRIC = 1e-2  # of the largest entry: contact data are written with few digits, and differ by up to 2.5e-3


class FrictionalContact(Blocks):
    """Contacts with Coulomb friction as it is: impulses in the cones ‖r_T‖ ≤ μ r_N, velocities u = W r + b.

    Of each contact: it is open (r = 0, u_N ≥ 0), or sticks (u = 0), or slides (u_N = 0, r_T of length μ r_N against
    u_T). Nothing is approximated by pyramids.

    Parameters
    ----------
    W : array or sparse array, shape (d k, d k), or three arrays (mass matrix, normals, tangents)
        Velocities by impulses, d rows a contact: its normal, then its d − 1 tangents, d = 3 in space and 2 in the
        plane; in 1/kg. Symmetric up to 1 % of its largest entry, as contact data are written with few digits; it is
        used as it is given. Or bodies, as for :meth:`lcp_plugin.LCP.from_contacts`; where one of the arrays is sparse,
        W stays sparse, and the tangents of all contacts are one matrix, (t k, v), t = d − 1, contact by contact.
    b : array, shape (d k,) or (k, d); or (v,) beside a mass matrix
        Velocities without the impulses, in m/s; of the bodies beside a mass matrix.
    friction : number or array, shape (k,)
        Coefficients μ ≥ 0.
    gaps, time_step : optional
        As for :meth:`lcp_plugin.LCP.from_contacts`.
    contacts : array of int, shape (B,), optional
        Of many worlds: how many contacts each has, the first of the k, all by default; what stands behind them is not
        looked at.
    dimension : int, optional
        d, where neither b nor `friction` tells it: 3 by default where the rows are a multiple of 3.

    Raises
    ------
    InvalidProblem
        For a W that is not symmetric, μ < 0, rows that are no multiple of d, numbers that are not finite.

    Notes
    -----
    With friction this is no convex program, whatever W: an answer need not be the only one, nor need there be one
    (Painlevé). A run that finds none ends STALLED, or INFEASIBLE where no impulses keep the contacts from closing.
    The answers of a pile share the motion more often than the impulses. Rolling and spinning friction are left out: a
    moment that ‖m‖ ≤ ν r_N limits beside ‖r_T‖ ≤ μ r_N is no second-order cone.

    ``result.motion`` has impulses and velocities contact by contact. Steps in time whose contacts change begin with
    the impulses of the step before, ``solve(FrictionalContact(W, b, friction), z0=r)``, 0 for new contacts; those of
    one W are a :func:`lcp_plugin.march`. :func:`lcp_plugin.load_problem` reads fclib's files.

    With an axis in front, W (B, d k, d k), b (B, d k) or (B, k, d), friction (B, k), any of these, it states B worlds:
    :func:`lcp_plugin.solve_batch` and :func:`lcp_plugin.derivative` take them at once, ``worlds[i]`` is
    the FrictionalContact of number i, and raises what is wrong with it. A contiguous W is read where it lies: leave its
    entries as they are while you use the worlds.

    Examples
    --------
    A block of 1 kg on the ground is pushed along (3, 4); friction is too weak to hold it:

    >>> from lcp_plugin import solve
    >>> result = solve(FrictionalContact(np.eye(3), [[-1.0, 3.0, 4.0]], 0.5))
    >>> result.z.round(6), result.w.round(6), result.motion.sticks
    (array([ 1. , -0.3, -0.4]), array([0. , 2.7, 3.6]), array([False]))

    Beside it a world in which friction holds it:

    >>> from lcp_plugin import solve_batch
    >>> batch = solve_batch(FrictionalContact(np.eye(3), [[[-1.0, 3.0, 4.0]], [[-1.0, 0.3, 0.0]]], 0.5))
    >>> (batch.z.round(6) + 0.0).tolist(), batch.motion.sticks.ravel().tolist()
    ([[1.0, -0.3, -0.4], [1.0, -0.3, 0.0]], [False, True])
    """

    bodies: Bodies | None = None

    def __new__(
        cls,
        W: Any = None,
        b: Any = None,
        friction: Any = 0.0,
        *,
        gaps: Any = None,
        time_step: float | None = None,
        contacts: ArrayLike | None = None,
        dimension: int | None = None,
    ) -> Any:
        """Return a FrictionalContactBatch where there are worlds, an object to be initialised where there are none."""
        if contacts is None and not _has_worlds(W, b, friction, gaps):
            return super().__new__(cls)
        return FrictionalContactBatch(
            W, b, friction, gaps=gaps, time_step=time_step, contacts=contacts, dimension=dimension
        )

    def __init__(
        self,
        W: Any,
        b: ArrayLike,
        friction: ArrayLike,
        *,
        gaps: ArrayLike | None = None,
        time_step: float | None = None,
        contacts: None = None,
        dimension: int | None = None,
    ) -> None:
        W, b, friction, self.bodies = _stated(W, b, friction, gaps, time_step, keeps_sparse=True)
        need = (
            "b must be a finite array of shape (d k,) or (k, d), d = 3 in space and 2 in the plane"
        )
        velocities = real_array(b, need)
        if velocities.ndim not in (1, 2):
            raise InvalidProblem(f"{need}, got shape {velocities.shape}")
        if velocities.ndim == 2:
            if dimension not in (None, velocities.shape[1]):
                raise InvalidProblem(
                    f"b has {velocities.shape[1]} columns and dimension is {dimension}; leave one out"
                )
            dimension = velocities.shape[1]
        offset = checked_vector(velocities.ravel(), "b", None)
        d = dimension_of(dimension, _shape_of(friction), offset.size)
        k = offset.size // d
        if self.bodies is None:
            offset = _until_contact(offset, gaps, time_step, d)
        mu = np.broadcast_to(
            checked_friction(friction, k, f"one a contact of {d} rows"), (k,)
        ).copy()
        warn_of_much_friction(mu, 3)
        W = rectangular_matrix(W, "W", offset.size, offset.size, is_copied=False)
        check_symmetric(W, "W", NEARLY_SYMMETRIC)
        rows = LCP(W, offset, lower=-np.inf, upper=np.inf)
        super().__init__(
            rows, np.arange(0, offset.size + 1, d, dtype=np.int64), mu, has_friction=True
        )
        self.dimension = d

    @classmethod
    def from_contacts(
        cls,
        contacts: Any,
        friction: ArrayLike,
        velocities: ArrayLike,
        *,
        gaps: ArrayLike | None = None,
        time_step: float | None = None,
    ) -> FrictionalContact:
        """Return contacts as :meth:`lcp_plugin.LCP.from_contacts` takes them, with cones for pyramids.

        Parameters
        ----------
        contacts, friction, velocities, gaps, time_step
            As there, without `directions`.

        Raises
        ------
        InvalidProblem
            As there.
        """
        bodies = tuple(contacts) if is_of_bodies(contacts) else contacts
        return cls(bodies, velocities, friction, gaps=gaps, time_step=time_step)

    @property
    def W(self) -> Any:
        """Velocities by impulses, as it is kept: dense or CSR."""
        return self.rows.M

    @property
    def b(self) -> FloatVector:
        """Velocities without impulses, shape (d k,)."""
        return self.q

    @property
    def friction(self) -> FloatVector:
        """Coefficients, shape (k,)."""
        return self.slope

    def with_q(self, b: ArrayLike) -> FrictionalContact:
        """Return the problem with other velocities, shape (d k,); what depends on W alone is shared."""
        other: FrictionalContact = with_other_q(
            self, np.ravel(real_array(b, "b must be a vector")), "b"
        )
        if self.bodies is not None:
            other.bodies = self.bodies._replace(
                velocities=None
            )  # b does not tell those of the bodies
        return other

    def _shape(self) -> dict[str, Any]:
        return {"mu": self.friction}

    def _words(self) -> str:
        return f"{in_words(self.slope.size, 'contact')} in {'space' if self.dimension == 3 else 'the plane'}"


class FrictionalContactBatch:
    """Worlds of at most k contacts each: what :class:`FrictionalContact` returns of arrays with an axis in front.

    Parameters
    ----------
    W, b, friction : array, shapes (B, d k, d k), (B, d k) or (B, k, d), and (B, k)
        As there; of the attributes of these names, contacts that are not there have 1 on the diagonal of W, 1 in b and
        no friction.
    gaps, time_step, contacts, dimension
        As in :class:`FrictionalContact`.

    Raises
    ------
    InvalidProblem
        Where shapes do not fit together.
    """

    def __init__(
        self,
        W: Any,
        b: ArrayLike,
        friction: ArrayLike,
        *,
        gaps: ArrayLike | None = None,
        time_step: float | None = None,
        contacts: ArrayLike | None = None,
        dimension: int | None = None,
    ) -> None:
        W, b, friction, bodies = _stated(W, b, friction, gaps, time_step, keeps_sparse=False)
        need = "b must have shape (B, d k) or (B, k, d), d = 3 in space and 2 in the plane"
        offsets = real_array(b, need)
        if offsets.ndim not in (1, 2, 3):
            raise InvalidProblem(f"{need}, got shape {offsets.shape}")
        if offsets.ndim == 3:
            dimension, offsets = offsets.shape[2], offsets.reshape(len(offsets), -1)
        n, mu = (
            offsets.shape[-1],
            real_array(friction, "friction must be a number, or have shape (k,) or (B, k)"),
        )
        self.dimension = d = dimension_of(dimension, mu.shape[-1:], n)
        if bodies is None:
            offsets = _until_contact(offsets, gaps, time_step, d)
        k = n // d
        matrices = real_array(W, f"W must have shape (B, {n}, {n}), {n} as b has")
        if matrices.ndim not in (2, 3) or matrices.shape[-2:] != (n, n):
            raise InvalidProblem(
                f"W must have shape (B, {n}, {n}), {n} as b has, got {matrices.shape}"
            )
        if mu.ndim > 2 or (mu.ndim and mu.shape[-1] != k):
            raise InvalidProblem(
                f"friction must be a number, or have shape ({k},) or (B, {k}), got {mu.shape}"
            )
        stacks = {"W": (matrices, 3), "b": (offsets, 2), "friction": (mu, 2)}
        lengths = {name: len(array) for name, (array, ndim) in stacks.items() if array.ndim == ndim}
        if contacts is not None and np.ndim(contacts) == 1:
            lengths["contacts"] = len(np.asarray(contacts))
        if len({*lengths.values()}) > 1:
            given = ", ".join(f"{name} {length}" for name, length in lengths.items())
            raise InvalidProblem(
                f"all arrays with an axis for the worlds must be equally long, got {given}"
            )
        count = next(iter(lengths.values()), 1)
        self.contacts = _checked_counts(contacts, count, k)
        shapes = (count, n, n), (count, n), (count, k)
        own: Any = tuple(
            np.ascontiguousarray(np.broadcast_to(array, shape), np.float64)
            for array, shape in zip((matrices, offsets, mu), shapes, strict=True)
        )
        is_there = np.arange(k) < self.contacts[:, np.newaxis]
        if not is_there.all():
            own = _padded(own[0], own[1], own[2], is_there, d)
        self.W, self.b, self.friction = map(read_only, own)
        warn_of_much_friction(np.where(np.isfinite(self.friction), self.friction, 0.0), 4)
        with np.errstate(invalid="ignore", over="ignore"):
            difference = np.abs(self.W - self.W.swapaxes(1, 2)).max(axis=(1, 2), initial=0.0)
            largest = np.maximum(
                self.W.max(axis=(1, 2), initial=0.0), -self.W.min(axis=(1, 2), initial=0.0)
            )
            self._is_stated = (
                (difference <= NEARLY_SYMMETRIC * largest)
                & (largest < np.inf)
                & np.isfinite(self.b).all(axis=1)
                & (self.friction >= 0.0).all(axis=1)
                & (self.friction < np.inf).all(axis=1)
            )

    @property
    def n(self) -> int:
        """Rows of each, d k."""
        return int(self.b.shape[1])

    @property
    def errors(self) -> dict[int, LCPError]:
        """What is wrong with world i, where something is."""
        found: dict[int, LCPError] = {}
        for i in np.flatnonzero(~self._is_stated).tolist():
            try:
                self[i]
            except LCPError as error:
                found[i] = error
        return found

    def save(self, path: str | PathLike[str]) -> None:
        """Write the worlds to a ``.npz`` file, which ``load_problem(path)`` reads.

        Raises
        ------
        UnreadableFile
            Where it cannot be written, or is called otherwise.
        """
        from ...interfaces.files.files import save_arrays

        arrays = {"W": self.W, "b": self.b, "mu": self.friction, "contacts": self.contacts}
        save_arrays(
            path, {**arrays, "dimension": np.array(self.dimension)}, "a batch of contact problems"
        )

    __setstate__ = restored

    def __len__(self) -> int:
        return len(self.b)

    def __getitem__(self, i: int) -> FrictionalContact:
        if not isinstance(i, int | np.integer):
            raise TypeError(
                f"a world is worlds[i], i an integer, got {i!r}; several are a problem of W[…], b[…]"
            )
        if not -len(self) <= i < len(self):
            raise IndexError(f"there are {len(self)} worlds, and none has the number {i}")
        count = int(self.contacts[i])
        rows = self.dimension * count
        return FrictionalContact(
            self.W[i, :rows, :rows],
            self.b[i, :rows],
            self.friction[i, :count],
            dimension=self.dimension,
        )

    def __iter__(self) -> Iterator[FrictionalContact]:
        return (self[i] for i in range(len(self)))

    def __repr__(self) -> str:
        where = "space" if self.dimension == 3 else "the plane"
        return f"FrictionalContact({len(self)} worlds of up to {self.n // self.dimension} contacts in {where})"


def _has_worlds(W: Any, b: Any, friction: Any, gaps: Any) -> bool:
    """Return whether one of the arrays that state contacts has an axis for worlds."""
    given = _shape_of(b)
    if len(given) > 2 or len(_shape_of(friction)) > 1 or len(_shape_of(gaps)) > 1:
        return True
    if not isinstance(W, tuple):
        matrix = _shape_of(W)
        return len(matrix) > 2 or (
            len(given) == 2 and (given[1] > 3 or (given[0] != 1 and given[1:] == matrix[-1:]))
        )
    mass, normals, tangents = map(_shape_of, W) if len(W) == 3 else ((), (), ())
    d = 1 + math.prod(tangents) // max(math.prod(normals), 1)
    return max(len(mass), len(normals)) > 2 or (
        len(given) == 2 and are_of_bodies(given, normals, d)
    )


def _shape_of(given: Any) -> tuple[int, ...]:
    """Return the shape of an array; that of a number for what is none, which is refused later."""
    try:
        return np.shape(given)
    except ValueError:
        return ()


def _stated(
    W: Any,
    b: Any,
    friction: Any,
    gaps: ArrayLike | None,
    time_step: float | None,
    *,
    keeps_sparse: bool,
) -> tuple[Any, Any, Any, Bodies | None]:
    """Return W, b, friction, and the bodies, of one problem or of many; b of bodies includes the gaps."""
    if not isinstance(W, tuple):
        return W, b, friction, None
    data = checked_contacts(
        W, friction, b, gaps=gaps, time_step=time_step, keeps_sparse=keeps_sparse
    )
    return data.W, data.until_contact(data.velocities, data.gaps), data.friction, data.bodies


def _until_contact(b: FloatVector, gaps: ArrayLike | None, time_step: Any, d: int) -> FloatVector:
    """Return velocities, shape (…, d k), plus those that close the gaps within the step."""
    if gaps is None and time_step is None:
        return b
    distances = checked_distances(gaps, time_step, b.shape[-1] // d)
    several = np.broadcast_shapes(b.shape[:-1], distances.shape[:-1])
    found = np.array(np.broadcast_to(b, (*several, b.shape[-1])))
    found[..., ::d] += distances / time_step
    return found


def _checked_counts(contacts: ArrayLike | None, count: int, k: int) -> NDArray[np.int64]:
    if contacts is None:
        return np.full(count, k)
    counts = np.asarray(contacts)
    if (
        counts.shape != (count,)
        or counts.dtype.kind not in "iu"
        or ((counts < 0) | (counts > k)).any()
    ):
        raise InvalidProblem(
            f"contacts must be {count} integers from 0 to {k}, one a world, got {contacts!r}"
        )
    return counts.astype(np.int64)


def _padded(W: Any, b: Any, mu: Any, is_there: NDArray[np.bool_], d: int) -> tuple[Any, Any, Any]:
    """Return copies in which contacts that are not there are open, each by itself."""
    W, b, mu = W.copy(), b.copy(), mu.copy()
    rows = np.repeat(is_there, d, axis=1)
    W[~(rows[:, :, np.newaxis] & rows[:, np.newaxis])] = 0.0
    world, row = np.nonzero(~rows)
    W[world, row, row], b[~rows], mu[~is_there] = 1.0, 1.0, 0.0
    return W, b, mu


def dimension_of(given: int | None, friction: tuple[int, ...], rows: int) -> int:
    """Return the rows of a contact; raise InvalidProblem where they do not add up."""
    count = math.prod(friction)
    if given is None and friction and count and rows % count == 0:
        given = rows // count
    d = 3 if given is None and rows % 3 == 0 else 2 if given is None else given
    if isinstance(d, bool) or not isinstance(d, (int, np.integer)) or d not in (2, 3):
        raise InvalidProblem(
            f"a contact has 3 rows (normal, tangent, tangent), or 2 in the plane, got {d!r}: {rows} rows and "
            f"{count} coefficients of friction"
        )
    if rows % d:
        need = "3, nor, in the plane, of 2" if given is None else d
        raise InvalidProblem(
            f"{rows} rows are no multiple of {need}, the rows of a contact: normal, then tangents"
        )
    return int(d)
