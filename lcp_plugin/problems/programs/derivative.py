"""Derivative of the solution of a quadratic program or of bounded least squares, by the LCP of its conditions.

With z = (x, inequality, equality), the conditions of ``min ½ xᵀP x + cᵀx, G x ≤ h, A x = b`` are the LCP of
:func:`~lcp_plugin.problems.programs.conversion.conditions`. A change of the data changes its q by

    (dP x + dc + dGᵀ inequality + dAᵀ equality, dh − dG x, db − dA x),

and the transposed map turns the gradient by q into the gradients by P, c, G, h, A and b. Least squares have the
gradient AᵀW(A x − b) + ridge x ± l1, where the sign is the sign of x_j; a row with a penalty ends at 0.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from typing import Any, NamedTuple, Self

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from ...core import checks
from ...core.checks import AnyMatrix, Array, Vector
from ...core.errors import InvalidOption, InvalidProblem, UnsuitableProblem
from ...core.lcp import LCP
from ...systems.free_systems import matvecs
from ...systems.graph import sum_of_outer
from ..least_squares.data import BoundedLeastSquares
from .conversion import condition_vectors, conditions
from .program import VECTORS, QuadraticProgram


class ProgramGradient(NamedTuple):
    """Gradient of a function of x with respect to the data of a program.

    Attributes
    ----------
    P, G, A : array, shapes (n, n), (m, n) and (p, n), or csr_array
        P symmetric; on the sparsity pattern of a sparse matrix. With an axis in front for a batch, or the sum over
        the batch if all its programs share the matrices.
    c, h, b, lower, upper : array, shapes (n,), (m,), (p,), (n,) and (n,), or (B, …)
        0 for inactive rows and bounds.
    """

    P: Array
    c: Vector
    G: Array
    h: Vector
    A: Array
    b: Vector
    lower: Vector
    upper: Vector


class LeastSquaresGradient(NamedTuple):
    """Gradient of a function of x with respect to the data of a least squares problem.

    Attributes
    ----------
    A : array, shape (m, n), or csr_array on its pattern
        With an axis in front for a batch, or the sum over the batch if all its problems share A.
    b, lower, upper, l1, weights, ridge : array, shapes (m,), (n,), (n,), (n,), (m,) and (), or (B, …)
    """

    A: Array
    b: Vector
    lower: Vector
    upper: Vector
    l1: Vector
    weights: Vector
    ridge: Any


def multiply(matrix: AnyMatrix, x: Vector, *, transposed: bool = False) -> Vector:
    """Return the product with x, or with each row of x; the matrix may have an axis in front."""
    if matrix.ndim == 3:
        return np.asarray(matvecs(matrix.swapaxes(1, 2) if transposed else matrix, x))
    matrix = matrix.T if transposed else matrix
    return np.asarray(matrix @ x if x.ndim == 1 else (matrix @ x.T).T)


def outer_products(matrix: AnyMatrix, *pairs: tuple[Vector, Vector]) -> Any:
    """Return Σ left_i right_j over the pairs, in the format of the matrix; one matrix for many rows gets their sum."""
    if matrix.ndim == 3:
        return sum(left[:, :, np.newaxis] * right[:, np.newaxis] for left, right in pairs)
    left, right = (np.concatenate([*map(np.atleast_2d, part)]) for part in zip(*pairs, strict=True))
    return sum_of_outer(matrix, left, right) if sp.issparse(matrix) else left.T @ right


class ProgramArrays:
    """Data of a program, or of a batch with an axis in front, and their map to the data of the LCP.

    Parameters
    ----------
    program : QuadraticProgram
        The program, or a program of the shape of all.
    data : dict
        P, G, A, c, h, b, lower and upper, in this order.
    """

    def __init__(self, program: QuadraticProgram, data: dict[str, Any]) -> None:
        self.program, self.data, self.ends = program, data, (program.n, program.n + program.h.size)
        self.shapes = {name: getattr(program, name).shape for name in data}

    def problem(self, stack: Callable[..., Any]) -> Any:
        """Return the conditions as an LCP, or by `stack` as a batch of LCPs."""
        M: Array = conditions(self.program)
        vectors = [self.data[name] for name in VECTORS]
        if vectors[0].ndim == 1:
            return M
        if self.data["P"].ndim == 3:
            P, G, A = (self.data[name] for name in "PGA")
            C = np.concatenate([G, A], axis=1)
            none = np.zeros((len(P), C.shape[1], C.shape[1]))
            M = np.block([[P, C.swapaxes(1, 2)], [-C, none]])
        return stack(M, *condition_vectors(*vectors))

    def change_of_q(self, z: Vector, d: dict[str, Any]) -> Vector:
        """Return the change of q for changes of the data."""
        x, inequality, equality = np.split(z, self.ends, axis=-1)
        dq = [
            np.zeros(z.shape)[..., : part.shape[-1]] + d.get(name, 0.0)
            for part, name in ((x, "c"), (inequality, "h"), (equality, "b"))
        ]
        if "P" in d:
            dq[0] += 0.5 * (multiply(d["P"], x) + multiply(d["P"], x, transposed=True))
        for k, name, multipliers in ((1, "G", inequality), (2, "A", equality)):
            if name in d:
                dq[0] += multiply(d[name], multipliers, transposed=True)
                dq[k] -= multiply(d[name], x)
        return np.concatenate(dq, axis=-1)

    def gradient(self, z: Vector, by_q: Vector, lower: Vector, upper: Vector) -> ProgramGradient:
        """Return the gradients by the data, from the gradients by q and the bounds."""
        x, inequality, equality = np.split(z, self.ends, axis=-1)
        c, h, b = np.split(by_q, self.ends, axis=-1)
        P = outer_products(self.data["P"], (0.5 * c, x), (0.5 * x, c))
        G = outer_products(self.data["G"], (inequality, c), (-h, x))
        A = outer_products(self.data["A"], (equality, c), (-b, x))
        n = self.ends[0]
        return ProgramGradient(P, c, G, h, A, b, lower[..., :n], upper[..., :n])

    def has_own_bound(self, side: str) -> Any:
        """Return the mask of the unknowns whose bound of the LCP is a bound of the data: all."""
        return True

    def name_of(self, k: int, side: str = "") -> str:
        """Return the name of an unknown of the LCP: of a bound, of x_k, or of the row of a multiplier."""
        m, p, n, _ = self.program.matrices.sizes
        if k >= n:
            return self.program.name(k - n)
        if side:
            return self.program.name(m + p + k + (n if side == "upper" else 0))
        return self.program.names.unknown(k, "x[{}]")


class LeastSquaresData:
    """Data of bounded least squares, or of a batch that shares A, weights and ridge, and their map to the LCP.

    Parameters
    ----------
    data : dict
        A, b, lower, upper, l1, weights and ridge, in this order.
    x : array, shape (n,) or (B, n)
        The solution, which determines the signs of the penalties.
    """

    def __init__(self, data: dict[str, Any], x: Vector) -> None:
        self.data, self.ends = data, data["A"].shape[-1:]
        self.shapes = {name: np.shape(data[name])[-1:] for name in data}
        self.shapes["A"] = data["A"].shape
        weighted = data["weights"] * self._residual(x)
        slope = multiply(data["A"], weighted, transposed=True) + data["ridge"] * x
        lower, upper = data["lower"], data["upper"]
        has_sides = (lower < 0.0) & (upper > 0.0)
        self.has_kink = (data["l1"] > 0.0) & has_sides
        is_negative = self.has_kink & ((x < 0.0) | ((x == 0.0) & (slope > 0.0)))
        of_bound = np.where(is_negative | (upper <= 0.0), -1.0, 1.0)
        self.sign = np.where(has_sides & ~self.has_kink, np.sign(x), of_bound)
        self.lower = np.where(self.has_kink & ~is_negative, 0.0, lower)
        self.upper = np.where(is_negative, 0.0, upper)

    def _residual(self, x: Vector) -> Vector:
        """Return A x − b."""
        return np.asarray(multiply(self.data["A"], x) - self.data["b"])

    def problem(self, stack: Callable[..., Any]) -> Any:
        """Return the conditions as an LCP, or by `stack` as a batch of LCPs."""
        A, weights, n = self.data["A"], self.data["weights"], self.ends[0]
        ridge = self.data["ridge"] * (sp.eye_array(n) if sp.issparse(A) else np.eye(n))
        M = (A.T @ sp.diags_array(weights) if sp.issparse(A) else A.T * weights) @ A + ridge
        q = self.data["l1"] * self.sign - multiply(A, weights * self.data["b"], transposed=True)
        if q.ndim == 1:
            return LCP(M, q, lower=self.lower, upper=self.upper)
        return stack(M, q, self.lower, self.upper)

    def change_of_q(self, x: Vector, d: dict[str, Any]) -> Vector:
        """Return the change of q for changes of the data."""
        A, weights, residual = self.data["A"], self.data["weights"], self._residual(x)
        of_residual = -np.asarray(d.get("b", 0.0)) + (multiply(d["A"], x) if "A" in d else 0.0)
        of_weighted = weights * of_residual + d.get("weights", 0.0) * residual
        if np.any((self.sign == 0.0) & (d.get("l1", 0.0) != 0.0)):
            raise UnsuitableProblem("x has a kink by l1 where l1 = 0 and x = 0; leave dl1 0 there")
        dq = multiply(A, of_weighted, transposed=True) + self.sign * d.get("l1", 0.0)
        dq += np.asarray(d.get("ridge", 0.0))[..., np.newaxis] * x
        return dq + multiply(d["A"], weights * residual, transposed=True) if "A" in d else dq

    def gradient(
        self, x: Vector, by_q: Vector, lower: Vector, upper: Vector
    ) -> LeastSquaresGradient:
        """Return the gradients by the data, from the gradients by q and the bounds."""
        A, weights, residual = self.data["A"], self.data["weights"], self._residual(x)
        product = multiply(A, by_q)
        return LeastSquaresGradient(
            A=outer_products(A, (weights * residual, by_q), (weights * product, x)),
            b=-weights * product,
            lower=np.where(self.has_own_bound("lower"), lower, 0.0),
            upper=np.where(self.has_own_bound("upper"), upper, 0.0),
            l1=self.sign * by_q,
            weights=product * residual,
            ridge=(by_q * x).sum(axis=-1),
        )

    def has_own_bound(self, side: str) -> Any:
        """Return the mask of the unknowns whose bound of the LCP is a bound of the data, and not the 0 of a penalty."""
        return getattr(self, side) == self.data[side]

    def name_of(self, k: int, side: str = "") -> str:
        """Return the name of a bound, of a penalty that holds x_k at 0, or of x_k."""
        is_penalty = bool(side) and bool(np.any(self.has_kink[..., k]))
        return f"l1[{k}]" if is_penalty else f"{side or 'x'}[{k}]"


class ProgramDerivative:
    """The derivative of the solution of a QuadraticProgram, or BoundedLeastSquares, or of a batch of these.

    Parameters
    ----------
    data : ProgramArrays or LeastSquaresData
    conditions : ConditionsDerivative or ConditionsBatchDerivative
        The derivative of the LCP of the conditions.

    Notes
    -----
    The data are P, c, G, h, A, b, lower and upper of a program, and A, b, lower, upper, l1, weights and ridge of least
    squares. Only the symmetric part of a change of P matters. If x or the multipliers of the active rows are not
    unique, or if a part of the program is active with multiplier 0, no gradient exists: `vjp` raises UnsuitableProblem,
    which names this part, and so does `jvp` in directions in which x has a kink. In a batch these problems have NaN,
    and an entry in `errors`. For multipliers, differentiate the LCP: ``derivative(solve(LCP.from_qp(…)))``.

    Examples
    --------
    The point of x₀ + x₁ ≤ 2 nearest to (1, 2), and its changes with h and with the point:

    >>> from lcp_plugin import QuadraticProgram, derivative, solve
    >>> dx = derivative(solve(QuadraticProgram(np.eye(2), [-1, -2], G=[[1, 1]], h=[2])))
    >>> dx.jvp(dh=[1.0]), dx.jvp(dc=[-1.0, 0.0])
    (array([0.5, 0.5]), array([ 0.5, -0.5]))
    >>> gradient = dx.vjp([1.0, 0.0])
    >>> gradient.h, gradient.G
    (array([0.5]), array([[-0.5, -0.5]]))
    """

    def __init__(self, data: Any, conditions: Any) -> None:
        self.data, self.conditions = data, conditions

    def one_sided(self) -> Self:
        """Return the derivative that accepts degenerate parts.

        There `jvp` is one-sided, and `vjp` the gradient of one of the pieces that meet, as of a ReLU at 0.
        """
        derivative = copy(self)
        derivative.conditions = self.conditions.one_sided()
        return derivative

    @property
    def errors(self) -> dict[int, Any]:
        """Error of each problem of a batch without a derivative; calls of `jvp` and `vjp` add theirs."""
        errors: dict[int, Any] = getattr(self.conditions, "errors", {})
        return errors

    @property
    def z(self) -> Vector:
        """The solution x at which the derivative is evaluated, shape (n,) or (B, n)."""
        return np.asarray(self.conditions.z[..., : self.data.ends[0]])

    @property
    def degenerate(self) -> Any:
        """Parts that are active with multiplier 0: their names, or of a batch a mask of x and the rows."""
        return self.conditions.degenerate_parts

    @property
    def is_unique(self) -> Any:
        """Whether the derivative exists, bool, or of a batch an array of bool, shape (B,)."""
        return self.conditions.is_unique

    def jvp(self, *unnamed: Any, **changes: Any) -> Vector:
        """Return the change dx for changes of the data.

        Parameters
        ----------
        **changes
            dP, dc, dG, dh, dA, db, dlower, dupper of a program; dA, db, dlower, dupper, dl1, dweights, dridge of
            least squares. Shapes as the data, in a batch also with an axis in front. dlower and dupper may be numbers.

        Returns
        -------
        array, shape (n,) or (B, n)

        Raises
        ------
        InvalidOption
            For another name.
        InvalidProblem
            For another shape, or numbers that are not finite.
        UnsuitableProblem
            If no derivative exists; the message names the part of the program.
        """
        if changes.keys() & {"dlower_rows", "dupper_rows"}:
            raise InvalidOption(
                "the derivative is by the rows G x ≤ h and A x = b of the program; from_ranges makes h of the upper "
                "bounds, then of the negative lower ones, and b of equal bounds: pass dh, db, dG, dA"
            )
        checks.require_known_changes(unnamed, changes, [f"d{name}" for name in self.data.shapes])
        arrays = {
            name[1:]: self._checked(name, values)
            for name, values in changes.items()
            if values is not None
        }
        named = {"dq": self.data.change_of_q(self.conditions.z, arrays)}
        for side in arrays.keys() & {"lower", "upper"}:
            bounds = np.where(self.data.has_own_bound(side), arrays[side], 0.0)
            named[f"d{side}"] = self._with_multipliers(bounds)
        return np.asarray(self.conditions.jvp(**named)[..., : self.data.ends[0]])

    def vjp(self, g: ArrayLike) -> Any:
        """Return the gradients of a function L(x) by the data.

        Parameters
        ----------
        g : array, shape (n,), or (B, n) for a batch
            ∂L/∂x.

        Returns
        -------
        ProgramGradient or LeastSquaresGradient

        Raises
        ------
        InvalidProblem, UnsuitableProblem
            As `jvp`.
        """
        g = self._checked("g", g, self.data.ends[:1])
        gradients = self.conditions.vjp(self._with_multipliers(g))
        q, z = np.asarray(gradients.q), np.asarray(self.conditions.z)
        z = np.where(q.any(axis=-1, keepdims=True), z, 0.0)
        return self.data.gradient(z, q, gradients.lower, gradients.upper)

    def _with_multipliers(self, of_x: Array) -> Any:
        """Return vectors of the unknowns of the LCP: these for x, and zeros for the multipliers."""
        vectors, n = np.zeros(self.conditions.z.shape), self.data.ends[0]
        vectors[..., :n] = of_x
        return vectors

    def _checked(self, name: str, values: Array, shape: tuple[int, ...] | None = None) -> Any:
        """Return the finite change of an array, in its shape, or with the axis of a batch in front."""
        shape = self.data.shapes[name[1:]] if shape is None else shape
        if sp.issparse(values) and len(shape) == 2:
            return checks.rectangular_matrix(values, name, *shape)
        shapes = [shape, *[(*self.conditions.z.shape[:-1], *shape)][: self.conditions.z.ndim - 1]]
        need = f"{name} must have shape {' or '.join(map(str, shapes))}"
        array = checks.real_array(values, need)
        if array.shape not in (*shapes, () if name in ("dlower", "dupper", "dl1") else shape):
            raise InvalidProblem(f"{need}, got shape {array.shape}")
        checks.require_finite(array, name)
        return array


def program_data(program: QuadraticProgram) -> ProgramArrays:
    """Return the data of a single program."""
    return ProgramArrays(program, {name: getattr(program, name) for name in (*"PGA", *VECTORS)})


def least_squares_data(problem: BoundedLeastSquares, x: Vector) -> LeastSquaresData:
    """Return the data of one least squares problem, or of a stack that shares A."""
    weights = problem.weights if problem.weights is not None else np.ones(problem.shape[0])
    data = {name: getattr(problem, name) for name in ("A", "b", "lower", "upper", "l1")}
    return LeastSquaresData(data | {"weights": weights, "ridge": problem.ridge}, x)
