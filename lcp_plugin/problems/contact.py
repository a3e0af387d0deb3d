"""Contacts with Coulomb friction, its cone a pyramid, as one linear complementarity problem.

Of contact c with friction coefficient μ let p be the normal impulse, β ≥ 0 one impulse an edge of the pyramid, u and v
the normal and the tangential velocity after the impulses, and the columns of D the edges, unit vectors in pairs d, −d:

    0 ≤ p ⊥ u ≥ 0,      0 ≤ β ⊥ Dᵀv + λ 1 ≥ 0,      0 ≤ λ ⊥ μ p − 1ᵀβ ≥ 0.

So λ is the speed of slipping against the steepest edge, and 0 where the contact sticks. Velocities are W times the
impulses, and those that the bodies would have without them, W = J m⁻¹ Jᵀ (Delassus' operator; J the rows of normals and
tangents, m the mass matrix), and z = (p of all contacts, β contact by contact, λ of all). Of velocities J u with no gap
there is a solution, and Lemke's path ends in one (Anitescu and Potra).

References
----------
D. E. Stewart, J. C. Trinkle, *An implicit time-stepping scheme for rigid body dynamics with inelastic collisions and
Coulomb friction*, Int. J. Numer. Meth. Eng. 39 (1996). M. Anitescu, F. A. Potra, *Formulating dynamic multi-rigid-body
contact problems with friction as solvable linear complementarity problems*, Nonlinear Dynamics 14 (1997),
doi:10.1023/A:1008292328909.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from ..core.checks import real_array
from ..core.errors import InvalidProblem
from ..core.lcp import LCP
from ..core.solving.result import Result

FloatArray = NDArray[np.float64]

SYMMETRIC = 1e-8  # of the largest entry
STILL = 1e-8  # of the largest velocity given: what is slower sticks
UNIT = 1e-6  # by which the length of a direction may differ from 1


@dataclass(frozen=True, eq=False)
class ContactMotion:
    """Impulses of each contact and its velocity after them; of a batch with an axis in front.

    Attributes
    ----------
    normal : ndarray, shape (k,)
        Impulses along the normals, ≥ 0, in N s.
    tangential : ndarray, shape (k, t)
        Friction impulses along the tangents, in N s.
    separation : ndarray, shape (k,)
        Velocity along the normal, in m/s: 0 where the contact stays closed.
    slip : ndarray, shape (k, t)
        Velocity along the tangents, in m/s.
    touches : array of bool, shape (k,)
        Whether the contact presses.
    sticks : array of bool, shape (k,)
        Whether it presses and does not slip: no faster than 1e-8 of the largest velocity given.
    """

    normal: FloatArray
    tangential: FloatArray
    separation: FloatArray
    slip: FloatArray
    touches: NDArray[np.bool_]
    sticks: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Contacts:
    """What a problem of contacts came from; of a batch with an axis in front.

    Attributes
    ----------
    W : ndarray, shape (d k, d k)
        Velocities by impulses, d = 1 + t rows a contact: its normal, then its tangents; in 1/kg.
    friction : ndarray, shape (k,)
    velocities : ndarray, shape (k, d)
        Without the impulses, in m/s.
    edges : ndarray, shape (m, t)
        Those of the pyramids, by the tangents.
    """

    W: FloatArray = field(repr=False)
    friction: FloatArray
    velocities: FloatArray = field(repr=False)
    edges: FloatArray = field(repr=False)

    @property
    def count(self) -> int:
        """The number of contacts, k."""
        return int(self.velocities.shape[-2])

    @property
    def arrays(self) -> tuple[FloatArray, FloatArray]:
        """M, shape (n, n), and q, shape (n,), n = k (m + 2); of a batch (B, n, n) and (B, n)."""
        k, m = self.count, len(self.edges)
        d, pressing = self.velocities.shape[-1], k * (1 + m)
        rows, contact = np.zeros((pressing, k * d)), np.arange(k)  # normals and edges by normals and tangents
        rows[contact, d * contact] = 1.0
        for c in range(k):
            rows[k + m * c:k + m * (c + 1), d * c + 1:d * (c + 1)] = self.edges
        M = np.zeros((*self.W.shape[:-2], k * (m + 2), k * (m + 2)))
        M[..., :pressing, :pressing] = rows @ self.W @ rows.T
        steepest, edge = pressing + contact, (k + m * contact[:, None]) + np.arange(m)
        M[..., edge, steepest[:, None]], M[..., steepest[:, None], edge] = 1.0, -1.0
        M[..., steepest, contact] = self.friction
        moving = self.velocities.reshape(*self.velocities.shape[:-2], k * d) @ rows.T
        return M, np.concatenate([moving, np.zeros((*moving.shape[:-1], k))], axis=-1)

    def recover(self, answer: Any) -> ContactMotion:
        """Return the impulses and velocities that an answer of the complementarity problem stands for.

        Parameters
        ----------
        answer : Result or array, shape (n,); of a batch BatchResult or array, shape (B, n)
            A Result of ``problem.with_q(q)`` has the velocities that its q stands for.

        Raises
        ------
        InvalidProblem
            Where it is no array of that shape.
        """
        k, m = self.count, len(self.edges)
        z = self._checked(getattr(answer, "z", answer), k)
        impulses = np.empty((*z.shape[:-1], *self.velocities.shape[-2:]))
        impulses[..., 0] = z[..., :k]
        impulses[..., 1:] = z[..., k:-k].reshape(*z.shape[:-1], k, m) @ self.edges
        given = self._velocities_of(answer)
        moved = (self.W @ impulses.reshape(*z.shape[:-1], -1, 1)).reshape(impulses.shape) + given
        slip, touches = moved[..., 1:], z[..., :k] > 0.0
        still = STILL * np.abs(given).max(axis=(-2, -1), initial=0.0)
        sticks = touches & (np.abs(slip).max(axis=-1) <= np.expand_dims(still, -1))
        return ContactMotion(impulses[..., 0], impulses[..., 1:], moved[..., 0], slip, touches, sticks)

    def _velocities_of(self, answer: Any) -> FloatArray:
        """Return the velocities without impulses, of the problem that a Result answers where that has another q."""
        problem = answer.certificate.problem if isinstance(answer, Result) else None
        if problem is None or problem.origin is self:
            return self.velocities
        k, along_edges = self.count, np.linalg.pinv(self.edges)
        tangential = problem.q[k:-k or None].reshape(k, -1) @ along_edges.T
        return np.concatenate([problem.q[:k, np.newaxis], tangential], axis=1)

    def start_from(self, answer: Any, same: ArrayLike) -> FloatArray:
        """Return a start z0, shape (n,), from the answer before, of contacts some of which have come or gone.

        Parameters
        ----------
        answer : Result or array
            Of a problem with as many edges a contact.
        same : array of int, shape (k,)
            Which contact of that problem each contact is, −1 for a new one.

        Raises
        ------
        InvalidProblem
            Where they do not fit together.
        """
        edges, which = len(self.edges), np.asarray(same)
        z = np.asarray(getattr(answer, "z", answer), dtype=np.float64)
        before = z.size // (edges + 2)
        is_fit = z.shape == (before * (edges + 2),) and which.shape == (self.count,) and which.dtype.kind in "iu"
        if not is_fit or which.max(initial=-1) >= before or which.min(initial=0) < -1:
            raise InvalidProblem(
                f"start_from needs an answer with {edges} edges a contact and {self.count} indices into its contacts, "
                f"−1 for a new one, got z of shape {z.shape} and same = {which.tolist()}"
            )
        normal, edge, steepest = z[:before], z[before:-before or None].reshape(before, edges), z[z.size - before:]
        kept, is_old = np.maximum(which, 0), which >= 0
        parts = (np.where(is_old.reshape(-1, *([1] * (part.ndim - 1))), part[kept], 0.0) if before else
                 np.zeros((self.count, *part.shape[1:])) for part in (normal, edge, steepest))
        return np.concatenate([part.ravel() for part in parts])

    def _checked(self, z: Any, k: int) -> FloatArray:
        shape = (*self.velocities.shape[:-2], k * (len(self.edges) + 2))
        need = f"z must have shape {shape}, of one result at a time where these are contacts of one problem"
        array = real_array(z, need)
        if array.shape != shape:
            raise InvalidProblem(f"{need}, got {array.shape}")
        return array


def lcp_from_contacts(contacts: Any, friction: ArrayLike, velocities: ArrayLike, directions: int = 4) -> LCP:
    """Return the complementarity problem of contacts with friction, see the module; ``origin.recover`` leads back.

    Parameters
    ----------
    contacts, friction, velocities, directions
        As in `contact_data`, without an axis in front.

    Returns
    -------
    LCP
        n = k (m + 2) with m edges a contact, and an origin of type :class:`Contacts`.

    Raises
    ------
    InvalidProblem
        As `contact_data`, and for a batch.

    Examples
    --------
    A block of 2 kg that gravity pulls into the ground and along it for a hundredth of a second; friction holds it at
    μ = 0.5, not at 0.3:

    >>> from lcp_plugin import solve
    >>> pull = 0.01 * np.array([-9.81, 3.924])
    >>> for friction in (0.5, 0.3):
    ...     problem = lcp_from_contacts((2.0 * np.eye(2), [[1, 0]], [[0, 1]]), friction, pull)
    ...     motion = problem.origin.recover(solve(problem))
    ...     print(motion.normal.round(5), motion.tangential.round(5), motion.slip.round(5), motion.sticks)
    [0.1962] [[-0.07848]] [[0.]] [ True]
    [0.1962] [[-0.05886]] [[0.00981]] [False]
    """
    given = contact_data(contacts, friction, velocities, directions)
    if given.W.ndim != 2:
        raise InvalidProblem(
            "LCP.from_contacts makes one problem, got arrays of a batch; write contact_data(…) from "
            "lcp_plugin.problems.contact, and solve_batch(*data.arrays)"
        )
    problem = LCP(*given.arrays)
    problem.origin = given
    return problem


def contact_data(contacts: Any, friction: ArrayLike, velocities: ArrayLike, directions: int = 4) -> Contacts:
    """Return contacts with friction, checked; any array may have an axis in front, one item a problem of a batch.

    ``solve_batch(*data.arrays)`` solves them all, and ``data.recover(batch)`` leads back.

    Parameters
    ----------
    contacts : array, shape (d k, d k), or three arrays (mass matrix, normals, tangents)
        W, symmetric, with d = 1 + t rows a contact: its normal, then its t tangents, t = 1 in the plane and 2 in space;
        in 1/kg. Or the mass matrix, shape (v, v), symmetric positive definite, in kg; normals, shape (k, v), and
        tangents, (k, t, v) or (k, v) in the plane: what the bodies' velocities contribute to those of the gap,
        positive where it opens, and along two directions. These are orthogonal unit vectors: of a free body's
        translations (columns where the mass matrix is m times the identity) that is checked; of joints nobody can.
    friction : number or array, shape (k,)
        Coefficients μ ≥ 0.
    velocities : array, shape (k, d), or (v,) beside a mass matrix
        What they would be at the end of the step without contact impulses, in m/s: along normal and tangents of each
        contact, or of the bodies. To a normal velocity may be added gap / time step, and restitution.
    directions : int
        Edges of a pyramid in space, even, at least 4; the first along the first tangent. In the plane there are two.

    Returns
    -------
    Contacts

    Raises
    ------
    InvalidProblem
        For negative friction, tangents that are not unit vectors, velocities or other arrays that do not fit, a W that
        is not symmetric, a mass matrix that is not positive definite.

    Examples
    --------
    >>> from lcp_plugin import solve_batch
    >>> data = contact_data(np.eye(3), 0.5, [[[-1.0, 0.3, 0.0]], [[-1.0, 0.9, 0.0]]])
    >>> data.recover(solve_batch(*data.arrays)).tangential.round(6).tolist()
    [[[-0.3, 0.0]], [[-0.5, 0.0]]]
    """
    given = _array(velocities, "velocities must be a finite array of shape (k, d), d = 3 in space and 2 in the plane")
    if isinstance(contacts, tuple) or (isinstance(contacts, list) and len(contacts) == 3 and np.ndim(contacts[0]) == 2):
        W, given = _of_bodies(tuple(contacts), given)
    else:
        W = _array(contacts, "W must be a finite, symmetric array of shape (d k, d k)")
        _check_symmetric(W, "W")
    if given.ndim not in (2, 3) or given.shape[-1] not in (2, 3) or given.shape[-2] * given.shape[-1] != W.shape[-1]:
        _refuse_velocities(W.shape[-1], given)
    edges, k = _edges(given.shape[-1] - 1, directions), given.shape[-2]
    need = f"friction must be a number, or an array of shape ({k},): one a contact"
    mu = _array(friction, need)
    if mu.ndim and (mu.ndim > 2 or mu.shape[-1] != k):
        raise InvalidProblem(f"{need}, got shape {mu.shape}")
    if mu.min(initial=0.0) < 0.0:
        at = tuple(np.argwhere(mu < 0.0)[0].tolist())
        where = f"friction{list(at)}" if at else "friction"
        raise InvalidProblem(f"friction must not be negative, but {where} = {mu[at]}; give μ ≥ 0, 0 for none")
    counts = {part.shape[0] for part, ndim in ((W, 3), (given, 3), (mu, 2)) if part.ndim == ndim}
    if len(counts) > 1:
        raise InvalidProblem(f"all arrays with an axis for the problems must be equally long, got {sorted(counts)}")
    for count in counts:
        W, given = np.broadcast_to(W, (count, *W.shape[-2:])), np.broadcast_to(given, (count, *given.shape[-2:]))
    return Contacts(W, np.broadcast_to(mu, given.shape[:-1]), given, edges)


def _of_bodies(contacts: tuple[Any, ...], velocities: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return W and the contacts' velocities from (mass matrix, normals, tangents) and velocities of either kind."""
    if len(contacts) != 3:
        raise InvalidProblem(f"contacts must be W, or (mass matrix, normals, tangents), got {len(contacts)} arrays")
    mass = _array(contacts[0], "the mass matrix must be a finite array of shape (v, v)")
    _check_symmetric(mass, "the mass matrix")
    v = mass.shape[-1]
    normals = _array(contacts[1], f"normals must be a finite array of shape (k, {v}), {v} the size of the mass matrix")
    need = f"tangents must be a finite array of shape (k, t, {v}), t = 2 in space and 1 in the plane"
    tangents = _array(contacts[2], need)
    if tangents.ndim == normals.ndim:
        tangents = tangents[..., None, :]
    if normals.ndim < 2 or normals.shape[-1] != v:
        raise InvalidProblem(f"normals must have shape (k, {v}), {v} the size of the mass matrix, got {normals.shape}")
    k = normals.shape[-2]
    is_fit = tangents.ndim == normals.ndim + 1 and tangents.shape[:-2] == normals.shape[:-1]
    if not is_fit or tangents.shape[-2] not in (1, 2) or tangents.shape[-1] != v:
        raise InvalidProblem(f"{need}, k = {k} as of the normals, got {tangents.shape}")
    rows = np.concatenate([normals[..., None, :], tangents], axis=-2)
    _check_directions(rows, mass)
    d = rows.shape[-2]
    J = rows.reshape(*rows.shape[:-3], k * d, v)
    try:
        half = np.linalg.solve(np.linalg.cholesky(mass), np.swapaxes(J, -1, -2))
    except np.linalg.LinAlgError as error:
        raise InvalidProblem(
            "the mass matrix must be positive definite, and a factor of Cholesky shows that it is not; leave out "
            "bodies that do not move, or give W"
        ) from error
    W = np.swapaxes(half, -1, -2) @ half
    if velocities.shape[-1:] == (v,) and (velocities.ndim == 1 or velocities.shape[-2] != k or d != v):
        velocities = (velocities[..., None, :] @ np.swapaxes(J, -1, -2)).reshape(*velocities.shape[:-1], k, d)
    elif velocities.ndim == 1:
        raise InvalidProblem(
            f"velocities must have shape ({v},), those of the bodies, or ({k}, {d}), those of the contacts, got "
            f"{velocities.shape}: too {'few' if velocities.size < v else 'many'}; give one for each row of the mass "
            "matrix"
        )
    return 0.5 * (W + np.swapaxes(W, -1, -2)), velocities


def _check_directions(rows: FloatArray, mass: FloatArray) -> None:
    """Refuse rows (k, d, v) that are no unit vectors where they show it.

    Columns in which the mass matrix is m times the identity, beside zeros, are translations of a free body, or
    rotations of one with three equal moments of inertia. Normal and tangents are linearly independent there for
    translations only: r × n, r × t and r × s lie in a plane.
    """
    *batch, _, d, v = rows.shape
    if batch or mass.ndim != 2:
        rows, mass = rows.reshape(-1, d, v), mass.reshape(-1, v, v)[0]
    seen, worst = np.zeros(rows.shape[0], np.bool_), np.full(rows.shape[0], np.inf)
    for first in range(v - d + 1):
        own = slice(first, first + d)
        others = np.delete(mass[own], np.s_[own], axis=1)
        if others.any() or not np.array_equal(mass[own, own], mass[first, first] * np.eye(d)):
            continue
        products = rows[:, :, own] @ np.swapaxes(rows[:, :, own], 1, 2)
        lengths = np.sqrt(np.einsum("kii->ki", products)) + np.finfo(float).tiny
        are = np.linalg.det(products / lengths[:, :, None] / lengths[:, None]) > UNIT
        seen, worst = seen | are, np.where(are, np.minimum(worst, np.abs(products - np.eye(d)).max(axis=(1, 2))), worst)
    wrong = np.flatnonzero(seen & (worst > UNIT))
    if wrong.size:
        c = int(wrong[0])
        raise InvalidProblem(
            f"normals and tangents must be orthogonal unit vectors, but those of contact {c} are off by {worst[c]:.2g} "
            "in the translations of a body; divide each by its length, the lever arms with it; or, where the unknowns "
            "are no translations, give W = J m⁻¹ Jᵀ and the velocities J u"
        )


def _edges(tangents: int, directions: int) -> FloatArray:
    """Return the edges of a pyramid, shape (m, t), as pairs d, −d: the second half is minus the first."""
    is_count = isinstance(directions, (int, np.integer)) and not isinstance(directions, bool)
    if not is_count or directions < 4 or directions % 2:
        raise InvalidProblem(f"directions must be an even number ≥ 4 (in the plane there are two), got {directions!r}")
    if tangents == 1:
        return np.array([[1.0], [-1.0]])
    angle = 2.0 * np.pi / directions * np.arange(directions // 2)
    half = np.column_stack([np.cos(angle), np.sin(angle)])
    half[np.abs(half) < UNIT] = 0.0
    return np.vstack([half, -half])


def _array(values: Any, need: str) -> FloatArray:
    array = real_array(values.toarray() if sp.issparse(values) else values, need).copy()
    if not np.isfinite(array).all():
        where = np.argwhere(~np.isfinite(array))[0].tolist()
        raise InvalidProblem(f"{need}, but entry {where} is {array[tuple(where)]}; repair it")
    return array


def _check_symmetric(matrix: FloatArray, name: str) -> None:
    if matrix.ndim not in (2, 3) or matrix.shape[-1] != matrix.shape[-2]:
        raise InvalidProblem(f"{name} must be square, got shape {matrix.shape}; of masses it is np.diag(masses)")
    difference = np.abs(matrix - np.swapaxes(matrix, -1, -2)).max(initial=0.0)
    if difference > SYMMETRIC * np.abs(matrix).max(initial=0.0):
        raise InvalidProblem(
            f"{name} must be symmetric, but entries differ from those across the diagonal by {difference:.2g}; is it "
            "J m⁻¹ Jᵀ with the same J on both sides?"
        )


def _refuse_velocities(size: int, velocities: FloatArray) -> None:
    d = velocities.shape[-1] if velocities.ndim > 1 and velocities.shape[-1] in (2, 3) else 3 if size % 3 == 0 else 2
    count = velocities.shape[-2] if velocities.ndim > 1 else velocities.size
    raise InvalidProblem(
        f"velocities must have shape ({size // d}, {d}): one row (normal, tangents) a contact, W having {size} rows, "
        f"got {velocities.shape}: too {'few' if count < size // d else 'many'}; of bodies give the mass matrix and u"
    )
