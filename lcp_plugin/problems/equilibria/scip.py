"""SCIP, the global solver of the extra ``[global]``, for equilibrium programs.

>>> import numpy as np
>>> from lcp_plugin import EquilibriumProgram, QuadraticProgram
>>> program = QuadraticProgram([[0, 1], [1, 0]], [0, 0], A=[[1, 1]], b=[3], lower=0, upper=2)  # x₀ x₁, x₀ + x₁ = 3
>>> result = minimize(EquilibriumProgram(program, [], []))
>>> result.status, round(result.value, 6), round(result.bound, 6)
('optimal', 2.0, 2.0)

A pair is a special ordered set: of z − lower and w, both ≥ 0, at most one is not zero. A box has two of them, with
w = w⁺ − w⁻. Smooth terms are expressions of SCIP, term by term; a repeated subexpression is a variable.

If the relaxation at the root is unbounded, SCIP 10 may prune unbounded children and report a wrong optimum (special
ordered sets). Then SCIP runs again within |x| ≤ 10⁶; a point at the edge of this box is called unbounded.

The result is in floating point, feasible to 1e-7 at best, and not a proof: :mod:`lcp_plugin.problems.equilibria` reads
off the active sets, solves the pairs again, measures the point, and names the source of the bound. SCIP needs no key.

References
----------
S. Bolusani et al., *The SCIP Optimization Suite 9.0* (2024), arXiv:2402.17702.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from ...core import deadline
from ...core.checks import AnyMatrix, Vector
from ...core.entries import entries_of_row
from ...core.errors import UnsupportedModel
from ...engines.linear_program import FEASIBLE
from ...expressions.rows import Program
from ...systems.equilibration import power_of_two
from .equilibrium_program import HIGH_CASE, LOW_CASE, EquilibriumProgram
from .relaxations import ENDS

SCIP_INFINITY = 1e20  # larger numbers are infinite for SCIP, also seconds
SHARE = 0.25  # of the requested gap
# box for unbounded relaxations; relative distance at which a point is at its edge
BOX, BOX_MARGIN = 1e6, 1e-3
ERROR_WORD = "SCIP:"  # start of SCIP's error messages

Watcher = Callable[[float, float, int], bool]


class ScipResult(NamedTuple):
    """The result of SCIP.

    Attributes
    ----------
    status : str
        Status as SCIP names it.
    x : ndarray, shape (n,), or None
        None without a point, or if an entry is infinite.
    value, bound : float
        Objective value and its bound; ∞ and −∞ if there is none.
    nodes : int
    """

    status: str
    x: Vector | None
    value: float
    bound: float
    nodes: int


def minimize_or_none() -> Callable[..., ScipResult] | None:
    """Return `minimize`, None if pyscipopt is not installed, or does not load."""
    try:
        import pyscipopt  # noqa: F401
    except ImportError:
        return None
    return minimize


def minimize(
    problem: EquilibriumProgram,
    tolerance: float = 1e-6,
    max_nodes: float = math.inf,
    ends: Watcher | None = None,
) -> ScipResult:
    """Return the least objective over all solutions of an equilibrium program, as SCIP finds it.

    Parameters
    ----------
    problem : EquilibriumProgram
    tolerance : float
        Largest value − bound, relative to |value|, or to 1 in the unit of the largest cost.
    max_nodes : float
    ends : callable, optional
        Receives value, bound and nodes after each node; a true result ends the search. Its exceptions are passed on.

    Raises
    ------
    ImportError
        If pyscipopt is not installed.
    UnsupportedModel
        Names a function that SCIP does not have.

    Notes
    -----
    The limit of the run around it holds, and Ctrl-C ends it with the status "userinterrupt".
    """
    lower, upper = problem.bounds(problem.all_cases)
    if (lower > upper).any():
        return ScipResult("infeasible", None, math.inf, math.inf, 0)
    # SCIP takes a thousandth in its linear programs; with less, a build without GMP prints a line for each
    # 1e-6 is the default of SCIP
    for feasible in sorted({min(FEASIBLE, tolerance), FEASIBLE, 1e-6}):
        model = _Model(problem, ends)
        result = model.solved(tolerance, max_nodes, feasible)
        if not result.status.startswith(ERROR_WORD):
            break
    is_unbounded = result.status == "unbounded"
    if not is_unbounded and (result.x is None or not model.root_is_unbounded):
        return result
    if result.status in ENDS:  # SCIP may not know bounds of children that were cut off
        return result._replace(bound=-math.inf)
    left = max(max_nodes - result.nodes, 0)
    in_box = _Model(problem, ends, BOX).solved(tolerance, left, FEASIBLE)
    in_box = in_box._replace(nodes=in_box.nodes + result.nodes)
    if in_box.x is None:
        in_box = in_box._replace(x=result.x, value=result.value)
    is_far = in_box.x is not None and np.abs(in_box.x).max(initial=0.0) > BOX * (1.0 - BOX_MARGIN)
    is_deep = in_box.value <= -SCIP_INFINITY * (1.0 - BOX_MARGIN)
    if is_unbounded or is_far or is_deep:
        return in_box._replace(status="unbounded", bound=-math.inf)
    return in_box


class _Model:
    """An equilibrium program as a model of SCIP.

    It is one class because SCIP's model, its variables and its event handler live and end together.

    Attributes
    ----------
    x : list
        Variables x in SCIP.
    unit : float
        Unit of the objective, a power of two, because SCIP ignores costs below 1e-9.
    """

    def __init__(
        self, problem: EquilibriumProgram, ends: Watcher | None, far: float = SCIP_INFINITY
    ) -> None:
        import pyscipopt

        self.scip, self.problem, self.model, self.ends = pyscipopt, problem, pyscipopt.Model(), ends
        self.error: BaseException | None = None
        costs = np.append(problem.program.c, sp.csr_array(problem.program.P).data)
        unit = 0.5 * float(power_of_two(np.abs(costs).max(initial=0.0)))
        self.unit = unit if problem.smooth is None else 1.0
        self.model.hideOutput()
        lower, upper = problem.bounds(problem.all_cases)
        codes = np.full(lower.size, "C")
        codes[problem.integers] = "I"
        lower, upper = np.maximum(lower, -far), np.minimum(upper, far)
        redundant = problem.redundant_unknowns()
        lower[redundant] = upper[redundant] = 0.0
        self.x = [
            self.model.addVar(lb=low, ub=high, vtype=code)
            for low, high, code in zip(lower.tolist(), upper.tolist(), codes.tolist(), strict=True)
        ]

    @property
    def root_is_unbounded(self) -> bool:
        """True if the first relaxation may be unbounded; its bound is ∞ after a first point."""
        has_bounds = bool(np.isfinite(self.problem.bounds(self.problem.all_cases)).all())
        is_infinite = abs(self.model.getDualboundRoot()) >= SCIP_INFINITY
        return not has_bounds and self.model.getNTotalNodes() > 1 and is_infinite

    def solved(self, tolerance: float, max_nodes: float, feasible: float) -> ScipResult:
        """Return the result of SCIP."""
        model = self.model
        model.setParams(
            {
                "limits/time": min(deadline.left(), SCIP_INFINITY),
                "limits/gap": SHARE * tolerance,
                "limits/absgap": SHARE * tolerance,
                "numerics/feastol": feasible,
                "timing/clocktype": 2,
                "limits/totalnodes": int(max_nodes) if max_nodes < 2**62 else -1,
                "heuristics/multistart/freq": -1,  # takes 10 s if bounds are missing
            }
        )
        self._watch_nodes()
        try:
            self._state()
            model.optimize()
        except (MemoryError, UnsupportedModel):
            raise
        except Exception as error:  # pyscipopt has no class of its own: "SCIP: error in LP solver!"
            return ScipResult(str(error), None, math.inf, -math.inf, 0)
        if self.error is not None:
            raise self.error
        status, x = model.getStatus(), None
        value, bound, nodes = self._reached()
        if model.getNSols():
            x = np.array([model.getSolVal(model.getBestSol(), variable) for variable in self.x])
            x = x if (np.abs(x) < SCIP_INFINITY).all() else None
        return ScipResult(status, x, value, bound, nodes)

    def _reached(self) -> tuple[float, float, int]:
        """Return value, bound and nodes."""
        value, bound = (
            math.copysign(math.inf, number) if abs(number) >= SCIP_INFINITY else number * self.unit
            for number in (self.model.getPrimalbound(), self.model.getDualbound())
        )
        return value if self.model.getNSols() else math.inf, bound, int(self.model.getNTotalNodes())

    def _watch_nodes(self) -> None:
        """Check after each node of SCIP whether the search ends; the C code of SCIP would swallow exceptions."""
        search, solved = self, self.scip.SCIP_EVENTTYPE.NODESOLVED  # type: ignore[attr-defined]

        class Nodes(self.scip.Eventhdlr):  # type: ignore[misc, name-defined]
            def eventinit(self) -> None:
                self.model.catchEvent(solved, self)

            def eventexit(self) -> None:
                self.model.dropEvent(solved, self)

            def eventexec(self, _: object) -> None:
                try:
                    ends = search.ends
                    is_over = search.error is None and ends is not None and ends(*search._reached())
                except BaseException as error:
                    search.error, is_over = error, True
                if is_over:
                    self.model.interruptSolve()

        self.model.includeEventhdlr(Nodes(), "lcp_plugin", "checks whether the search ends")

    # --- the statement ---

    def _state(self) -> None:
        program, smooth = self.problem.program, self.problem.smooth
        for matrix, low, high in (
            (program.G, np.full(program.h.size, -np.inf), program.h),
            (program.A, program.b, program.b),
        ):
            self._constrain(self._sums(matrix, self.x, np.zeros(low.size)), low, high)
        constant = np.array([program.constant / self.unit])
        objective = self._sums(program.c[None] / self.unit, self.x, constant)[0]
        P = sp.coo_array(program.P)
        entries = zip(P.row.tolist(), P.col.tolist(), P.data.tolist(), strict=True)
        nonlinear_terms = [0.5 * a / self.unit * self.x[i] * self.x[j] for i, j, a in entries]
        if smooth is not None:
            if not isinstance(smooth.map, Program):
                raise UnsupportedModel(
                    "SCIP reads the smooth part of an EquilibriumProgram term by term, and a function of Python's "
                    "has no terms; state the model in cvxpy, Pyomo or AMPL"
                )
            term, *rows = self._results(smooth.map)
            nonlinear_terms.append(term)
            self._constrain(rows, smooth.lower, smooth.upper)
        if nonlinear_terms:
            epigraph = self.model.addVar(lb=None)
            self.model.addCons(self.scip.quicksum(nonlinear_terms) <= epigraph)
            objective = objective + epigraph
        self.model.setObjective(objective, "minimize")
        for i, cases in enumerate(self.problem.all_cases.tolist()):
            self._pair(i, cases)

    def _constrain(self, terms: list[Any], low: Vector, high: Vector) -> None:
        for term, least, most in zip(terms, low.tolist(), high.tolist(), strict=True):
            if least == most:
                self.model.addCons(term == most)
            if -SCIP_INFINITY < least < most:
                self.model.addCons(term >= least)
            if least < most < SCIP_INFINITY:
                self.model.addCons(term <= most)

    def _pair(self, i: int, cases: int) -> None:
        """State z ⟂ w: the distance of z from the lower (upper) bound or w⁺ (w⁻) is zero."""
        z, w = self.x[self.problem.first[i]], self.x[self.problem.second[i]]
        parts = []  # of w
        if cases & LOW_CASE:
            parts.append(self.model.addVar(lb=0.0))
            self.model.addConsSOS1([self._named(z - float(self.problem.lower[i]), 0.0), parts[-1]])
        if cases & HIGH_CASE:
            parts.append(self.model.addVar(lb=None, ub=0.0))
            self.model.addConsSOS1([self._named(float(self.problem.upper[i]) - z, 0.0), parts[-1]])
        self.model.addCons(self.scip.quicksum(parts) == w)

    def _named(self, value: object, lower: float | None = None) -> Any:
        """Return a new variable that is that expression."""
        variable = self.model.addVar(lb=lower)
        self.model.addCons(variable == value)
        return variable

    # --- expressions ---

    def _sums(self, matrix: AnyMatrix, quantities: list[Any], offset: Vector) -> list[Any]:
        """Return each row times the quantities, plus the offset."""
        rows, total = sp.csr_array(matrix), self.scip.quicksum
        return [
            total(a * quantities[j] for j, a in zip(*entries_of_row(rows, k), strict=True)) + shift
            for k, shift in enumerate(offset.tolist())
        ]

    def _results(self, program: Program) -> list[Any]:
        """Return the results of a program of expressions."""
        quantities = list(self.x)
        parts = [*(part for level in program.levels for part in level.arguments), program.result]
        columns = np.concatenate([part.matrix.indices for part in parts])
        uses = np.bincount(columns, minlength=program.result.matrix.shape[1])
        for level in program.levels:
            sides = [self._sums(part.matrix, quantities, part.offset) for part in level.arguments]
            values = [
                self._applied(function.name, *(side[k] for side in sides[: function.arguments]))
                for function, span in level.spans
                for k in range(span.start, span.stop)
            ]
            shared = uses[len(quantities) : len(quantities) + len(values)] > 1
            pairs = zip(values, shared, strict=True)
            quantities += [self._named(value) if twice else value for value, twice in pairs]
        return self._sums(program.result.matrix, quantities, program.result.offset)

    def _applied(self, name: str, *u: Any) -> Any:
        """Return a function of SCIP's expressions."""
        scip = self.scip
        if name.startswith("power ") and name != "power of":
            exponent = float(name.removeprefix("power "))
            return u[0] ** (int(exponent) if exponent.is_integer() else exponent)
        forms: dict[str, Callable[..., Any]] = {
            "exp": scip.exp,
            "log": scip.log,
            "sin": scip.sin,
            "cos": scip.cos,
            "product": lambda a, b: a * b,
            "quotient": lambda a, b: a / b,
            "log1p": lambda a: scip.log(1.0 + a),
            "log10": lambda a: scip.log(a) / math.log(10.0),
            "relative entropy": lambda a, b: a * scip.log(a / b),
            "tan": lambda a: scip.sin(a) / scip.cos(a),
            "log add exp": lambda a, b: scip.log(scip.exp(a) + scip.exp(b)),
            "power of": lambda a, b: scip.exp(b * scip.log(a)),
            "sinh": lambda a: 0.5 * (scip.exp(a) - scip.exp(-a)),
            "cosh": lambda a: 0.5 * (scip.exp(a) + scip.exp(-a)),
            "tanh": lambda a: 1.0 - 2.0 / (scip.exp(2.0 * a) + 1.0),
            "asinh": lambda a: scip.log(a + scip.sqrt(a * a + 1.0)),
            "acosh": lambda a: scip.log(a + scip.sqrt(a * a - 1.0)),
            "atanh": lambda a: 0.5 * scip.log((1.0 + a) / (1.0 - a)),
        }
        if name not in forms:
            raise UnsupportedModel(
                f"SCIP knows no {name}, so that no global bound is found; write it with products, quotients, powers, "
                "exp, log, sqrt, sin and cos, or leave out the objective and use derivative(problem) for a "
                "local search"
            )
        return forms[name](*u)
