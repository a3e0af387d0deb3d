"""The problem that an ``.nl`` file states, its solution, and the side conditions, in the file's variables and rows.

Side conditions are inequalities without a partner and bounds of variables without a complementarity. Bounds of a
variable with a complementarity all belong to it, stated there or not, as PATH and AMPL take them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import compress
from os import PathLike
from typing import Any

import numpy as np
import scipy.sparse as sp

from ... import __version__
from ...core.checks import BoolVector, Indices, Vector, fill, normalize_bounds
from ...core.errors import InvalidProblem, UnsupportedModel
from ...core.lcp import LCP
from ...core.names import format_count
from ...core.problem_classes import with_article
from ...core.settings import Settings, Status
from ...expressions.rows import Program, Rows
from ...judges.worst_rows import WorstRow, outside_row
from ...problems.nonlinear.data import NonlinearProblem
from ...problems.programs.certification import (
    Certification,
    certify,
    certify_point,
    with_side_conditions,
)
from ...problems.programs.program import QuadraticProgram
from ...problems.programs.solving import solve_program
from ...problems.statement import STATUS_ELSEWHERE, SquareModel, Statement, solve_from
from ...solving.dispatch import solve
from ...solving.result import Outcome, Result
from .expressions import UNKNOWNS, Expressions
from .reading import NLContent, read_content, variables_in

SIDE_CONDITION = 1e-6  # by which a side condition may be violated, or ten times the tolerance


def values_and_slopes(content: NLContent, x: Vector, rows: Indices) -> tuple[Vector, sp.csr_array]:
    """Return the values of rows, then objectives, with these numbers, and their derivatives by all variables."""
    expressions = Expressions(content, np.full(x.size, np.nan), adds_unknowns=False)
    program = Program.of(expressions.compiler, [expressions.rows(rows)], {UNKNOWNS: 0}, x.size)
    return program.value(x), program.jacobian(x)


# --- Side conditions -----------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class SideConditions:
    """Side conditions of a complementarity problem.

    Attributes
    ----------
    content : NLContent
    inequalities : ndarray of int
        Rows without a partner.
    bounded : ndarray of int
        Variables with bounds and without a complementarity.
    """

    content: NLContent
    inequalities: Indices
    bounded: Indices

    def names(self) -> list[str]:
        """Return the names: inequalities, variables."""
        content = self.content
        rows, variables = self.inequalities.tolist(), self.bounded.tolist()
        return [*map(content.row, rows), *map(content.variable, variables)]

    def violated(self, x: Vector, tolerance: float) -> list[WorstRow]:
        """Return the conditions that x violates by more than a tolerance, the worst first."""
        content, inner = self.content, self.inequalities
        if not (names := self.names()):
            return []
        rows, slopes = values_and_slopes(content, x, inner)
        bounded, steps = x[self.bounded], 1.0 + np.abs(x)
        values = np.append(rows, bounded)
        changes = np.append(abs(slopes) @ steps, steps[self.bounded])  # if all variables change
        lower = np.append(content.row_lower[inner], content.lower[self.bounded])
        upper = np.append(content.row_upper[inner], content.upper[self.bounded])
        excesses = np.nan_to_num(excess(values, lower, upper, changes), nan=np.inf, posinf=np.inf)
        bounds = np.where(values < lower, lower, upper)
        beyond = np.flatnonzero(excesses > tolerance).tolist()
        found = [outside_row(names[k], float(values[k]), float(bounds[k])) for k in beyond]
        residuals = zip(found, excesses[beyond].tolist(), strict=True)
        worst = [row._replace(residual=residual) for row, residual in residuals]
        return sorted(worst, key=lambda row: -row.residual)


def excess(body: Vector, lower: Vector, upper: Vector, changes: Vector) -> Any:
    """Return the violation of bounds relative to their size, at least 1, or to the row's change if that is less."""
    sizes = np.maximum(*(np.where(np.isfinite(end), np.abs(end), 0.0) for end in (lower, upper)))
    scales = np.where(changes > 0.0, changes, np.abs(body)) + sizes
    scales = np.minimum(np.maximum(1.0, sizes), scales)
    violations = np.maximum(np.maximum(lower - body, body - upper), 0.0)
    return violations / np.where(scales > 0.0, scales, 1.0)


@dataclass(frozen=True, eq=False)
class NLAnswer(Outcome):
    """Result of a run, in the variables and rows of the file.

    Attributes
    ----------
    x : ndarray, shape (n,), or None
        None if a search found no solution, or a proof shows that none exists.
    duals : ndarray, shape (m,), or None
        For a complementarity row the value w. For a row of a program the derivative of the objective by the row's
        right-hand side, the convention of AMPL. 0 for the other rows of a complementarity problem.
    status : Status
    message : str
        One line: outcome, residual, iterations.
    result : Result, QuadraticProgramResult or EquilibriumResult
    objective : float or None
    """

    x: Vector | None
    duals: Vector | None
    status: Status
    message: str
    result: Any = field(repr=False)
    objective: float | None

    def __post_init__(self) -> None:
        """Keep no vector next to a proof that no solution exists."""
        if self.has_no_solution:
            fill(self, x=None, duals=None)

    @property
    def code(self) -> int:
        """AMPL's number for the status."""
        return STATUS_ELSEWHERE[self.status][0]


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
    known: Vector

    @abstractmethod
    def solve(self, algorithm: object = "auto", **options: Any) -> NLAnswer:
        """Return the answer.

        Parameters
        ----------
        algorithm, **options
            Of :func:`lcp_plugin.solve`, or :func:`lcp_plugin.problems.nonlinear.solving.solve_nonlinear` for a smooth
            model.
        """

    def variables(self, values: Vector) -> Vector:
        """Return all variables, shape (n,), from the values of the unknowns."""
        x = np.append(self.known, np.zeros(len(self.content.defined_trees)))
        x[self.unknowns] = values
        return x[: self.known.size]

    def starts(self) -> Vector:
        """Return the start of each unknown, 0 for defined variables."""
        start = np.append(self.content.start, np.zeros(len(self.content.defined_trees)))
        return start[self.unknowns]

    def objective(self, x: Vector) -> float:
        """Return the objective as the file states it: expanded, (x - 10⁶)² loses ten digits."""
        if not self.content.is_maximized.size:
            return 0.0
        first = np.array([self.content.row_lower.size])
        return float(values_and_slopes(self.content, x, first)[0][0])

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
    side_conditions : SideConditions
        Conditions that are checked at the solution; if it violates some, the model of all conditions is solved.
    """

    problem: LCP | NonlinearProblem
    arrangement: SquareModel
    pairs: Indices
    side_conditions: SideConditions

    @property
    def start(self) -> Vector:
        """The start in the unknowns of the problem; the value nearest to 0 for unknowns without a start in the file."""
        return self.starts()[self.arrangement.elimination.kept]

    def solve(self, algorithm: object = "auto", **options: Any) -> NLAnswer:
        """Return the answer; see :meth:`NLModel.solve`."""
        is_started = self.content.has_start.any() or self.side_conditions.bounded.size
        options = {"algorithm": algorithm, **options}
        result = solve_from(self.arrangement, self.start if is_started else None, options)
        x, duals = self.values(result.z, result.w)
        status, words = result.status, result.status.name.lower()
        if status is Status.SOLVED:
            tolerance = options.get("tolerance", Settings.tolerance)
            if wrong := self._violated(x, max(SIDE_CONDITION, 10.0 * tolerance)):
                if (other := self._another(options, result)) is not None:
                    why = f"; {wrong}" if other.result.has_no_solution else ""
                    return replace(other, message=other.message + why)
                status, words = Status.STALLED, f"{wrong}, and no other solution was found"
        message = self._message(words, result.residual, result.iterations)
        return NLAnswer(x, duals, status, message, result, None)

    def _violated(self, x: Vector, tolerance: float) -> str:
        """Return the names of the side conditions that are violated at x; else ""."""
        if not (rows := self.side_conditions.violated(x, tolerance)):
            return ""
        others = f", nor {len(rows) - 1} more" if len(rows) > 1 else ""
        what = f"{rows[0].name} does not hold{others}, off by {rows[0].residual:.2g}"
        return f"the complementarities and equations are solved, but {what}"

    def _another(self, options: dict[str, Any], result: Result) -> NLAnswer | None:
        """Return a solution of the pairs that meets all conditions, or a proof that there is none; else None."""
        if (limit := options.get("max_seconds")) is not None:
            limit = max(limit - result.seconds, 0.0)
        try:
            other = FileStatement(self.content).best().solve(max_iterations=1000, max_seconds=limit)
        except UnsupportedModel:
            return None
        return other if other.is_solved or other.result.has_no_solution else None

    def values(self, z: Vector, w: Vector) -> tuple[Vector, Vector]:
        """Return the variables, and the values of the complementarity rows, 0 for other rows."""
        elimination = self.arrangement.elimination
        slack = np.zeros(self.known.size + len(self.content.defined_trees))
        slack[self.unknowns] = elimination.expand_slack(w)
        duals = np.zeros(self.content.row_lower.size)
        duals[self.pairs] = slack[self.content.partners[self.pairs]]
        return self.variables(elimination.expand(z)), duals


@dataclass(eq=False, repr=False)
class ProgramModel(NLModel):
    """A convex quadratic or linear program; without an objective, the search for a feasible point.

    Attributes
    ----------
    sign : float
        −1 if the file maximizes the objective.
    rows : ndarray of int, shape (k,)
        Numbers in the file of the program's rows: rows without limits are left out.
    """

    problem: QuadraticProgram
    sign: float
    rows: Indices

    def solve(self, algorithm: object = "auto", **options: Any) -> NLAnswer:
        """Return the answer, infeasible or unbounded only with a proof, ``answer.result.proof``."""
        result = solve_program(self.problem, algorithm, **options)
        status = result.status
        x = self.variables(result.solution.x)
        objective = self.objective(x) if result.proof is None else None
        words = "optimal" if result.is_solved else status.name.lower()
        words += "" if objective is None else f", objective {objective:.9g}"
        # The residuals of the program, on which the status relies, not the residuals of its optimality conditions.
        message = self._message(words, result.solution.error, result.iterations)
        duals = np.zeros(self.content.row_lower.size)
        duals[self.rows] = -self.sign * result.solution.row_multipliers[: self.rows.size] + 0.0
        return NLAnswer(x, duals, status, message, result, objective)


@dataclass(eq=False, repr=False)
class EquilibriumModel(NLModel):
    """A program with complementarity constraints, in the variables and the values of the complementarity rows.

    Attributes
    ----------
    pairs, columns : ndarray of int
        The complementarity rows, and the unknowns that are their values.
    """

    pairs: Indices
    columns: Indices

    def start_or_none(self) -> Vector | None:
        """Return the start in the unknowns of the problem; None if the file names none, or a row has no value."""
        x = np.zeros(self.problem.program.n)
        x[: self.unknowns.size] = self.starts()
        variables = self.variables(x[: self.unknowns.size])
        x[self.columns] = values_and_slopes(self.content, variables, self.pairs)[0]
        return x if self.content.has_start.any() and np.isfinite(x).all() else None

    def solve(self, algorithm: object = "auto", **options: Any) -> NLAnswer:
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
        options.pop("threads", None)
        if "max_iterations" in options:
            options["max_nodes"] = options.pop("max_iterations")
        result = solve(self.problem, algorithm, **{"x0": self.start_or_none(), **options})
        x, duals, objective, status = None, None, None, result.status
        if result.objective is not None:
            x = self.variables(result.x[: self.unknowns.size])
            duals = np.zeros(self.content.row_lower.size)
            duals[self.pairs] = result.x[self.columns]
            objective = self.objective(x)
        words = "optimal" if result.is_solved else status.name.lower()
        reached = "" if result.has_no_solution else f"{result.describe_accuracy()}, "
        advice = "" if result.is_solved or result.has_no_solution else f"; {result.advice}"
        message = f"lcp_plugin {__version__}: {words}; {reached}{format_count(result.nodes, 'node')}{advice}"
        return NLAnswer(x, duals, status, message, result, objective)


def read_nl(path: str | PathLike[str]) -> NLModel:
    """Return the model that an ``.nl`` file states, text or binary.

    Parameters
    ----------
    path : str or Path

    Raises
    ------
    UnreadableFile
        If the file is missing or corrupt.
    UnsupportedModel
        Names the row or variable that is not supported.
    """
    return model_of(read_content(path))


def model_of(content: NLContent) -> NLModel:
    """Return the model that the content of an ``.nl`` file states.

    Raises
    ------
    UnsupportedModel
        Naming the row or variable that is not taken.
    """
    start = np.clip(content.start, content.lower, content.upper)
    return _model_of(FileStatement(replace(content, start=start)))


def _model_of(statement: FileStatement) -> ComplementarityModel | ProgramModel | EquilibriumModel:
    content = statement.content
    has_goal = statement.has_objective() or content.is_integer.any()
    is_square = statement.is_complementarity_problem() and not (statement.pairs.size and has_goal)
    return statement.complementarities() if is_square else statement.best()


def certify_values(content: NLContent, tolerance: float) -> Certification:
    """Return the verdict on the starts of the variables, unchanged, measured in all rows and bounds of the file.

    Raises
    ------
    InvalidProblem
        If a variable has no finite value, or the file has neither an objective nor complementarities.
    """
    for k in np.flatnonzero(~(content.has_start & np.isfinite(content.start)))[:1].tolist():
        value = f"the value {content.start[k]}" if content.has_start[k] else "no value"
        raise InvalidProblem(f"{content.variable(k)} has {value}; solve, or set a number first")
    statement, start = FileStatement(content), content.start
    is_bounded = np.isfinite(content.lower) | np.isfinite(content.upper)
    bounded = np.flatnonzero(is_bounded & ~statement.is_paired)
    conditions = SideConditions(content, statement.inequalities, bounded)
    if not (statement.pairs.size or content.is_maximized.size) and conditions.names():
        raise InvalidProblem(
            "the model has bounds or inequalities, but neither an objective nor complementarities to certify; give "
            'certify(model, pairs="match") if it is square, or add an Objective'
        )
    model = _model_of(statement)
    x = statement.expressions.all_values(start)
    if isinstance(model, ComplementarityModel):
        problem, z, violated = model.arrangement.at_values(x, tolerance, statement.name)
        certification = certify_point(problem, z, tolerance)
        violated += conditions.violated(start, tolerance)
    else:
        certification = certify(model.problem, x, tolerance=tolerance)
        known = np.flatnonzero(~np.isnan(statement.known))
        violated = SideConditions(content, known[:0], known).violated(start, tolerance)
    return with_side_conditions(certification, violated)


def lcp_in_nl(path: str | PathLike[str]) -> LCP:
    """Return the LCP that an ``.nl`` file states; raise UnsupportedModel for any other problem."""
    model = read_nl(path)
    conditions = model.side_conditions.names() if isinstance(model, ComplementarityModel) else []
    if isinstance(model.problem, LCP) and not conditions:
        return model.problem
    kind = f"{with_article(type(model.problem).__name__)}, not an LCP"
    if conditions:
        kind = f"more than a complementarity problem: {conditions[0]} is a condition next to it"
    raise UnsupportedModel(
        f"{path} states {kind}; lcp_plugin.interfaces.nl.read_nl(path).solve() and `lcp-plugin solve` take it"
    )


class FileStatement:
    """Rows of a file, sorted by type.

    It is one class because the rows of each type are sorted once, for both types of models.

    Parameters
    ----------
    content : NLContent
    """

    def __init__(self, content: NLContent) -> None:
        self.content, self.n, self.m = content, content.lower.size, content.row_lower.size
        self.pairs = np.flatnonzero(content.partners >= 0)
        if content.is_integer.any() and not self.pairs.size:
            name = content.variable(int(np.flatnonzero(content.is_integer)[0]))
            raise UnsupportedModel(
                f"{name} is an integer variable; integer variables are supported only in models with "
                'complementarities, and need SCIP: write SolverFactory("scip"), or give it a continuous domain'
            )
        low, high = content.row_lower, content.row_upper
        self._check_crossed(content.variable, content.lower, content.upper)
        self._check_crossed(content.row, low, high)
        is_row, is_bounded = content.partners < 0, np.isfinite(low) | np.isfinite(high)
        self.equations = np.flatnonzero(is_row & (low == high))
        self.inequalities = np.flatnonzero(is_row & (low != high) & is_bounded)
        self.has_no_bounds = is_row & ~is_bounded
        self.is_paired = np.zeros(self.n, dtype=bool)
        self.is_paired[content.partners[self.pairs]] = True
        self.known = self._known(self.has_no_bounds)
        self.expressions = Expressions(content, self.known)
        self.is_affine = self.expressions.is_affine()[: self.m] | self.has_no_bounds

    def _check_crossed(self, call: Callable[[int], str], low: Vector, high: Vector) -> None:
        """Raise if a lower bound is above an upper bound."""
        for k in np.flatnonzero(low > normalize_bounds(low, high)[1])[:1].tolist():
            raise UnsupportedModel(f"{call(k)}: lower bound {low[k]:g} > {high[k]:g}; correct one")

    def _known(self, leaves_out: BoolVector) -> Vector:
        """Return the values of fixed variables and of variables that occur in no remaining row."""
        content, occurs = self.content, self.is_paired.copy()
        for trees, linear in (
            (compress(content.trees, ~leaves_out), content.linear[~leaves_out]),
            (content.objective_trees, content.objective_linear),
            (content.defined_trees, content.defined_linear),
        ):
            columns = np.append(variables_in(trees), linear.nonzero()[1])
            occurs[columns[columns < self.n]] = True
        is_known = ~self.is_paired & ((content.lower == content.upper) | ~occurs)
        return np.where(is_known, content.start, np.nan)

    def is_complementarity_problem(self) -> bool:
        """Return whether the file has an objective, or affine rows that are not square."""
        if self.pairs.size:
            return True
        if self.has_objective():
            return False
        if not self.is_affine.all():
            return bool(self.expressions.matrix[self.equations].nnz)
        if self.inequalities.size:
            return False
        unknowns = np.flatnonzero(np.isnan(self.known))
        lower, upper = self.content.lower[unknowns], self.content.upper[unknowns]
        is_free = np.isneginf(lower) & np.isposinf(upper)
        return bool(is_free.all()) and unknowns.size == self.equations.size > 0

    def has_objective(self) -> bool:
        """Return whether there is an objective that is not constant."""
        return bool(self.content.is_maximized.size and self.expressions.matrix[[self.m]].nnz)

    def best(self) -> ProgramModel | EquilibriumModel:
        """Return the program, with complementarity constraints if there are pairs."""
        content, expressions, m = self.content, self.expressions, self.m
        unknowns = expressions.unknowns
        others = np.flatnonzero((content.partners < 0) & ~self.has_no_bounds)
        stated = self._statement()
        integers = np.flatnonzero(content.is_integer[unknowns[unknowns < self.n]])
        for part in self._parts(others):
            ends = content.row_lower[part], content.row_upper[part]
            stated.constrain(expressions.rows(part), *ends, name=content.rows_of(part))
        if expressions.definitions.size:
            stated.constrain(expressions.rows(expressions.definitions))
        # With an objective a pair has the bounds that it states, otherwise all of its variable
        has_goal = self.has_objective() or content.is_integer.any()
        for part in (pairs := self._parts(self.pairs)):
            columns, bits = content.partners[part], content.partner_bounds[part] if has_goal else 3
            lower = np.where(bits & 1, content.lower[columns], -np.inf)
            upper = np.where(bits & 2, content.upper[columns], np.inf)
            row, name = expressions.rows(part), content.rows_of(part)
            stated.complement(expressions.place[columns], row, lower, upper, name=name)
        has_objective = bool(content.is_maximized.size)
        sign = -1.0 if has_objective and content.is_maximized[0] else 1.0
        goal = expressions.rows(np.array([m])) if has_objective else Rows({}, np.zeros(1), (1,))
        problem = stated.best(goal, sign, integers)
        if pairs:
            rows = np.concatenate(pairs)
            return EquilibriumModel(content, problem, unknowns, self.known, rows, problem.second)
        if not self.is_affine.all():
            first = content.row(np.flatnonzero(~self.is_affine)[0])
            raise UnsupportedModel(
                f"{first} is nonlinear: inequalities, and rows of a program without complementarities, must be affine; "
                "write it as a complementarity, add an objective, or state one equation per variable without a pair"
            )
        if problem.smooth is not None:
            raise UnsupportedModel("the objective is not quadratic; give a convex quadratic one")
        return ProgramModel(content, problem.program, unknowns, self.known, sign, others)

    def _parts(self, rows: Indices) -> list[Indices]:
        """Return the affine rows, then the others; no empty part."""
        is_affine = self.expressions.is_affine()[rows]
        return [part for part in (rows[is_affine], rows[~is_affine]) if part.size]

    def complementarities(self) -> ComplementarityModel:
        """Return the complementarity problem."""
        if self.inequalities.size:
            is_inequality = np.isin(np.arange(self.m), self.inequalities)
            self.known = self._known(self.has_no_bounds | is_inequality)
            self.expressions = Expressions(self.content, self.known)
        content, expressions = self.content, self.expressions
        pairs, equations = self.pairs, np.append(self.equations, expressions.definitions)
        right = np.append(content.row_lower, np.zeros(expressions.offset.size - self.m))
        equations = self._without_empty(equations, right)
        statement = self._statement()
        for part in self._parts(pairs):
            z = expressions.place[content.partners[part]]
            ends = statement.lower[z], statement.upper[z]
            statement.complement(z, expressions.rows(part), *ends, name=content.rows_of(part))
        for part in self._parts(equations):
            ends = right[part], right[part]
            statement.constrain(expressions.rows(part), *ends, name=content.rows_of(part))
        # Arrays of the model's language are not known: unknowns without a pair count as one variable.
        arrangement = statement.square((~statement.is_paired).astype(np.int64))
        unknowns = expressions.unknowns
        conditions = SideConditions(content, self.inequalities, unknowns[arrangement.dropped])
        model = content, arrangement.problem, unknowns, self.known
        return ComplementarityModel(*model, arrangement, pairs, conditions)

    def _statement(self) -> Statement:
        """Return the unknowns with their bounds."""
        content, unknowns = self.content, self.expressions.unknowns
        free = np.full(len(content.defined_trees), np.inf)
        ends = np.append(content.lower, -free)[unknowns], np.append(content.upper, free)[unknowns]
        return Statement(self.expressions.compiler, {UNKNOWNS: 0}, *ends, self.name)

    def name(self, column: int) -> str:
        """Return the name of an unknown."""
        return self.content.variable(int(self.expressions.unknowns[column]))

    def _without_empty(self, equations: Indices, right: Vector) -> Indices:
        """Leave out the equations that have no unknown; raise if they are violated."""
        content, expressions = self.content, self.expressions
        is_empty = np.diff(expressions.matrix.indptr)[equations] == 0
        empty: Indices = equations[is_empty]
        if empty.size:
            known = np.nan_to_num(self.known)
            sizes = abs(values_and_slopes(content, known, empty)[1]) @ np.abs(known)
            sizes = np.where(np.isfinite(sizes), sizes, 0.0)
            off = expressions.offset[empty] - right[empty]
            wrong = np.abs(off) > 2.0**-40 * (sizes + np.abs(right[empty]))
            for k in np.flatnonzero(wrong)[:1]:
                raise UnsupportedModel(
                    f"{content.row(empty[k])} holds no unknown, and its sides differ by {off[k]:g}; correct it"
                )
        return equations[~is_empty]
