"""QuantEcon: ``lemke`` of this module takes the place of ``quantecon.optimize.lcp_lemke``."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..auto import solve_lcp
from ..core.checks import FloatVector, checked_vector
from ..core.errors import InvalidOption, InvalidProblem
from ..core.lcp import LCP
from ..methods.lemke import lemke_path

STATUS = {"solved": 0, "limit": 1, "ray": 2, "rounding": 3}


class LCPResult(NamedTuple):
    """What `lemke` found, with the fields of ``quantecon.optimize.lcp_lemke.LCPResult``."""

    z: FloatVector
    success: bool
    status: int
    num_iter: int


def lemke(
    M: ArrayLike,
    q: ArrayLike,
    d: ArrayLike | None = None,
    max_iter: int = 10**6,
    piv_options: Any = None,
    tableau: Any = None,
    basis: Any = None,
    z: Any = None,
) -> LCPResult:
    """Return the end of Lemke's path along w = M z + q + t d: z ≥ 0, w = M z + q ≥ 0, zᵀw = 0.

    The same parameters, result and path as ``quantecon.optimize.lcp_lemke``; where a tie leaves a choice, the path may
    be another one, and where rounding ends it other starts are tried. On a ray it ends as that does:
    :func:`lcp_plugin.solve` goes on, and takes bounds and a sparse M.

    Parameters
    ----------
    M : array or sparse array, shape (n, n)
    q : array, shape (n,)
    d : array, shape (n,), optional
        The covering vector, positive; 1 by default.
    max_iter : int
        Pivots at most, the first one included, which brings t in.
    piv_options, tableau, basis : object, optional
        Taken and left alone: the tolerances are those of an equilibrated problem, and the tableau is our own.
    z : array of float, shape (n,), optional
        Where to write z, too.

    Returns
    -------
    LCPResult
        z, success, status and num_iter. status 0: solved, and the relative residual of z on your data is at most
        1e-10, or at the level of rounding; 1: `max_iter` pivots; 2: a secondary ray (for a positive semidefinite M
        there is no solution then); 3, which QuantEcon has not: rounding has ended every path.

    Raises
    ------
    InvalidProblem
        Where M and q state no problem.
    InvalidOption
        Where d is no positive vector of length n, z cannot be written to, or `max_iter` is no whole number ≥ 0.

    Notes
    -----
    On random problems of nine classes, n = 2 to 60, both end with the same status, z and number of pivots but where
    rounding decides. A call takes about a millisecond at n = 10, most of it to check z; QuantEcon, which checks
    nothing, takes a fiftieth. Many small problems: :func:`lcp_plugin.solve_batch`.

    Examples
    --------
    >>> from lcp_plugin.interfaces.quantecon import lemke as lcp_lemke
    >>> lcp_lemke([[1, 0, 0], [2, 1, 0], [2, 2, 1]], [-8, -12, -14])
    LCPResult(z=array([8., 0., 0.]), success=True, status=0, num_iter=8)
    """
    problem = LCP(M, q)
    covering = _covering(d, problem.n)
    if isinstance(max_iter, bool) or not isinstance(max_iter, (int, np.integer)) or max_iter < 0:
        raise InvalidOption(f"max_iter must be a whole number ≥ 0, got {max_iter!r}")
    if z is not None and not (
        isinstance(z, np.ndarray) and z.shape == (problem.n,) and z.flags.writeable
    ):
        raise InvalidOption(
            f"z must be a writable array of shape ({problem.n},), got {type(z).__name__}"
        )
    if not (problem.q < 0.0).any():
        found, end, pivots = np.zeros(problem.n), "solved", 0
    else:
        found, end, pivots = lemke_path(problem, covering, max(int(max_iter), 1))
    if end == "rounding":
        result = solve_lcp(problem, "lemke", tolerance=1e-10, prove_infeasibility=False)
        if result.is_solved:
            found, end = result.z.copy(), "solved"
    if z is not None:
        z[:] = found
        found = z
    return LCPResult(found, end == "solved", STATUS[end], pivots)


def _covering(d: ArrayLike | None, n: int) -> FloatVector:
    if d is None:
        return np.ones(n)
    try:
        covering = checked_vector(d, "d", n)
    except InvalidProblem as error:
        raise InvalidOption(str(error)) from error
    if not (covering > 0.0).all():
        i = int(np.flatnonzero(~(covering > 0.0))[0])
        raise InvalidOption(
            f"d must be positive to cover every row, but d[{i}] = {covering[i]}; leave it out for 1"
        )
    return covering
