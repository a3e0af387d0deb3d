"""analyze(): facts about a problem of any class, and the plan of ``algorithm="auto"`` for it, without a solve."""

from __future__ import annotations

import re
from itertools import groupby
from pkgutil import resolve_name
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from ..core.errors import InvalidProblem
from ..core.problem_classes import CLASSES, class_of, refusal
from ..proofs.verdicts import MatrixReport, Verdict, wrapped

CONVEXITY = "is_symmetric", "is_positive_semidefinite", "is_positive_definite", "is_p_matrix"
HEADING = 'algorithm="auto", each stage if the stages before it do not solve the problem:'
REFUSED = 'algorithm="auto" has no stage: solve raises an error, because the program is not convex'


class PlannedStage(NamedTuple):
    """Stage of a plan: the method, the reason for it, and its budget ("" for none)."""

    name: str
    because: str
    until: str


class ProblemReport(MatrixReport):
    """Verdicts on the matrix of a problem, and the stages of ``algorithm="auto"``; ``print`` shows all of it.

    The matrix is M of an LCP and of cones, W of contacts, P of a program, and F′(x) where a nonlinear problem starts.
    Least squares have none.

    Parameters
    ----------
    problem : problem of any class

    Attributes
    ----------
    problem : object
    plan : tuple of PlannedStage
        Method, reason and budget of each stage that runs if the stages before it fail.
    claims : sequence of str
        Names of the verdicts that matter for the problem.
    """

    def __init__(self, problem: Any) -> None:
        name = class_of(problem) or "LCP"
        module = CLASSES[name].solver.partition(":")[0]
        self.symbol, matrix, stages = resolve_name(f"lcp_plugin.{module}:planned")(problem)
        super().__init__(sp.csr_array((0, 0)) if matrix is None else matrix)
        self.problem, self.claims = problem, self.claims if name == "LCP" else CONVEXITY
        planned = (
            PlannedStage(one.algorithm.name, one.because, one.budget.until) for one in stages
        )
        self.plan = tuple(stage for stage, _ in groupby(planned))

    def verdict(self, name: str) -> Verdict:
        """Return (value, evidence) of a claim; the evidence has the name of the matrix."""
        value, evidence = super().verdict(name)
        return Verdict(
            value, re.sub(r"\bM(?=[ᵀ[ ]|$)", self.symbol.partition(" ")[0] or "M", evidence)
        )

    def __str__(self) -> str:
        of = getattr(self.problem, "program", self.problem)  # of a program with pairs
        lower, upper = getattr(of, "lower", ()), getattr(of, "upper", ())
        bounds = f"lower bounds: {np.isfinite(lower).sum()}, upper: {np.isfinite(upper).sum()}"
        lines = [repr(self.problem), bounds, *[super().__str__()] * bool(self.n)]
        lines.append(HEADING if self.plan else REFUSED)
        for number, (name, because, until) in enumerate(self.plan, 1):
            reason = f"{because}; until {until}" if until else because
            lines += wrapped(f"{number:>3} {name:<20} ", reason)
        return "\n".join(lines)


@np.errstate(all="ignore")
def analyze(problem: Any) -> MatrixReport:
    """Return the classes of a matrix; of a problem also the plan of ``algorithm="auto"``. Nothing is solved.

    Parameters
    ----------
    problem : problem of any class, or array or sparse array, shape (n, n)

    Returns
    -------
    MatrixReport or ProblemReport
        Verdicts that are True or False with a proof, or None; a program is convex if P `is_positive_semidefinite`.

    Raises
    ------
    InvalidProblem
        If the argument is neither a problem nor a real, finite, square matrix.

    Notes
    -----
    Each verdict is computed on first access; ``print(report)`` computes all of them. A nonlinear F is called at one
    point, and for differences near it.

    Examples
    --------
    >>> from lcp_plugin import QuadraticProgram
    >>> report = analyze([[2.0, -3.0], [1.0, 2.0]])
    >>> report.is_h_plus, report.is_positive_definite
    (True, True)
    >>> analyze([[1, 2], [2, 1]]).evidence["is_p_matrix"]
    'symmetric: the principal minor of rows 0, 1 is not positive'
    >>> report = analyze(QuadraticProgram([[2, 0], [0, 2]], [-2, -4], G=[[1, 1]], h=[2]))
    >>> report.is_positive_semidefinite, [stage.name for stage in report.plan]
    (True, ['daqp', 'piqp', 'clarabel', 'lcp'])
    """
    if class_of(problem) is not None:
        return ProblemReport(problem)
    if not (hasattr(problem, "shape") or isinstance(problem, list | tuple)):
        raise InvalidProblem(f"{refusal('analyze', problem)}; or a square matrix")
    return MatrixReport(problem)
