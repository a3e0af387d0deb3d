"""Contacts with Coulomb friction, its cone a pyramid, as one linear complementarity problem.

For contact c with friction coefficient μ let p be the normal impulse, β ≥ 0 one impulse per edge of the pyramid, u and
v the normal and the tangential velocity after the impulses, and the columns of D the edges, unit vectors in pairs d,
−d:

    0 ≤ p ⊥ u ≥ 0,      0 ≤ β ⊥ Dᵀv + λ 1 ≥ 0,      0 ≤ λ ⊥ μ p − 1ᵀβ ≥ 0.

So λ is the speed of slipping against the steepest edge, and 0 where the contact sticks. Velocities are W times the
impulses, and those that the bodies would have without them, W = J m⁻¹ Jᵀ (Delassus' operator; J the rows of normals and
tangents, m the mass matrix), and z = (p of all contacts, β contact by contact, λ of all). For velocities J u and no
gaps a solution exists, and Lemke's path ends in one (Anitescu and Potra).

A simulation takes a few calls per step:

    problem = LCP.from_contacts((mass, normals, tangents), friction, velocities, gaps=gaps, time_step=dt)
    result = solve(problem)
    velocities = problem.origin.recover(result).body_velocities + dt * accelerations

References
----------
D. E. Stewart, J. C. Trinkle, *An implicit time-stepping scheme for rigid body dynamics with inelastic collisions and
Coulomb friction*, Int. J. Numer. Meth. Eng. 39 (1996). M. Anitescu, F. A. Potra, *Formulating dynamic multi-rigid-body
contact problems with friction as solvable linear complementarity problems*, Nonlinear Dynamics 14 (1997),
doi:10.1023/A:1008292328909.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from ..core import checks
from ..core.checks import Array, checked_vector, is_number, real_array, rectangular_matrix
from ..core.errors import InvalidProblem, warn
from ..solving.result import Result

FloatArray = NDArray[np.float64]

UNIT_LENGTH = 1e-6  # by which the length of a direction may differ from 1
NOT_DEFINITE = "the mass matrix must be positive definite, and is not; leave out bodies that do not move, or give W"
# of soft rubber it is some 2; a larger number is probably an angle or a percentage
MOST_FRICTION = 5.0


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
        Velocity along the normal, in m/s; 0 if the contact stays closed.
    slip : ndarray, shape (k, t)
        Velocity along the tangents, in m/s.
    touches : array of bool, shape (k,)
        True if the contact presses.
    sticks : array of bool, shape (k,)
        True if it presses and does not slip: no faster than 1e-8 of the largest velocity.
    body_velocities : ndarray, shape (v,), or None
        Body velocities after the impulses, u + m⁻¹ Jᵀ impulses. None if the contacts were built without a mass matrix
        and the bodies' velocities u, and for ``problem.with_q(q)``, whose q does not determine u.
    equations : ndarray, shape (p,)
        Impulses of the equations, of either sign: of hinges, motors, loops.
    """

    normal: FloatArray
    tangential: FloatArray
    separation: FloatArray
    slip: FloatArray
    touches: NDArray[np.bool_]
    sticks: NDArray[np.bool_]
    body_velocities: FloatArray | None = None
    equations: FloatArray | None = None


def motion_of(r: Array, u: Array, b: Array, d: int, p: int = 0, after: Any = None) -> ContactMotion:
    """Return impulses r and velocities u, shape (…, d k + p) each, as a motion; b: velocities without impulses."""
    r, of_equations = np.split(r, [r.shape[-1] - p], axis=-1)
    r, u = (rows.reshape(*rows.shape[:-1], -1, d) for rows in (r, u[..., : r.shape[-1]]))
    threshold = 1e-8 * np.abs(b).max(axis=-1, initial=0.0)[..., np.newaxis]  # what is slower sticks
    with np.errstate(all="ignore"):
        touches, speeds = r[..., 0] > 0.0, np.hypot.reduce(np.abs(u[..., 1:]), axis=-1)
    sticks = touches & (speeds <= threshold)
    motion = r[..., 0], r[..., 1:], u[..., 0], u[..., 1:], touches, sticks
    return ContactMotion(*motion, after, of_equations)


class Bodies(NamedTuple):
    """The bodies behind contacts: mass and its inverse, (v, v), rows J, (d k + p, v), dense or CSR, and velocities.

    The velocities have shape (v,); None if they are unknown.
    """

    mass: Any
    inverse: Any
    rows: Any
    velocities: FloatArray | None
    dimension: int

    def moving(self, velocities: FloatArray, p: int) -> tuple[FloatArray, Bodies]:
        """Return the velocities of all rows, and the bodies with theirs; of bodies, or of contacts and p equations."""
        (rows, v), d = self.rows.shape, self.dimension
        if velocities.shape == (v,):
            of_bodies = checked_vector(velocities, "velocities", v)
            return self.rows @ of_bodies, self._replace(velocities=of_bodies)
        if velocities.shape != (shape := (rows,) if p else (rows // d, d)):
            raise InvalidProblem(
                f"velocities must have shape ({v},), of the bodies, or {shape}, of the contacts"
                f"{' and equations' * bool(p)}, got {velocities.shape}: too "
                f"{'few' if velocities.size < v else 'many'}"
            )
        return velocities.ravel(), self._replace(velocities=None)

    def velocities_after(self, impulses: FloatArray) -> FloatArray | None:
        """Return the velocities after impulses of all rows; None without the velocities before."""
        if self.velocities is None:
            return None
        return self.velocities + self.inverse @ (self.rows.T @ impulses)


@dataclass(frozen=True, eq=False)
class Contacts:
    """The contacts from which a problem was made.

    Attributes
    ----------
    W : ndarray, shape (d k + p, d k + p)
        Velocities by impulses, d = 1 + t rows per contact: its normal, then its tangents; in 1/kg. Equations are last.
    friction : ndarray, shape (k,)
    velocities : ndarray, shape (k, d)
        Without the impulses, in m/s.
    edges : ndarray, shape (m, t)
        Edges of the pyramids, in coordinates of the tangents.
    closing : ndarray, shape (k,)
        Normal velocities that close the gaps within the step, in m/s.
    bodies : Bodies or None
        The mass matrix, normals and tangents, if W was built from them.
    equations : ndarray, shape (p,)
        Velocities of the equations without the impulses.
    """

    W: FloatArray = field(repr=False)
    friction: FloatArray
    velocities: FloatArray = field(repr=False)
    edges: FloatArray = field(repr=False)
    closing: FloatArray = field(repr=False)
    bodies: Bodies | None = field(default=None, repr=False)
    equations: FloatArray = field(default_factory=lambda: np.zeros(0), repr=False)

    @property
    def arrays(self) -> tuple[FloatArray, FloatArray]:
        """M, shape (n, n), and q, shape (n,), n = k (m + 2) + p."""
        (m, t), k, p = self.edges.shape, self.friction.size, self.equations.size
        each = np.vstack([np.eye(1, 1 + t), np.column_stack([np.zeros(m), self.edges])])
        # contact by contact; normals come first in M
        order = np.argsort(np.arange(k * (1 + m)) % (1 + m) > 0, kind="stable")

        def by_edges(x: FloatArray) -> FloatArray:
            """Return rows of normals and edges in place of normals and tangents."""
            of_contacts = each @ x[: len(x) - p].reshape(k, 1 + t, x.shape[1])
            rows = of_contacts.reshape(order.size, x.shape[1])
            return np.concatenate([rows[order], x[len(x) - p :]])

        moving = self.velocities.copy()
        moving[:, 0] += self.closing
        n = k * (m + 2) + p
        M, q, columns = np.zeros((n, n)), np.zeros(n), np.r_[: order.size, n - p : n]
        M[np.ix_(columns, columns)] = by_edges(by_edges(self.W).T).T
        q[columns] = by_edges(np.append(moving, self.equations)[:, np.newaxis])[:, 0]
        contact, edge = np.arange(k), np.arange(k, k * (1 + m))
        steepest = order.size + (edge - k) // m
        M[edge, steepest], M[steepest, edge] = 1.0, -1.0
        M[order.size + contact, contact] = self.friction
        return M, q

    @property
    def lower(self) -> FloatArray:
        """Lower bounds of the unknowns, −∞ of the impulses of equations."""
        count = self.friction.size * (len(self.edges) + 2)
        return np.repeat([0.0, -np.inf], [count, self.equations.size])

    def recover(self, answer: Any) -> ContactMotion:
        """Return the impulses and velocities that an answer of the complementarity problem stands for.

        Parameters
        ----------
        answer : Result or array, shape (n,)
            A Result of ``problem.with_q(q)`` has the velocities that its q stands for.

        Raises
        ------
        InvalidProblem
            For another shape.
        """
        (m, t), k, p = self.edges.shape, self.friction.size, self.equations.size
        n = k * (m + 2) + p
        need = f"z must have shape ({n},), of one result at a time"
        z = real_array(getattr(answer, "z", answer), need)
        if z.shape != (n,):
            raise InvalidProblem(f"{need}, got {z.shape}")
        contacts = np.column_stack([z[:k], z[k : k * (1 + m)].reshape(k, m) @ self.edges])
        impulses = np.append(contacts, z[n - p :])
        b, after = np.append(self.velocities, self.equations), None
        if (
            isinstance(answer, Result)
            and (problem := answer.certificate.problem).origin is not self
        ):
            edges = problem.q[k : k * (1 + m)].reshape(k, m)
            tangential = edges @ np.linalg.pinv(self.edges).T
            contacts = np.column_stack([problem.q[:k] - self.closing, tangential])
            b = np.append(contacts, problem.q[n - p :])
        elif self.bodies is not None:
            after = self.bodies.velocities_after(impulses)
        return motion_of(impulses, self.W @ impulses + b, b, 1 + t, p, after)


def contact_data(
    contacts: object,
    friction: ArrayLike,
    velocities: ArrayLike,
    directions: int = 4,
    *,
    gaps: ArrayLike | None = None,
    time_step: float | None = None,
    equations: int = 0,
) -> Contacts:
    """Return contacts with friction, checked; ``LCP(*data.arrays, lower=data.lower)`` is their problem.

    Parameters
    ----------
    contacts : array, shape (d k, d k), or three arrays (mass matrix, normals, tangents)
        W, symmetric, with d = 1 + t rows per contact: its normal, then its t tangents, t = 1 in the plane and 2 in
        space; in 1/kg. Or the mass matrix, shape (v, v), symmetric positive definite, in kg; normals, shape (k, v), and
        tangents, (k, t, v) or (k, v) in the plane: they map the bodies' velocities to the velocity of the gap,
        positive if it opens, and to the velocities along the tangents. These directions must be orthogonal unit
        vectors; this is checked for translations of free bodies (columns in which the mass matrix is m times the
        identity), and cannot be checked for joints.
    friction : number or array, shape (k,)
        Coefficients μ ≥ 0; a ModelWarning is issued above 5.
    velocities : array, shape (k, d), or (v,) with a mass matrix
        Velocities at the end of the step without contact impulses, in m/s: along normal and tangents of each contact,
        or of the bodies. Restitution is added to normal velocities, for which it takes the shape (k, d).
    directions : int
        Edges of a pyramid in space, even, at least 4; the first along the first tangent. In the plane there are two.
    gaps : number or array, shape (k,), optional
        Distances at the beginning of the step, in m, negative where bodies overlap; with `time_step`. A contact may
        close by gap / time step then, before it presses. It does not matter whether W or a mass matrix is given: add
        nothing to `velocities` yourself.
    time_step : float, optional
        In s, > 0.
    equations : int, or array, shape (p, v), with a mass matrix
        As of :class:`lcp_plugin.FrictionalContact`; then velocities have the shape (d k + p,), or (v,).

    Returns
    -------
    Contacts
        ``data.recover(result)`` returns the motion.

    Raises
    ------
    InvalidProblem
        For negative friction, tangents that are not unit vectors, velocities or other arrays that do not fit, a W that
        is not symmetric, a mass matrix that is not positive definite.

    Examples
    --------
    A block of 2 kg that gravity pulls into the ground and along it for a hundredth of a second; friction holds it at
    μ = 0.5, not at 0.3:

    >>> from lcp_plugin import LCP, solve
    >>> pull = 0.01 * np.array([-9.81, 3.924])
    >>> for friction in (0.5, 0.3):
    ...     problem = LCP.from_contacts((2.0 * np.eye(2), [[1, 0]], [[0, 1]]), friction, pull)
    ...     motion = problem.origin.recover(solve(problem))
    ...     print(motion.normal.round(5), motion.tangential.round(5), motion.slip.round(5), motion.sticks)
    [0.1962] [[-0.07848]] [[0.]] [ True]
    [0.1962] [[-0.05886]] [[0.00981]] [False]

    It falls with 1 m/s, 4 mm above the ground; a step takes 0.01 s. It may lose the 4 mm, so it keeps 0.4 m/s, and the
    ground takes the other 0.6 m/s:

    >>> block = 2.0 * np.eye(2), [[0, 1]], [[1, 0]]  # mass matrix, normals, tangents; its velocities: along, up
    >>> problem = LCP.from_contacts(block, 0.5, [0.0, -1.0], gaps=0.004, time_step=0.01)
    >>> result = solve(problem)
    >>> motion = problem.origin.recover(result)
    >>> motion.normal.round(6), motion.separation.round(6), motion.body_velocities.round(6)
    (array([1.2]), array([-0.4]), array([ 0. , -0.4]))
    """
    need = "velocities must be a finite array of shape (k, d), d = 3 in space and 2 in the plane"
    b, bodies = _array(velocities, need), None
    if is_of_bodies(contacts):
        W, b, bodies, equations = contacts_of_bodies(contacts, b, equations)
        W, d = W.toarray() if sp.issparse(W) else W, bodies.dimension
    else:
        W = _array(contacts, "W must be a finite, symmetric array of shape (d k, d k)")
        check_symmetric(W, "W")
        p = checked_count(equations)
        d = b.shape[1] if b.ndim == 2 else 0
        if p:  # the rows of a contact follow from the number of coefficients
            d = (b.size - p) // max(np.size(friction), 1) if np.ndim(friction) else 0
        if d not in (2, 3) or b.size != len(W) or (b.size - p) % d:
            d = d if d in (2, 3) else 3 if (len(W) - p) % 3 == 0 else 2
            need = f"({len(W) // d}, {d}), one row (normal, tangents) per contact of W"
            need = f"({len(W)},), and friction one number per contact" if p else need
            raise InvalidProblem(
                f"velocities must have shape {need}, got shape "
                f"{b.shape}; the order is LCP.from_contacts(contacts, friction, velocities)"
            )
    b, of_equations = np.split(b.ravel(), [b.size - equations])
    k = b.size // d
    mu, edges = checked_friction(friction, k), _edges(d - 1, directions)
    warn_of_much_friction(mu)
    closing = closing_speeds(gaps, time_step, k)
    return Contacts(W, mu, b.reshape(k, d), edges, closing, bodies, of_equations)


def _is_whole(value: int) -> bool:
    """Return whether the value is an integer and not a bool."""
    return isinstance(value, (int, np.integer)) and not isinstance(value, bool)


def checked_count(equations: int) -> int:
    """Return the number of equations, which are the last rows."""
    if not _is_whole(equations) or equations < 0:
        got = f"an array of shape {np.shape(equations)}" if np.ndim(equations) else repr(equations)
        raise InvalidProblem(
            f"equations must be the number p of equations, the last rows of W, got {got}; rows for the velocities of "
            "bodies belong to (mass matrix, normals, tangents)"
        )
    return int(equations)


def checked_friction(friction: ArrayLike, k: int, need: str = "one a contact") -> FloatArray:
    """Return the coefficients of k contacts, shape (k,), from such an array or a number."""
    need = f"friction must be a number, or an array of shape ({k},): {need}"
    mu = _of_contacts(friction, (k,), need)
    if mu.min(initial=0.0) < 0.0:
        i = int(np.argmax(mu < 0.0))
        raise InvalidProblem(
            f"friction must not be negative, but friction[{i}] = {mu[i]}; give μ ≥ 0, 0 for none"
        )
    return mu


def is_of_bodies(contacts: object) -> bool:
    """Return whether these are (mass matrix, normals, tangents) rather than W."""
    is_list = isinstance(contacts, list) and len(contacts) == 3 and np.ndim(contacts[0]) == 2
    return is_list or isinstance(contacts, tuple)


def closing_speeds(
    gaps: ArrayLike | None, time_step: float | None, k: int, count: int | None = None
) -> FloatArray:
    """Return gaps / time_step, shape (k,), or (count, k) of a batch; 0 without both."""
    shape = (k,) if count is None else (count, k)
    if gaps is None and time_step is None:
        return np.zeros(shape)
    if gaps is None or time_step is None:
        missing = "gaps" if gaps is None else "time_step"
        raise InvalidProblem(f"{missing} is missing; give both gaps, in m, and time_step, in s")
    if not is_number(time_step) or not 0.0 < time_step < np.inf:
        raise InvalidProblem(f"time_step must be a number of seconds > 0, got {time_step!r}")
    batch = "" if count is None else f" or {shape}"
    need = f"gaps must be a number, or a finite array of shape ({k},){batch}: one per contact"
    return _of_contacts(gaps, shape, need) / time_step


def _of_contacts(values: ArrayLike, shape: tuple[int, ...], need: str) -> FloatArray:
    """Return a number per contact from an array of this shape, or of its last axis, or from one number."""
    array = _array(values, need)
    if array.shape not in ((), shape[-1:], shape):
        raise InvalidProblem(f"{need}, got shape {array.shape}")
    return np.broadcast_to(array, shape).copy()


def warn_of_much_friction(friction: FloatArray) -> None:
    """Warn the user if a coefficient is larger than for any material."""
    if not friction.max(initial=0.0) > MOST_FRICTION:
        return
    at = np.unravel_index(int(friction.argmax()), friction.shape)
    warn(
        f"friction{[int(i) for i in at]} = {friction[at]:g} is more than {MOST_FRICTION:g}, which no two materials "
        "have: of soft rubber it is some 2; if it is an angle, give its tangent, if a percentage, divide by 100"
    )


def contacts_of_bodies(
    contacts: Any, velocities: FloatArray, equations: Any
) -> tuple[Any, FloatArray, Bodies, int]:
    """Return W, the velocities of its rows, the bodies, and the number of equations, from (mass, normals, tangents).

    All matrices are dense if the arguments are, and small; otherwise CSR, and the mass matrix is inverted component by
    component. `velocities` has shape (v,), or (k, d) of the contacts, or (d k + p,) of contacts and p equations.
    """
    if len(contacts) != 3:
        raise InvalidProblem(
            f"contacts must be W, or (mass matrix, normals, tangents), got {len(contacts)} arrays"
        )
    mass, normals, tangents = contacts
    shape = np.shape(tangents)
    if np.ndim(mass) < 2:
        raise InvalidProblem(
            f"the mass matrix must be square, got shape {np.shape(mass)}; of masses it is np.diag(masses)"
        )
    if len(shape) == 3:
        tangents = np.reshape(tangents, (-1, shape[2]))
    if np.ndim(equations) < 2:
        if np.ndim(equations) or equations != 0:
            raise InvalidProblem(
                f"equations of bodies must be an array of shape (p, {np.shape(mass)[-1]}), got {equations!r:.60}; "
                "write a single row as [[…]]"
            )
        equations = np.zeros((0, np.shape(mass)[-1]))
    mass = rectangular_matrix(mass, "the mass matrix", None, None)
    check_symmetric(mass, "the mass matrix")
    v = mass.shape[0]
    others = ("normals", normals, v), ("tangents", tangents, None), ("equations", equations, v)
    parts = [mass, *(rectangular_matrix(value, name, None, v) for name, value, v in others)]
    # Velocities of bodies whose dense matrices stay dense
    is_sparse = any(map(sp.issparse, parts)) or v > 300
    mass, normals, tangents, joints = map(sp.csr_array, parts) if is_sparse else parts
    k, p = normals.shape[0], joints.shape[0]
    t = tangents.shape[0] // k if k else shape[1] if len(shape) == 3 else 2
    if t not in (1, 2) or tangents.shape != (t * k, v) or shape[:-2] not in ((), (k,)):
        raise InvalidProblem(
            f"tangents must have shape (k, t, {v}) or (t k, {v}), t = 2 in space and 1 in the plane, the t of a "
            f"contact one after the other, k = {k} as of the normals; got {shape}"
        )
    vstack: Any = partial(sp.vstack, format="csr") if is_sparse else np.vstack
    order = np.column_stack([np.arange(k), k + np.arange(t * k).reshape(k, t)]).ravel()
    J = vstack([normals, tangents])[order]
    _check_directions(J, mass, 1 + t)
    J, inverse = vstack([J, joints]), inverse_by_components(mass)
    W = J @ inverse @ J.T
    velocities, bodies = Bodies(mass, inverse, J, None, 1 + t).moving(velocities, p)
    return 0.5 * (W + W.T), velocities, bodies, p


def inverse_by_components(mass: Any) -> Any:
    """Return the inverse of a symmetric positive definite matrix: a small dense one, or CSR with small components.

    Raises
    ------
    InvalidProblem
        If it is not positive definite.
    """
    if isinstance(mass, np.ndarray):
        return _inverses(mass)
    from scipy.sparse.csgraph import connected_components  # most problems do not need it

    if (mass.diagonal() <= 0.0).any():
        raise InvalidProblem(NOT_DEFINITE)
    component = connected_components(mass, directed=False)[1]
    sizes = np.bincount(component)[component]
    order = np.lexsort((component, sizes))  # rows of a component one after the other
    inverses: list[Any] = [sp.csr_array((0, 0))]
    for size in np.unique(sizes).tolist():
        rows = order[sizes[order] == size]
        part = sp.bsr_array(sp.csr_array(mass)[rows][:, rows], blocksize=(size, size))
        part.data = _inverses(part.data)
        inverses.append(part)
    place = np.argsort(order)
    return sp.block_diag(inverses, format="csr")[place][:, place]


def _inverses(blocks: FloatArray) -> FloatArray:
    """Return the inverses of matrices, (…, v, v); raise InvalidProblem if one is not positive definite."""
    try:
        np.linalg.cholesky(blocks)
    except np.linalg.LinAlgError as error:
        raise InvalidProblem(NOT_DEFINITE) from error
    inverses: Any = np.linalg.inv(blocks)
    return inverses


def _check_directions(J: Any, mass: Any, d: int) -> None:
    """Raise InvalidProblem if rows of J, d per contact, are clearly not unit vectors.

    Columns in which the mass matrix is m times the identity, with zeros elsewhere, are translations of a free body, or
    rotations of a body with three equal moments of inertia. Normal and tangents are linearly independent there for
    translations only: r × n, r × t and r × s lie in a plane. A normal of length 1 there shows a translation.
    """
    (k, v), diagonal = J.shape, mass.diagonal()
    k //= d
    alone = ((mass != 0.0).sum(axis=0) == 1) & (diagonal != 0.0)
    windows = np.arange(max(v - d + 1, 0))[:, None] + np.arange(d)
    is_ball = (diagonal[windows] == diagonal[windows[:, :1]]) & alone[windows]
    windows = windows[is_ball.all(axis=1)]
    if sp.issparse(mass):
        parts = sp.bsr_array(J[:, windows.ravel()], blocksize=(d, d))
        basis, counts = parts.data, np.diff(parts.indptr)
    else:
        basis = J[:, windows].reshape(k, d, len(windows), d).swapaxes(1, 2).reshape(-1, d, d)
        counts = len(windows)
    contact, products = np.repeat(np.arange(k), counts), basis @ np.swapaxes(basis, 1, 2)
    lengths = np.sqrt(np.einsum("kii->ki", products)) + np.finfo(float).tiny
    are = np.linalg.det(products / lengths[:, :, None] / lengths[:, None]) > UNIT_LENGTH
    are |= np.abs(lengths[:, 0] - 1.0) < UNIT_LENGTH
    off = np.abs(products - np.eye(d)).max(axis=(1, 2))[are]
    least = np.full(k, np.inf)
    # one body in whose translations they are unit vectors is enough
    np.minimum.at(least, contact[are], off)
    wrong = np.flatnonzero((least > UNIT_LENGTH) & (least < np.inf))
    if wrong.size:
        c = int(wrong[0])
        raise InvalidProblem(
            f"normals and tangents must be orthogonal unit vectors, but contact {c} has products that differ from 1 or "
            f"0 by {least[c]:.2g}; divide each by its length, or, if the unknowns are not translations, pass J m⁻¹ Jᵀ, "
            "J u"
        )


def _edges(tangents: int, directions: int) -> FloatArray:
    """Return the edges of a pyramid, shape (m, t), as pairs d, −d: the second half is minus the first."""
    if not _is_whole(directions) or directions < 4 or directions % 2:
        raise InvalidProblem(
            f"directions must be an even number ≥ 4, got {directions!r}; leave directions out in the plane"
        )
    if tangents == 1:
        return np.array([[1.0], [-1.0]])
    angle = 2.0 * np.pi / directions * np.arange(directions // 2)
    half = np.column_stack([np.cos(angle), np.sin(angle)])
    half[np.abs(half) < UNIT_LENGTH] = 0.0
    return np.vstack([half, -half])


def _array(values: Any, need: str) -> FloatArray:
    array = real_array(values.toarray() if sp.issparse(values) else values, need).copy()
    checks.require_finite(array, need.split(maxsplit=1)[0])
    return array


@np.errstate(all="ignore")
def check_symmetric(matrix: Any, name: str, tolerance: float = 1e-8) -> None:
    """Raise InvalidProblem if max |m_ij − m_ji| exceeds `tolerance` times the largest entry."""
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1]:
        raise InvalidProblem(
            f"{name} must be square, got shape {matrix.shape}; of masses it is np.diag(masses)"
        )
    if not matrix.size:
        return
    difference, largest = abs(matrix - matrix.T).max(), abs(matrix).max()
    if difference > tolerance * largest:
        raise InvalidProblem(
            f"{name} must be symmetric, but entries differ by {difference:.2g}; is it J m⁻¹ Jᵀ, the same J twice?"
        )
