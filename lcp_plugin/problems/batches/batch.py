"""Many problems in one call: small problems together, others individually."""

from __future__ import annotations

from collections.abc import Sequence
from types import EllipsisType
from typing import Any, Unpack

import numpy as np
from numpy.typing import ArrayLike

from ...core.algorithm import Algorithm
from ...core.checks import AnyMatrix, Array
from ...core.errors import InvalidOption, InvalidProblem, did_you_mean
from ...core.lcp import LCP
from ...core.problem import check_labels
from ...core.problem_classes import CLASSES, class_of, refusal
from ...core.settings import DEFAULTS, BatchOptions, Settings
from ...engines import ENGINES
from ...judges.program import PROGRAM_TOLERANCE
from ...solving.dispatch import method_of
from ..cones.frictional_contact import FrictionalContactBatch
from ..least_squares.data import BoundedLeastSquares
from ..prepared import PreparedProblem
from ..programs.program import QuadraticProgram, refuse_nonconvex
from .batch_run import BatchAnswers, BatchRun
from .instances import ContactInstances, Listed, RightSides, Stacked
from .jax_arrays import is_of_device, solve_on_device
from .program_batch import ProgramBatch, programs_for


@np.errstate(all="ignore")
def solve_batch(
    M: AnyMatrix,
    q: Array = None,
    *,
    lower: ArrayLike | EllipsisType | None = ...,
    upper: ArrayLike | EllipsisType | None = ...,
    z0: ArrayLike | None = None,
    algorithm: str | Algorithm = "auto",
    callback: object = None,
    **options: Unpack[BatchOptions],
) -> BatchAnswers:
    """Return the results of many problems; small ones are solved together.

    Parameters
    ----------
    M : array, shape (B, n, n) or (n, n), a sparse array or an LCP for all, a sequence of problems, a program and its
        vectors, or the result of `FrictionalContact.worlds`; in place of one problem also a solver of `prepare`.
        With one LCP and a q of shape (B, n), all problems share the cached properties of its matrix and its bounds,
        unless `lower` or `upper` is passed. For one program, pass a sequence of mappings instead of q, as
        ``[{"b": b}, …]``, with the arguments of ``program.with_vectors``.
        A sequence may contain problems of different sizes and of all classes; do not pass q, lower or upper with it.
        LCPs of one size with at most 128 unknowns are solved in a compiled loop if there are 32, or by "lemke" any
        number; small problems over the same cones and programs of one shape as stacks; others individually. Arrays
        of shape (B, n, n) are not copied: do not change their entries while you use the result.
        Arrays of JAX, and of PyTorch and CuPy on a GPU, stay on their device: M or q of LCPs with n at most 128. JAX
        solves them; problems whose points a sufficient test does not accept are solved on the host.
    q : array, shape (B, n) or (n,)
        For one QuadraticProgram the vectors c, shape (B, n), or the mappings; for one BoundedLeastSquares the vectors
        b, shape (B, m).
    lower, upper : scalar or array, shape (n,) or (B, n), or None
        None means no bound, as in `LCP`; by default the bounds of the LCP, or 0 and ∞.
    z0 : array, shape (B, n) or (n,), optional
        Warm starts; for a list of problems a list of vectors or None.
    algorithm : str or Algorithm
    callback : callable, optional
        Called as ``callback(finished, count)``, numbers of problems, after each stack or chunk, and after each problem
        that is solved by itself. A truthy return value ends the batch: the remaining problems are INTERRUPTED.
    **options
        tolerance, max_iterations, absolute_tolerance, prove_infeasibility: options of each problem, see
        :func:`lcp_plugin.solve`; the two options below belong to the entire batch.
    max_seconds : float, optional
        Wall-clock limit in seconds for the entire batch. Unsolved problems then end with MAX_SECONDS.
    threads : int, optional
        Number of threads that share small problems; by default all threads available to the process. Results are
        bit-identical for any number.

    Returns
    -------
    BatchAnswers
        Arrays x, status, objective and iterations with one row per problem, and ``explain()``; a sequence of the
        results of :func:`lcp_plugin.solve`. Accessing an invalid problem raises its error. Each problem has its own
        certificate; a program is tested as in
        :class:`~lcp_plugin.problems.programs.result.QuadraticProgramResult`. A NaN or an infeasible problem does not
        affect the others. After Ctrl-C the remaining problems are INTERRUPTED. x and w are on the device of M.

    Raises
    ------
    InvalidProblem
        If shapes do not fit together, or an item of the sequence is not a problem.
    UnknownAlgorithm, InvalidOption
        See :func:`lcp_plugin.solve`.
    Exception
        Any error of a function of the user; its attribute `finished` has the results before it.

    Examples
    --------
    >>> batch = solve_batch([[[2, 1], [1, 2]], [[4, 0], [0, 4]]], [[-5, 1], [-4, -8]])
    >>> batch.z.round(6).tolist(), batch.all_solved
    ([[2.5, 0.0], [1.0, 2.0]], True)
    >>> batch[1].status.name
    'SOLVED'

    >>> from lcp_plugin import prepare
    >>> step = prepare(LCP([[2, 1], [1, 2]], [0, 0]))
    >>> solve_batch(step, [[-5, 1], [-3, -3]]).z.round(6).tolist()
    [[2.5, 0.0], [1.0, 1.0]]
    >>> program = QuadraticProgram(np.eye(2), [0, 0], A=[[1, 1]], b=[2])
    >>> solve_batch(program, [{"b": [2]}, {"b": [4]}]).x.tolist()
    [[1.0, 1.0], [2.0, 2.0]]
    >>> solve_batch(program, [[0, 2], [2, 0]]).x.tolist()
    [[2.0, 0.0], [0.0, 2.0]]
    >>> fit = BoundedLeastSquares([[1, 0], [1, 1], [0, 1]], [0, 0, 0])
    >>> solve_batch(fit, [[2, 1, -1], [1, 3, 2]]).x.round(6).tolist()
    [[1.5, 0.0], [1.0, 2.0]]
    """
    if isinstance(M, PreparedProblem):
        M = M.problem
    check_labels(M, {"q": q})
    overrides = checked_overrides(options)  # before the data
    pairs = (lower, -np.inf), (upper, np.inf)
    lower, upper = (None if x is ... else none if x is None else x for x, none in pairs)
    if is_of_device(M) or (isinstance(M, np.ndarray) and is_of_device(q)):
        method_of(algorithm, {})
        bounds = 0.0 if lower is None else lower, np.inf if upper is None else upper
        return solve_on_device((M, q, *bounds, z0), algorithm, overrides, callback)
    programs = _programs_of(M, q, lower, upper, z0)
    if programs is not None:
        if z0 is not None or "absolute_tolerance" in overrides:
            raise InvalidOption("a program takes no z0 or absolute_tolerance; leave them out")
        overrides.setdefault("tolerance", PROGRAM_TOLERANCE)
        if not (isinstance(algorithm, str) and algorithm in ENGINES):
            method_of(algorithm, {})
        if programs.base is not None:
            refuse_nonconvex(programs.base)
        return BatchRun(programs, algorithm, overrides).run(callback)
    stated = _problems_of(M, q, lower, upper, z0)
    if stated.are_lcps:
        method_of(algorithm, {})
    return BatchRun(stated, algorithm, overrides).run(callback)


def checked_overrides(options: Any) -> dict[str, Any]:
    """Return the options of a batch other than defaults; raise InvalidOption for unknown names and wrong values."""
    for name in sorted(options.keys() - BatchOptions.__annotations__.keys()):
        known = ("lower", "upper", "z0", "algorithm", "callback", *BatchOptions.__annotations__)
        hint = "; pass starts as z0, one for each problem"
        hint = hint if name == "x0" else did_you_mean(name, known)
        raise InvalidOption(f"solve_batch has no option {name!r}{hint}")
    overrides = {name: value for name, value in options.items() if value is not None}
    Settings(**overrides)
    for name in ("absolute_tolerance", "prove_infeasibility"):  # which some classes lack
        if overrides.get(name) == DEFAULTS[name]:
            del overrides[name]
    return overrides


def _problems_of(M: AnyMatrix, q: Array, lower: Array, upper: Array, z0: Array) -> Any:
    """Return the checked problems of a batch that is not of programs of one shape."""
    if isinstance(M, FrictionalContactBatch):
        _refuse_data("contacts", "FrictionalContact.worlds(W, b, friction)", q, lower, upper)
        return ContactInstances(M, z0)
    if isinstance(M, BoundedLeastSquares) and q is not None:
        _refuse_algorithm(q)
        return RightSides(M, b=q, lower=lower, upper=upper, z0=z0)
    if (name := class_of(M)) is not None and not (isinstance(M, LCP) and q is not None):
        usage = f"solve_batch({CLASSES[name].batch})"
        raise InvalidProblem(f"solve_batch needs many problems, got one {name}; write {usage}")
    if isinstance(M, Sequence) and (not len(M) or any(map(class_of, M))):
        for k, item in enumerate(M):
            if class_of(item) is None:
                wrong = refusal("solve_batch", item)
                raise InvalidProblem(f"item {k} of the batch: {wrong}; write LCP(M, q)")
        _refuse_data("these problems", "problem.with_q(q, lower=…, upper=…)", q, lower, upper)
        return (RightSides.of(M) if z0 is None else None) or Listed(M, z0)
    low, high = (M.lower, M.upper) if isinstance(M, LCP) else (0.0, np.inf)
    return Stacked(M, q, low if lower is None else lower, high if upper is None else upper, z0)


def _programs_of(M: AnyMatrix, q: Any, lower: Any, upper: Any, z0: Any) -> ProgramBatch | None:
    """Return programs of one shape, from any of three forms; None for other data or with starts."""
    if isinstance(M, ProgramBatch):
        return M
    if isinstance(M, QuadraticProgram) and q is not None:
        _refuse_algorithm(q)
        _refuse_data("the vectors", '[{"lower": …, "upper": …}]', None, lower, upper)
        is_list = isinstance(q, Sequence) and bool(q)
        if hasattr(q, "shape") or (is_list and isinstance(q[0], (Sequence, np.ndarray))):
            return ProgramBatch.with_costs(M, q)
        return ProgramBatch.of(programs_for(M, q), M)
    is_list = z0 is None and isinstance(M, Sequence) and bool(M)
    if is_list and all(isinstance(item, QuadraticProgram) for item in M):
        _refuse_data("these problems", "QuadraticProgram(P, c, …)", q, lower, upper)
        return ProgramBatch.of(M, M[0])
    return None


def _refuse_algorithm(q: Array) -> None:
    if isinstance(q, str):
        raise InvalidOption(
            f"the second argument is the vectors (q, or b, or c), got {q!r}; pass the algorithm as algorithm={q!r}"
        )


def _refuse_data(what: str, remedy: str, q: Array, lower: Array, upper: Array) -> None:
    _refuse_algorithm(q)
    if not (q is None and lower is None and upper is None):
        raise InvalidOption(f"{what} already contain q and bounds; for others write: {remedy}")
