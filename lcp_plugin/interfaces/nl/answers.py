"""The models of ``.nl`` files solved, and the answers in the file's own variables and rows."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import scipy.sparse as sp

from ... import __version__
from ...core.checks import FloatVector
from ...core.errors import InvalidOption, UnsupportedModel
from ...core.lcp import LCP
from ...core.representation import format_count
from ...core.settings import Settings, Status
from ...core.solving.base_result import Outcome
from ...core.solving.result import Result
from ...expressions.statement import SquareModel, mismatches, solve_from
from ...problems.equilibria.equilibrium_program import EquilibriumProgram
from ...problems.nonlinear.data import NonlinearProblem
from ...problems.programs.program import QuadraticProgram
from ...problems.programs.solving import QuadraticProgramResult, solve_program
from .checks import FEASIBLE, SideConditions, evaluated, pair_bounds, sizes_of
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
MAX_SEARCH_NODES = 1000  # of a search that the user did not request
OBJECTIVE = 1e-3  # tolerance for the objective: an expanded one has lost digits


@dataclass(frozen=True, eq=False)
class NLAnswer(Outcome):
    """Result of a run, in the variables and rows of the file.

    Attributes
    ----------
    x : ndarray, shape (n,), or None
        None if a search found no solution.
    duals : ndarray, shape (m,), or None
        For a complementarity row the value w. For a row of a program the derivative of the objective by the row's
        right-hand side, the convention of AMPL. 0 for the other rows of a complementarity problem.
    status : Status
    message : str
        One line: outcome, residual, iterations.
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


@dataclass(eq=False, repr=False)
class NLModel(ABC):
    """Problem that an ``.nl`` file states.

    Attributes
    ----------
    content : NLContent
    problem : LCP, NonlinearProblem, QuadraticProgram or EquilibriumProgram
    unknowns : ndarray of int
        Variable of the file that each unknown is.
    known : ndarray, shape (n,)
        Values of the variables that are not unknowns.
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

    def variables(self, values: FloatVector) -> FloatVector:
        """Return all variables, shape (n,), from the values of the unknowns."""
        x = self.known.copy()
        x[self.unknowns] = values
        return x

    def names(self) -> list[str]:
        """Return the names of the variables, or of their numbers if the file has no names."""
        return [*map(self.content.variable, range(self.content.lower.size))]

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.problem})"

    def _message(self, words: str, residual: float, iterations: int) -> str:
        return f"lcp_plugin {__version__}: {words}; residual {residual:.1e}, {format_count(iterations, 'iteration')}"


@dataclass(eq=False, repr=False)
class ComplementarityModel(NLModel):
    """A complementarity problem or a system; from n on, unknowns are defined variables.

    Attributes
    ----------
    arrangement : SquareModel
        The problem in fewer unknowns, with definitions substituted.
    pairs : ndarray of int
        The complementarity rows.
    beside : SideConditions
        Conditions that are checked at the solution.
    order : ndarray of int
        Numbers of the rows as the arrangement has them: pairs, then equations; from m on, of defined variables.
    search : callable
        Returns the model of all conditions, which is solved if a solution violates some.
    """

    problem: LCP | NonlinearProblem
    arrangement: SquareModel
    pairs: Indices
    beside: SideConditions
    order: Indices
    search: Callable[[], NLModel]

    @property
    def start(self) -> FloatVector:
        """The start in the unknowns of the problem; the value nearest to 0 for unknowns without a start in the file."""
        content = self.content
        start = np.clip(content.start, content.lower, content.upper)
        start = np.append(start, np.zeros(content.defined_trees.size))
        return start[self.unknowns][self.arrangement.elimination.kept]

    def solve(self, algorithm: Any = "auto", **options: Any) -> NLAnswer:
        """Return the answer; see :meth:`NLModel.solve`."""
        is_started = self.content.has_start.any() or self.beside.bounded.size
        options = {"algorithm": algorithm, **options}
        found = solve_from(self.problem, self.start if is_started else None, options)
        x, duals = self.values(found.z, found.w)
        status, words = found.status, found.status.name.lower()
        if status is Status.SOLVED:
            rows = evaluated(self.content, x)[0]
            wrong = self._misreading(rows, found)
            tolerance = options.get("tolerance", Settings.tolerance)
            if not wrong and (wrong := self.beside.violated(x, rows, tolerance)):
                if (other := self._another(options, found)) is not None:
                    why = f"; {wrong}" if other.result.has_no_solution else ""
                    return replace(other, message=other.message + why)
                wrong += ", and no other solution was found"
            status, words = (Status.STALLED, wrong) if wrong else (status, words + self._remark(x))
        message = self._message(words, found.residual, found.iterations)
        return NLAnswer(x, duals, status, message, found, None, CODES[status])

    def _another(self, options: dict[str, Any], found: Result) -> NLAnswer | None:
        """Return a solution of the pairs that meets all conditions, or a proof that there is none; else None."""
        if (limit := options.get("max_seconds")) is not None:
            limit = max(limit - found.seconds, 0.0)
        try:
            other = self.search().solve(max_iterations=MAX_SEARCH_NODES, max_seconds=limit)
        except UnsupportedModel:
            return None
        return other if other.is_solved or other.result.has_no_solution else None

    def _remark(self, x: FloatVector) -> str:
        """Return the name of a variable at a bound that its pair does not state; else ""."""
        content, at = self.content, x[self.content.partners[self.pairs]]
        both = (pair_bounds(content, self.pairs, as_stated=one) for one in (False, True))
        for word, own, stated in zip(("lower", "upper"), *both, strict=True):
            is_near = np.abs(at - own) <= FEASIBLE * np.maximum(1.0, np.abs(own))
            for k in self.pairs[is_near & (own != stated)][:1].tolist():
                j = content.partners[k]
                return (
                    f"; {content.variable(j)} stops at its own {word} bound {x[j]:g}, which counts although "
                    f"its complementarity, {content.row(k)}, does not state it"
                )
        return ""

    def _misreading(self, rows: FloatVector, result: Result) -> str:
        """Return the name of a row of the file that differs from its computed value; else ""."""
        content, order = self.content, self.order
        is_row = order < rows.size
        limits, stated = (
            np.where(content.partners >= 0, 0.0, content.row_lower),
            np.zeros(order.size),
        )
        stated[is_row] = (rows - limits)[order[is_row]]
        # Equations, also definitions of variables, may leave a residual.
        kept = self.unknowns[self.arrangement.elimination.kept]
        is_of_pair = np.isin(kept, content.partners[self.pairs])
        slip = float(np.abs(result.w[~is_of_pair]).max(initial=0.0))
        found = self.arrangement.first_mismatch(result.z, result.w, stated, slip)
        if found is None:
            return ""
        k = int(order[found[0]])
        return _mismatch(content.row(k), rows[k], found[1] + limits[k])

    def values(self, z: FloatVector, w: FloatVector) -> tuple[FloatVector, FloatVector]:
        """Return the variables, and the values of the complementarity rows, 0 for other rows."""
        elimination = self.arrangement.elimination
        n, duals = self.known.size, np.zeros(self.content.row_lower.size)
        x, slack = np.append(self.known, np.zeros(self._size - n)), np.zeros(self._size)
        x[self.unknowns] = elimination.expand(z)
        slack[self.unknowns] = elimination.expand_slack(w)
        duals[self.pairs] = slack[self.content.partners[self.pairs]]
        return x[:n], duals

    @property
    def _size(self) -> int:
        return self.known.size + self.content.defined_trees.size


@dataclass(eq=False, repr=False)
class ProgramModel(NLModel):
    """A convex quadratic or linear program; without an objective, the search for a feasible point.

    Attributes
    ----------
    sign : float
        −1 if the file maximizes the objective.
    matrix : CSR array, shape (k, unknowns)
        The rows of the program are matrix · unknowns + constants.
    constants : ndarray, shape (k,)
    rows : ndarray of int, shape (k,)
        Their numbers in the file: rows without limits are left out.
    """

    problem: QuadraticProgram
    sign: float
    matrix: sp.csr_array
    constants: FloatVector
    rows: Indices

    def solve(self, algorithm: Any = "auto", **options: Any) -> NLAnswer:
        """Return the answer, infeasible or unbounded only with a proof, ``answer.result.proof``."""
        found = solve_program(self.problem, algorithm, **options)
        status = found.status
        x = self.variables(found.solution.x)
        values, objectives = evaluated(self.content, x)
        # As the file states it: expanded, (x - 10⁶)² has lost ten digits.
        objective = float(objectives[0]) if objectives.size else 0.0
        words = "optimal" if found.is_solved else status.name.lower()
        if status is Status.SOLVED and (wrong := self._misreading(values, objective, found)):
            status, words = Status.STALLED, wrong
        has_objective = found.proof is None
        words += f", objective {objective:.9g}" if has_objective else ""
        # The residuals of the program, on which the status relies, not the residuals of its optimality conditions.
        message = self._message(words, found.solution.error, found.iterations)
        duals = np.zeros(self.content.row_lower.size)
        duals[self.rows] = -self.sign * found.solution.row_multipliers + 0.0
        told = objective if has_objective else None
        return NLAnswer(x, duals, status, message, found, told, CODES[status])

    def _misreading(
        self, values: FloatVector, objective: float, found: QuadraticProgramResult
    ) -> str:
        """Return the name of a row or objective that differs between file and program; else ""."""
        x, values = found.solution.x, values[self.rows]
        rows = self.matrix @ x + self.constants
        for k in mismatches(values, rows, abs(self.matrix) @ np.abs(x) + np.abs(self.constants)):
            return _mismatch(self.content.row(int(self.rows[k])), values[k], rows[k])
        computed, terms = self.sign * found.solution.objective, _objective_terms(self.problem, x)
        is_wrong = mismatches(objective, computed, terms).size > 0
        return _mismatch("the objective", objective, computed) if is_wrong else ""


@dataclass(eq=False, repr=False)
class EquilibriumModel(NLModel):
    """A program with complementarity constraints, in the variables and the values of the complementarity rows.

    Attributes
    ----------
    sign : float
        −1 if the file maximizes the objective.
    pairs, columns : ndarray of int
        The complementarity rows, and the unknowns that are their values.
    """

    problem: EquilibriumProgram
    sign: float
    pairs: Indices
    columns: Indices

    def start_or_none(self) -> FloatVector | None:
        """Return the start in the unknowns of the problem; None if the file names none, or a row has no value."""
        x = np.zeros(self.problem.program.n)
        x[: self.unknowns.size] = self.content.start[self.unknowns]
        rows = evaluated(self.content, self.variables(x[: self.unknowns.size]))[0]
        x[self.columns] = rows[self.pairs]
        return x if self.content.has_start.any() and np.isfinite(x).all() else None

    def solve(self, algorithm: Any = "auto", **options: Any) -> NLAnswer:
        """Return the answer, optimal only with a closed gap; the message names the bound's source.

        Parameters
        ----------
        algorithm : str
            "auto": SCIP if it is installed, else branch and bound.
        **options
            Options of :func:`~lcp_plugin.problems.equilibria.branch_and_bound.minimize_over_solutions`;
            ``max_iterations`` is its ``max_nodes``, ``threads`` is taken and changes nothing.

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
            x = self.variables(result.x[: self.unknowns.size])
            duals = np.zeros(self.content.row_lower.size)
            duals[self.pairs] = result.x[self.columns]
            objective, wrong = self._as_stated(x, duals, result.value)
        words = "optimal" if result.is_solved else status.name.lower()
        if wrong and result.is_solved:
            status, words = Status.STALLED, wrong
        of = "" if self.sign > 0.0 else " (of minus the objective)"
        reached = "" if result.has_no_solution else f"{result.describe_accuracy()}{of}, "
        nodes = f"{result.nodes} node{'s' * (result.nodes != 1)}"
        advice = "" if result.is_solved or result.has_no_solution else f"; {result.advice}"
        message = f"lcp_plugin {__version__}: {words}; {reached}{nodes}{advice}"
        return NLAnswer(x, duals, status, message, result, objective, CODES[status])

    def _as_stated(self, x: FloatVector, duals: FloatVector, value: float) -> tuple[float, str]:
        """Return the objective as the file states it, and the violation of its rows, if any."""
        content, sign = self.content, self.sign
        rows, objectives = evaluated(content, x)
        objective = float(objectives[0]) if objectives.size else 0.0
        sizes = sizes_of(content, x, np.arange(rows.size + objectives.size))
        within = np.clip(rows, content.row_lower, content.row_upper)
        within[self.pairs] = duals[self.pairs]
        terms = 1.0 + sizes[: rows.size] + np.abs(within)
        for k in mismatches(rows, within, terms, FEASIBLE * terms)[:1]:
            return objective, _mismatch(content.row(int(k)), rows[k], within[k])
        own = _objective_terms(self.problem.program, x[self.unknowns])
        most = abs(value) + own + float(sizes[rows.size :].sum())
        is_wrong = (
            objectives.size and mismatches(objective, sign * value, 0.0, OBJECTIVE * most).size
        )
        return objective, _mismatch("the objective", objective, sign * value) if is_wrong else ""


def _objective_terms(program: QuadraticProgram, x: FloatVector) -> float:
    """Return the sum of the absolute values of the objective's terms at the leading unknowns x."""
    own = np.zeros(program.n)
    own[: x.size] = np.abs(x)
    terms = own @ (0.5 * (abs(program.P) @ own) + np.abs(program.c))
    return float(terms) + abs(program.constant)


def _mismatch(name: str, value: float, computed: float) -> str:
    return f"{name} is {value:.9g} at the answer, where {computed:.9g} was computed"


def _of_search(options: dict[str, Any]) -> dict[str, Any]:
    """Return the options that a search takes; raise InvalidOption for others."""
    from ...problems.equilibria.branch_and_bound import OPTIONS

    taken = {name: wish for name, wish in options.items() if name != "threads"}
    wishes = {name: wish for name, wish in taken.items() if (name, wish) != ("algorithm", "auto")}
    if "max_iterations" in wishes:
        wishes["max_nodes"] = wishes.pop("max_iterations")
    for name in wishes.keys() - {*OPTIONS}:
        raise InvalidOption(
            f"an objective with complementarities is minimized by SCIP or branch and bound, which has no option "
            f"{name}, got {wishes[name]!r}; leave it out; the options are {', '.join(OPTIONS)}"
        )
    return wishes
