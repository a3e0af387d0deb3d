"""Many problems with one matrix: prepare it once, solve for each q."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar, overload

import numpy as np
from numpy.typing import ArrayLike

from ...core.algorithm import Algorithm
from ...core.errors import InvalidOption, InvalidProblem
from ...core.kernels.threads import threads_for
from ...core.lcp import LCP
from ...core.matrix.row_sums import has_positive_diagonal, inverse_residual_scale, row_splits
from ...core.problem_classes import class_of, refusal, takes
from ...core.settings import Settings, checked_threads
from ...methods.banded import Banded
from ...systems.factors import bands
from ..cones.frictional_contact import FrictionalContact, FrictionalContactBatch
from ..equilibria.equilibrium_program import EquilibriumProgram
from ..least_squares.data import BoundedLeastSquares
from ..programs.convexity import refuse_nonconvex
from ..programs.criterion import PROGRAM_TOLERANCE
from ..programs.program import QuadraticProgram
from ..programs.solving import programs_for
from ..programs.stacked_programs import QuadraticProgramBatch
from .batch_items import Items, Listed, Stacked
from .batch_run import BatchResult, BatchRun
from .contact_batch import ContactBatchResult, ContactBatchRun
from .mixed_batch import AnswerList, MixedRun
from .program_batch import ProgramBatchResult, ProgramBatchRun

P = TypeVar("P", LCP, QuadraticProgram)


@np.errstate(under="ignore")
def prepare(problem: P, *, threads: int | None = None) -> P:
    """Return the problem, prepared for many q: all cached properties of M are computed.

    ``problem.with_q(q)`` shares them. Without this call, a solve computes each property when it needs it. For a
    program, the properties of P, G and A are computed; ``program.with_vectors(c, h, b)`` shares them.

    Parameters
    ----------
    problem : LCP or QuadraticProgram
    threads : int, optional
        As for :func:`lcp_plugin.solve`.

    Raises
    ------
    InvalidOption
        If it is neither, or `threads` is not a number of threads.
    UnsupportedModel
        If the program is not convex.

    Examples
    --------
    >>> from lcp_plugin import LCP, solve
    >>> problem = prepare(LCP([[2, -1], [-1, 2]], [-1, 0]))
    >>> [float(solve(problem.with_q([-1, q])).z[0].round(6)) for q in (0.0, 1.0)]
    [0.666667, 0.5]
    """
    if isinstance(problem, QuadraticProgram):
        checked_threads(threads)
        refuse_nonconvex(problem)
        return problem
    if not isinstance(problem, LCP):
        raise InvalidOption(refusal("prepare", problem))
    from ...methods.multigrid import Multigrid
    from ...systems.hierarchy.levels import hierarchy_of

    with threads_for(checked_threads(threads)):
        inverse_residual_scale(problem.matrix)
        if Banded().predicted_passes(problem, math.inf) < math.inf:
            bands(problem.matrix)
        for backward in (False, True):
            row_splits(problem.matrix, backward)
        if has_positive_diagonal(problem.matrix).all():
            hierarchy_of(problem.matrix, Multigrid.coarsest)
    return problem


@overload
def solve_batch(
    M: QuadraticProgramBatch,
    *,
    algorithm: str | Algorithm = "auto",
    tolerance: float = 1e-6,
    max_iterations: int | None = None,
    max_seconds: float | None = None,
    prove_infeasibility: bool = True,
    threads: int | None = None,
) -> ProgramBatchResult: ...
@overload
def solve_batch(
    M: FrictionalContact | FrictionalContactBatch,
    *,
    z0: ArrayLike | None = None,
    algorithm: str | Algorithm = "auto",
    tolerance: float = 1e-8,
    max_iterations: int | None = None,
    max_seconds: float | None = None,
    absolute_tolerance: float = 0.0,
    prove_infeasibility: bool = True,
    threads: int | None = None,
) -> ContactBatchResult: ...
@overload
def solve_batch(
    M: QuadraticProgram,
    q: Sequence[Mapping[str, ArrayLike]],
    *,
    algorithm: str | Algorithm = "auto",
    tolerance: float = 1e-6,
    max_iterations: int | None = None,
    max_seconds: float | None = None,
    prove_infeasibility: bool = True,
    threads: int | None = None,
) -> ProgramBatchResult: ...
@overload
def solve_batch(  # type: ignore[overload-overlap]  # a list of LCPs is one of problems, too
    M: Sequence[LCP],
    *,
    z0: ArrayLike | None = None,
    algorithm: str | Algorithm = "auto",
    tolerance: float = 1e-8,
    max_iterations: int | None = None,
    max_seconds: float | None = None,
    absolute_tolerance: float = 0.0,
    prove_infeasibility: bool = True,
    threads: int | None = None,
) -> BatchResult: ...
@overload
def solve_batch(
    M: Sequence[LCP | QuadraticProgram | EquilibriumProgram | BoundedLeastSquares],
    *,
    algorithm: str | Algorithm = "auto",
    tolerance: float = 1e-8,
    max_iterations: int | None = None,
    max_seconds: float | None = None,
    prove_infeasibility: bool = True,
    threads: int | None = None,
) -> AnswerList: ...
@overload
def solve_batch(
    M: Any,
    q: ArrayLike | None = None,
    *,
    lower: ArrayLike | None = None,
    upper: ArrayLike | None = None,
    z0: ArrayLike | None = None,
    algorithm: str | Algorithm = "auto",
    tolerance: float = 1e-8,
    max_iterations: int | None = None,
    max_seconds: float | None = None,
    absolute_tolerance: float = 0.0,
    prove_infeasibility: bool = True,
    threads: int | None = None,
) -> BatchResult: ...
def solve_batch(
    M: Any,
    q: Any = None,
    *,
    lower: ArrayLike | None = None,
    upper: ArrayLike | None = None,
    z0: ArrayLike | None = None,
    algorithm: str | Algorithm = "auto",
    tolerance: float | None = None,
    max_iterations: int | None = None,
    max_seconds: float | None = None,
    absolute_tolerance: float = 0.0,
    prove_infeasibility: bool = True,
    threads: int | None = None,
) -> Any:
    """Return the results of many problems; small ones are solved in one compiled loop.

    Parameters
    ----------
    M : array, shape (B, n, n) or (n, n), a sparse array or an LCP for all, a sequence of problems, a program and its
        vectors, a QuadraticProgramBatch, or the result of
        `FrictionalContact.worlds`
        With one LCP and a q of shape (B, n), all problems share the cached properties of its matrix, as after
        :func:`prepare`, and its bounds, unless `lower` or `upper` is passed. For one program, pass a sequence of
        mappings instead of q, as ``[{"b": b}, …]``, with the arguments of ``program.with_vectors``.
        A sequence may contain LCPs of different sizes and all problem classes that :func:`lcp_plugin.solve` takes
        without further data; do not pass q, lower or upper with it. Programs of one shape are tested together, as in a
        QuadraticProgramBatch; small problems over cones with dense matrices share a compiled loop; others are solved
        one by one. Arrays of shape (B, n, n) are not copied: do not change their entries while you use the result.
    q : array, shape (B, n) or (n,)
    lower, upper : scalar or array, shape (n,) or (B, n)
    z0 : array, shape (B, n) or (n,), optional
        Warm starts; for a list of LCPs a list of vectors or None.
    algorithm, tolerance, max_iterations, absolute_tolerance, prove_infeasibility
        For each problem, as in :func:`lcp_plugin.solve`.
    max_seconds : float, optional
        In seconds, for the entire batch: problems not solved by then end with MAX_SECONDS.
    threads : int, optional
        Number of threads of the compiled loop; by default all that the process may use. Problems that the loop does not
        solve use one thread. Results are the same bit for bit for any number.

    Returns
    -------
    BatchResult, ProgramBatchResult for programs of one shape, ContactBatchResult, or AnswerList for other problems
        All have arrays x, status, objective and iterations with one row per problem, and ``explain()``, and are
        sequences of the results of :func:`lcp_plugin.solve`; accessing an invalid problem raises its error. Each
        problem has its own certificate; a program is tested as in
        :class:`~lcp_plugin.problems.programs.solving.QuadraticProgramResult`. A NaN or an infeasible problem does not
        affect the others: problems that the compiled loop does not solve are solved one by one. After Ctrl-C the
        remaining ones are INTERRUPTED. If the compiled loop finds a Farkas certificate, the status is INFEASIBLE even
        with prove_infeasibility=False.

    Raises
    ------
    InvalidProblem
        If shapes do not fit together, or an item of the sequence is not a problem.
    UnknownAlgorithm, InvalidOption
        As :func:`lcp_plugin.solve`.

    Examples
    --------
    >>> batch = solve_batch([[[2, 1], [1, 2]], [[4, 0], [0, 4]]], [[-5, 1], [-4, -8]])
    >>> batch.z.round(6).tolist(), batch.all_solved
    ([[2.5, 0.0], [1.0, 2.0]], True)
    >>> batch[1].status.name
    'SOLVED'

    >>> problem = prepare(LCP([[2, 1], [1, 2]], [0, 0]))
    >>> solve_batch(problem, [[-5, 1], [-3, -3]]).z.round(6).tolist()
    [[2.5, 0.0], [1.0, 1.0]]
    >>> program = prepare(QuadraticProgram(np.eye(2), [0, 0], A=[[1, 1]], b=[2]))
    >>> solve_batch(program, [{"b": [2]}, {"b": [4]}]).x.tolist()
    [[1.0, 1.0], [2.0, 2.0]]

    The points of x₁ + x₂ ≤ 2 nearest to (1, 2) and to (0, 1):

    >>> answers = solve_batch(QuadraticProgramBatch(np.eye(2), [[-1, -2], [0, -1]], G=[[1, 1]], h=[2]))
    >>> (answers.x.round(6) + 0.0).tolist(), answers.inequality.round(6).tolist(), answers[0].status.name
    ([[0.5, 1.5], [0.0, 1.0]], [[0.5], [0.0]], 'SOLVED')
    """
    checked, limit = checked_threads(threads), Settings(max_seconds=max_seconds).max_seconds
    programs = _programs_of(M, q, lower, upper, z0)
    asked: dict[str, Any] = {
        "max_iterations": max_iterations,
        "prove_infeasibility": prove_infeasibility,
        "threads": 1,
    }
    default = PROGRAM_TOLERANCE if programs is not None else Settings.tolerance
    asked["tolerance"] = default if tolerance is None else tolerance
    if programs is not None:
        if z0 is not None or absolute_tolerance != 0.0:
            raise InvalidOption(
                "a batch of programs takes no z0 or absolute_tolerance; leave them out"
            )
        return ProgramBatchRun(programs, algorithm, asked, threads=checked, limit=limit).run()
    asked["absolute_tolerance"] = absolute_tolerance
    every, defaults = (
        {**asked, "algorithm": algorithm, "z0": z0},
        {**(solve_batch.__kwdefaults__ or {}), "threads": 1, "tolerance": default},
    )
    wishes = {
        name: wish
        for name, wish in every.items()
        if not (wish is defaults[name] or (np.isscalar(wish) and wish == defaults[name]))
    }
    if isinstance(M, FrictionalContactBatch):
        _refuse_data("contacts", "FrictionalContact(W, b, friction)", q, lower, upper)
        wishes.pop("z0", None)
        return ContactBatchRun(M, wishes, z0, threads=checked, limit=limit).run()
    items: Items
    if (name := class_of(M)) is not None and not (isinstance(M, LCP) and q is not None):
        write = {LCP: "problem, Q", QuadraticProgram: 'program, [{"b": b}, …]'}.get(
            type(M), "[problem]"
        )
        raise InvalidProblem(
            f"solve_batch needs many problems, got one {name}; write solve_batch({write})"
        )
    others = [one for one in M if class_of(one)] if isinstance(M, Sequence) else []
    for one in others:
        if not takes("solve_batch", one):
            raise InvalidProblem(refusal("solve_batch", one))
    if any(not isinstance(one, LCP) for one in others):
        for k, one in enumerate(M):
            if class_of(one) is None:
                raise InvalidProblem(f"item {k} of the batch: {refusal('solve_batch', one)}")
        _refuse_data("these problems", "new ones", q, lower, upper)
        return MixedRun(M, wishes, threads=checked, limit=limit).run()
    if isinstance(M, Sequence) and (not len(M) or any(isinstance(problem, LCP) for problem in M)):
        items = Listed(_checked_list(M, q, lower, upper), z0)
    else:
        held = M if isinstance(M, LCP) else None
        lower = (0.0 if held is None else held.lower) if lower is None else lower
        upper = (np.inf if held is None else held.upper) if upper is None else upper
        items = Stacked(M, q, lower, upper, z0)
    return BatchRun(items, algorithm, asked, threads=checked, limit=limit).run()


def _programs_of(M: Any, q: Any, lower: Any, upper: Any, z0: Any) -> QuadraticProgramBatch | None:
    """Return programs of one shape, however they were given; None of anything else, and of those with starts."""
    if isinstance(M, QuadraticProgramBatch):
        _refuse_data("programs", "QuadraticProgramBatch(P, c, …)", q, lower, upper)
        return M
    if isinstance(M, QuadraticProgram) and q is not None:
        _refuse_data("the mappings", '[{"lower": …, "upper": …}]', None, lower, upper)
        return QuadraticProgramBatch.of(programs_for(M, q), M)
    if (
        z0 is None
        and isinstance(M, Sequence)
        and M
        and all(isinstance(one, QuadraticProgram) for one in M)
    ):
        _refuse_data("these problems", "new ones", q, lower, upper)
        return QuadraticProgramBatch.of(M, M[0])
    return None


def _checked_list(problems: Sequence[Any], q: Any, lower: Any, upper: Any) -> Sequence[LCP]:
    for k, problem in enumerate(problems):
        if not isinstance(problem, LCP):
            raise InvalidProblem(
                f"a list of LCPs holds {type(problem).__name__} as item {k}; write LCP(M, q)"
            )
    _refuse_data("LCPs", "problem.with_q(q, lower=…, upper=…)", q, lower, upper)
    return problems


def _refuse_data(what: str, remedy: str, q: Any, lower: Any, upper: Any) -> None:
    if isinstance(q, str):
        raise InvalidOption(
            f"an algorithm is named by algorithm={q!r}; what stands second are vectors"
        )
    if not (q is None and lower is None and upper is None):
        raise InvalidOption(f"{what} bring q and their bounds; write {remedy} for others")
