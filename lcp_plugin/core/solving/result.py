"""The result of a run: a status with advice, the solution, and the record of the run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..certificates.criterion import RowsAtPoint
from ..certificates.residuals import Certificate
from ..checks import FloatVector, read_only, restore_state
from ..errors import UnsuitableMatrix
from ..lcp import LCP
from ..representation import format_count
from ..settings import Settings, Status
from .base_result import NEXT, BaseResult

if TYPE_CHECKING:
    from ...proofs.bounds import ErrorBound
    from ...proofs.guarantees import Guarantee


class StageRecord(NamedTuple):
    """Algorithm of a run: name, reason of its choice, iterations, work in passes over M, remark for advice."""

    name: str
    because: str
    iterations: int
    work: float
    remark: str = ""


def stage_lines(stages: Sequence[StageRecord]) -> list[str]:
    """Return a line per stage: method, iterations, share of the work, reason; a single stage only with a reason."""
    if len(stages) == 1:
        return [f"  {stages[0].name}: {stages[0].because}"] if stages[0].because else []
    total = sum(stage.work for stage in stages) or 1.0
    return [
        f"  {stage.name}, {format_count(stage.iterations, 'iteration')}, {stage.work / total:.0%} of the work"
        + (stage.because and f": {stage.because}")
        for stage in stages
    ]


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


@dataclass(frozen=True, eq=False, repr=False)
class Result(BaseResult):
    """Result of a linear complementarity problem, with its residuals and the record of the run.

    Attributes
    ----------
    z, w : ndarray, shape (n,)
        The best iterate and its slack M z + q, read-only; `x` is z.
    status : Status
        Derived from the certificate; if the certificate does not pass, the reason for termination.
    certificate : Certificate
        All residuals of z on the caller's data.
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
    is_polished : bool
        True if z is the solution of the linear system on the active set of the last iterate; ``polish=False`` returns
        the iterate.
    infeasibility : NoSolutionProof or None
        A proof that the problem in double precision has no solution; ``verify()`` checks it on the problem's data. Its
        ``margin`` bounds the residual of every z from below; the status is INFEASIBLE or NO_SOLUTION if
        the margin exceeds the tolerance. With another status the margin is smaller: `advice` reports it.
    """

    z: FloatVector = field(repr=False)
    w: FloatVector = field(repr=False)
    status: Status
    certificate: Certificate = field(repr=False)
    algorithm: str
    iterations: int
    work: float
    seconds: float
    setup_seconds: float
    tolerance: float
    history: tuple[Sample, ...] = field(default=(), repr=False)
    stages: tuple[StageRecord, ...] = field(default=(), repr=False)
    infeasibility: Any = field(default=None, repr=False)
    absolute_tolerance: float = 0.0
    begun: str = ""
    is_polished: bool = False
    _asked: Any = field(default="auto", repr=False)  # the algorithm, or its name
    _wants_bound: bool = field(default=False, repr=False)
    _advice: Mapping[Status, str] = field(
        default_factory=dict, repr=False
    )  # advice of a status that replaces its default

    __setstate__ = restore_state

    @classmethod
    def at(
        cls,
        problem: LCP,
        z: FloatVector,
        stage: StageRecord,
        settings: Settings,
        seconds: float = 0.0,
        rows: RowsAtPoint | None = None,
    ) -> Result:
        """Return the result at a point that is measured as SOLVED, without another solve or measurement.

        Parameters
        ----------
        problem : LCP
        z : ndarray, shape (n,)
            Read-only.
        stage : StageRecord
            The method of "auto" that found z, with its iterations and work.
        settings : Settings
        seconds : float
            Seconds of the computation of z.
        rows : RowsAtPoint, optional
            The values of the rows at z, measured on :func:`~lcp_plugin.core.certificates.criterion.row_data`.
        """
        certificate = Certificate(problem, z)
        if rows is not None:
            certificate.__dict__["_rows"] = rows
        return cls(
            z=z,
            w=read_only(rows.w) if rows else certificate.w,
            status=Status.SOLVED,
            certificate=certificate,
            algorithm=f"auto: {stage.name}",
            iterations=stage.iterations,
            work=stage.work + 1.0,  # of the measurement
            seconds=seconds,
            setup_seconds=0.0,
            tolerance=settings.tolerance,
            absolute_tolerance=settings.absolute_tolerance,
            stages=(stage,),
        )

    @property
    def error_bound(self) -> ErrorBound | None:
        """Bound of the error, if requested and if M allows one; computed on first access.

        The time of its computation is ``error_bound.seconds``; the run's seconds do not include it.
        """
        return self._bound_or_reason[0]

    @property
    def no_error_bound(self) -> str:
        """The reason why a requested bound does not exist; otherwise empty."""
        return self._bound_or_reason[1]

    @cached_property
    def _bound_or_reason(self) -> tuple[ErrorBound | None, str]:
        if not self._wants_bound:
            return None, ""
        from ...proofs.bounds import error_bound

        try:
            return error_bound(self.certificate.problem, self.z), ""
        except UnsuitableMatrix as error:
            return None, str(error)

    @cached_property
    def guarantee(self) -> Guarantee:
        """Convergence theorem that covers the caller's choice of algorithm on this matrix; computed on first access.

        See :func:`lcp_plugin.proofs.guarantees.convergence_guarantee`.
        """
        from ...proofs.guarantees import convergence_guarantee

        return convergence_guarantee(self.certificate.problem, self._asked)

    @property
    def x(self) -> FloatVector:
        """The best iterate, z."""
        return self.z

    @property
    def proof(self) -> Any:
        """The proof `infeasibility` if the status is INFEASIBLE or NO_SOLUTION; otherwise None."""
        return self.infeasibility if self.has_no_solution else None

    @property
    def residual(self) -> float:
        """The relative residual."""
        return self.certificate.relative_residual

    @property
    def advice(self) -> str:
        """Meaning of the status for this run, and the recommended next step after ``next:``."""
        advice = self._advice.get(self.status, self.status.value)
        if self.is_solved or self.has_no_solution:
            happened, begins, to_do = advice.partition(NEXT)
            return "; ".join([happened, *self._describe_scope("z")]) + begins + to_do
        remarks = [stage.remark for stage in self.stages if stage.remark]
        happened, begins, to_do = advice.partition(NEXT)
        return "; ".join([happened, *remarks]) + begins + to_do

    @np.errstate(all="ignore")
    def explain(self) -> str:
        """Return the event, its certainty and the next step, one line each; then the reasons and the methods."""
        from ...proofs.misleading import what_may_mislead

        lines = [*self._verdict(), *self._course(), *stage_lines(self.stages)]
        if self.is_polished:
            lines.append("  polish: a linear solve on the active set of the last iterate gives z")
        if self.is_solved:
            lines += [stage.remark for stage in self.stages[-1:] if stage.remark]
        if self.infeasibility is not None and not self.has_no_solution:
            lines.append(str(self.infeasibility))
        if self.no_error_bound:
            lines.append(f"no error bound: {self.no_error_bound}")
        return "\n".join([*lines, *what_may_mislead(self)])

    def _effort(self) -> str:
        matrix = "F′" if self.certificate.is_linearised else "M"
        return (
            f"{self.algorithm}: {format_count(self.iterations, 'iteration')}, {self.seconds:.3g} s (set-up "
            f"{self.setup_seconds:.3g} s), the work of {self.work:.1f} products of {matrix} with a vector"
        )

    def describe_accuracy(self) -> str:
        """Return the relative residual next to the tolerance, or the proof that no solution exists."""
        if self.has_no_solution:
            return str(self.infeasibility)
        residual, asked = f"relative residual {self.residual:.3e}", f"tolerance {self.tolerance:g}"
        bound, *proven = str(self.error_bound or "").splitlines() or [""]
        lines = [f"{residual}, {asked}{self._or_absolute}", *filter(None, [bound])]
        return "\n".join(["; ".join(lines), *proven])

    @property
    def _or_absolute(self) -> str:
        if not self.absolute_tolerance:
            return ""
        return f", or {self.absolute_tolerance:.3e} in the unit of z; that is {self.certificate.scaled_residual:.3e}"

    def _numbers(self) -> dict[str, float]:
        certificate, bound = self.certificate, self.error_bound
        bounds = (
            {}
            if bound is None
            else {"error_bound": bound.infinity, "relative_error_bound": bound.relative}
        )
        return {
            "n": certificate.problem.n,
            "relative_residual": certificate.relative_residual,
            "natural_residual": certificate.natural_residual,
            "euclidean_residual": certificate.euclidean_residual,
            "bound_violation": certificate.bound_violation,
            "complementarity": certificate.complementarity,
            "work": self.work,
            "setup_seconds": self.setup_seconds,
            "tolerance": self.tolerance,
            **({"absolute_tolerance": self.absolute_tolerance} if self.absolute_tolerance else {}),
            **bounds,
        }
