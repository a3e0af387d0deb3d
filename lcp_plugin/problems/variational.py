"""Variational inequalities over polyhedra, as complementarity problems with multipliers."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from ..core.checks import AnyMatrix, Vector
from ..core.errors import InvalidProblem
from ..core.lcp import LCP
from ..core.names import Names
from ..core.problem_classes import foreign_function
from .nonlinear.data import NonlinearProblem
from .programs.conversion import QPOrigin, conditions
from .programs.program import VECTORS, QuadraticProgram
from .programs.program_matrices import ProgramMatrices


def variational(
    F: Any,
    G: AnyMatrix = None,
    h: ArrayLike | None = None,
    A: AnyMatrix = None,
    b: ArrayLike | None = None,
    lower: ArrayLike = -np.inf,
    upper: ArrayLike = np.inf,
    *,
    over: Any = None,
    constraints: Any = (),
) -> Any:
    """Return the problem of x in K with F(x)ᵀ(y − x) ≥ 0 for all y in K = {G y ≤ h, A y = b, lower ≤ y ≤ upper}.

    In cvxpy, ``variational(F, over=[x], constraints=[…])`` is a constraint next to pairs and agents.

    Parameters
    ----------
    F : (M, q), (function, jacobian), function, or cvxpy expression
        F(x) = M x + q with arrays of shapes (n, n) and (n,); or a function that returns shape (n,), with a function
        for F′(x), shape (n, n), dense or sparse. Without it F′ is computed by differences.
    G, h : arrays, shapes (m, n) and (m,), optional
    A, b : arrays, shapes (p, n) and (p,), optional
    lower, upper : number or array, shape (n,)
        Bounds of x; none by default.
    over : list of cvxpy variables, or of their entries
        The unknowns x of a cvxpy expression F, in the order of the entries of F.
    constraints : list of cvxpy constraints
        Affine or convex in x. Other variables and parameters count as data of K, also variables that depend on x: so a
        quasi-variational inequality, whose K moves with x, is stated by a copy of x and the equation copy == x.

    Returns
    -------
    LCP, NonlinearProblem or cvxpy constraint
        The conditions of x with multipliers of the rows. ``problem.origin.recover(result)`` is the result of the
        linear program min F(x)ᵀy over K at y = x, SOLVED as the problem is: `x`, and `solution` with the multipliers
        of all rows and ``gap()``, the maximum of F(x)ᵀ(x − y) over K. The status is INFEASIBLE with a Farkas
        certificate if K is empty. The cvxpy constraint has ``dual_value`` and ``gap()`` as
        :func:`lcp_plugin.optimal`.

    Raises
    ------
    InvalidProblem
        If the data define no such problem.

    Examples
    --------
    >>> from lcp_plugin import solve
    >>> problem = variational(([[2, 1], [-1, 2]], [-8, -6]), G=[[1, 1]], h=[3], lower=0)
    >>> solution = problem.origin.recover(solve(problem)).solution
    >>> solution.x.round(6), solution.inequality.round(6), round(solution.gap(), 9)
    (array([1.25, 1.75]), array([3.75]), 0.0)
    """
    function = F[0] if isinstance(F, (list, tuple)) and F else F
    if (stated := foreign_function("variational", function)) is not None:
        has_bounds = np.isfinite(lower).any() or np.isfinite(upper).any()
        if has_bounds or any(data is not None for data in (G, h, A, b)):
            raise InvalidProblem(
                "F is an expression of cvxpy; write its set as constraints=[G @ x <= h, x >= lower, …]"
            )
        return stated(F, over, constraints)
    if over is not None or constraints:
        raise InvalidProblem(
            f"over and constraints belong to a cvxpy expression F, got F of type {type(F).__name__}; write "
            "variational(F, G=…, h=…, A=…, b=…)"
        )
    first, second = F if isinstance(F, (tuple, list)) and len(F) == 2 else (F, None)
    rows = G, h, A, b, lower, upper
    if not callable(first):
        if second is None:
            raise InvalidProblem(
                f"F must be (M, q), (function, jacobian) or a function, got {type(F).__name__}; for F(x) = M x + q "
                "write variational((M, q), …)"
            )
        pair = LCP(first, second)
        origin = QPOrigin(QuadraticProgram(None, np.zeros(pair.n), *rows), F=pair.slack)
        matrices = ProgramMatrices(pair.M, origin.reduced.G, origin.reduced.A)
        vectors = (getattr(origin.reduced, name) for name in VECTORS[1:])
        program = QuadraticProgram.with_matrices(matrices, pair.q, *vectors)
        return conditions(program, Names(origin.row_name)).with_origin(origin)
    sizes = [np.shape(array)[-1] for array in (lower, upper, G, A) if np.ndim(array)]
    if not sizes:
        raise InvalidProblem(
            "the number of unknowns is not known; pass a bound as an array, lower=np.full(n, -np.inf)"
        )
    return _nonlinear(first, second, QuadraticProgram(None, np.zeros(sizes[0]), *rows))


def _nonlinear(F: Any, jacobian: Any, program: QuadraticProgram) -> NonlinearProblem:
    """Return the conditions of a function F, with multipliers of the rows that are not bounds."""
    n, inside = program.n, NonlinearProblem(F, jacobian, program.lower, program.upper)
    origin = QPOrigin(program, F=inside.value)
    C, linear = origin.reduced.matrices.terms.rows, conditions(origin.reduced)

    def value(z: Vector) -> Vector:
        w = linear.slack(z)
        w[:n] += inside.value(z[:n])
        return w

    def slopes(z: Vector) -> Any:
        slope, _ = inside.call_jacobian(z[:n], None)
        if np.shape(slope) != (n, n):
            inside.derivative(z[:n])  # raises
        return sp.block_array([[slope, C.T], [-C, None]], format="csr") if C.shape[0] else slope

    bounds, names = (linear.lower, linear.upper), Names(origin.row_name)
    problem = NonlinearProblem(value, slopes, *bounds, names=names)
    problem.origin, problem.affine_part = origin, lambda: program
    return problem
