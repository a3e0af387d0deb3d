"""Conversions and files of an LCP: the functions behind ``LCP.from_qp``, ``LCP.load``, ``problem.save``."""

from __future__ import annotations

from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .core.checks import AnyMatrix
from .core.errors import InvalidOption
from .core.files import checked_path, save_lcp
from .core.lcp import LCP
from .interfaces.nl.writing import write_nl
from .interfaces.program_files import load_lcp
from .problems.contact import contact_data
from .problems.programs.conversion import lcp_from_qp
from .problems.programs.program import QuadraticProgram


def save(problem: LCP, path: str | PathLike[str]) -> None:
    """Write the problem to ``path``, a ``.npz`` or ``.nl`` file; the file appears whole or not at all.

    A path ending in ``.npz`` gets the keys data, indices, indptr, shape (M as CSR), q, lower, upper; a path ending
    in ``.nl`` gets a file for AMPL's solvers.

    Parameters
    ----------
    problem : LCP
    path : str or PathLike

    Raises
    ------
    UnreadableFile
        If it cannot be written, or its name belongs to another format, as a.mat.
    """
    target = checked_path(path)
    if target.suffix.lower() == ".nl":
        write_nl(problem, target)
    else:
        save_lcp(problem, target)


def from_qp(
    P: AnyMatrix,
    c: ArrayLike | None = None,
    G: AnyMatrix = None,
    h: ArrayLike | None = None,
    A: AnyMatrix = None,
    b: ArrayLike | None = None,
    lower: ArrayLike = -np.inf,
    upper: ArrayLike = np.inf,
) -> LCP:
    """Return the LCP of min ½ xᵀP x + cᵀx over G x ≤ h, A x = b, lower ≤ x ≤ upper.

    To compute only x, use ``solve(QuadraticProgram(P, c, …))``, which is faster. For a result of this LCP,
    ``problem.origin.recover(result)`` returns the result of the program, tested on the program. ``solve`` tests this
    LCP as any other: z may be SOLVED, and x, of which the gap is large, not.
    Errors: :func:`lcp_plugin.problems.programs.conversion.lcp_from_qp`.

    Parameters
    ----------
    P : array or sparse array, shape (n, n), or a QuadraticProgram, which needs no other argument
        Symmetric, positive semidefinite up to rounding: UnsupportedModel where it clearly is not.
    c : array, shape (n,)
    G, h : shapes (p, n) and (p,), optional
        Inequalities G x ≤ h.
    A, b : shapes (m, n) and (m,), optional
        Equations A x = b.
    lower, upper : scalar or array, shape (n,)
        Bounds of x; none by default.

    Raises
    ------
    InvalidOption
        If other data are given in addition to a QuadraticProgram.
    """
    if not isinstance(P, QuadraticProgram):
        return lcp_from_qp(QuadraticProgram(P, c, G, h, A, b, lower, upper))  # type: ignore[arg-type]
    others = [data for data in (c, G, h, A, b) if data is not None]
    if others or not (np.array_equal(lower, -np.inf) and np.array_equal(upper, np.inf)):
        raise InvalidOption("a QuadraticProgram has all data; call LCP.from_qp(program) alone")
    return lcp_from_qp(P)


def from_contacts(
    contacts: AnyMatrix,
    friction: ArrayLike,
    velocities: ArrayLike,
    directions: int = 4,
    *,
    gaps: ArrayLike | None = None,
    time_step: float | None = None,
    equations: object = 0,
) -> LCP:
    """Return the LCP of rigid bodies in contact with friction; ``origin.recover(result)`` has impulses and slip.

    See :func:`lcp_plugin.problems.contact.contact_data` for shapes, units and errors.
    :class:`lcp_plugin.FrictionalContact` uses the exact friction cone instead of a pyramid.

    Parameters
    ----------
    contacts : array W, shape (d k, d k), or (mass matrix, normals, tangents)
    friction : number or array, shape (k,)
    velocities : array, shape (k, d), or (v,) with a mass matrix
        Without the impulses.
    directions : int
        Edges of each friction pyramid.
    gaps : number or array, shape (k,), optional
        Distances at the beginning of the step, in m. Add none to `velocities`.
    time_step : float, optional
        Length of the step in s, required with `gaps`: a contact may close by gap / time step.
    equations : int, or array, shape (p, v), with a mass matrix
        Hinges, motors, loops, as of :class:`lcp_plugin.FrictionalContact`.

    Raises
    ------
    InvalidProblem
        As `contact_data`.
    """
    options: Any = {"gaps": gaps, "time_step": time_step, "equations": equations}
    contact_problem = contact_data(contacts, friction, velocities, directions, **options)
    return LCP(*contact_problem.arrays, lower=contact_problem.lower).with_origin(contact_problem)


def load(path: str | PathLike[str]) -> LCP:
    """Return a problem written by :meth:`save` or ``numpy.savez(path, M=M, q=q)``, or in Matrix Market files.

    A ``.npz`` file holds q and M (dense), or M's CSR arrays as data, indices, indptr, shape; lower and upper where
    they are not 0 and ∞. A ``.mtx`` file holds M; q.mtx is next to it, and lower.mtx and upper.mtx if wanted. A bound
    of 1e20 or more in absolute value means ∞. Pickled content is never read. For MATLAB's files call
    ``scipy.io.loadmat``. For other models in AMPL's ``.nl`` format use :func:`lcp_plugin.interfaces.nl.read_nl`.

    Parameters
    ----------
    path : str or PathLike

    Raises
    ------
    UnreadableFile
        If the file is missing, corrupt, or not a linear complementarity problem.
    UnsupportedModel
        If a ``.nl`` file contains another model.
    """
    return load_lcp(path)
