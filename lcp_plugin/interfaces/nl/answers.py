"""The models of ``.nl`` files solved, and the answers in the file's own variables and rows."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from ... import __version__
from ...core.certificates.row_residuals import magnitude
from ...core.checks import BoolVector, FloatVector
from ...core.errors import InvalidOption
from ...core.kernels.floats import EPSILON
from ...core.lcp import LCP
from ...core.representation import in_words
from ...core.settings import Settings, Status
from ...core.solving.result import Result
from ...expressions.statement import SquareModel, solve_from
from ...problems.equilibria.equilibrium_program import EquilibriumProgram
from ...problems.nonlinear.data import NonlinearProblem
from ...problems.programs.program import QuadraticProgram
from ...problems.programs.solving import QuadraticProgramResult, solve_program
from .checks import FEASIBLE, Evaluation, SideConditions, contradiction, evaluated
from .content import Indices, NLContent

#: AMPL's numbers for the ways a run may end.
CODES = {
    Status.SOLVED: 0,
    Status.PRECISION_LIMIT: 100,
    Status.INFEASIBLE: 200,
    Status.NO_SOLUTION: 200,
    Status.UNBOUNDED: 300,
    Status.MAX_ITERATIONS: 400,
    Status.MAX_SECONDS: 401,
    Status.INTERRUPTED: 402,
    Status.STALLED: 500,
    Status.DIVERGED: 501,
}
OUTSIDE = 1e-8  # of 1 + |x|
ROUNDINGS = 100.0  # times what rounding alone leaves open
OBJECTIVE = 1e-3  # of what the objective may differ by: one that is expanded has lost digits
TAKEN = (
    "tolerance",
    "max_iterations",
    "max_seconds",
    "callback",
    "verbose",
    "threads",
    "prove",
)  # beside an objective
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


@dataclass(eq=False, repr=False)
class NLModel(ABC):
    """What an ``.nl`` file states.

    Attributes
    ----------
    content : NLContent
    problem : LCP, NonlinearProblem, QuadraticProgram or EquilibriumProgram
    unknowns : ndarray of int
        The variable that each of its unknowns is.
    known : ndarray, shape (n,)
        The values of the variables that are none of them.
    """

    content: NLContent
    problem: Any
    unknowns: Indices
    known: FloatVector

    @abstractmethod
    def solve(self, algorithm: Any = "auto", **options: Any) -> NLAnswer:
        """Return the answer.

        Parameters
        ----------
        algorithm, **options
            Of :func:`lcp_plugin.solve`, or :func:`lcp_plugin.problems.nonlinear.solving.solve_nonlinear` for a smooth
            model.
        """

    @property
    def start(self) -> FloatVector:
        """The start in the unknowns of the problem; 0 where the file names none."""
        start: FloatVector = self.content.start[self.unknowns]
        return start

    def variables(self, values: FloatVector) -> FloatVector:
        """Return all variables, shape (n,), from the values of the unknowns."""
        x = self.known.copy()
        x[self.unknowns] = values
        return x

    def names(self) -> list[str]:
        """Return the names of the variables; of their numbers where the file has none."""
        return [*map(self.content.variable, range(self.content.lower.size))]

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.problem})"

    def _message(self, words: str, residual: float, iterations: int) -> str:
        return f"lcp_plugin {__version__}: {words}; residual {residual:.1e}, {in_words(iterations, 'iteration')}"


@dataclass(eq=False, repr=False)
class ComplementarityModel(NLModel):
    """A linear or nonlinear complementarity problem, or equations; from n on, unknowns are defined variables.

    Attributes
    ----------
    arrangement : SquareModel
        The problem in fewer unknowns, definitions put in.
    pairs : ndarray of int
        The complementarity rows.
    constants : ndarray, shape (m,)
        The values of complementarity rows that hold no unknown and are left out.
    beside : SideConditions
        What is held against the answer afterwards.
    """

    problem: LCP | NonlinearProblem
    arrangement: SquareModel
    pairs: Indices
    constants: FloatVector
    beside: SideConditions

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
        x = self.beside.settled(x)
        status, words = (
            found.status,
            STUCK if result.is_solved and not found.is_solved else found.status.name.lower(),
        )
        if status is Status.SOLVED and (wrong := self._wrong(x, duals, found, options)):
            status, words = Status.STALLED, wrong
        elif status is Status.SOLVED and (bound := self.beside.at_bounds_of_their_own(x)):
            words = f"{words}; {bound}"
        message = self._message(words, found.residual, found.iterations)
        return NLAnswer(x, duals, status, message, found, None, CODES[status])

    def _wrong(
        self, x: FloatVector, duals: FloatVector, result: Result, options: dict[str, Any]
    ) -> str:
        """Return what the rows of the file, evaluated as they stand, say against the answer; else nothing."""
        values = evaluated(self.content, x)
        tolerance = options.get("tolerance", Settings.tolerance)
        return self._contradiction(duals, values, result) or self.beside.violated(
            x, values.rows, tolerance
        )

    def _contradiction(self, duals: FloatVector, values: Evaluation, result: Result) -> str:
        """Return what the values of the rows say against those computed; else nothing."""
        content, widths = self.content, np.zeros(self._size)
        if isinstance(self.problem, NonlinearProblem):
            terms = magnitude(self.problem.linearised(result.z), result.z)
            widths[self.unknowns[self.arrangement.elimination.kept]] = EPSILON * terms
        is_pair = content.partners >= 0
        is_equation = ~is_pair & (content.row_lower == content.row_upper)
        at_equations = np.abs(np.delete(result.w, np.flatnonzero(self._is_of_pair)))
        allowed = np.full(
            duals.size, ROUNDINGS * widths.max(initial=0.0) + at_equations.max(initial=0.0)
        )
        allowed[is_pair] = ROUNDINGS * widths[content.partners[is_pair]]
        expected = np.where(is_pair, duals, content.row_lower)
        expected = np.where(is_pair | is_equation, expected, np.nan)
        return contradiction(content, values, expected, allowed)

    def values(self, z: FloatVector, w: FloatVector) -> tuple[FloatVector, FloatVector]:
        """Return the variables, and the values of the complementarity rows, 0 for other rows."""
        elimination = self.arrangement.elimination
        n, duals = self.known.size, self.constants.copy()
        x, slack = np.append(self.known, np.zeros(self._size - n)), np.zeros(self._size)
        x[self.unknowns] = elimination.expand(z)
        slack[self.unknowns] = elimination.expand_slack(w)
        duals[self.pairs] = slack[self.content.partners[self.pairs]]
        return x[:n], duals

    @property
    def _size(self) -> int:
        return self.known.size + self.content.defined_trees.size

    @cached_property
    def _is_of_pair(self) -> BoolVector:
        """Which rows of the problem are complementarity rows of the file, shape (n,)."""
        return np.isin(
            self.unknowns[self.arrangement.elimination.kept], self.content.partners[self.pairs]
        )

    def _without_bounds(self, result: Result, options: dict[str, Any]) -> Result:
        """Return the result, of equations whose unknowns have bounds gone on without these: they excuse no equation."""
        problem = self.problem
        kept = ~self._is_of_pair & (np.isfinite(problem.lower) | np.isfinite(problem.upper))
        if not isinstance(problem, NonlinearProblem) or not kept.any() or not result.is_solved:
            return result
        lower, upper = np.where(kept, -np.inf, problem.lower), np.where(kept, np.inf, problem.upper)
        free = NonlinearProblem(problem.F, problem.jacobian, lower, upper)
        found = solve_from(free, None, {**options, "z0": result.z})
        beyond = np.maximum(problem.lower - found.z, found.z - problem.upper)[kept]
        is_inside = bool((beyond <= OUTSIDE * (1.0 + np.abs(found.z[kept]))).all())
        if not (found.is_solved and is_inside):
            return replace(result, status=Status.STALLED)
        return replace(found, iterations=result.iterations + found.iterations)


@dataclass(eq=False, repr=False)
class ProgramModel(NLModel):
    """A convex quadratic or linear program; without an objective, the question for a point that meets the rows.

    Attributes
    ----------
    sign : float
        −1 where the objective of the file is to be maximised.
    constant : float
        What the objective adds.
    matrix : CSR array, shape (m, unknowns)
        The rows of the file are matrix · unknowns + offset.
    offset : ndarray, shape (m,)
        NaN for a row without limits, which is left out.
    """

    problem: QuadraticProgram
    sign: float
    constant: float
    matrix: sp.csr_array
    offset: FloatVector

    def solve(self, algorithm: Any = "auto", **options: Any) -> NLAnswer:
        """Return the answer; infeasible and unbounded are said only with a proof, ``answer.result.proof``."""
        found = solve_program(self.problem, algorithm, **options)
        status = found.status
        x = self.variables(found.solution.x)
        values = evaluated(self.content, x)
        # As the file states it: expanded, (x - 10⁶)² has lost ten digits.
        objective = float(values.objectives[0]) if values.objectives.size else 0.0
        words, code = "optimal" if found.is_solved else status.name.lower(), CODES[status]
        if status is Status.SOLVED and (wrong := self._contradiction(values, found)):
            status, words, code = Status.STALLED, wrong, CODES[Status.STALLED]
        has_objective = found.proof is None
        words += f", objective {objective:.9g}" if has_objective else ""
        # The program's own residuals, which the status is made of, not those of its optimality conditions.
        message = self._message(words, found.solution.error, found.iterations)
        duals = -self.sign * found.solution.row_multipliers + 0.0
        return NLAnswer(
            x, duals, status, message, found, objective if has_objective else None, code
        )

    def _contradiction(self, values: Evaluation, found: QuadraticProgramResult) -> str:
        """Return which row, or the objective, is another in the file than in the program; else nothing."""
        program, own = self.problem, np.abs(found.solution.x)
        rows = self.matrix @ found.solution.x + self.offset
        terms = own @ (0.5 * (abs(program.P) @ own) + np.abs(program.c)) + abs(self.constant)
        objective = self.sign * found.solution.objective + self.constant, float(terms)
        return contradiction(self.content, values, rows, objective=objective)


@dataclass(eq=False, repr=False)
class EquilibriumModel(NLModel):
    """A program with complementarity constraints, in the variables and the values of the complementarity rows.

    Attributes
    ----------
    sign : float
        −1 where the objective of the file is to be maximised.
    pairs, columns : ndarray of int
        The complementarity rows, and the unknowns that are their values.
    """

    problem: EquilibriumProgram
    sign: float
    pairs: Indices
    columns: Indices

    def start_or_none(self) -> FloatVector | None:
        """Return the start in the unknowns of the problem; None where the file names none, or a row has no value."""
        x = np.zeros(self.problem.program.n)
        x[: self.unknowns.size] = self.content.start[self.unknowns]
        x[self.columns] = evaluated(self.content, self.variables(x[: self.unknowns.size])).rows[
            self.pairs
        ]
        return x if self.content.has_start.any() and np.isfinite(x).all() else None

    def solve(self, algorithm: Any = "auto", **options: Any) -> NLAnswer:
        """Return the answer, optimal only with a gap that is closed; the message says whose bound it is.

        Parameters
        ----------
        algorithm : str
            "auto": SCIP where it is installed, else branch and bound.
        **options
            Of :func:`lcp_plugin.problems.equilibria.branch_and_bound.minimize_over_solutions`; ``max_iterations`` is
            its ``max_nodes``, ``threads`` is taken and changes nothing.

        Raises
        ------
        InvalidOption
            For any other.
        """
        from ...problems.equilibria.branch_and_bound import (
            minimize_over_solutions,
        )  # which loads more

        wishes = _of_search({**options, "algorithm": algorithm})
        result = minimize_over_solutions(self.problem, **{"x0": self.start_or_none(), **wishes})
        x, duals, objective, status, wrong = None, None, None, result.status, ""
        if result.x is not None:
            x, duals = (
                self.variables(result.x[: self.unknowns.size]),
                np.zeros(self.content.row_lower.size),
            )
            duals[self.pairs] = result.x[self.columns]
            objective, wrong = self._as_stated(x, duals, result.value)
        if wrong and result.is_solved:
            status = Status.STALLED
        words = (
            wrong
            if wrong and result.is_solved
            else "optimal"
            if result.is_solved
            else status.name.lower()
        )
        of = "" if self.sign > 0.0 else " (of minus the objective)"
        reached = "" if result.has_no_solution else f"{result.reached()}{of}, "
        nodes = f"{result.nodes} node{'s' * (result.nodes != 1)}"
        advice = "" if result.is_solved or result.has_no_solution else f"; {result.advice}"
        message = f"lcp_plugin {__version__}: {words}; {reached}{nodes}{advice}"
        return NLAnswer(x, duals, status, message, result, objective, CODES[status])

    def _as_stated(self, x: FloatVector, duals: FloatVector, value: float) -> tuple[float, str]:
        """Return the objective as the file states it, and what its rows say against the answer, if anything."""
        content, values = self.content, evaluated(self.content, x)
        within = np.clip(values.rows, content.row_lower, content.row_upper)
        within[self.pairs] = duals[self.pairs]
        objective = float(values.objectives[0]) if values.objectives.size else 0.0
        bound = (
            self.sign * value + 0.0,
            (abs(value) + float(values.objective_sizes[:1].sum())) / OBJECTIVE,
        )
        return objective, contradiction(
            content, values, within, FEASIBLE, objective=bound, relative=FEASIBLE
        )


def _of_search(options: dict[str, Any]) -> dict[str, Any]:
    """Return the options that a search takes, of those of any model; raise InvalidOption for any other wish."""
    from ...problems.equilibria.branch_and_bound import OPTIONS

    plain = {one.name: one.default for one in fields(Settings)} | {"algorithm": "auto"}
    given = {name: wish for name, wish in options.items() if wish is not None}
    wishes = {name: wish for name, wish in given.items() if name in (*OPTIONS, *TAKEN)}
    for name, wish in given.items():
        if name not in wishes and wish != plain.get(name):
            raise InvalidOption(
                f"an objective beside complementarities is minimised by SCIP or branch and bound, which takes no "
                f"{name}, got {wish!r}; leave it out; taken are {', '.join(TAKEN)}"
            )
    wishes.pop("threads", None)
    if "max_iterations" in wishes:
        wishes["max_nodes"] = wishes.pop("max_iterations")
    return wishes
