"""The models of ``.nl`` files solved, and the answers in the file's own variables and rows."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from ... import __version__
from ...core.checks import BoolVector, FloatVector
from ...core.lcp import LCP
from ...core.settings import Settings, Status
from ...core.solving.result import Result
from ...modeling.assembly import Arrangement, solve_from
from ...problems.equilibria.equilibrium_program import EquilibriumProgram
from ...problems.nonlinear.data import NonlinearProblem
from ...problems.programs.program import QuadraticProgram
from ...problems.programs.solving import QuadraticProgramResult, judged_program
from .content import Indices, NLContent
from .evaluation import contradiction, evaluated
from .side_conditions import SideConditions

#: AMPL's numbers for the ways a run may end.
CODES = {
    Status.SOLVED: 0, Status.PRECISION_LIMIT: 100, Status.INFEASIBLE: 200, Status.NO_SOLUTION: 200,
    Status.UNBOUNDED: 300, Status.MAX_ITERATIONS: 400, Status.MAX_SECONDS: 401, Status.INTERRUPTED: 402,
    Status.STALLED: 500, Status.DIVERGED: 501,
}
OUTSIDE = 1e-8  # of 1 + |x|
ROUNDINGS = 100.0  # times what rounding alone leaves open
PROGRAM_GOAL = 1e-6  # of the terms of a row
STUCK = "stalled at bounds of variables where equations do not hold, which only a complementarity would allow"


@dataclass(frozen=True, eq=False)
class NLAnswer:
    """What a run found, in the variables and rows of the file.

    Attributes
    ----------
    x : ndarray, shape (n,), or None
        None where a search found no solution.
    duals : ndarray, shape (m,), or None
        Of a complementarity row its value w. Of a row of a program the derivative of the objective by the row's
        right-hand side, the convention of AMPL. 0 for the other rows of a complementarity problem.
    status : Status
    message : str
        One line: how it ended, residual, iterations.
    result : Result, QuadraticProgramResult or EquilibriumResult
    objective : float or None
    code : int
        AMPL's number for the status.
    """

    x: FloatVector | None
    duals: FloatVector | None
    status: Status
    message: str
    result: Any = field(repr=False)
    objective: float | None
    code: int

    @property
    def is_solved(self) -> bool:
        """Whether the status is SOLVED."""
        return self.status is Status.SOLVED


class NLModel(ABC):
    """What an ``.nl`` file states.

    Attributes
    ----------
    content : NLContent
    problem : LCP, NonlinearProblem or QuadraticProgram
    """

    content: NLContent
    problem: LCP | NonlinearProblem | QuadraticProgram | EquilibriumProgram

    @abstractmethod
    def solve(self, algorithm: Any = "auto", **options: Any) -> NLAnswer:
        """Return the answer.

        Parameters
        ----------
        algorithm, **options
            Of :func:`lcp_plugin.solve`, or :func:`lcp_plugin.solve_nonlinear` for a smooth model.
        """

    @property
    @abstractmethod
    def start(self) -> FloatVector:
        """The start in the unknowns of the problem; 0 where the file names none."""

    def names(self) -> list[str]:
        """Return the names of the variables; of their numbers where the file has none."""
        return [f"variable {k}" for k in range(self.content.lower.size)] if self.content.names is None \
            else self.content.names

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.problem})"

    def _message(self, words: str, residual: float, iterations: int) -> str:
        return f"lcp_plugin {__version__}: {words}; residual {residual:.1e}, {iterations} iterations"


@dataclass(frozen=True, eq=False)
class PairRows:
    """The complementarity rows, and the variables that only name the value of one.

    Attributes
    ----------
    rows, partners : ndarray of int
        The rows, and the variable of each.
    folded : ndarray of int
        Those of the rows that were a multiple of one variable, plus a number.
    variables : ndarray of int
    weights, offsets : ndarray
        Such a row is weight · variable + offset.
    constants : ndarray, shape (m,)
        The values of complementarity rows that hold no unknown and are left out.
    """

    rows: Indices
    partners: Indices
    folded: Indices
    variables: Indices
    weights: FloatVector
    offsets: FloatVector
    constants: FloatVector


class ComplementarityModel(NLModel):
    """A linear or nonlinear complementarity problem, or equations.

    Parameters
    ----------
    content : NLContent
    arrangement : Arrangement
    unknowns : ndarray of int
        The variable that each unknown of the arrangement is; from n on, a defined variable.
    known : ndarray, shape (n,)
        The values of variables that are no unknowns.
    pairs : PairRows
    beside : SideConditions
        What is held against the answer afterwards.
    """

    def __init__(
        self, content: NLContent, arrangement: Arrangement, unknowns: Indices, known: FloatVector, pairs: PairRows,
        beside: SideConditions,
    ) -> None:
        self.content, self.arrangement, self.unknowns, self.pairs = content, arrangement, unknowns, pairs
        self.beside = beside
        self.problem: LCP | NonlinearProblem = arrangement.problem
        self._known, self._size = known, known.size + content.defined_trees.size

    @property
    def start(self) -> FloatVector:
        """The start in the unknowns of the problem; 0 where the file names none."""
        start = np.append(self.content.start, np.zeros(self.content.defined_trees.size))
        return start[self.unknowns][self.arrangement.elimination.kept]

    def solve(self, algorithm: Any = "auto", **options: Any) -> NLAnswer:
        """Return the answer; see :meth:`NLModel.solve`."""
        start = self.start if self.content.has_start.any() else None
        result = solve_from(self.problem, start, {"algorithm": algorithm, **options})
        found = self._without_bounds(result, {"algorithm": algorithm, **options})
        x, duals = self.values(found.z, found.w)
        status, words = found.status, STUCK if result.is_solved and not found.is_solved else found.status.name.lower()
        if status is Status.SOLVED and (wrong := self._wrong(x, duals, found, options)):
            status, words = Status.STALLED, wrong
        message = self._message(words, found.residual, found.iterations)
        return NLAnswer(x, duals, status, message, found, None, CODES[status])

    def _wrong(self, x: FloatVector, duals: FloatVector, result: Result, options: dict[str, Any]) -> str:
        """Return what the rows of the file, evaluated as they stand, say against the answer; else nothing."""
        values = evaluated(self.content, x)
        tolerance = options.get("tolerance", Settings.tolerance)
        return self._contradiction(x, duals, values, result) or self.beside.violated(x, values[0], tolerance)

    def _contradiction(
        self, x: FloatVector, duals: FloatVector, values: tuple[FloatVector, FloatVector], result: Result
    ) -> str:
        """Return what the values of the rows say against those computed; else nothing."""
        content, widths = self.content, np.zeros(self._size)
        if isinstance(self.problem, NonlinearProblem) and self.problem.enclosure is not None:
            low, high = self.problem.enclosure.interval_F(result.z, result.z)
            widths[self.unknowns[self.arrangement.elimination.kept]] = high - low
        is_pair = content.partners >= 0
        is_equation = ~is_pair & (content.row_lower == content.row_upper)
        at_equations = np.abs(np.delete(result.w, np.flatnonzero(self._is_of_pair)))
        allowed = np.full(duals.size, ROUNDINGS * widths.max(initial=0.0) + at_equations.max(initial=0.0))
        allowed[is_pair] = ROUNDINGS * widths[content.partners[is_pair]]
        expected = np.where(is_pair, duals, content.row_lower)
        expected = np.where(is_pair | is_equation, expected, np.nan)
        return contradiction(content, x, values, expected, allowed)

    def values(self, z: FloatVector, w: FloatVector) -> tuple[FloatVector, FloatVector]:
        """Return the variables, and the values of the complementarity rows, 0 for other rows."""
        elimination, pairs = self.arrangement.elimination, self.pairs
        n, duals = self._known.size, self.pairs.constants.copy()
        x, slack = np.append(self._known, np.zeros(self._size - n)), np.zeros(self._size)
        x[self.unknowns] = elimination.expand(z)
        slack[self.unknowns] = elimination.expand_slack(w)
        duals[pairs.rows] = slack[pairs.partners]
        x[pairs.variables] = (duals[pairs.folded] - pairs.offsets) / pairs.weights
        return x[:n], duals

    @cached_property
    def _is_of_pair(self) -> BoolVector:
        """Which rows of the problem are complementarity rows of the file, shape (n,)."""
        return np.isin(self.unknowns[self.arrangement.elimination.kept], self.pairs.partners)

    def _without_bounds(self, result: Result, options: dict[str, Any]) -> Result:
        """Return the result, of equations whose unknowns have bounds gone on without these: they excuse no equation."""
        problem = self.problem
        kept = ~self._is_of_pair & (np.isfinite(problem.lower) | np.isfinite(problem.upper))
        if not isinstance(problem, NonlinearProblem) or not kept.any() or not result.is_solved:
            return result
        lower, upper = np.where(kept, -np.inf, problem.lower), np.where(kept, np.inf, problem.upper)
        free = NonlinearProblem(problem.F, problem.jacobian, lower, upper, enclosure=problem.enclosure)
        found = solve_from(free, None, {**options, "z0": result.z})
        beyond = np.maximum(problem.lower - found.z, found.z - problem.upper)[kept]
        is_inside = bool((beyond <= OUTSIDE * (1.0 + np.abs(found.z[kept]))).all())
        if not (found.is_solved and is_inside):
            return replace(result, status=Status.STALLED)
        return replace(found, iterations=result.iterations + found.iterations)


class ProgramModel(NLModel):
    """A convex quadratic or linear program; without an objective, the question for a point that meets the rows.

    Parameters
    ----------
    content : NLContent
    problem : QuadraticProgram
        In the unknowns, made of the rows by `from_ranges`; to be minimised.
    unknowns : ndarray of int
        The variable that each of its variables is.
    known : ndarray, shape (n,)
        The values of the variables that are none of them.
    sign : float
        −1 where the objective of the file is to be maximised.
    constant : float
        What the objective adds.
    """

    def __init__(
        self, content: NLContent, problem: QuadraticProgram, unknowns: Indices, known: FloatVector, sign: float,
        constant: float,
    ) -> None:
        self.content, self.unknowns = content, unknowns
        self.problem = self.program = problem
        self._known, self.sign, self.constant = known, sign, constant

    @property
    def start(self) -> FloatVector:
        """The start in the unknowns of the problem; 0 where the file names none."""
        start: FloatVector = self.content.start[self.unknowns]
        return start

    def solve(self, algorithm: Any = "auto", **options: Any) -> NLAnswer:
        """Return the answer; infeasible and unbounded are said only with a proof, ``answer.result.proof``."""
        found = judged_program(self.program, algorithm, **options)
        status = found.status
        x = self._known.copy()
        x[self.unknowns] = found.solution.x
        values = evaluated(self.content, x)
        # As the file states it: expanded, (x - 10⁶)² has lost ten digits.
        objective = float(values[1][0]) if values[1].size else 0.0
        words, code = "optimal" if found.is_solved else status.name.lower(), CODES[status]
        if status is Status.SOLVED and (wrong := self._contradiction(x, values, found)):
            status, words, code = Status.STALLED, wrong, CODES[Status.STALLED]
        is_told = found.proof is None
        words += f", objective {objective:.9g}" if is_told else ""
        # The program's own residuals, which the status is made of, not those of its optimality conditions.
        message = self._message(words, found.solution.error, found.iterations)
        duals = -self.sign * found.solution.row_multipliers + 0.0
        return NLAnswer(x, duals, status, message, found, objective if is_told else None, code)

    def _contradiction(
        self, x: FloatVector, values: tuple[FloatVector, FloatVector], found: QuadraticProgramResult
    ) -> str:
        """Return which row of the file does not hold at x, or that its objective is another; else nothing."""
        content, program, own = self.content, self.program, np.abs(found.solution.x)
        within = np.clip(values[0], content.row_lower, content.row_upper)
        size = 1.0 + np.abs(within) + abs(content.linear) @ np.abs(x)
        terms = own @ (0.5 * (abs(program.P) @ own) + np.abs(program.c)) + abs(self.constant)
        objective = self.sign * found.solution.objective + self.constant, float(terms)
        return contradiction(content, x, values, within, max(found.goal, PROGRAM_GOAL) * size, objective)
