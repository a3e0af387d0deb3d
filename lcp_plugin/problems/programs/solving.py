"""Solves convex quadratic programs by `solve`: engines of others first, then a run; judged by their own residuals."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp

from ...auto import asked_of_solve, solve_lcp
from ...core.certificates.residuals import Certificate
from ...core.checks import FloatVector, checked_vector, restored
from ...core.deadline import Clock, is_over, seconds_left, time_limit
from ...core.errors import (
    InvalidOption,
    InvalidProblem,
    LCPError,
    UnsuitableMatrix,
    UnsuitableProblem,
    UnsupportedModel,
)
from ...core.kind import Kind
from ...core.settings import OF_SOLVE, Status, checked_callback
from ...core.solving.answer import NEXT, Answer
from ...core.solving.result import Result, Sample, StageRecord, stage_lines
from ...core.solving.run_log import say
from ...engines import ENGINES, Engine, Hint, engine_class
from ...methods.interior_point import InteriorPoint
from ...methods.search.stages import FeasibilityCheck
from ...systems.null_space import null_space_by_rows
from .conversion import QPOrigin, optimality_conditions
from .convexity import LARGEST_CHECKED, refuse_nonconvex
from .criterion import constraint_tolerance, program_goal
from .engine_calls import EngineRun, engines_for, run_engine, solved_as_given
from .kind import QUADRATIC_PROGRAM
from .no_minimum import QPInfeasibility, QPUnboundedness, numbers, prove_unheld
from .program import QuadraticProgram
from .solution import QPSolution

SEEN = ("callback", "verbose", "error_bound", "z0", "tolerance_on", "absolute_tolerance")
NEARLY = 1e-3  # residuals beyond that are not even inaccurately optimal
SHORTEST = 0.1  # a limit of seconds that no small program reaches
PIVOTS_AT_LAST = {InteriorPoint.name, "lemke"}  # these take long where there is no solution
BY_ROWS = "constraints alone"
BY_FACTOR = "factor of P"  # that meets a pivot of 0
NOT_MET = "no x within the bounds meets them"
NO_MINIMUM = "it came upon a proof that the program has no minimum"
VECTORS = {"c", "h", "b", "lower", "upper"}


ADVICE = {
    Status.SOLVED: "x is optimal within the tolerance, as measured on your data",
    Status.PRECISION_LIMIT: "the residuals are small, but not within the tolerance; next: rescale the data",
    Status.INFEASIBLE: "no x meets all constraints; next: check the data; result.proof proves it",
    Status.STALLED: (
        "the program's own residuals no longer fall, and no proof was found, or looked for, that it has no minimum; "
        "next: check the data and their units"
    ),
}


@dataclass(frozen=True, eq=False, repr=False)
class QuadraticProgramResult(Answer):
    """The answer to a quadratic program, judged by the program's own residuals.

    Attributes
    ----------
    status : Status
        SOLVED (optimal) by the program's own residuals, INFEASIBLE or UNBOUNDED with a proof, PRECISION_LIMIT where
        they are small, but above the goal; otherwise why the run ended.
    solution : QPSolution
        x, the multipliers and their residuals.
    goal : float
        The size of the residuals that is called optimal.
    algorithm, iterations, seconds
        Of the whole run, seconds in wall-clock time.
    proof : QPInfeasibility or QPUnboundedness or None
        Of INFEASIBLE or UNBOUNDED.
    tolerance : float
        As given to :func:`lcp_plugin.solve`.
    stages : tuple of StageRecord
        What ran, in order.
    history : tuple of Sample
        Of the complementarity problem; empty unless asked for with ``record=True``.
    setup_seconds : float
        Seconds until the first iterate.
    begun : str
        As of :class:`lcp_plugin.Result`.
    contradiction : str
        Of an infeasible cvxpy problem: which of its constraints contradict one another.
    """

    answered_kind: ClassVar[Kind] = QUADRATIC_PROGRAM

    status: Status
    solution: QPSolution
    goal: float
    algorithm: str
    iterations: int
    seconds: float
    tolerance: float
    stages: tuple[StageRecord, ...] = ()
    history: tuple[Sample, ...] = ()
    setup_seconds: float = 0.0
    proof: QPInfeasibility | QPUnboundedness | None = None
    begun: str = ""
    contradiction: str = ""
    _run: Result | None = None
    _origin: QPOrigin | None = None

    __setstate__ = restored

    @cached_property
    def lcp_result(self) -> Result:
        """The run on the complementarity problem of the program; where none was needed, the answer converted."""
        if self._run is not None:
            return self._run
        origin = self._origin or QPOrigin.of(self.program)
        problem = origin.problem()
        problem.origin = problem.criterion = origin
        certificate = Certificate.of(problem, origin.stated(self.x, self.solution.multipliers))
        return Result(
            certificate.z,
            certificate.w,
            self.status,
            certificate,
            self.algorithm,
            self.iterations,
            sum(stage.work for stage in self.stages),
            self.seconds,
            self.setup_seconds,
            self.tolerance,
            self.history,
            self.stages,
            self.proof,
        )

    @property
    def program(self) -> QuadraticProgram:
        """The program."""
        return self.solution.program

    @property
    def x(self) -> FloatVector:
        """The minimiser, or the best point that was found, shape (n,)."""
        return self.solution.x

    @property
    def objective(self) -> float | None:
        """½ xᵀP x + cᵀx; None where a proof says that there is no minimum."""
        return None if self.has_no_solution else self.solution.objective

    @property
    def duals(self) -> dict[str, FloatVector]:
        """The multipliers ``inequality``, ``equality``, ``lower``, ``upper``, with cvxpy's signs."""
        return {
            name: getattr(self.solution, name)
            for name in ("inequality", "equality", "lower", "upper")
        }

    @property
    def z(self) -> FloatVector:
        """The answer to the complementarity problem."""
        if self._origin is None or "lcp_result" in self.__dict__:
            return self.lcp_result.z
        return self._origin.stated(self.x, self.solution.multipliers)

    @property
    def w(self) -> FloatVector:
        """Its slack M z + q."""
        return self.lcp_result.w

    @property
    def certificate(self) -> Certificate:
        """What is known of z in the complementarity problem."""
        return self.lcp_result.certificate

    @property
    def is_compiled(self) -> bool:
        """Whether an engine settled the program: no complementarity problem was made of it."""
        return self._run is None and self._origin is None

    @property
    def advice(self) -> str:
        """What the status means for this program, and behind ``next:`` what to do."""
        happened, begins, to_do = ADVICE.get(self.status, self.status.value).partition(NEXT)
        words = [happened, *self._of_which("x")]
        if self.status is Status.PRECISION_LIMIT and self.program.facts.contradicts_by_rounding:
            words.append(
                "the constraints contradict one another by what is rounding beside their coefficients"
            )
        if (
            self.program.n <= LARGEST_CHECKED
            and self.program.is_convex is False
            and not self.has_no_solution
        ):
            words.append(
                "P has a negative eigenvalue, which is taken for rounding"
                if self.is_solved
                else "P has a negative eigenvalue, and if it is no rounding error the program is not convex"
            )
        return "; ".join(words) + begins + to_do

    def _numbers(self) -> dict[str, float]:
        names = ("primal_residual", "dual_residual", "duality_gap")
        residuals = (
            {}
            if self.has_no_solution
            else {name: float(getattr(self.solution, name)) for name in names}
        )
        return {
            **super()._numbers(),
            **residuals,
            "goal": self.goal,
            "setup_seconds": self.setup_seconds,
        }

    def reached(self) -> str:
        """Return the residuals and what was asked of them, or what proves that there are none."""
        if self.proof is None:
            found, least = self.solution, constraint_tolerance(self.goal)
            return (
                f"objective {self.objective:.9g}; constraints are violated by {found.primal_residual:.1e} (tolerance "
                f"{least:.0e}), {found.dual_residual:.1e} of the gradient is left, the duality gap is "
                f"{found.duality_gap:.1e} (tolerance {self.goal:.0e}), each beside its terms"
            )
        return f"{self.proof}\n{self.contradiction}" if self.contradiction else str(self.proof)

    def _course(self) -> list[str]:
        has_run = self.is_solved or not self.is_compiled  # a proof may have come first
        return [*super()._course(), *(stage_lines(self.stages) if has_run else [])]


@np.errstate(under="ignore")
def solve_program(
    program: QuadraticProgram, algorithm: Any = "auto", *, tolerance: float = 1e-9, **options: Any
) -> QuadraticProgramResult:
    """Return the answer with the smallest residuals in the program's own terms, and a status that its data prove.

    Parameters
    ----------
    program : QuadraticProgram
        Convex; merely convex and linear programs included.
    algorithm, tolerance, **options
        Of :func:`lcp_plugin.solve`. The tolerance is that of the complementarity problem; where the program's own
        residuals are above 1e-6 at it (or above ten times the tolerance, if that is larger), the run goes on. Where the
        interior point and the feasibility check end without a solution, a proof that there is none is looked for, which
        ends the run, too; not so with ``prove_infeasibility=False``. A `z0` is an earlier answer's z, where a run
        starts; engines of others begin anew, and "interior_point", which is "piqp" here.

    Raises
    ------
    UnsupportedModel
        Where the program is not convex, or the named algorithm cannot run on a merely convex one. A program whose
        constraints are proved to contradict one another is INFEASIBLE whatever its objective is.
    UnknownAlgorithm, InvalidOption
        As `solve`.
    """
    clock = Clock()
    try:
        return _solved(program, algorithm, tolerance, dict(options), clock)
    except (
        KeyboardInterrupt
    ):  # before the run, which has a point to hand back, or in an engine's call
        return _interrupted(program, algorithm, tolerance, clock.read())
    except UnsupportedModel:
        if options.get("prove_infeasibility") is False or program.is_convex is not False:
            raise
        with time_limit(min(options.get("max_seconds") or math.inf, seconds_left())):
            proof = program.facts.proof_of_contradiction(program_goal(tolerance))
        if proof is None:
            raise
        return _without_minimum(program, proof, BY_ROWS, tolerance, clock.read())


def _solved(
    program: QuadraticProgram,
    algorithm: Any,
    tolerance: float,
    options: dict[str, Any],
    clock: Clock,
) -> QuadraticProgramResult:
    """Return the answer to a convex program."""
    if (start := options.pop("z0", None)) is not None:
        try:
            options["guess"] = checked_vector(start, "z0", None)
        except InvalidProblem as error:
            raise InvalidOption(str(error)) from error
    options = {name: wish for name, wish in options.items() if wish is not None}
    is_name = isinstance(algorithm, str)
    if algorithm == InteriorPoint.name if is_name else isinstance(algorithm, InteriorPoint):
        algorithm, is_name = (
            InteriorPoint.engine,
            True,
        )  # which it asks of an LCP, too, for its program
    if algorithm in ENGINES if is_name else isinstance(algorithm, Engine):
        return _solved_by_engine(program, algorithm, tolerance, options)
    guess, is_auto = options.pop("guess", None), is_name and algorithm == "auto"
    may_ask_engines = _may_ask_engines(algorithm, tolerance, options)
    goal, prove_infeasibility = program_goal(tolerance), options.get("prove_infeasibility", True)
    if may_ask_engines and (decided := _by_engines(program, tolerance, options, clock)) is not None:
        return decided
    may_be_unheld = (
        is_auto
        and prove_infeasibility
        and sp.issparse(program.P)
        and (program.n <= LARGEST_CHECKED or null_space_by_rows(program.P) is not None)
    )
    # What is asked before a run, between its stages, and after it knows of the limit by this.
    with _limit(options):
        unheld = _unheld(program, goal) if may_be_unheld else None
        if unheld is not None:
            if options.get("verbose"):
                say(f"{unheld.status.name}: the program is {unheld}")
            return _without_minimum(program, unheld, BY_FACTOR, tolerance, clock.read())
        result, solution, proof = _by_run(program, algorithm, tolerance, guess, options)
    meets_goal = solution.is_minimal(goal)
    if (
        proof is None
        and prove_infeasibility
        and not ended_by_caller(result, options)
        and not solution.is_sure(goal)
    ):
        proof = program.facts.accepted_proof(
            goal, is_met=meets_goal and solution.holds_surely(goal)
        )
    is_nearly = solution.is_minimal(max(goal, NEARLY)) or (
        not meets_goal and _contradicts_by_rounding(program)
    )
    status = _status(result, meets_goal, is_nearly, proof)
    if options.get("verbose") and status is not result.status:
        say(f"{status.name}: {ADVICE.get(status, status.value) if proof is None else proof}")
    if proof is not None:
        result = replace(result, status=status, infeasibility=proof)
        solution = QPSolution.without_multipliers(program, solution.x)
    return QuadraticProgramResult(
        status,
        solution,
        goal,
        result.algorithm,
        result.iterations,
        clock.read(),
        tolerance,
        result.stages,
        result.history,
        result.setup_seconds,
        proof,
        _run=result,
    )


def _limit(options: dict[str, Any]) -> AbstractContextManager[None]:
    """Return the limit of seconds that the options set, within one around."""
    seconds = options.get("max_seconds", math.inf)
    return time_limit(min(seconds, seconds_left())) if seconds < math.inf else nullcontext()


def _by_engines(
    program: QuadraticProgram, tolerance: float, options: dict[str, Any], clock: Clock
) -> QuadraticProgramResult | None:
    """Return what engines, and proofs where these find no answer, decide; None where a run is to be begun."""
    goal, prove_infeasibility = program_goal(tolerance), options.get("prove_infeasibility", True)
    with _limit(options):
        by, found = _at_once(program, goal, options)
        if isinstance(found, EngineRun) and prove_infeasibility:
            found = found.proof(goal) or found
    if isinstance(found, EngineRun):
        history = _two_samples(by, found, clock.read()) if options.get("record") else ()
        status = Status.STALLED if found.contradicts else Status.SOLVED
        return QuadraticProgramResult(
            status,
            found.solution,
            goal,
            f"auto: {by}",
            found.stage.iterations,
            clock.read(),
            tolerance,
            (found.stage,),
            history,
        )
    if found is not None:
        return _without_minimum(program, found, by, tolerance, clock.read())
    if not (prove_infeasibility and program.facts.contradicts_by_rounding):
        return None
    x = np.clip(0.0, program.lower, program.upper)
    nearest = QPSolution.of_rows(program, x, np.zeros(program.constraints.limit.size))
    return QuadraticProgramResult(
        Status.PRECISION_LIMIT,
        nearest,
        goal,
        f"auto: {BY_ROWS}",
        0,
        clock.read(),
        tolerance,
        (StageRecord(BY_ROWS, NOT_MET, 0, 0.0),),
    )


def _solved_by_engine(
    program: QuadraticProgram, algorithm: Any, tolerance: float, options: dict[str, Any]
) -> QuadraticProgramResult:
    """Return what an engine of others answers, judged; where it finds nothing, a proof that there is no minimum.

    An engine begins anew, whatever start there is, and is looked at when it has ended: a record has two samples, and a
    callback is called once.
    """
    options.pop("guess", None)
    wishes = {name: options.pop(name) for name in OF_SOLVE if name in options}
    callback = checked_callback(wishes.pop("callback", None))
    settings = asked_of_solve("auto", {"tolerance": tolerance, **wishes})[1]
    engine = _engine(algorithm, {**options, **_steps(algorithm, wishes)})
    clock, goal = Clock(), program_goal(tolerance)
    with time_limit(min(settings.max_seconds, seconds_left())):
        run = run_engine(program, engine, goal, is_verbose=settings.verbose)
        meets_goal, proof = run.meets_goal, None
        if settings.prove_infeasibility:
            proof = run.proof(goal)
    is_nearly = run.says is Hint.OPTIMAL and run.solution.is_minimal(max(goal, NEARLY))
    is_nearly |= not meets_goal and _contradicts_by_rounding(program)
    why = Status.STALLED
    if run.says is Hint.STOPPED:
        why = Status.MAX_SECONDS if clock.read() >= settings.max_seconds else Status.MAX_ITERATIONS
    status = (
        proof.status
        if proof is not None
        else Status.SOLVED
        if meets_goal
        else (Status.PRECISION_LIMIT if is_nearly else why)
    )
    solution = (
        run.solution if proof is None else QPSolution.without_multipliers(program, run.solution.x)
    )
    steps, seconds = run.stage.iterations, clock.read()
    history = _two_samples(engine.name, run, seconds)
    if callback is not None:
        callback(history[-1], run.solution.x)
    return QuadraticProgramResult(
        status,
        solution,
        goal,
        engine.name,
        steps,
        seconds,
        tolerance,
        (run.stage,),
        history if settings.record else (),
        proof=proof,
    )


def _two_samples(name: str, run: EngineRun, seconds: float) -> tuple[Sample, Sample]:
    """Return what a record has of an engine: its start, of which nothing is known, and its end."""
    return Sample(0, 0.0, 0.0, None, name), Sample(
        run.stage.iterations, 0.0, seconds, run.solution.error, name
    )


def _engine(algorithm: Any, options: dict[str, Any]) -> Engine:
    """Return the engine with its options."""
    if not isinstance(algorithm, Engine):
        return engine_class(algorithm)(**options)
    if options:
        raise InvalidOption(
            f"give {min(options)} to {type(algorithm).__name__}(…), or name the engine: "
            f"solve(program, {algorithm.name!r}, …)"
        )
    return algorithm


def _steps(algorithm: Any, wishes: dict[str, Any]) -> dict[str, Any]:
    """Return max_iterations by the name that the engine has for it."""
    most = wishes.pop("max_iterations", None)
    steps = algorithm.steps if isinstance(algorithm, Engine) else engine_class(algorithm).steps
    return {} if most is None else {steps: most}


def _interrupted(
    program: QuadraticProgram, algorithm: Any, tolerance: float, seconds: float
) -> QuadraticProgramResult:
    """Return the result of a run that Ctrl-C has ended: there is nothing of it."""
    solution = QPSolution.without_multipliers(program, np.clip(0.0, program.lower, program.upper))
    name = algorithm if isinstance(algorithm, str) else algorithm.name
    return QuadraticProgramResult(
        Status.INTERRUPTED, solution, program_goal(tolerance), name, 0, seconds, tolerance
    )


def _contradicts_by_rounding(program: QuadraticProgram) -> bool:
    """Return whether the known proof of a contradiction is of one too small to count: that of rounded data."""
    return isinstance(program.facts.known_proof, QPInfeasibility)


def _unheld(program: QuadraticProgram, goal: float) -> QPUnboundedness | None:
    """Return the proof that nothing holds a structure against its load, where it counts; the program keeps it."""
    refuse_nonconvex(program)
    proof = program.facts.accept_proof(prove_unheld(program), goal)
    return proof if isinstance(proof, QPUnboundedness) else None


def _without_minimum(
    program: QuadraticProgram,
    proof: QPInfeasibility | QPUnboundedness,
    by: str,
    tolerance: float,
    seconds: float,
) -> QuadraticProgramResult:
    """Return the result of a program that has no minimum, as was found without a run."""
    x = np.clip(
        numbers(proof.point) if isinstance(proof, QPUnboundedness) else 0.0,
        program.lower,
        program.upper,
    )
    return QuadraticProgramResult(
        proof.status,
        QPSolution.without_multipliers(program, x),
        program_goal(tolerance),
        f"auto: {by}",
        0,
        seconds,
        tolerance,
        (StageRecord(by, NO_MINIMUM, 0, 0.0),),
        proof=proof,
    )


def _status(
    result: Result,
    meets_goal: bool,
    is_nearly: bool,
    proof: QPInfeasibility | QPUnboundedness | None,
) -> Status:
    """Return the proof's status, or that of a limit that came first; otherwise what the program's residuals say.

    Whether the run is solved, stalled or without a solution was judged in its units, not in the program's.
    """
    if proof is not None:
        return proof.status
    judged = (Status.SOLVED, Status.PRECISION_LIMIT, Status.STALLED)
    if result.status not in judged and not result.has_no_solution:
        return result.status
    return Status.SOLVED if meets_goal else Status.PRECISION_LIMIT if is_nearly else Status.STALLED


def _may_ask_engines(algorithm: Any, tolerance: float, options: dict[str, Any]) -> bool:
    """Return whether engines may be asked: no callback wants the steps. Refuse what is wrong."""
    is_auto = isinstance(algorithm, str) and algorithm == "auto"
    if options or not is_auto or not isinstance(tolerance, float):
        asked_of_solve(algorithm, {"tolerance": tolerance, **options})
        checked_callback(options.get("callback"))
        is_short = options.get("max_seconds", 1.0) < SHORTEST or "max_iterations" in options
        if not is_auto or is_short or any(options.get(name, False) is not False for name in SEEN):
            return False
    if not 0.0 < tolerance < 1.0:
        asked_of_solve(algorithm, {"tolerance": tolerance})
        return False
    return True


def _at_once(
    program: QuadraticProgram, goal: float, options: dict[str, Any]
) -> tuple[str, EngineRun | QPInfeasibility | QPUnboundedness | None]:
    """Return the answer of the first engine that has one, a proof that there is none, or None; and who has it.

    Where no proof is wanted, a run without an answer where the constraints are seen to contradict.
    """
    prove_infeasibility = options.get("prove_infeasibility", True)
    try:
        begun = solved_as_given(program, goal)
        if isinstance(begun, EngineRun):
            return begun.stage.name, begun
        for engine in engines_for(program):
            run, begun = run_engine(program, engine, goal, begun=begun), None
            if run.meets_goal:
                return engine.name, run
            is_hint = run.says in (Hint.INFEASIBLE, Hint.UNBOUNDED)
            if (
                prove_infeasibility
                and is_hint
                and (proof := program.facts.accepted_proof(goal)) is not None
            ):
                return engine.name, proof
            if run.contradicts and not prove_infeasibility:
                return engine.name, run
            if is_over():
                break
        if prove_infeasibility and program.facts.sees_contradiction(goal):
            proof = program.facts.accepted_proof(goal)
            return (BY_ROWS, proof) if proof is not None else ("", None)
    except KeyboardInterrupt:  # a run that ends at its start hands back what there is
        options["callback"] = lambda *_: True
    return "", None


def _by_run(
    program: QuadraticProgram,
    algorithm: Any,
    tolerance: float,
    guess: FloatVector | None,
    options: dict[str, Any],
) -> tuple[Result, QPSolution, QPInfeasibility | QPUnboundedness | None]:
    """Return a run on the complementarity problem, the answer, and the proof that ended it."""
    refuse_nonconvex(program)
    goal, proofs = program_goal(tolerance), list[Any]()

    def find_proof() -> Any:
        proofs.append(program.facts.accepted_proof(goal))
        return proofs[-1]

    wants_proof = options.get("prove_infeasibility", True)
    run = run_program(
        program,
        algorithm,
        tolerance,
        guess=guess,
        find_proof=find_proof if wants_proof else None,
        **options,
    )
    return *run, proofs[-1] if proofs else None


def run_program(
    program: QuadraticProgram,
    algorithm: Any,
    tolerance: float,
    *,
    guess: FloatVector | None = None,
    find_proof: Callable[[], Any] | None = None,
    callback: Any = None,
    **options: Any,
) -> tuple[Result, QPSolution]:
    """Return a run on the complementarity problem of a program, and the answer; a proof that is found ends it."""
    problem, labels = optimality_conditions(program, puts_in=True), set[str]()

    def ends(sample: Sample, z: FloatVector) -> bool:
        labels.add(sample.label)
        wants_end = callback is not None and bool(callback(sample, z))
        is_last_resort = sample.label == FeasibilityCheck.name or labels >= PIVOTS_AT_LAST
        if wants_end or find_proof is None or not is_last_resort or (proof := find_proof()) is None:
            return wants_end
        problem.origin.end_by(proof)
        return True

    if guess is not None and guess.size == problem.n:
        options["z0"] = guess
    if (left := seconds_left()) < math.inf:
        options["max_seconds"] = min(left, options.get("max_seconds", math.inf))
    try:
        result = solve_lcp(
            problem,
            algorithm,
            tolerance=tolerance,
            callback=ends if callback or find_proof else None,
            **options,
        )
    except (UnsuitableMatrix, UnsuitableProblem) as refusal:
        what = "a program's conditions of optimality, whose M has a zero on the diagonal for each of its rows"
        raise UnsupportedModel(f"{refusal} (M is that of {what})") from refusal
    return result, problem.origin.recover(result)


def ended_by_caller(result: Result, options: Mapping[str, Any]) -> bool:
    """Return whether a limit that the caller set, or the caller, ended the run."""
    limits = {Status.MAX_ITERATIONS: "max_iterations", Status.MAX_SECONDS: "max_seconds"}
    return result.status is Status.INTERRUPTED or limits.get(result.status) in options


def prepare_program(program: QuadraticProgram) -> None:
    """Compute what solves of the program, and of others with its matrices, ask of these."""
    refuse_nonconvex(program)
    if program.matrices.is_judged_by_sums:
        _ = program.matrices.stacked_sizes


def programs_for(program: QuadraticProgram, vectors: Any) -> list[QuadraticProgram | LCPError]:
    """Return the program with each of many vectors, or what is wrong with these.

    Raises
    ------
    InvalidProblem
        Where it is no sequence of mappings from the names of vectors.
    """
    if isinstance(vectors, Mapping) or not isinstance(vectors, Sequence):
        raise InvalidProblem(
            f'a program takes a list of mappings, as [{{"b": b}}], got {type(vectors).__name__}'
        )
    programs: list[QuadraticProgram | LCPError] = []
    for k, one in enumerate(vectors):
        if not isinstance(one, Mapping) or (unknown := set(one) - VECTORS):
            what = f"the name {min(unknown)!r}" if isinstance(one, Mapping) else type(one).__name__
            raise InvalidProblem(
                f"entry {k} must map some of {', '.join(sorted(VECTORS))} to vectors, got {what}"
            )
        try:
            programs.append(program.with_vectors(**one))
        except LCPError as error:
            programs.append(error)
    return programs
