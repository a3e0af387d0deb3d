"""cvxpylayers: quadratic programs as layers, solved and differentiated here: ``CvxpyLayer(…, solver=LCPSolver())``.

cvxpylayers 1.2 hands a solver of its own the numbers of min ½ xᵀP x + qᵀx, A x + b in a product of cones, and wants
x and the multipliers, then the gradients by these numbers; where they stand, it says once, to ``setup``. Cones other
than the equations and inequalities of a program are refused there. It does so in PyTorch; its layers for JAX call no
solver but its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
import scipy.sparse as sp

try:
    from cvxpylayers.interfaces.base import SolverInterface
except ImportError:
    raise ImportError(
        "lcp_plugin.interfaces.cvxpylayers needs cvxpylayers from 1.2 on; install it with: "
        "pip install 'cvxpylayers>=1.2'"
    ) from None

from ..auto import asked_of_solve
from ..core.checks import FloatVector
from ..core.errors import LCPError, NotConverged, UnsuitableProblem, UnsupportedModel
from ..problems.programs.conversion import conditions
from ..problems.programs.program import QuadraticProgram
from ..problems.programs.solving import solve_program
from ..problems.sensitivity import Derivative

__all__ = ["LCPSolver"]

NOT_UNIQUE = (
    "the minimum of the program, or its multipliers, are not determined by the active constraints alone: these are "
    "linearly dependent, or the objective is flat between them; drop redundant constraints, or make the objective "
    "strictly convex"
)

OTHER_CONES = {
    "soc": "second-order cones",
    "exp": "exponential cones",
    "psd": "semidefinite cones",
    "p3d": "power cones",
    "pnd": "power cones",
}


class Layout(NamedTuple):
    """Where the numbers of P and of [A b] stand, and how many rows are equations."""

    P: tuple[Any, Any]
    A: tuple[Any, Any]
    n: int
    rows: int
    equations: int

    @classmethod
    def of(cls, context: Any) -> Layout:
        """Return that of a layer; UnsupportedModel where it is no quadratic program."""
        dims = context.cone_dims
        if wrong := [words for name, words in OTHER_CONES.items() if getattr(dims, name, None)]:
            raise UnsupportedModel(
                f"LCPSolver takes quadratic and linear programs, and this one needs {wrong[0]}; write norms of one "
                "and infinity, squares and linear constraints, or leave solver= out for diffcp"
            )
        if context.problem is not None and context.problem.is_mixed_integer():
            raise UnsupportedModel(
                "LCPSolver takes no integer variables: there is nothing to differentiate"
            )
        n = context.q.shape[0] - 1
        rows = int(dims.zero) + int(dims.nonneg)
        P, A = (
            _places(reduced.problem_data_index)
            for reduced in (context.reduced_P, context.reduced_A)
        )
        return cls(P, A, n, rows, int(dims.zero))

    def program(self, P: FloatVector | None, q: FloatVector, A: FloatVector) -> QuadraticProgram:
        """Return the program of some numbers: A x + b = 0 on the first rows, ≥ 0 on the others."""
        n, m = self.n, self.rows
        hessian = (
            sp.csr_array((n, n))
            if P is None
            else sp.csr_array(sp.coo_array((P, self.P), shape=(n, n)))
        )
        whole = sp.csc_array(sp.coo_array((A, self.A), shape=(m, n + 1)))
        matrix, right = sp.csr_array(-whole[:, :n]), whole[:, [n]].toarray().ravel()
        first, others = slice(self.equations), slice(self.equations, None)
        return QuadraticProgram(
            hessian, q[:n], matrix[others], right[others], matrix[first], right[first]
        )


def _places(structure: Any) -> tuple[Any, Any]:
    """Return the row and the column of each number, from what is kept of a matrix by columns."""
    if structure is None:
        return np.zeros(0, dtype=int), np.zeros(0, dtype=int)
    rows, ends, shape = structure
    return np.asarray(rows), np.repeat(np.arange(shape[1]), np.diff(ends))


class SolvedProgram(NamedTuple):
    """A solved program, which can be differentiated."""

    layout: Layout
    x: FloatVector
    y: FloatVector  # equations first, as cvxpy has them
    at: Derivative
    is_quadratic: bool

    def gradients(
        self, dx: FloatVector, dy: FloatVector
    ) -> tuple[FloatVector | None, FloatVector, FloatVector]:
        """Return the gradients by the numbers of P, q and [A b], from those by x and y."""
        n, p = self.layout.n, self.layout.equations
        try:
            by_q = self.at.vjp(np.concatenate([dx, dy[p:], dy[:p]])).q
        except UnsuitableProblem as error:
            raise UnsuitableProblem(NOT_UNIQUE) from error
        of_x, of_rows = (
            by_q[:n],
            np.concatenate([by_q[self.x.size + dy.size - p :], by_q[n : n + dy.size - p]]),
        )
        i, j = self.layout.A
        is_matrix, k = j < n, np.minimum(j, n - 1)
        by_A = np.where(is_matrix, of_rows[i] * self.x[k] - of_x[k] * self.y[i], of_rows[i])
        by_P = of_x[self.layout.P[0]] * self.x[self.layout.P[1]] if self.is_quadratic else None
        return by_P, np.append(of_x, 0.0), by_A


class LCPSolver(SolverInterface):  # type: ignore[misc]
    """What ``CvxpyLayer`` takes as its `solver`: convex quadratic and linear programs, single or a batch.

    Parameters
    ----------
    **options
        Of :func:`lcp_plugin.solve`, for every call: ``algorithm``, ``tolerance``, ``max_seconds``, … A call's own
        ``solver_args`` come before them.

    Raises
    ------
    InvalidOption, UnknownAlgorithm
        For an option that does not exist.
    UnsupportedModel
        By ``CvxpyLayer``: the problem needs other cones, or integers.
    NotConverged
        By a call: a program of the batch has no solution that was found; it says which, and why.
    UnsuitableProblem
        By ``backward``: the solution has no derivative there.

    Examples
    --------
    The point of x₁ + x₂ ≤ 2 nearest to p:

    >>> import cvxpy as cp, torch
    >>> from cvxpylayers.torch import CvxpyLayer
    >>> x, p = cp.Variable(2), cp.Parameter(2)
    >>> problem = cp.Problem(cp.Minimize(cp.sum_squares(x - p)), [cp.sum(x) <= 2])
    >>> layer = CvxpyLayer(problem, parameters=[p], variables=[x], solver=LCPSolver())
    >>> given = torch.tensor([1.0, 2.0], dtype=torch.float64, requires_grad=True)
    >>> (nearest,) = layer(given)
    >>> nearest.tolist()
    [0.5, 1.5]
    >>> nearest[0].backward()
    >>> given.grad.tolist()
    [0.5, -0.5]
    """

    canon_solver = "CLARABEL"  # which takes quadratic objectives, and variables without bounds
    supports_quad_obj = True
    _SINGLE: ClassVar[str] = "the program"

    def __init__(self, **options: Any) -> None:
        self.options = _known(options)
        self._layouts: WeakKeyDictionary[Any, Layout] = (
            WeakKeyDictionary()
        )  # of each layer, by its cones

    def setup(self, ctx: Any) -> None:
        """Keep the places of a layer's numbers; one solver may serve several layers."""
        self._layouts[ctx.cone_dims] = Layout.of(ctx)
        ctx.solver_ctx = _TorchAlone()

    def solve_numpy_batch(
        self, P: Any, q: Any, A: Any, dims: Any, solver_args: dict[str, Any], needs_grad: bool
    ) -> tuple[Any, Any, Any]:
        """Return x and the multipliers, a row a program, and what the derivatives need."""
        layout, options = self._layouts[dims], _known({**self.options, **solver_args})
        numbers = [None if one is None else np.asarray(one, dtype=np.float64) for one in (P, q, A)]
        found = [
            self._solved(
                layout, [None if one is None else one[k] for one in numbers], options, k, len(q)
            )
            for k in range(len(q))
        ]
        x, y = (np.array([getattr(one, name) for one in found]) for name in ("x", "y"))
        return x, y, found if needs_grad else None

    def derivative_numpy_batch(
        self, dprimal: Any, ddual: Any, saved_state: Sequence[SolvedProgram]
    ) -> tuple[Any, Any, Any]:
        """Return the gradients by the numbers of P, q and [A b], a row a program."""
        every = [
            one.gradients(dx, dy) for one, dx, dy in zip(saved_state, dprimal, ddual, strict=True)
        ]
        by_P, by_q, by_A = zip(*every, strict=True)
        return None if by_P[0] is None else np.array(by_P), np.array(by_q), np.array(by_A)

    def _solved(
        self, layout: Layout, numbers: list[Any], options: dict[str, Any], k: int, count: int
    ) -> SolvedProgram:
        """Return the solution of program k, or raise what is wrong, with its number."""
        where = self._SINGLE if count == 1 else f"program {k} of the batch"
        try:
            program = layout.program(*numbers)
            found = solve_program(program, **options)
        except LCPError as error:
            raise type(error)(f"{where}: {error}") from error
        if not found.is_solved:
            why = (
                f"is {found.proof}"
                if found.proof is not None
                else f"ended {found.status.name}: {found.advice}"
            )
            raise NotConverged(f"{where} gives the layer no solution: it {why}")
        x, inequality, equality = (
            found.solution.x,
            found.solution.inequality,
            found.solution.equality,
        )
        problem, z = conditions(program), np.concatenate([x, inequality, equality])
        at = Derivative(problem, z, problem.M @ z + problem.q)
        return SolvedProgram(
            layout, x, np.concatenate([equality, inequality]), at, numbers[0] is not None
        )

    def solve_torch_batch(
        self, P: Any, q: Any, A: Any, dims: Any, solver_args: dict[str, Any], needs_grad: bool
    ) -> tuple[Any, Any, Any]:
        """Return the same as tensors, in the type and place of q."""
        P, c, A = (None if one is None else one.detach().cpu().numpy() for one in (P, q, A))
        x, y, state = self.solve_numpy_batch(P, c, A, dims, solver_args, needs_grad)
        return _like(q, x), _like(q, y), state

    def derivative_torch_batch(
        self, dprimal: Any, ddual: Any, saved_state: Any
    ) -> tuple[Any, Any, Any]:
        """Return the same as tensors."""
        dx, dy = dprimal.detach().cpu().numpy(), ddual.detach().cpu().numpy()
        by_P, by_q, by_A = self.derivative_numpy_batch(dx, dy, saved_state)
        return (
            None if by_P is None else _like(dprimal, by_P),
            _like(dprimal, by_q),
            _like(dprimal, by_A),
        )


def _known(options: dict[str, Any]) -> dict[str, Any]:
    """Return the options, or raise where one does not exist."""
    others = {name: value for name, value in options.items() if name != "algorithm"}
    asked_of_solve(options.get("algorithm", "auto"), others)
    return options


class _TorchAlone:
    """What cvxpylayers 1.2 asks in JAX, where it calls no solver of one's own."""

    def jax_to_data(self, *_: Any) -> Any:
        raise UnsupportedModel(
            "cvxpylayers 1.2 calls a solver of one's own in PyTorch alone; in JAX take "
            "lcp_plugin.interfaces.learn.jax, or leave solver= out for diffcp"
        )


def _like(tensor: Any, values: Any) -> Any:
    """Return the values as a tensor of the type and in the place of another one."""
    import torch

    return torch.from_numpy(values).to(dtype=tensor.dtype, device=tensor.device)
