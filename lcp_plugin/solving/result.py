"""Results of runs: a status with advice, the solution, and the record of the run."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from operator import attrgetter
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self

import numpy as np

from ..core.algorithm import Algorithm
from ..core.checks import Array, MadeOnAccess, Vector, read_only, restore_state
from ..core.errors import NotConverged, UnsuitableMatrix
from ..core.lcp import LCP
from ..core.names import Names, format_count, remark_on_labels
from ..core.problem_classes import Door
from ..core.settings import PROVEN, Settings, Status
from ..judges.certificate import Certificate
from ..judges.lcp import Measured, RowData, row_data
from ..judges.worst_rows import SHOWN, WorstRows, worst_pairs

if TYPE_CHECKING:
    from ..proofs.bounds import ErrorBound
    from ..proofs.guarantees import Guarantee

NOTHING_TO_DO = "the residual of the start is within the tolerance already; no iteration was needed"
NEXT = "; next: "  # between the event and the next step
UNPROVEN = Status.STALLED, Status.DIVERGED, Status.MAX_ITERATIONS


class StageRecord(NamedTuple):
    """Algorithm of a run: name, reason, iterations, work in passes over M, remark for advice, why it failed."""

    name: str
    because: str
    iterations: int
    work: float
    remark: str = ""
    ending: str = ""


def name_of_run(stages: Sequence[StageRecord], chosen: Algorithm | None) -> str:
    """Return the name of the algorithm of a result: of the call, and the methods that ran if they are others."""
    name, chain = "auto" if chosen is None else chosen.name, [stage.name for stage in stages]
    return name if chain in ([], [name]) else f"{name}: {', '.join(chain)}"


@dataclass(frozen=True)
class Sample:
    """Measurement during a run.

    Attributes
    ----------
    iteration : int
        Number of the iteration; 0 is the projected start, after the set-up.
    work : float
        Matrix entries touched so far, divided by the nonzeros of M.
    seconds : float
        Seconds of the algorithm so far, set-up included; the clock stops while a sample is measured.
    residual : float or None
        Relative residual; None at the start of an external solver, and in a callback at a step that was not measured.
    label : str
        Name of the current algorithm.
    """

    iteration: int
    work: float
    seconds: float
    residual: float | None
    label: str = ""


Callback = Callable[[Sample, Any], Any]


def end_at_once(sample: Sample, z: Array) -> bool:
    """End a run at its start: the callback of a run whose user ended it there."""
    return True


class Outcome:
    """Properties that follow from the status."""

    if TYPE_CHECKING:

        @property
        def status(self) -> Status:
            """SOLVED, or the reason for termination."""

    @property
    def is_solved(self) -> bool:
        """True if the status is SOLVED."""
        return self.status is Status.SOLVED

    @property
    def has_no_solution(self) -> bool:
        """True if a proof shows that no solution exists: INFEASIBLE, NO_SOLUTION or UNBOUNDED."""
        return self.status in PROVEN


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class BaseResult(MadeOnAccess, Outcome):
    """Base class of all results; the result of each problem class has further attributes.

    Attributes
    ----------
    status : Status
        SOLVED, or the reason for termination; the class of the result documents the stopping criterion.
    x : ndarray, shape (n,), or None
        The solution (z of a complementarity problem), or the best iterate; None without a point. All vectors of a
        result with a proof that no solution exists are NaN.
    objective : float or None
        Objective value at x; None if the problem has no objective.
    algorithm : str
        Name of the algorithm; for "auto" the chain of methods that ran.
    iterations : int
        Number of iterations.
    seconds : float
        Wall-clock seconds of the run.
    tolerance : float
        Relative tolerance of the run.
    history : tuple of Sample
        Empty unless ``record=True``.
    stages : tuple of StageRecord
        The methods that ran, in order; more than one for ``auto``.
    begun : str
        Description of the starting point, if the caller did not choose it; otherwise empty.
    agents : tuple of Optimal
        Agents of a cvxpy model; ``explain()`` prints the possible gain of each.
    """

    status: Status
    algorithm: str
    iterations: int
    seconds: float
    tolerance: float
    history: tuple[Sample, ...] = ()
    stages: tuple[StageRecord, ...] = field(default_factory=tuple)  # of no class: made on access
    begun: str = ""
    agents: tuple[Any, ...] = ()
    _advice: ClassVar[Mapping[Status, str]] = {}  # in place of the text of the status

    __setstate__ = restore_state

    if TYPE_CHECKING:  # a field or a property

        @property
        def x(self) -> Any:
            """The values of the unknowns."""

    @property
    def objective(self) -> float | None:
        """Objective value at x; None if the problem has no objective."""
        return None

    @property
    def proof(self) -> Any:
        """Proof of the status, an object with ``verify()``; None if the status rests only on residuals."""
        return getattr(self, "infeasibility", None) if self.has_no_solution else None

    @property
    def conflict(self) -> Any:
        """Irreducible set of constraints that cannot hold together, by name; computed on first access.

        A :class:`lcp_plugin.proofs.conflict.Conflict`: `names`, `verify()` and a `point(k)` that satisfies
        all members but number k. None without a Farkas certificate.
        """
        return getattr(self._farkas_proof, "conflict", None)

    @property
    def has_conflict(self) -> bool:
        """True if `conflict` is not None; the set is not computed."""
        return hasattr(type(self._farkas_proof), "conflict")

    @property
    def _farkas_proof(self) -> Any:
        """The proof whose conflict is the conflict of this result."""
        return self.proof

    @property
    def named(self) -> dict[str, float]:
        """Values of x by the names of the unknowns; without a name "z[0]", and "x[0]" of programs and least squares."""
        certificate = getattr(self, "certificate", None)
        problem = getattr(self, "program", None) or getattr(certificate, "problem", None)
        names = getattr(problem, "names", Names())
        otherwise = "z[{}]" if isinstance(self, Result) else "x[{}]"
        return {names.unknown(j, otherwise): value for j, value in enumerate(self.x.tolist())}

    @property
    def advice(self) -> str:
        """Meaning of the status for this run, and the recommended next step after ``next:``."""
        happened, begins, to_do = self._advice_of_status().partition(NEXT)
        return "; ".join([happened, *self._clauses()]) + begins + to_do

    def _advice_of_status(self) -> str:
        return self._advice.get(self.status, self.status.value)

    def _clauses(self) -> list[str]:
        """Return clauses that the advice adds to the event."""
        return []

    def describe_accuracy(self) -> str:
        """Return the achieved accuracy next to the required accuracy."""
        raise NotImplementedError

    @np.errstate(all="ignore")
    def explain(self) -> str:
        """Return the event, its certainty and the next step, one line each; then the reasons and the methods."""
        gains = [agent.describe_gap() for agent in self.agents]
        course = [self._effort(), *filter(None, [self.begun]), *gains]
        if len(stages := self.stages) == 1:
            course += [f"  {stage.name}: {stage.because}" for stage in stages if stage.because]
        total = sum(stage.work for stage in stages) or 1.0
        course += [
            f"  {stage.name}, {format_count(stage.iterations, 'iteration')}"
            + (f", {stage.work / total:.0%} of the work" if stage.work else "")
            + (stage.ending and f", {stage.ending}")
            + (stage.because and f": {stage.because}")
            for stage in (stages if len(stages) > 1 else ())
        ]
        is_decided = self.is_solved or self.has_no_solution
        worst = str("" if is_decided else self._worst(SHOWN) or "").splitlines()
        lines = worst if self.is_solved else [*worst, self._mistake()]
        rows = ["the worst rows:"] * bool(worst) + [f"  {line}" for line in lines if line]
        happened, begins, to_do = self.advice.partition(NEXT)
        what, *why = happened.split("; ")
        sure, *more = self.describe_accuracy().splitlines()
        verdict = [f"{self.status.name}: {what}", sure, *filter(None, [begins[2:] + to_do])]
        text = "\n".join([*verdict, *why, *more, *course, *self._remarks(), *rows])
        return "\n".join(filter(None, (text, remark_on_labels(text))))

    def _worst(self, count: int) -> WorstRows:
        """Return the rows that fail the criterion by most; none by default."""
        return WorstRows()

    def _mistake(self) -> str:
        """Return the likely mistake of the model, below the worst rows; none by default."""
        return ""

    def _remarks(self) -> list[str]:
        """Return the last lines of the explanation."""
        return []

    def _effort(self) -> str:
        """Return the name of the algorithm, its iterations and seconds."""
        count = format_count(self.iterations, "iteration")
        return f"{self.algorithm}: {count}, {self.seconds:.3g} s"

    def require_solved(self) -> Self:
        """Return this result, or raise NotConverged if the status is not SOLVED.

        Raises
        ------
        NotConverged
            The message has the status, the achieved accuracy and the advice.
        """
        if not self.is_solved:
            raise NotConverged(
                f"{self.status.name} after {self.iterations} iterations of {self.algorithm}: "
                f"{'; '.join([*self.describe_accuracy().splitlines(), self.advice])}"
            )
        return self

    if TYPE_CHECKING:

        def plot(self, **how: Any) -> Any:
            """Return matplotlib's axes with a plot of the result; see `lcp_plugin.evidence.drawing.plot_answer`."""

    else:
        plot = Door()

    def __repr__(self) -> str:
        # on ranks, x is a part
        size = "" if self.x is None else f"n={getattr(self, 'n', len(self.x))}, "
        value = "" if self.objective is None else f"objective {self.objective:.9g}, "
        return f"{type(self).__name__}({self.status.name}, {size}{value}{BaseResult._effort(self)})"

    def __str__(self) -> str:
        return self.explain()


@dataclass(frozen=True, eq=False, repr=False)
class Result(BaseResult):
    """Result of a linear complementarity problem, with its residuals and the record of the run.

    Attributes
    ----------
    z : ndarray, shape (n,)
        The best iterate, read-only; `x` is z. NaN with a proof that no solution exists, and so is w.
    status : Status
        Derived from the certificate; if the certificate does not pass, the reason for termination.
    certificate : Certificate
        All residuals of the best iterate on the caller's data.
    algorithm : str
        Name of the algorithm; for ``auto`` the chain of methods that ran.
    iterations, work, seconds, setup_seconds
        Totals of the run; see :class:`Sample` for the units.
    tolerance, absolute_tolerance
        The values passed to :func:`lcp_plugin.solve`.
    begun : str
        Description of the starting point, if the caller did not choose it; otherwise empty.
    history : tuple of Sample
        Empty unless ``record=True``.
    stages : tuple of StageRecord
        The methods that ran, in order; more than one for ``auto``.
    agents : tuple of Optimal
        Agents of a cvxpy model; otherwise empty.
    is_polished : bool
        True if z is the solution of the linear system on the active set of the last iterate; ``polish=False`` returns
        the iterate.
    evaluations : Evaluations or None
        Of a nonlinear problem: the calls of F, the derivatives, and the calls at which F is undefined.
    infeasibility : NoSolutionProof or None
        A proof that the problem in double precision has no solution; ``verify()`` checks it on the problem's data. Its
        ``margin`` bounds the residual of every z from below; the status is INFEASIBLE or NO_SOLUTION if
        the margin exceeds the tolerance. With another status the margin is smaller: `advice` reports it.
    """

    z: Vector
    certificate: Certificate
    work: float
    setup_seconds: float
    infeasibility: Any = None
    absolute_tolerance: float = 0.0
    is_polished: bool = False
    evaluations: Any = None
    _asked: Algorithm | None = None  # None for "auto"
    _advice: Mapping[Status, str] = field(default_factory=dict, kw_only=True)  # type: ignore[misc]

    @classmethod
    def of(
        cls,
        problem: LCP,
        point: Measured,
        stages: Sequence[StageRecord],
        settings: Settings,
        seconds: float = 0.0,
        chosen: Algorithm | None = None,
    ) -> Result:
        """Return the result at a point that is measured as SOLVED, without another solve or measurement.

        Parameters
        ----------
        problem : LCP
        point : Measured
            Its rows, if it has some, are measured on :func:`~lcp_plugin.judges.lcp.row_data`.
        stages : sequence of StageRecord
            The methods that ran.
        settings : Settings
        seconds : float
            Seconds of the computation of z.
        chosen : Algorithm, optional
            The algorithm of the call; None for "auto".
        """
        z, rows = read_only(point.z), point.rows
        if rows is None and not problem.matrix.is_dense:  # the caller may overwrite a sparse M
            rows = row_data(problem).rows(z)
        return cls.of_known(
            None,
            z=z,
            status=Status.SOLVED,
            certificate=Certificate.at(problem, z, rows=rows),
            algorithm=name_of_run(stages, chosen),
            iterations=sum(stage.iterations for stage in stages),
            work=sum(stage.work for stage in stages),
            seconds=seconds,
            setup_seconds=0.0,
            tolerance=settings.tolerance,
            absolute_tolerance=settings.absolute_tolerance,
            stages=tuple(stages),
            _asked=chosen,
        )

    @cached_property
    def error_bound(self) -> ErrorBound | None:
        """Bound of the error of a linear problem, computed on first access; None if M allows no bound.

        The time of its computation is ``error_bound.seconds``; the run's seconds do not include it.
        :func:`lcp_plugin.error_bound` raises the reason.
        """
        from ..proofs.bounds import error_bound  # with proofs, which a solve does without

        if type(getattr(self.certificate, "criterion", None)) is not RowData:
            return None
        try:
            return error_bound(self.certificate.problem, self.z)
        except UnsuitableMatrix:
            return None

    @cached_property
    def guarantee(self) -> Guarantee:
        """Convergence theorem that covers the caller's choice of algorithm on this matrix; computed on first access.

        See :func:`lcp_plugin.convergence_guarantee`.
        """
        from .explanation import guarantee_of_choice

        return guarantee_of_choice(self.certificate.problem, self._asked)

    @cached_property
    def w(self) -> Vector:
        """The slack M z + q, shape (n,), read-only; computed on first access."""
        return self.z if self.has_no_solution else self.certificate.w

    x = property(attrgetter("z"), doc="The best iterate, z.")
    residual = property(attrgetter("certificate.relative_residual"), doc="The relative residual.")

    def _clauses(self) -> list[str]:
        is_decided = self.is_solved or self.has_no_solution
        return [] if is_decided else [stage.remark for stage in self.stages if stage.remark]

    def _remarks(self) -> list[str]:
        from .explanation import lack_of_a_theorem, what_may_mislead

        lines = []
        if self.is_polished:
            lines.append("  polish: a linear solve on the active set of the last iterate gives z")
        if self.is_solved:
            lines += [stage.remark for stage in self.stages[-1:] if stage.remark]
        if self.infeasibility is not None and not self.has_no_solution:
            lines.append(str(self.infeasibility))
        if self.is_solved:
            lines.append(what_may_mislead(self.certificate, self.work))
        elif self._asked is not None and self.status in UNPROVEN:
            lines.append(lack_of_a_theorem(self.guarantee, self.algorithm, self.advice))
        return [*filter(None, lines)]

    def _effort(self) -> str:
        work = f"{self.work:.1f} products of {self.certificate.criterion.matrix} with a vector"
        return f"{super()._effort()} (set-up {self.setup_seconds:.3g} s), the work of {work}"

    def describe_accuracy(self) -> str:
        """Return the relative residual next to the tolerance, or the proof that no solution exists."""
        if self.has_no_solution:
            return str(self.infeasibility)
        residual, asked = f"relative residual {self.residual:.3e}", f"tolerance {self.tolerance:g}"
        if self.absolute_tolerance:
            reached = self.certificate.scaled_residual
            asked += f", or {self.absolute_tolerance:.3e} in the unit of z; that is {reached:.3e}"
        return f"{residual}, {asked}"

    def _worst(self, count: int) -> WorstRows:
        data = self.certificate.criterion
        point = data.measure_at(self.z, self.w, self.tolerance)
        return worst_pairs(data, point, self.certificate.problem.names, self.tolerance, count)

    def _mistake(self) -> str:
        from .explanation import likely_mistake_of

        return likely_mistake_of(self.certificate, self.status)
