"""From unknowns with bounds, pairs and equations to a complementarity problem, whatever language stated them."""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ..auto import solve_lcp
from ..core.checks import FloatVector
from ..core.errors import InvalidOption, NotSquare, UnsupportedModel
from ..core.lcp import LCP
from ..core.representation import in_words
from ..core.solving.result import Result
from ..problems.cones.data import Blocks
from ..problems.cones.solving import solve_cones
from ..problems.nonlinear.data import NonlinearProblem
from ..problems.nonlinear.solving import solve_nonlinear
from .equations import (
    Affine,
    Elimination,
    eliminate_definitions,
    known_ranges,
    matched_for_monotony,
)
from .expressions.program import Program
from .expressions.rows import Compiler, Rows, assembled

BEGUN = "begun from the values of the variables, which are the last answer unless others were set"
UNCERTAIN = (
    1e-3  # stands for entries of a derivative that are zero or infinite where equations are matched
)


@dataclass(frozen=True, eq=False)
class PairedRows:
    """Rows that belong to a pair, or that are to be zero, and what the language has in their place.

    Attributes
    ----------
    expression : object
        What the rows were read from.
    rows : Rows
    constraint : object
        The equality that states them, None for a side of a pair.
    slacks : ndarray of int or None
        The unknowns that the rows are less than the expression, one a row; None for none.
    """

    expression: Any
    rows: Rows
    constraint: Any = None
    slacks: NDArray[np.int64] | None = None


@dataclass(frozen=True, eq=False)
class Arrangement:
    """The problem that pairs and equations became, and where its unknowns and rows come from.

    Attributes
    ----------
    problem : LCP or NonlinearProblem
        An LCP where everything is affine.
    elimination : Elimination
        The way from its unknowns to all of them.
    stored : csr_array, csr_array
        The entries of the pairs and of the equations, over all unknowns; empty in a nonlinear problem.
    places : ndarray of int, shape (n,)
        Which row is each row of the problem, up to `signs`: of the pairs, then of the equations that define nothing.
    signs : ndarray, shape (n,)
    matched : ndarray of int
        Of the equations that define nothing, one after the other: the unknown that each goes with.
    """

    problem: LCP | NonlinearProblem
    elimination: Elimination
    stored: tuple[sp.csr_array, sp.csr_array]
    places: NDArray[np.int64]
    signs: FloatVector
    matched: NDArray[np.int64]


class Assembly:
    """Unknowns with bounds, pairs and equations of one model.

    Parameters
    ----------
    compiler : Compiler
        That made the rows.
    first : dict
        From the key of a source to the number of its first unknown.
    lower, upper : ndarray, shape (count,)
        Bounds of the unknowns.
    """

    #: Whether unknowns that go with an equation may keep bounds that nothing implies; the answer is looked at then.
    keeps_bounds = False

    def __init__(
        self, compiler: Compiler, first: dict[int, int], lower: FloatVector, upper: FloatVector
    ) -> None:
        self.compiler, self.first, self.lower, self.upper = compiler, first, lower, upper
        self.is_paired = np.zeros(lower.size, dtype=bool)
        #: Of each pair: the unknowns, the function that belongs to them, and its sign.
        self.pairs: list[tuple[NDArray[np.int64], PairedRows, FloatVector]] = []
        self.equations: list[PairedRows] = []

    @property
    def count(self) -> int:
        """The number of unknowns."""
        return self.lower.size

    def variable_of(self) -> NDArray[np.int64]:
        """Return which variable of the language each unknown belongs to, by number."""
        raise NotImplementedError

    def names_of(self, columns: NDArray[np.int64]) -> list[str]:
        """Return what the variables that these unknowns belong to are called."""
        raise NotImplementedError

    def entry(self, column: np.int64) -> str:
        """Return how the unknown is written: h[2]."""
        raise NotImplementedError

    def affine(self, functions: Sequence[PairedRows]) -> Affine:
        """Return all rows over all unknowns, each with the number of its function; a single block as it is."""
        matrix, offset = assembled([one.rows for one in functions], self.first, self.count)
        return Affine(
            matrix,
            offset,
            np.repeat(np.arange(len(functions)), [one.rows.size for one in functions]),
        )

    def arranged(self) -> Arrangement:
        """Put definitions in, match the equations left with the unknowns left, and put everything in its place.

        Notes
        -----
        Of a nonlinear model nothing is eliminated: an unknown that an equation defines stays, and with it the sparsity
        of everything that it would be put in.
        """
        functions, of_pairs = [*(one for _, one, _ in self.pairs), *self.equations], len(self.pairs)
        columns = np.concatenate(
            [*(columns for columns, _, _ in self.pairs), np.zeros(0, dtype=np.int64)]
        )
        signs = np.concatenate([*(sign for _, _, sign in self.pairs), np.zeros(0)])
        free, sizes = (
            np.flatnonzero(~self.is_paired),
            (columns.size, sum(one.rows.size for one in self.equations)),
        )
        self._check_square(free, sizes[1])
        self._drop_implied_bounds(free)
        elimination, stored = (
            Elimination.of_nothing(self.count),
            [sp.csr_array((size, self.count)) for size in sizes],
        )
        program = None
        if any(one.rows.level for one in functions):
            results = [one.rows for one in functions]
            program = Program.of(self.compiler, results, self.first, self.count)
        else:
            pairs, equations = self.affine(functions[:of_pairs]), self.affine(self.equations)
            stored = [pairs.matrix, equations.matrix]
            if self.equations:
                elimination, equations, pairs = eliminate_definitions(
                    equations, pairs, ~self.is_paired, self.variable_of()
                )
        kept = elimination.kept
        place = np.zeros(self.count, dtype=np.int64)
        place[kept] = np.arange(kept.size)
        columns, free = place[columns], np.flatnonzero(~self.is_paired[kept])
        if free.size:
            matrices = (
                (pairs.matrix, equations.matrix)
                if program is None
                else self._derivatives(program, sizes[0])
            )
            signed = sp.csr_array(sp.diags_array(signs) @ matrices[0])
            order, turned = matched_for_monotony(matrices[1], signed, columns, free)
            free = free[order]
            columns, signs = np.concatenate([columns, free]), np.concatenate([signs, turned])
        matched = kept[free]
        places = np.argsort(columns, kind="stable")
        signs = signs[places]
        bounds = {"lower": self.lower[kept], "upper": self.upper[kept]}
        problem: LCP | NonlinearProblem
        if program is None:
            problem = LCP(*_arranged(pairs, equations, places, signs), **bounds)
        else:
            program = program.rearranged(places, signs)
            problem = NonlinearProblem(program.value, program.jacobian, **bounds)
        return Arrangement(problem, elimination, (stored[0], stored[1]), places, signs, matched)

    def _derivatives(self, program: Program, pairs: int) -> tuple[sp.csr_array, sp.csr_array]:
        """Return what the derivatives of pairs and equations are like inside the bounds."""
        derivative = program.jacobian(np.clip(1.0, self.lower, self.upper))
        sizes = np.where(np.isfinite(derivative.data), derivative.data, 0.0)
        derivative.data = np.where(sizes == 0.0, UNCERTAIN, sizes)
        return derivative[:pairs], derivative[pairs:]

    def _drop_implied_bounds(self, free: NDArray[np.int64]) -> None:
        """Forget the bounds of unknowns that go with an equation where the model implies them; raise where not."""
        bounded = free[np.isfinite(self.lower[free]) | np.isfinite(self.upper[free])]
        if not bounded.size:
            return
        affine = [pair for pair in self.pairs if not pair[1].rows.level]
        columns = np.concatenate(
            [*(columns for columns, _, _ in affine), np.zeros(0, dtype=np.int64)]
        )
        has_low, has_high = np.isfinite(self.lower[columns]), np.isfinite(self.upper[columns])
        # What has both bounds, or none, leaves the sign of its function open.
        signs = np.concatenate([*(sign for _, _, sign in affine), np.zeros(0)])
        signs = np.where(has_low == has_high, np.nan, signs * np.where(has_low, 1.0, -1.0))
        equations = [function for function in self.equations if not function.rows.level]
        rows = self.affine([*(function for _, function, _ in affine), *equations])
        signs = np.append(signs, np.zeros(rows.offset.size - signs.size))
        low, high, rounding = known_ranges(rows, signs, self.lower, self.upper, self.is_paired)
        wrong = bounded[((low > self.upper + rounding) | (high < self.lower - rounding))[bounded]]
        if wrong.size:
            raise UnsupportedModel(
                f"equations and pairs keep {self.entry(wrong[0])} outside its bounds, {self.lower[wrong[0]]:g} and "
                f"{self.upper[wrong[0]]:g}: no point satisfies the model; correct one of them"
            )
        is_implied = (low >= self.lower - rounding) & (high <= self.upper + rounding)
        left = bounded[~is_implied[bounded]]
        if left.size and not self.keeps_bounds:
            entry = self.entry(left[0])
            raise UnsupportedModel(
                f"{entry} has bounds that the rest of the model does not imply, and no pair says what gives way at "
                f"them; drop them, or make it the variable of a pair, as in complements({entry}, F)"
            )
        implied = bounded[is_implied[bounded]]
        self.lower[implied], self.upper[implied] = -np.inf, np.inf

    def _check_square(self, free: NDArray[np.int64], equations: int) -> None:
        """Raise where there are not as many equations as unknowns without a pair."""
        if free.size == equations:
            return
        of_pairs = sum(
            function.slacks.size for function in self.equations if function.slacks is not None
        )
        counted = f", {of_pairs} of them from pairs of two expressions" if of_pairs else ""
        names = ", ".join(self.names_of(free)) or "none"
        way_out = ""
        if equations > free.size:
            way_out = (
                "; where one says how prices are scaled, as sum(p) == 1, drop a market that the others imply, or give "
                "the equation a free multiplier, a variable in the rows of the pairs"
            )
        has_bounds = np.isfinite(self.lower[free]) | np.isfinite(self.upper[free])
        raise (NotSquare if free.size > equations and has_bounds.any() else UnsupportedModel)(
            f"the model has {in_words(equations, 'equation')}{counted} and {in_words(free.size, 'unknown')} without a "
            f"complementarity ({names}); it needs as many equations as such unknowns{way_out}"
        )


def _arranged(
    pairs: Affine, equations: Affine, places: NDArray[np.int64], signs: FloatVector
) -> tuple[sp.csr_array, FloatVector]:
    """Return the rows in their places, with their signs: the user's own matrix, without a copy, where nothing moves."""
    M, q = pairs.matrix, pairs.offset
    if equations.offset.size:
        M, q = (
            sp.csr_array(sp.vstack([M, equations.matrix], format="csr")),
            np.append(q, equations.offset),
        )
    if not np.array_equal(places, np.arange(q.size)):
        M, q = sp.csr_array(M[places]), q[places]
    return (sp.csr_array(sp.diags_array(signs) @ M), signs * q) if (signs != 1.0).any() else (M, q)


def solve_from(
    problem: LCP | NonlinearProblem | Blocks, start: FloatVector | None, options: dict[str, Any]
) -> Result:
    """Return the answer to a problem that a model became.

    Parameters
    ----------
    problem : LCP, NonlinearProblem or Blocks
    start : array, shape (n,), or None
        The present values of the unknowns, where all have one; ``z0`` among the options goes before.
    options : dict
        Of `solve`, of `solve_nonlinear` or of `solve_cones`.
    """
    is_given = "z0" in options or start is None or not np.isfinite(start).all()
    if isinstance(problem, Blocks):
        problem.problem_kind.refuse(options)
        _refuse_unknown(
            options, "a model with cones", list(inspect.signature(solve_cones).parameters)[1:]
        )
    if isinstance(problem, NonlinearProblem):
        known = ["z0", *list(inspect.signature(solve_nonlinear).parameters)[2:]]
        _refuse_unknown(options, "a nonlinear model", known)
        z0: Any = options.get("z0", np.zeros_like(problem.lower)) if is_given else start
        # The derivative is ours; what the language itself evaluates is compared at the end.
        own = {
            "check_jacobian": False,
            **{name: value for name, value in options.items() if name != "z0"},
        }
        result = solve_nonlinear(problem, z0, **own)
    else:
        run: Any = solve_cones if isinstance(problem, Blocks) else solve_lcp
        result = run(problem, **(options if is_given else {"z0": start, **options}))
    return result if is_given else replace(result, begun=result.begun or BEGUN)


def _refuse_unknown(options: dict[str, Any], what: str, known: list[str]) -> None:
    for name in options:
        if name not in known:
            raise InvalidOption(f"{what} has no option {name!r}; it has {', '.join(known)}")
