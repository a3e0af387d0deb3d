"""Problem that an ``.nl`` file states: a complementarity problem or a quadratic program."""

from __future__ import annotations

from collections.abc import Callable
from os import PathLike

import numpy as np
import scipy.sparse as sp

from ...core.checks import BoolVector, FloatVector
from ...core.errors import UnsupportedModel
from ...core.lcp import LCP
from ...expressions.rows import Rows
from ...expressions.statement import Statement
from ...problems.programs.program import QuadraticProgram
from .answers import ComplementarityModel, EquilibriumModel, NLModel, ProgramModel
from .checks import SideConditions, pair_bounds, sizes_of
from .content import Indices, NLContent, Token
from .expressions import UNKNOWNS, Expressions
from .reading import read_content

KINDS = {
    "QuadraticProgram": "a quadratic program",
    "EquilibriumProgram": "an objective with complementarities",
}
ROUNDING = 2.0**-40  # of the terms of a row without unknowns


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
    statement = FileStatement(content)
    has_goal = statement.has_objective() or content.is_integer.any()
    is_square = statement.is_complementarity_problem() and not (statement.pairs.size and has_goal)
    return statement.complementarities() if is_square else statement.best()


def lcp_in_nl(path: str | PathLike[str]) -> LCP:
    """Return the LCP that an ``.nl`` file states; raise UnsupportedModel for any other problem."""
    model = read_nl(path)
    beside = model.beside.names() if isinstance(model, ComplementarityModel) else []
    if isinstance(model.problem, LCP) and not beside:
        return model.problem
    kind = KINDS.get(type(model.problem).__name__, "a nonlinear complementarity problem")
    kind = f"{kind}, not a linear complementarity problem"
    if beside:
        kind = f"more than a complementarity problem: {beside[0]} is a condition next to it"
    raise UnsupportedModel(
        f"{path} states {kind}; lcp_plugin.interfaces.nl.read_nl(path).solve() and `lcp-plugin solve` take it"
    )


def program_in_nl(path: str | PathLike[str]) -> QuadraticProgram:
    """Return the program of an ``.nl`` file, to be minimized; else raise."""
    model = read_nl(path)
    if isinstance(model, ProgramModel):
        return model.problem
    raise UnsupportedModel(
        f"{path} states complementarities or equations, not a program; `lcp-plugin solve` takes it"
    )


class FileStatement:
    """Rows of a file, sorted by type.

    Parameters
    ----------
    content : NLContent
    """

    def __init__(self, content: NLContent) -> None:
        self.content, self.n, self.m = (content, content.lower.size, content.row_lower.size)
        self._refuse_discrete()
        low, high = content.row_lower, content.row_upper
        self._check_crossed(content.variable, content.lower, content.upper)
        self._check_crossed(content.row, low, high)
        is_pair = content.partners >= 0
        self.pairs = np.flatnonzero(is_pair)
        self.equations = np.flatnonzero(~is_pair & (low == high))
        is_bounded = np.isfinite(low) | np.isfinite(high)
        self.inequalities = np.flatnonzero(~is_pair & (low != high) & is_bounded)
        self.says_nothing = ~is_pair & ~is_bounded
        self.is_paired = np.zeros(self.n, dtype=bool)
        self.is_paired[content.partners[self.pairs]] = True
        self.known = self._known(self.says_nothing)
        self.expressions = Expressions(content, self.known)
        self.is_affine = self.expressions.is_affine()[: self.m] | self.says_nothing

    def _refuse_discrete(self) -> None:
        content = self.content
        if content.is_integer.any() and not (content.partners >= 0).any():
            name = content.variable(int(np.flatnonzero(content.is_integer)[0]))
            raise UnsupportedModel(
                f"{name} is an integer variable; integer variables are supported only in models with "
                "complementarities, and need SCIP: write "
                'SolverFactory("scip"), or give it a continuous domain'
            )

    def _check_crossed(
        self, call: Callable[[int], str], low: FloatVector, high: FloatVector
    ) -> None:
        """Raise if a lower bound is above an upper bound."""
        crossed = np.flatnonzero(low > high)
        if crossed.size:
            k = int(crossed[0])
            raise UnsupportedModel(
                f"{call(k)} has the lower bound {low[k]:g} above the upper bound {high[k]:g}: no point satisfies the "
                "model; correct one of them"
            )

    def _known(self, leaves_out: BoolVector) -> FloatVector:
        """Return the values of fixed variables and of variables that occur in no remaining row."""
        content, occurs = self.content, self.is_paired.copy()
        objectives, defined = content.objective_trees, content.defined_trees
        for trees, linear, is_kept in (
            (content.trees, content.linear, ~leaves_out),
            (objectives, content.objective_linear, np.ones(objectives.size, dtype=bool)),
            (defined, content.defined_linear, np.ones(defined.size, dtype=bool)),
        ):
            is_used = np.repeat(is_kept, np.diff(trees.starts)) & (trees.kinds == Token.VARIABLE)
            used = trees.values[is_used].astype(np.int64)
            columns = np.append(used, linear[is_kept].nonzero()[1])
            occurs[columns[columns < self.n]] = True
        is_known = ~self.is_paired & ((content.lower == content.upper) | ~occurs)
        return np.where(is_known, np.clip(content.start, content.lower, content.upper), np.nan)

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
        is_free = np.isneginf(self.content.lower[unknowns]) & np.isposinf(
            self.content.upper[unknowns]
        )
        return bool(is_free.all()) and unknowns.size == self.equations.size > 0

    def has_objective(self) -> bool:
        """Return whether there is an objective that is not constant."""
        row = self.expressions.matrix[[self.m]] if self.content.is_maximized.size else None
        return row is not None and row.nnz > 0

    def best(self) -> ProgramModel | EquilibriumModel:
        """Return the program, with complementarity constraints if there are pairs."""
        self._put_in_definitions()
        content, found, m = self.content, self.expressions, self.m
        own, place = found.unknowns, np.full(self.n, -1)
        place[own] = np.arange(own.size)
        others = np.flatnonzero((content.partners < 0) & ~self.says_nothing)
        stated = self._statement()
        stated.integers = np.flatnonzero(content.is_integer[own])
        for part in self._parts(others):
            stated.constrain(found.rows(part), content.row_lower[part], content.row_upper[part])
        as_stated = bool(self.has_objective() or content.is_integer.any())
        for part in (pairs := self._parts(self.pairs)):
            bounds = pair_bounds(content, part, as_stated=as_stated)
            stated.complement(place[content.partners[part]], found.rows(part), *bounds)
        has_objective = bool(content.is_maximized.size)
        sign = -1.0 if has_objective and content.is_maximized[0] else 1.0
        goal = found.rows(np.array([m])) if has_objective else Rows({}, np.zeros(1), (1,))
        problem = stated.best(goal, sign)
        if pairs:
            rows = np.concatenate(pairs)
            return EquilibriumModel(content, problem, own, self.known, sign, rows, problem.second)
        if not self.is_affine.all():
            row = content.row(np.flatnonzero(~self.is_affine)[0])
            raise UnsupportedModel(
                f"{row} is nonlinear: inequalities, and rows of a program without complementarities, must be affine; "
                "write it as a complementarity, add an objective, or state one equation per variable without a pair"
            )
        if problem.smooth is not None:
            raise UnsupportedModel(
                "the objective is neither linear nor quadratic; convex quadratic ones are taken"
            )
        A = sp.csr_array(found.matrix[others, : own.size])
        limits = A, found.offset[others], others
        return ProgramModel(content, problem.program, own, self.known, sign, *limits)

    def _parts(self, rows: Indices) -> list[Indices]:
        """Return the affine rows, then the others; no empty part."""
        is_affine = self.expressions.is_affine()[rows]
        return [part for part in (rows[is_affine], rows[~is_affine]) if part.size]

    def _put_in_definitions(self) -> None:
        """Let no defined variable be an unknown."""
        found = self.expressions
        if found.definitions.size:
            found.put_in(found.definitions, np.flatnonzero(found.unknowns >= self.n))

    def complementarities(self) -> ComplementarityModel:
        """Return the complementarity problem."""
        if self.inequalities.size:
            is_inequality = np.isin(np.arange(self.m), self.inequalities)
            self.known = self._known(self.says_nothing | is_inequality)
            self.expressions = Expressions(self.content, self.known)
        content, found = self.content, self.expressions
        pairs, equations = self.pairs, np.append(self.equations, found.definitions)
        right = np.append(content.row_lower, np.zeros(found.offset.size - self.m))
        equations = self._without_empty(equations, right)
        statement = self._statement()
        place = np.full(self.n + content.defined_trees.size, -1)
        place[found.unknowns] = np.arange(found.unknowns.size)
        order = [self._parts(pairs), self._parts(equations)]
        for part in order[0]:
            z = place[content.partners[part]]
            statement.complement(z, found.rows(part), statement.lower[z], statement.upper[z])
        for part in order[1]:
            statement.constrain(found.rows(part), right[part], right[part])
        # Arrays of the model's language are not known: unknowns without a pair count as one variable.
        arrangement = statement.square((~statement.is_paired).astype(np.int64))
        bounded = found.unknowns[arrangement.dropped]
        beside = SideConditions(content, self.inequalities, bounded)
        return ComplementarityModel(
            content,
            arrangement.problem,
            found.unknowns,
            self.known,
            arrangement,
            pairs,
            beside,
            np.concatenate([*order[0], *order[1]]),
            lambda: FileStatement(content).best(),
        )

    def _statement(self) -> Statement:
        """Return the unknowns with their bounds."""
        content, found = self.content, self.expressions
        free = np.full(content.defined_trees.size, np.inf)
        lower, upper = np.append(content.lower, -free), np.append(content.upper, free)
        return Statement(
            found.compiler,
            {UNKNOWNS: 0},
            lower[found.unknowns],
            upper[found.unknowns],
            lambda column: content.variable(int(found.unknowns[column])),
        )

    def _without_empty(self, equations: Indices, right: FloatVector) -> Indices:
        """Leave out the equations that have no unknown; raise if they are violated."""
        content, found = self.content, self.expressions
        is_empty = np.diff(found.matrix.indptr)[equations] == 0
        empty: Indices = equations[is_empty]
        if empty.size:
            sizes = sizes_of(content, np.nan_to_num(self.known), empty)
            off = found.offset[empty] - right[empty]
            wrong = np.abs(off) > ROUNDING * (sizes + np.abs(right[empty]))
            for k in np.flatnonzero(wrong)[:1]:
                raise UnsupportedModel(
                    f"{content.row(empty[k])} holds no unknown, and its sides differ by {off[k]:g}: no point "
                    "satisfies the model; correct it"
                )
        left: Indices = equations[~is_empty]
        return left
