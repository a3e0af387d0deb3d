"""Contacts with Coulomb friction, its cone a pyramid, as one linear complementarity problem.

Of contact c with friction coefficient μ let p be the normal impulse, β ≥ 0 one impulse an edge of the pyramid, u and v
the normal and the tangential velocity after the impulses, and the columns of D the edges, unit vectors in pairs d, −d:

    0 ≤ p ⊥ u ≥ 0,      0 ≤ β ⊥ Dᵀv + λ 1 ≥ 0,      0 ≤ λ ⊥ μ p − 1ᵀβ ≥ 0.

So λ is the speed of slipping against the steepest edge, and 0 where the contact sticks. Velocities are W times the
impulses, and those that the bodies would have without them, W = J m⁻¹ Jᵀ (Delassus' operator; J the rows of normals and
tangents, m the mass matrix), and z = (p of all contacts, β contact by contact, λ of all). Of velocities J u with no gap
there is a solution, and Lemke's path ends in one (Anitescu and Potra).

A simulation takes a few calls a step; ``start_from`` begins the next solve from the answer before:

    problem = LCP.from_contacts((mass, normals, tangents), friction, velocities, gaps=gaps, time_step=dt)
    result = solve(problem, z0=problem.origin.start_from(before, same))
    velocities = problem.origin.recover(result).body_velocities + dt * accelerations

References
----------
D. E. Stewart, J. C. Trinkle, *An implicit time-stepping scheme for rigid body dynamics with inelastic collisions and
Coulomb friction*, Int. J. Numer. Meth. Eng. 39 (1996). M. Anitescu, F. A. Potra, *Formulating dynamic multi-rigid-body
contact problems with friction as solvable linear complementarity problems*, Nonlinear Dynamics 14 (1997),
doi:10.1023/A:1008292328909.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from ..core.checks import canonical_csr, is_number, real_array, rectangular_matrix
from ..core.errors import InvalidProblem, ModelWarning
from ..core.lcp import LCP
from ..core.solving.result import Result

FloatArray = NDArray[np.float64]

SYMMETRIC = 1e-8  # of the largest entry
STICKS = 1e-8  # of the largest velocity given: what is slower sticks
UNIT = 1e-6  # by which the length of a direction may differ from 1
NOT_DEFINITE = (
    "the mass matrix must be positive definite, and a factor of Cholesky shows that it is not; leave out bodies that "
    "do not move, or give W"
)
MOST_FRICTION = (
    5.0  # of soft rubber it is some 2; what is larger is probably an angle or a percentage
)


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
    body_velocities : ndarray, shape (v,), or None
        Those of the bodies after the impulses, u + m⁻¹ Jᵀ impulses. None where the contacts were stated without a mass
        matrix and the bodies' velocities u, and of ``problem.with_q(q)``, whose q does not tell u.
    """

    normal: FloatArray
    tangential: FloatArray
    separation: FloatArray
    slip: FloatArray
    touches: NDArray[np.bool_]
    sticks: NDArray[np.bool_]
    body_velocities: FloatArray | None = None


def motion_of(r: Any, u: Any, given: Any, after: Any = None) -> ContactMotion:
    """Return impulses r and velocities u, shape (…, k, d) each, as a motion; `given`, (…, d k), are those without."""
    still = STICKS * np.abs(given).max(axis=-1, initial=0.0)[..., np.newaxis]
    with np.errstate(over="ignore", under="ignore"):
        touches, speeds = r[..., 0] > 0.0, np.hypot.reduce(np.abs(u[..., 1:]), axis=-1)
    return ContactMotion(
        r[..., 0], r[..., 1:], u[..., 0], u[..., 1:], touches, touches & (speeds <= still), after
    )


class Bodies(NamedTuple):
    """The bodies behind contacts: mass, shape (v, v), rows J, (d k, v), and velocities, (v,) or None if not given."""

    mass: Any
    rows: Any
    velocities: FloatArray | None

    @property
    def by_impulse(self) -> Any:
        """What a unit impulse of each row adds to the velocities, m⁻¹ Jᵀ, shape (v, d k); sparse where these are."""
        if sp.issparse(self.mass):
            return inverse_by_components(self.mass) @ self.rows.T
        return np.asarray(
            np.linalg.solve(self.mass, np.swapaxes(self.rows, -1, -2)), dtype=np.float64
        )


@dataclass(frozen=True, eq=False)
class Contacts:
    """The contacts from which a problem was made; of a batch with an axis in front.

    Attributes
    ----------
    W : ndarray, shape (d k, d k)
        Velocities by impulses, d = 1 + t rows a contact: its normal, then its tangents; in 1/kg.
    friction : ndarray, shape (k,)
    velocities : ndarray, shape (k, d)
        Without the impulses, in m/s.
    edges : ndarray, shape (m, t)
        Those of the pyramids, by the tangents.
    gaps : ndarray, shape (k,), or None
        Distances at the beginning of the step, in m.
    time_step : float or None
        In s, where gaps are given.
    bodies : Bodies or None
        Where W was made of a mass matrix, normals and tangents.
    """

    W: FloatArray = field(repr=False)
    friction: FloatArray
    velocities: FloatArray = field(repr=False)
    edges: FloatArray = field(repr=False)
    gaps: FloatArray | None = field(default=None, repr=False)
    time_step: float | None = None
    bodies: Bodies | None = field(default=None, repr=False)

    @property
    def count(self) -> int:
        """The number of contacts, k."""
        return int(self.velocities.shape[-2])

    @property
    def arrays(self) -> tuple[FloatArray, FloatArray]:
        """M, shape (n, n), and q, shape (n,), n = k (m + 2); of a batch (B, n, n) and (B, n)."""
        k, m = self.count, len(self.edges)
        M = self._in_matrix(self.W, self.friction)
        steepest = k * (1 + m) + np.arange(k)
        edge = (k + m * np.arange(k)[:, None]) + np.arange(m)
        M[..., edge, steepest[:, None]], M[..., steepest[:, None], edge] = 1.0, -1.0
        return M, self._in_vector(self.velocities, self.gaps)

    @property
    def _by_edges(self) -> FloatArray:
        """The normals and edges by normals and tangents, shape (k (1 + m), k d)."""
        k, m, d = self.count, len(self.edges), self.velocities.shape[-1]
        rows, contact = np.zeros((k * (1 + m), k * d)), np.arange(k)
        rows[contact, d * contact] = 1.0
        for c in range(k):
            rows[k + m * c : k + m * (c + 1), d * c + 1 : d * (c + 1)] = self.edges
        return rows

    def _in_matrix(self, W: FloatArray, friction: FloatArray) -> FloatArray:
        """Return what W and the coefficients, or changes of them, are in M, which is linear in them."""
        k, rows = self.count, self._by_edges
        pressing = len(rows)
        M = np.zeros(
            (*np.broadcast_shapes(W.shape[:-2], friction.shape[:-1]), pressing + k, pressing + k)
        )
        M[..., :pressing, :pressing] = rows @ W @ rows.T
        M[..., pressing + np.arange(k), np.arange(k)] = friction
        return M

    def _in_vector(self, velocities: FloatArray, gaps: FloatArray | None) -> FloatArray:
        """Return what velocities, shape (k, d), and gaps, or changes of them, are in q, which is linear in them."""
        k, velocities = self.count, self.until_contact(velocities, gaps)
        moving = velocities.reshape(*velocities.shape[:-2], -1) @ self._by_edges.T
        return np.concatenate([moving, np.zeros((*moving.shape[:-1], k))], axis=-1)

    def until_contact(self, velocities: FloatArray, gaps: FloatArray | None) -> FloatArray:
        """Return velocities, shape (k, d), less those that close the gaps within the step, or changes of them."""
        if gaps is None or self.time_step is None:
            return velocities
        closing = np.zeros((*gaps.shape, velocities.shape[-1]))
        closing[..., 0] = gaps / self.time_step
        return velocities + closing

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
        given, bodies = self._velocities_of(answer), self.bodies
        moved = (self.W @ impulses.reshape(*z.shape[:-1], -1, 1)).reshape(impulses.shape) + given
        after = None
        if bodies is not None and bodies.velocities is not None and given is self.velocities:
            after = (
                bodies.velocities
                + (bodies.by_impulse @ impulses.reshape(*z.shape[:-1], -1, 1))[..., 0]
            )
        return motion_of(impulses, moved, given.reshape(*given.shape[:-2], -1), after)

    def _velocities_of(self, answer: Any) -> FloatArray:
        """Return the velocities without impulses, of the problem that a Result answers where that has another q."""
        problem = answer.certificate.problem if isinstance(answer, Result) else None
        if problem is None or problem.origin is self:
            return self.velocities
        k, along_edges = self.count, np.linalg.pinv(self.edges)
        tangential = problem.q[k : -k or None].reshape(k, -1) @ along_edges.T
        normal = problem.q[:k]
        if self.gaps is not None and self.time_step is not None:
            normal = normal - self.gaps / self.time_step
        return np.concatenate([normal[:, np.newaxis], tangential], axis=1)

    def start_from(self, answer: Any, same: ArrayLike) -> FloatArray:
        """Return a start z0, shape (n,), from the answer before, of contacts some of which have come or gone.

        ``solve(problem, z0=problem.origin.start_from(before, same))`` begins there.

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
        is_fit = (
            z.shape == (before * (edges + 2),)
            and which.shape == (self.count,)
            and which.dtype.kind in "iu"
        )
        if not is_fit or which.max(initial=-1) >= before or which.min(initial=0) < -1:
            raise InvalidProblem(
                f"start_from needs an answer with {edges} edges a contact and {self.count} indices into its contacts, "
                f"−1 for a new one, got z of shape {z.shape} and same = {which.tolist()}"
            )
        normal, edge, steepest = (
            z[:before],
            z[before : -before or None].reshape(before, edges),
            z[z.size - before :],
        )
        kept, is_old = np.maximum(which, 0), which >= 0
        parts = (
            np.where(is_old.reshape(-1, *([1] * (part.ndim - 1))), part[kept], 0.0)
            if before
            else np.zeros((self.count, *part.shape[1:]))
            for part in (normal, edge, steepest)
        )
        return np.concatenate([part.ravel() for part in parts])

    def _checked(self, z: Any, k: int) -> FloatArray:
        shape = (*self.velocities.shape[:-2], k * (len(self.edges) + 2))
        need = f"z must have shape {shape}, of one result at a time where these are contacts of one problem"
        array = real_array(z, need)
        if array.shape != shape:
            raise InvalidProblem(f"{need}, got {array.shape}")
        return array


def lcp_from_contacts(
    contacts: Any,
    friction: ArrayLike,
    velocities: ArrayLike,
    directions: int = 4,
    *,
    gaps: ArrayLike | None = None,
    time_step: float | None = None,
) -> LCP:
    """Return the complementarity problem of contacts with friction, see the module; ``origin.recover`` leads back.

    Parameters
    ----------
    contacts, friction, velocities, directions, gaps, time_step
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

    It falls with 1 m/s, 4 mm above the ground; a step takes 0.01 s. It may lose the 4 mm, so it keeps 0.4 m/s, and the
    ground takes the other 0.6 m/s:

    >>> block = 2.0 * np.eye(2), [[0, 1]], [[1, 0]]  # mass matrix, normals, tangents; its velocities: along, up
    >>> problem = lcp_from_contacts(block, 0.5, [0.0, -1.0], gaps=0.004, time_step=0.01)
    >>> result = solve(problem)
    >>> motion = problem.origin.recover(result)
    >>> motion.normal.round(6), motion.separation.round(6), motion.body_velocities.round(6)
    (array([1.2]), array([-0.4]), array([ 0. , -0.4]))
    """
    given = checked_contacts(contacts, friction, velocities, directions, gaps, time_step)
    if given.W.ndim != 2:
        raise InvalidProblem(
            "LCP.from_contacts makes one problem, got arrays of a batch; write contact_data(…) from "
            "lcp_plugin.problems.contact, and solve_batch(*data.arrays)"
        )
    warn_of_much_friction(given.friction, 4)
    problem = LCP(*given.arrays)
    problem.origin = given
    return problem


def contact_data(
    contacts: Any,
    friction: ArrayLike,
    velocities: ArrayLike,
    directions: int = 4,
    *,
    gaps: ArrayLike | None = None,
    time_step: float | None = None,
) -> Contacts:
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
        Coefficients μ ≥ 0; a ModelWarning is issued above 5.
    velocities : array, shape (k, d), or (v,) beside a mass matrix
        What they would be at the end of the step without contact impulses, in m/s: along normal and tangents of each
        contact, or of the bodies. Restitution is added to normal velocities, for which it takes the shape (k, d).
    directions : int
        Edges of a pyramid in space, even, at least 4; the first along the first tangent. In the plane there are two.
    gaps : number or array, shape (k,), optional
        Distances at the beginning of the step, in m, negative where bodies overlap; with `time_step`. A contact may
        close by gap / time step then, before it presses. It does not matter whether W or a mass matrix is given: add
        nothing to `velocities` yourself.
    time_step : float, optional
        In s, > 0.

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
    data = checked_contacts(contacts, friction, velocities, directions, gaps, time_step)
    warn_of_much_friction(data.friction, 3)
    return data


def checked_contacts(
    contacts: Any,
    friction: ArrayLike,
    velocities: ArrayLike,
    directions: int = 4,
    gaps: ArrayLike | None = None,
    time_step: float | None = None,
    *,
    keeps_sparse: bool = False,
) -> Contacts:
    """Return what :func:`contact_data` does, without a warning; W is sparse where a part is and `keeps_sparse`."""
    bodies = None
    given = _array(
        velocities,
        "velocities must be a finite array of shape (k, d), d = 3 in space and 2 in the plane",
    )
    if is_of_bodies(contacts):
        is_sparse = keeps_sparse and any(map(sp.issparse, contacts))
        W, given, bodies = (_of_sparse_bodies if is_sparse else _of_bodies)(tuple(contacts), given)
    else:
        W = _array(contacts, "W must be a finite, symmetric array of shape (d k, d k)")
        check_symmetric(W, "W")
    if (
        given.ndim not in (2, 3)
        or given.shape[-1] not in (2, 3)
        or given.shape[-2] * given.shape[-1] != W.shape[-1]
    ):
        _refuse_velocities(W.shape[-1], given)
    edges, k = _edges(given.shape[-1] - 1, directions), given.shape[-2]
    mu = checked_friction(friction, k)
    distances = (
        None if gaps is None and time_step is None else checked_distances(gaps, time_step, k)
    )
    several = (W, 3), (given, 3), (mu, 2), (np.empty(k) if distances is None else distances, 2)
    counts = {part.shape[0] for part, ndim in several if part.ndim == ndim}
    if len(counts) > 1:
        raise InvalidProblem(
            f"all arrays with an axis for the problems must be equally long, got {sorted(counts)}"
        )
    for count in counts:
        W, given = (
            np.broadcast_to(W, (count, *W.shape[-2:])),
            np.broadcast_to(given, (count, *given.shape[-2:])),
        )
    mu = np.broadcast_to(mu, given.shape[:-1])
    distances = None if distances is None else np.broadcast_to(distances, given.shape[:-1])
    return Contacts(
        W, mu, given, edges, distances, None if distances is None else time_step, bodies
    )


def checked_friction(friction: ArrayLike, k: int, need: str = "one a contact") -> FloatArray:
    """Return the coefficients of k contacts: a number, shape (k,), or with an axis in front."""
    need = f"friction must be a number, or an array of shape ({k},): {need}"
    mu = _array(friction, need)
    if mu.ndim and (mu.ndim > 2 or mu.shape[-1] != k):
        raise InvalidProblem(f"{need}, got shape {mu.shape}")
    if mu.min(initial=0.0) < 0.0:
        at = tuple(np.argwhere(mu < 0.0)[0].tolist())
        where = f"friction{list(at)}" if at else "friction"
        raise InvalidProblem(
            f"friction must not be negative, but {where} = {mu[at]}; give μ ≥ 0, 0 for none"
        )
    return mu


def is_of_bodies(contacts: Any) -> bool:
    """Return whether these are (mass matrix, normals, tangents) rather than W."""
    is_list = isinstance(contacts, list) and len(contacts) == 3 and np.ndim(contacts[0]) == 2
    return is_list or isinstance(contacts, tuple)


def are_of_bodies(velocities: tuple[int, ...], normals: tuple[int, ...], d: int) -> bool:
    """Return whether velocities of this shape, beside normals of that, are those of bodies, not (k, d) of contacts."""
    return velocities[-1:] == normals[-1:] and (
        len(velocities) == 1 or velocities[-2:] != (*normals[-2:-1], d)
    )


def checked_distances(gaps: ArrayLike | None, time_step: float | None, k: int) -> FloatArray:
    """Return the gaps, checked with the time step."""
    if gaps is None or time_step is None:
        missing = "gaps" if gaps is None else "time_step"
        raise InvalidProblem(
            f"gaps and time_step go together, but {missing} is missing; give both, in m and in s"
        )
    if not is_number(time_step) or not 0.0 < time_step < np.inf:
        raise InvalidProblem(f"time_step must be a number of seconds > 0, got {time_step!r}")
    need = f"gaps must be a number, or a finite array of shape ({k},): one a contact"
    distances = _array(gaps, need)
    if distances.ndim > 2 or (distances.ndim and distances.shape[-1] != k):
        raise InvalidProblem(f"{need}, got shape {distances.shape}")
    return distances


def warn_of_much_friction(friction: FloatArray, level: int) -> None:
    """Warn the caller so many frames up where a coefficient is larger than those of any material."""
    if not friction.max(initial=0.0) > MOST_FRICTION:
        return
    at = np.unravel_index(int(friction.argmax()), friction.shape)
    warnings.warn(
        f"friction{[int(i) for i in at]} = {friction[at]:g} is more than {MOST_FRICTION:g}, which no two materials "
        "have: of soft rubber it is some 2; if it is an angle, give its tangent, if a percentage, divide by 100",
        ModelWarning,
        stacklevel=level,
    )


def _product(x: FloatArray, A: FloatArray) -> FloatArray:
    """Return xᵀA, of a batch one by one."""
    product: FloatArray = (x[..., None, :] @ A)[..., 0, :]
    return product


def _of_bodies(
    contacts: tuple[Any, ...], velocities: FloatArray
) -> tuple[FloatArray, FloatArray, Bodies]:
    """Return W, the contacts' velocities and the bodies from (mass matrix, normals, tangents) and velocities."""
    _require_three(contacts)
    mass = _array(contacts[0], "the mass matrix must be a finite array of shape (v, v)")
    check_symmetric(mass, "the mass matrix")
    v = mass.shape[-1]
    normals = _array(
        contacts[1],
        f"normals must be a finite array of shape (k, {v}), {v} the size of the mass matrix",
    )
    need = (
        f"tangents must be a finite array of shape (k, t, {v}), t = 2 in space and 1 in the plane"
    )
    tangents = _array(contacts[2], need)
    _require_fit(normals.shape, v)
    k = normals.shape[-2]
    if tangents.ndim == normals.ndim and tangents.shape[-2] in (
        k,
        2 * k,
    ):  # those of a contact one after the other
        tangents = tangents.reshape(
            *tangents.shape[:-2], k, tangents.shape[-2] // max(k, 1), -1 if k else v
        )
    is_fit = tangents.ndim == normals.ndim + 1 and tangents.shape[:-2] == normals.shape[:-1]
    if not is_fit or tangents.shape[-2] not in (1, 2) or tangents.shape[-1] != v:
        raise InvalidProblem(f"{need}, k = {k} as of the normals, got {tangents.shape}")
    rows = np.concatenate([normals[..., None, :], tangents], axis=-2)
    d = rows.shape[-2]
    _check_directions(sp.csr_array(rows.reshape(-1, v)), sp.csr_array(mass.reshape(-1, v, v)[0]), d)
    J = rows.reshape(*rows.shape[:-3], k * d, v)
    try:
        half = np.linalg.solve(np.linalg.cholesky(mass), np.swapaxes(J, -1, -2))
    except np.linalg.LinAlgError as error:
        raise InvalidProblem(NOT_DEFINITE) from error
    W = np.swapaxes(half, -1, -2) @ half
    return 0.5 * (W + np.swapaxes(W, -1, -2)), *_of_contacts(velocities, mass, J, k, d)


def _of_sparse_bodies(
    contacts: tuple[Any, ...], velocities: FloatArray
) -> tuple[sp.csr_array, FloatArray, Bodies]:
    """Return the same, sparse; the mass matrix is inverted component by component, as body by body."""
    _require_three(contacts)
    names, flat = ("the mass matrix", "normals", "tangents"), list(contacts)
    if np.ndim(flat[2]) == 3:
        flat[2] = np.reshape(flat[2], (-1, np.shape(flat[2])[-1]))
    mass, normals, tangents = (
        canonical_csr(sp.csr_array(rectangular_matrix(part, name, None, None)), name)
        for part, name in zip(flat, names, strict=True)
    )
    v = mass.shape[1]
    check_symmetric(mass, "the mass matrix")
    _require_fit(normals.shape, v)
    k = normals.shape[0]
    t = tangents.shape[0] // max(k, 1)
    if (k and t not in (1, 2)) or tangents.shape != (t * k, v):
        raise InvalidProblem(
            f"sparse tangents must have shape (t k, {v}), t = 2 in space and 1 in the plane, the t of a contact one "
            f"after the other, k = {k} as of the normals; got {tangents.shape}"
        )
    order = np.concatenate(
        [np.arange(k)[:, None], k + np.arange(t * k).reshape(k, t)], axis=1
    ).ravel()
    J = sp.csr_array(sp.vstack([normals, tangents], format="csr")[order])
    _check_directions(J, mass, 1 + t)
    W = J @ inverse_by_components(mass) @ J.T
    return sp.csr_array(0.5 * (W + W.T)), *_of_contacts(velocities, mass, J, k, 1 + t)


def inverse_by_components(mass: sp.csr_array) -> sp.csr_array:
    """Return the inverse of a symmetric positive definite matrix, whose connected components are small.

    Raises
    ------
    InvalidProblem
        Where it is not positive definite.
    """
    from scipy.sparse.csgraph import connected_components  # what most problems do not need

    count, component = connected_components(mass, directed=False)
    order, sizes = np.argsort(component, kind="stable"), np.bincount(component, minlength=count)
    firsts = np.cumsum(sizes) - sizes
    place = np.empty(order.size, np.int64)
    place[order] = np.arange(order.size) - np.repeat(firsts, sizes)
    M, inverse = sp.coo_array(mass), [sp.csr_array(mass.shape)]
    for size in np.unique(sizes).tolist():
        own = np.flatnonzero(sizes == size)
        number, inside = np.searchsorted(own, component[M.row]), sizes[component[M.row]] == size
        blocks = np.zeros((own.size, size, size))
        blocks[number[inside], place[M.row[inside]], place[M.col[inside]]] = M.data[inside]
        try:
            np.linalg.cholesky(blocks)
        except np.linalg.LinAlgError as error:
            raise InvalidProblem(NOT_DEFINITE) from error
        rows = order[firsts[own][:, None] + np.arange(size)]
        where = np.repeat(rows, size, axis=1).ravel(), np.tile(rows, size).ravel()
        inverse.append(sp.csr_array((np.linalg.inv(blocks).ravel(), where), shape=mass.shape))
    return sp.csr_array(sum(inverse[1:], inverse[0]))


def _require_three(contacts: tuple[Any, ...]) -> None:
    if len(contacts) != 3:
        raise InvalidProblem(
            f"contacts must be W, or (mass matrix, normals, tangents), got {len(contacts)} arrays"
        )


def _require_fit(normals: tuple[int, ...], v: int) -> None:
    if len(normals) < 2 or normals[-1] != v:
        raise InvalidProblem(
            f"normals must have shape (k, {v}), {v} the size of the mass matrix, got {normals}"
        )


def _of_contacts(
    velocities: FloatArray, mass: Any, J: Any, k: int, d: int
) -> tuple[FloatArray, Bodies]:
    """Return the contacts' velocities and the bodies, from the velocities of either."""
    v, own = mass.shape[-1], None
    if are_of_bodies(velocities.shape, (k, v), d):
        own, velocities = (
            velocities,
            _product(velocities, J.T if sp.issparse(J) else np.swapaxes(J, -1, -2)),
        )
        velocities = velocities.reshape(*velocities.shape[:-1], k, d)
    elif velocities.ndim == 1:
        raise InvalidProblem(
            f"velocities must have shape ({v},), those of the bodies, or ({k}, {d}), those of the contacts, got "
            f"{velocities.shape}: too {'few' if velocities.size < v else 'many'}; give one for each row of the mass "
            "matrix"
        )
    return velocities, Bodies(mass, J, own)


def _check_directions(J: sp.csr_array, mass: sp.csr_array, d: int) -> None:
    """Refuse rows of J, d a contact, that are no unit vectors where they show it.

    Columns in which the mass matrix is m times the identity, beside zeros, are translations of a free body, or
    rotations of one with three equal moments of inertia. Normal and tangents are linearly independent there for
    translations only: r × n, r × t and r × s lie in a plane.
    """
    diagonal, v = mass.diagonal(), mass.shape[0]
    alone = (np.bincount(mass.indices, minlength=v) == 1) & (diagonal != 0.0)
    windows = np.arange(max(v - d + 1, 0))[:, None] + np.arange(d)
    windows = windows[
        (alone[windows] & (diagonal[windows] == diagonal[windows[:, :1]])).all(axis=1)
    ]
    part = sp.coo_array(J[:, windows.ravel()])
    pair, number = np.unique((part.row // d) * len(windows) + part.col // d, return_inverse=True)
    own = np.zeros((pair.size, d, d))
    own[number, part.row % d, part.col % d] = part.data
    products = own @ np.swapaxes(own, 1, 2)
    lengths = np.sqrt(np.einsum("kii->ki", products)) + np.finfo(float).tiny
    are = np.linalg.det(products / lengths[:, :, None] / lengths[:, None]) > UNIT
    off = np.abs(products - np.eye(d)).max(axis=(1, 2))[are]
    contact = pair[are] // max(len(windows), 1)
    least = np.full(J.shape[0] // d, np.inf)
    np.minimum.at(
        least, contact, off
    )  # one body in whose translations they are unit vectors is enough
    wrong = np.flatnonzero((least > UNIT) & (least < np.inf))
    if wrong.size:
        c = int(wrong[0])
        raise InvalidProblem(
            f"normals and tangents must be orthogonal unit vectors, but those of contact {c} are off by {least[c]:.2g} "
            "in the translations of a body; divide each by its length, the lever arms with it; or, where the unknowns "
            "are no translations, give W = J m⁻¹ Jᵀ and the velocities J u"
        )


def _edges(tangents: int, directions: int) -> FloatArray:
    """Return the edges of a pyramid, shape (m, t), as pairs d, −d: the second half is minus the first."""
    is_count = isinstance(directions, (int, np.integer)) and not isinstance(directions, bool)
    if not is_count or directions < 4 or directions % 2:
        raise InvalidProblem(
            f"directions must be an even number ≥ 4 (in the plane there are two), got {directions!r}"
        )
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
        what = f"entry {where}" if where else "it"
        raise InvalidProblem(f"{need}, but {what} is {array[tuple(where)]}; repair it")
    return array


def check_symmetric(matrix: Any, name: str, tolerance: float = SYMMETRIC) -> None:
    """Refuse a matrix whose entries differ from those across the diagonal by more than that of the largest."""
    if matrix.ndim not in (2, 3) or matrix.shape[-1] != matrix.shape[-2]:
        raise InvalidProblem(
            f"{name} must be square, got shape {matrix.shape}; of masses it is np.diag(masses)"
        )
    other = matrix.T if sp.issparse(matrix) else np.swapaxes(matrix, -1, -2)
    difference, largest = (
        abs(part).max() if part.size else 0.0 for part in (matrix - other, matrix)
    )
    if difference > tolerance * largest:
        raise InvalidProblem(
            f"{name} must be symmetric, but entries differ from those across the diagonal by {difference:.2g}; is it "
            "J m⁻¹ Jᵀ with the same J on both sides?"
        )


def _refuse_velocities(size: int, velocities: FloatArray) -> None:
    d = (
        velocities.shape[-1]
        if velocities.ndim > 1 and velocities.shape[-1] in (2, 3)
        else 3
        if size % 3 == 0
        else 2
    )
    count = velocities.shape[-2] if velocities.ndim > 1 else velocities.size
    raise InvalidProblem(
        f"velocities must have shape ({size // d}, {d}): one row (normal, tangents) a contact, W having {size} rows, "
        f"got {velocities.shape}: too {'few' if count < size // d else 'many'}; of bodies give the mass matrix and u"
    )
