"""Layers for PyTorch and JAX: z(M, q, lower, upper) with exact gradients, batched.

Install the extra ``[torch]`` or ``[jax]``. The layers run on the CPU; in JAX, within ``jit`` and ``vmap``, small LCPs
and quadratic programs stay on their device (``solve_lcp``). The CPU build of PyTorch is sufficient.

In PyTorch, ``z = lcp_layer(M, q); z.sum().backward()`` with ``lcp_plugin.interfaces.learn.torch.lcp_layer``; in JAX,
after ``jax.config.update("jax_enable_x64", True)``, ``jax.grad(lambda q: lcp_layer(M, q).sum())(q)`` with
``lcp_plugin.interfaces.learn.jax.lcp_layer``.

**Shapes.** The last axis of q and of the bounds is the axis of the unknowns. The last two axes of M are its rows and
columns. Leading axes are batch axes, and broadcast as in numpy. One M of shape (n, n) for all costs one matrix. A
bound may be a number. A batch is solved by :func:`~lcp_plugin.solve_batch`; a single problem may be as large as
:func:`~lcp_plugin.solve` takes. So M may also be a sparse scipy array, a constant of the layer.

**The result** is z, solved again on the free rows, so that z is exact to rounding for any tolerance; compute
w = M z + q from it. If a problem is not SOLVED, :class:`~lcp_plugin.NotConverged` names its number in the batch.
(JAX wraps this error.) With ``mask=True`` a layer returns (z, is_solved) instead: an instance that is not
solved, or whose numbers are invalid, has z = 0 and the gradient 0, and the batch continues.

**Gradients** by all four are computed by :meth:`ManyDerivatives.vjp`: exact if no row is both at a bound and has w = 0.
If such a row exists, as for a ReLU at 0, they are the gradients of one of the pieces that meet there. A second
derivative raises an error. If the block of M on the free rows is singular, they belong to the least change, as
:class:`lcp_plugin.problems.sensitivity.Derivative` describes.

**Transformations.** Gradients go backward: in JAX ``grad``, ``vjp``, ``jacrev``, also under ``jit`` and ``vmap``, whose
axis becomes a batch axis; in PyTorch ``backward()``, ``torch.func.grad`` and ``torch.func.vjp``. Forward mode
exists for small problems within ``jit``, and in numpy as :meth:`BatchDerivative.jvp`.

**Quadratic programs.** ``qp_layer(P, c, G, h, A, b)`` returns x of min ½ xᵀP x + cᵀx, G x ≤ h, A x = b, with the
gradients of :class:`~lcp_plugin.problems.programs.derivative.ProgramDerivative`; arguments as in qpth and OptNet. If
x or its multipliers are not unique on the piece of the gradient, the gradient raises UnsuitableProblem, which names the
rows.

**Contact with friction.** ``contact_layer(W, b, friction)`` returns the impulses of a batch, with the gradients of
:class:`~lcp_plugin.problems.sensitivity.ContactBatchDerivative`.

**Double precision**: single precision raises an error, because a certificate of rounded data certifies
another problem. Convert before and after the layer (``q.double()``, ``z.float()``); gradients pass through that.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp

from ...core.checks import Array
from ...core.errors import InvalidProblem, LCPError, NotConverged, UnsupportedModel
from ...core.names import listed
from ...problems.batches.batch import checked_overrides, solve_batch
from ...problems.batches.batch_run import BatchAnswers
from ...problems.batches.program_batch import ProgramBatch, programs_for
from ...problems.cones.frictional_contact import FrictionalContact
from ...problems.programs.program import VECTORS, QuadraticProgram
from ...problems.sensitivity import derivative

Convert = Callable[[Any, str], Any]  # of a library: the array of an argument with this name
LAYER_BOUNDS = "lower", "upper"
MAY_BE_NUMBERS = *LAYER_BOUNDS, "friction"


class Layer(ABC):
    """A batch of problems as a function of arrays: the solutions, and then their gradients by the arrays.

    Parameters
    ----------
    mask : bool
        Whether unsolved problems get z = 0 and the gradient 0, instead of an error.
    **options
        Options of :func:`lcp_plugin.solve_batch`.

    Raises
    ------
    InvalidOption
        For another option, or a wrong value.
    """

    def __init__(self, *, mask: bool = False, **options: Any) -> None:
        self.mask, self.options = mask, options
        others = {"z0", "algorithm", "callback", *self.of_problem}
        fixed = {name for name in options.keys() - others if not hasattr(options[name], "aval")}
        checked_overrides({name: options[name] for name in fixed})  # JAX may trace a tolerance

    of_problem: ClassVar[tuple[str, ...]] = ()  # options of the problem
    takes_start: ClassVar[bool] = True
    kind: ClassVar[str]  # the class of the problem of an instance
    own_axes: ClassVar[dict[str, str]]  # of the arrays of one problem, a letter for each size
    names: ClassVar[tuple[str, ...]]  # of the gradients by all arrays

    @classmethod
    def problem_shapes(cls, *shapes: tuple[int, ...]) -> list[tuple[int, ...]]:
        """Return the shapes of the arrays of one problem, from the shapes of arrays with batch axes."""
        pairs = zip(cls.own_axes.items(), shapes, strict=True)
        ends = (
            ((shapes[1] if name in LAYER_BOUNDS else shape), len(own))
            for (name, own), shape in pairs
        )
        return [shape[-count:] for shape, count in ends]

    @abstractmethod
    def _solved(self, axes: tuple[int, ...], data: Sequence[Any], options: object) -> BatchAnswers:
        """Return the results of the problems in arrays with these axes in front of the axes of a problem."""

    @classmethod
    def axes_of(cls, *shapes: tuple[int, ...]) -> tuple[int, ...]:
        """Return the batch axes: all axes in front of those of one problem.

        Raises
        ------
        InvalidProblem
            Names an array that does not fit the arrays before it, or all of them if their axes do not broadcast.

        Examples
        --------
        >>> LCPLayer.axes_of((5, 1, 3, 3), (7, 3), (3,), ())
        (5, 7)
        """
        sizes, fronts = dict[str, int](), list[tuple[int, ...]]()
        for (name, letters), shape in zip(cls.own_axes.items(), shapes, strict=True):
            needed, own = [sizes.get(one, one) for one in letters], shape[-len(letters) :]
            is_number = name in MAY_BE_NUMBERS and own in ((), (1,))
            if not is_number and own != (0, 0):  # of a constant M
                fits = len(own) == len(letters)
                pairs = zip(letters, own, strict=False)
                if not (fits and all(sizes.setdefault(*pair) == pair[1] for pair in pairs)):
                    need = f"(…, {', '.join(map(str, needed))})"
                    need += ", or be a number" * (name in MAY_BE_NUMBERS)
                    raise InvalidProblem(f"{name} must have shape {need}, got {shape}")
            fronts.append(shape[: -len(letters)])
        try:
            return np.broadcast_shapes(*fronts)
        except ValueError:
            received = ", ".join(map("{} {}".format, cls.own_axes, shapes))
            raise InvalidProblem(f"the axes in front must broadcast, got {received}") from None

    def _differentiated(self, answers: BatchAnswers) -> Any:
        """Return the derivative of the results."""
        return derivative(answers)

    def _by(self, gradient: Array) -> list[Any]:
        """Return the gradients by all arrays."""
        return [getattr(gradient, name) for name in self.names]

    def solve(self, *data: Any, z0: Array = None) -> tuple[Any, Any]:
        """Return the solutions, shape (…, n), of problems with axes that broadcast, and which are solved, shape (…).

        Raises
        ------
        InvalidProblem
            If numbers or shapes are not a valid problem.
        NotConverged
            If a problem is not solved. A layer with `mask` raises neither of them.
        """
        self.data, self.axes = data, self.axes_of(*(array.shape for array in data))
        n = data[1].shape[-1]
        has_start = self.takes_start and z0 is not None
        start = {"z0": as_stack(z0, self.axes, (n,))} if has_start else {}
        answers = self._solved(self.axes, data, self.options | start)
        self.derivative: Any = self._differentiated(answers)
        errors = self.derivative.errors
        if errors and not self.mask:
            kinds = (InvalidProblem, UnsupportedModel)
            types = (kind for kind in kinds for error in errors.values() if isinstance(error, kind))
            kind = next(types, NotConverged)
            alone = f"{self.kind}({', '.join(self.own_axes)})" if kind is NotConverged else ""
            raise _first(errors, self.axes, kind, alone)
        self.is_solved = np.ones(math.prod(self.axes), np.bool_)
        self.is_solved[[*errors]] = False
        z = np.where(self.is_solved[:, np.newaxis], self.derivative.z, 0.0)
        return z.reshape(*self.axes, n), self.is_solved.reshape(self.axes)

    def gradients(self, g: Array) -> tuple[Any, ...]:
        """Return the gradients by the arrays of the last `solve`, in their shapes, from the gradient by z.

        Raises
        ------
        UnsuitableProblem
            If a problem that the loss depends on has no gradient.
        """
        rows = g.reshape(math.prod(self.axes), g.shape[-1])
        rows = np.where(self.is_solved[:, np.newaxis], rows, 0.0)
        gradient = self.derivative.vjp(rows)
        if wrong := {k: error for k, error in self.derivative.errors.items() if rows[k].any()}:
            raise _first(wrong, self.axes, type(next(iter(wrong.values()))))
        pairs = zip(self._by(gradient), self.data, strict=True)
        return tuple(self._summed(by, array.shape) for by, array in pairs)

    def _summed(self, by: Any, shape: tuple[int, ...]) -> Any:
        """Return gradients of each problem, or their sum, in the shape of an array that broadcasts."""
        if by.size != math.prod(shape):
            by = by.reshape(*self.axes, *by.shape[1:])
            more = by.ndim - len(shape)
            shared = [k for k, size in enumerate(shape, more) if size < by.shape[k]]
            by = by.sum((*range(more), *shared))
        return np.asarray(by).reshape(shape)


LayerCall = tuple[Layer, tuple[Any, ...]]


class LCPLayer(Layer):
    """LCPs as a function of M, q, lower and upper.

    Parameters
    ----------
    M : sparse array, shape (n, n), or None
        M if it is a constant of the layer; the array in its place has no entries.
    """

    kind, own_axes = "LCP", dict(M="nn", q="n", lower="n", upper="n")

    def __init__(self, M: Array = None, *, mask: bool = False, **options: Any) -> None:
        super().__init__(mask=mask, **options)
        self.M = M

    @classmethod
    def of(cls, convert: Convert, M: Array, q: Array, bounds: Array, **options: Any) -> LayerCall:
        """Return the layer and its arrays."""
        q, lower, upper = convert(q, "q"), convert(bounds[0], "lower"), convert(bounds[1], "upper")
        is_constant = sp.issparse(M)
        M_of_call = convert(np.zeros((0, 0)) if is_constant else M, "M")
        return cls(M if is_constant else None, **options), (M_of_call, q, lower, upper)

    def _solved(self, axes: tuple[int, ...], data: Sequence[Any], options: Any) -> BatchAnswers:
        shape = data[1].shape[-1:]
        q, lower, upper = (as_stack(array, axes, shape) for array in data[1:])
        M = matrices(data[0], axes) if self.M is None else self.M
        return solve_batch(M, q, lower=lower, upper=upper, **options)

    def _by(self, gradient: Array) -> list[Any]:
        M = gradient.M if self.M is None else np.zeros((0, 0))
        return [M, gradient.q, gradient.lower, gradient.upper]


class QPLayer(Layer):
    """Quadratic programs as a function of P, c, G, h, A, b, lower and upper; P by its symmetric part."""

    kind, takes_start = "QuadraticProgram", False
    own_axes: ClassVar = dict(P="nn", c="n", G="mn", h="m", A="pn", b="p", lower="n", upper="n")
    names = tuple(own_axes)

    @classmethod
    def of(cls, convert: Convert, data: dict[str, Any], **options: Any) -> LayerCall:
        """Return the layer and its arrays; of P = None for a linear program, and no rows for None and empty arrays.

        Raises
        ------
        InvalidProblem
            If a matrix has no right-hand side, or the reverse.
        """
        n = np.shape(data["c"])[-1:]
        if data["P"] is None:
            data["P"] = np.zeros((*n, *n))
        for rows, right in (("G", "h"), ("A", "b")):
            are_none = [data[key] is None or 0 in np.shape(data[key]) for key in (rows, right)]
            if are_none[0] != are_none[1]:
                present, missing = (right, rows) if are_none[0] else (rows, right)
                raise InvalidProblem(f"{present} is given without {missing}; pass both, or neither")
            if are_none[0]:
                data[rows], data[right] = np.zeros((0, *n)), np.zeros(0)
        return cls(**options), tuple(convert(data[name], name) for name in cls.own_axes)

    def _solved(self, axes: tuple[int, ...], data: Sequence[Any], options: Any) -> BatchAnswers:
        arrays = 0.5 * (data[0] + data[0].swapaxes(-1, -2)), data[2], data[4]
        P, G, A = (matrices(array, axes) for array in arrays)
        shapes = self.problem_shapes(*(array.shape for array in data))
        vectors = [as_stack(data[k], axes, shapes[k]) for k in (1, 3, 5, 6, 7)]
        named = [dict(zip(VECTORS, rows, strict=True)) for rows in zip(*vectors, strict=True)]
        if P.ndim == G.ndim == A.ndim == 2:
            c, h, b = (np.zeros(rows.shape[1]) for rows in vectors[:3])
            base = QuadraticProgram(P, c, G, h, A, b)
            programs = programs_for(base, named)
        else:
            stacks = ([*as_stack(array, axes, array.shape[-2:])] for array in arrays)
            programs = [*map(_attempt, *stacks, named)]
            good = [program for program in programs if isinstance(program, QuadraticProgram)]
            if not good:
                raise programs[0]  # type: ignore[misc]
            base = good[0]
        batch = ProgramBatch.of(programs, base)
        if batch is None:
            raise InvalidProblem(
                f"programs of {P.shape[-1]} unknowns with a matrix each are too large for a layer; share P, G and A"
            )
        return solve_batch(batch, **options)

    def _differentiated(self, answers: BatchAnswers) -> Any:
        return derivative(answers).one_sided()


def _attempt(P: Array, G: Array, A: Array, vectors: dict[str, Any]) -> QuadraticProgram | LCPError:
    """Return a program, or its error."""
    try:
        return QuadraticProgram(P, G=G, A=A, **vectors)
    except LCPError as error:
        return error


class ContactLayer(Layer):
    """Contact problems with friction as a function of W, b and friction."""

    kind, own_axes = "FrictionalContact", dict(W="nn", b="n", friction="k")
    names = "M", "q", "friction"
    of_problem = "contacts", "dimension", "equations"

    @classmethod
    def of(cls, convert: Convert, W: Array, b: Array, friction: Array, **options: Any) -> LayerCall:
        """Return the layer and its arrays."""
        return cls(**options), (convert(W, "W"), convert(b, "b"), convert(friction, "friction"))

    def _solved(self, axes: tuple[int, ...], data: Sequence[Any], options: Any) -> BatchAnswers:
        W, b, friction = data
        of_problem = {name: options.pop(name) for name in options.keys() & {*self.of_problem}}
        b = as_stack(b, axes, b.shape[-1:])
        friction = as_stack(friction, axes, friction.shape[-1:]) if friction.ndim else friction
        problem = FrictionalContact.worlds(matrices(W, axes), b, friction, **of_problem)
        return solve_batch(problem, **options)


def as_stack(array: Array, axes: tuple[int, ...], shape: tuple[int, ...]) -> Any:
    """Return an array with one axis in place of these axes in front of the axes of a problem."""
    return np.broadcast_to(array, (*axes, *shape)).reshape(math.prod(axes), *shape)


def matrices(M: Array, axes: tuple[int, ...]) -> Any:
    """Return one matrix for all problems, or a stack of matrices."""
    shape = M.shape[-2:]
    return M.reshape(shape) if math.prod(M.shape[:-2]) == 1 else as_stack(M, axes, shape)


def _first(
    errors: dict[int, LCPError], axes: tuple[int, ...], kind: type[LCPError], alone: str = ""
) -> LCPError:
    """Return an error that reports the first failed problem and the numbers of the others."""
    first, *others = (tuple(map(int, np.unravel_index(k, axes))) for k in sorted(errors))
    also = f", nor for {listed(map(str, others), 5)}" if others else ""
    where = f"problem {first} of the batch" if axes else "the problem"
    result = f" (with result = solve({alone}) of its numbers; mask=True skips it)" if alone else ""
    return kind(f"the layer found no solution for {where}{also}: {errors[min(errors)]}{result}")
