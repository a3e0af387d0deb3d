"""SCIP, the global solver of the extra ``[global]``: an equilibrium program goes in, a point and a bound come out.

>>> import numpy as np
>>> from lcp_plugin import EquilibriumProgram, QuadraticProgram
>>> program = QuadraticProgram([[0, 1], [1, 0]], [0, 0], A=[[1, 1]], b=[3], lower=0, upper=2)  # x₀ x₁, x₀ + x₁ = 3
>>> found = minimize(EquilibriumProgram(program, [], []))
>>> found.status, round(found.value, 6), round(found.bound, 6)
('optimal', 2.0, 2.0)

A pair is a special ordered set: of z − lower and w, both ≥ 0, at most one is not zero. A box has two of them, with
w = w⁺ − w⁻. Smooth terms are expressions of SCIP's, term by term; what occurs twice inside others is a variable.

Where its first relaxation falls without end, SCIP may cut off children that do, too, and call the rest optimal (release
10, special ordered sets). Then it is asked again within |x| ≤ 10⁶, and what reaches that far is called unbounded; so it
is where SCIP itself calls the objective unbounded, for a point that is a number.

What comes out is in floating point, feasible to 1e-8 at best, and no proof: :mod:`lcp_plugin.problems.equilibria` reads
off the cases, solves the pairs again, measures the point, and says whose the bound is. SCIP asks for no licence key.

References
----------
S. Bolusani et al., *The SCIP Optimization Suite 9.0* (2024), arXiv:2402.17702.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from ..core.checks import FloatVector
from ..core.deadline import seconds_left
from ..core.errors import UnsupportedModel
from ..modeling.expressions.functions import Function
from ..modeling.expressions.program import Combination, Program
from ..problems.equilibria.branch_and_bound import ENDS
from ..problems.equilibria.equilibrium_program import BETWEEN, LOWER, UPPER, EquilibriumProgram
from ..problems.programs.program import QuadraticProgram

LARGEST = 1e20  # what is farther is infinite for SCIP
LONGEST = 1e20  # seconds
SHARE = 0.25  # of the gap that is asked for
FAR, INSIDE = 1e6, 1e-3  # a box for what falls without end, and what is near it, relatively
FEASIBLE = 1e-8  # rather than 1e-6, which makes values wrong by that times multipliers
FAILED = "SCIP:"  # what its errors begin with
LESS_FEASIBLE = 1e-6  # SCIP's own: its linear programs may do better
FIRST, GROWTH = 64.0, 2.0  # nodes until a better point is asked for, and from one to the next

Watcher = Callable[[float, float, int], bool]
Improver = Callable[[FloatVector | None], FloatVector | None]


class ScipAnswer(NamedTuple):
    """What SCIP says.

    Attributes
    ----------
    status : str
        SCIP's word.
    x : ndarray, shape (n,), or None
        None where an entry is infinite.
    value, bound : float
        Of the objective; ∞ and −∞ where there is none.
    nodes : int
    """

    status: str
    x: FloatVector | None
    value: float
    bound: float
    nodes: int


def minimize_or_none() -> Callable[..., ScipAnswer] | None:
    """Return `minimize`, None where pyscipopt is not installed, or does not load."""
    try:
        import pyscipopt  # noqa: F401
    except ImportError:
        return None
    return minimize


def minimize(
    problem: EquilibriumProgram, *, tolerance: float = 1e-6, max_nodes: float = math.inf,
    start: FloatVector | None = None, ends: Watcher | None = None, improves: Improver | None = None,
) -> ScipAnswer:
    """Return the least objective over all solutions of an equilibrium program, as SCIP finds it.

    Parameters
    ----------
    problem : EquilibriumProgram
    tolerance : float
        Of value − bound, beside |value|, or beside 1 in the unit of the largest cost.
    max_nodes : float
    start : array, shape (n,), optional
        A solution to begin with.
    ends : callable, optional
        Gets value, bound and nodes after each node; ends the search by something true. What it raises is passed on.
    improves : callable, optional
        Gets now and then the point of a node's relaxation, None where there is none; returns a solution that is better
        than those before, or None.

    Raises
    ------
    ImportError
        Where pyscipopt is not installed.
    UnsupportedModel
        Naming a function that SCIP does not know.

    Notes
    -----
    The limit of the run around it holds, and Ctrl-C ends it with the status "userinterrupt".
    """
    for feasible in (FEASIBLE, LESS_FEASIBLE):
        model = _Model(problem)
        found = model.solved(tolerance, max_nodes, start, ends, improves, feasible)
        if not found.status.startswith(FAILED):
            break
    is_unbounded = found.status == "unbounded"
    if not is_unbounded and (found.x is None or not model.fell):
        return found
    if found.status in ENDS:  # of the children that were cut off it may know nothing
        return found._replace(bound=-math.inf)
    within = _Model(problem, FAR).solved(tolerance, max(max_nodes - found.nodes, 0), found.x, ends, improves, FEASIBLE)
    within = within._replace(nodes=within.nodes + found.nodes)
    if within.status.startswith(FAILED) and not is_unbounded:
        return within._replace(x=found.x, value=found.value)
    is_far = within.x is None or np.abs(within.x).max(initial=0.0) > FAR * (1.0 - INSIDE)
    is_deep = within.value <= -LARGEST * (1.0 - INSIDE)
    return within._replace(status="unbounded", bound=-math.inf) if is_unbounded or is_far or is_deep else within


class _Model:
    """An equilibrium program as SCIP's.

    Attributes
    ----------
    x : list
        SCIP's variables of x.
    unit : float
        What the objective is measured in, a power of two: SCIP takes costs below 1e-9 for nothing.
    added : list
        Of each variable that was added the function that gives its value, from x and from those before it.
    """

    def __init__(self, problem: EquilibriumProgram, far: float = math.inf) -> None:
        import pyscipopt

        self.scip, self.problem, self.model = pyscipopt, problem, pyscipopt.Model()
        self.unit = 1.0 if problem.smooth is not None else _power_below(problem.program)
        self.model.hideOutput()
        lower, upper = problem.bounds(problem.all_cases)
        lower, upper = np.maximum(lower, -far), np.minimum(upper, far)
        self._excludes = bool((lower > upper).any())
        kinds = np.full(lower.size, "C")
        kinds[problem.integers] = "I"
        self.x = [] if self._excludes else [
            self._variable(low, high, kind) for low, high, kind in zip(lower, upper, kinds.tolist(), strict=True)
        ]
        self.added: list[tuple[Any, Callable[[FloatVector], float]]] = []
        if not self._excludes:
            self._state()

    @property
    def fell(self) -> bool:
        """Whether the first relaxation had no least objective; its bound is ∞ where a point came first."""
        return bool(self.model.getNTotalNodes() > 1 and abs(self.model.getDualboundRoot()) >= LARGEST)

    def solved(
        self, tolerance: float, max_nodes: float, start: FloatVector | None, ends: Watcher | None,
        improves: Improver | None, feasible: float,
    ) -> ScipAnswer:
        """Return what SCIP finds."""
        if self._excludes:
            return ScipAnswer("infeasible", None, math.inf, math.inf, 0)
        model = self.model
        model.setParams({
            "limits/time": min(seconds_left(), LONGEST), "limits/gap": SHARE * tolerance,
            "limits/absgap": SHARE * tolerance, "numerics/feastol": feasible, "timing/clocktype": 2,
            "limits/totalnodes": int(max_nodes) if max_nodes < 2**62 else -1,
            "heuristics/multistart/freq": -1,  # takes 10 s where bounds are missing
        })
        if start is not None:
            model.addSol(self._solution(start), free=True)
        silence = _Silence()
        watcher = self._watched_by(ends, improves, silence)
        try:
            with silence:
                model.optimize()
        except MemoryError:
            raise
        except Exception as error:  # pyscipopt has no class of its own: "SCIP: error in LP solver!"
            return ScipAnswer(str(error), None, math.inf, -math.inf, 0)
        if watcher.error is not None:
            raise watcher.error
        status, x = model.getStatus(), None
        value, bound, nodes = watcher.reached()
        if model.getNSols():
            best = model.getBestSol()
            x = np.array([model.getSolVal(best, one) for one in self.x])
            x = x if (np.abs(x) < LARGEST).all() else None
        return ScipAnswer(status, x, value, bound, nodes)

    # --- the statement ---

    def _variable(self, lower: float = -math.inf, upper: float = math.inf, kind: str = "C") -> Any:
        ends = [None if abs(end) >= LARGEST else float(end) for end in (lower, upper)]
        return self.model.addVar(lb=ends[0], ub=ends[1], vtype=kind)

    def _state(self) -> None:
        program, smooth = self.problem.program, self.problem.smooth
        for matrix, low, high in ((program.G, -np.inf, program.h), (program.A, program.b, program.b)):
            terms = self._sums(sp.csr_array(matrix), self.x, np.zeros(matrix.shape[0]))
            self._constrain(terms, np.broadcast_to(low, high.shape), high)
        costs, offset = sp.csr_array(program.c[None]) / self.unit, np.array([self.problem.offset / self.unit])
        goal, bent = self._sums(costs, self.x, offset)[0], []
        P = sp.coo_array(sp.csr_array(program.P))
        if P.nnz:
            entries = zip(P.row.tolist(), P.col.tolist(), P.data.tolist(), strict=True)
            bent.append(self.scip.quicksum(0.5 * a / self.unit * self.x[i] * self.x[j] for i, j, a in entries))
        if smooth is not None:
            if not isinstance(smooth.map, Program):
                raise UnsupportedModel(
                    "SCIP reads the smooth part of an EquilibriumProgram term by term, and a function of Python's "
                    "has no terms; state the model in cvxpy, Pyomo or AMPL"
                )
            term, *rows = self._results(smooth.map)
            if not _is_number(term):
                bent.append(term)
            self._constrain(rows, smooth.lower, smooth.upper)
        if bent:
            height = self._variable()
            self.model.addCons(self.scip.quicksum(bent) - height <= 0.0)
            self.added.append((height, self._bent_value))
            goal = goal + height
        self.model.setObjective(goal, "minimize")
        for i, cases in enumerate(self.problem.all_cases.tolist()):
            self._pair(i, cases)

    def _bent_value(self, x: FloatVector) -> float:
        return (self.problem.objective(x) - self.problem.offset - float(self.problem.program.c @ x)) / self.unit

    def _constrain(self, terms: list[Any], low: FloatVector, high: FloatVector) -> None:
        for term, least, most in zip(terms, low.tolist(), high.tolist(), strict=True):
            if _is_number(term):  # a row of nothing
                if not least - FEASIBLE <= term <= most + FEASIBLE:
                    self.model.addCons(self.x[0] - self.x[0] >= 1.0)
            elif least == most:
                self.model.addCons(term == most)
            else:
                if least > -LARGEST:
                    self.model.addCons(term >= least)
                if most < LARGEST:
                    self.model.addCons(term <= most)

    def _pair(self, i: int, cases: int) -> None:
        """State z ⟂ w by special ordered sets of what is beyond a bound and of w."""
        problem, model = self.problem, self.model
        z, w = int(problem.first[i]), int(problem.second[i])
        if z == w or cases == BETWEEN:  # bounds say it
            if z == w and cases != BETWEEN:
                self._constrain([self.x[z]], np.zeros(1), np.zeros(1))
            return
        lower, upper = float(problem.lower[i]), float(problem.upper[i])
        if cases == LOWER + BETWEEN:
            parts = [self._shifted(z, 1.0, -lower), self._shifted(w, 1.0, 0.0)]
            model.addConsSOS1(parts)
        elif cases == UPPER + BETWEEN:
            model.addConsSOS1([self._shifted(z, -1.0, upper), self._shifted(w, -1.0, 0.0)])
        else:
            above, below = self._variable(0.0), self._variable(0.0)
            self.added += [(above, lambda x: max(float(x[w]), 0.0)), (below, lambda x: max(-float(x[w]), 0.0))]
            model.addCons(above - below == self.x[w])
            model.addConsSOS1([self._shifted(z, 1.0, -lower), above])
            model.addConsSOS1([self._shifted(z, -1.0, upper), below])

    def _shifted(self, column: int, sign: float, offset: float) -> Any:
        """Return a variable ≥ 0 that is sign · x + offset: x itself where it is."""
        if sign == 1.0 and offset == 0.0:
            return self.x[column]
        variable = self._variable(0.0)
        self.model.addCons(variable == sign * self.x[column] + offset)
        self.added.append((variable, lambda x: sign * float(x[column]) + offset))
        return variable

    # --- expressions ---

    def _sums(self, matrix: sp.csr_array, quantities: list[Any], offset: FloatVector) -> list[Any]:
        """Return each row times the quantities, plus the offset: a number where the row is empty."""
        found = []
        for k, shift in enumerate(offset.tolist()):
            entries = slice(matrix.indptr[k], matrix.indptr[k + 1])
            terms = [a * quantities[j] for j, a in
                     zip(matrix.indices[entries].tolist(), matrix.data[entries].tolist(), strict=True)]
            found.append(self.scip.quicksum(terms) + shift if terms else shift)
        return found

    def _results(self, program: Program) -> list[Any]:
        """Return the results of a program of expressions."""
        quantities, first = list(self.x), program.n
        parts = [*(one for level in program.levels for one in level.arguments), program.result]
        columns = np.concatenate([one.matrix.indices for one in parts])
        uses = np.bincount(columns, minlength=program.result.matrix.shape[1])
        for level in program.levels:
            sides = [self._combined(argument, quantities) for argument in level.arguments]
            for function, span in level.spans:
                for k in range(span.start, span.stop):
                    value = self._applied(function, *(side[k] for side in sides[: function.arguments]))
                    is_shared = uses[first + k] > 1 and not _is_number(value)
                    quantities.append(self._named(value, program, first + k) if is_shared else value)
            first += level.size
        return self._combined(program.result, quantities)

    def _combined(self, combination: Combination, quantities: list[Any]) -> list[Any]:
        width = combination.matrix.shape[1]
        known = [*quantities, *[0.0] * (width - len(quantities))]  # a level takes none of those that come after it
        return self._sums(combination.matrix, known, combination.offset)

    def _named(self, value: Any, program: Program, place: int) -> Any:
        variable = self._variable()
        self.model.addCons(variable == value)
        self.added.append((variable, lambda x: float(program.quantities(x)[place])))
        return variable

    def _applied(self, function: Function, *u: Any) -> Any:
        """Return a function of SCIP's expressions."""
        if all(map(_is_number, u)):
            return float(function.value(*(np.array([one]) for one in u))[0])
        name, scip = function.name, self.scip
        if name.startswith("power ") and name != "power of":
            exponent = float(name.removeprefix("power "))
            return u[0] ** (int(exponent) if exponent.is_integer() else exponent)
        forms: dict[str, Callable[..., Any]] = {
            "exp": scip.exp, "log": scip.log, "sin": scip.sin, "cos": scip.cos,
            "product": lambda a, b: a * b, "quotient": lambda a, b: a / b,
            "log1p": lambda a: scip.log(1.0 + a), "log10": lambda a: scip.log(a) / math.log(10.0),
            "relative entropy": lambda a, b: a * _log(scip, a / b), "tan": lambda a: scip.sin(a) / scip.cos(a),
            "log add exp": lambda a, b: scip.log(_exp(scip, a) + _exp(scip, b)),
            "power of": lambda a, b: scip.exp(b * _log(scip, a)),
            "sinh": lambda a: 0.5 * (scip.exp(a) - scip.exp(-a)), "cosh": lambda a: 0.5 * (scip.exp(a) + scip.exp(-a)),
            "tanh": lambda a: 1.0 - 2.0 / (scip.exp(2.0 * a) + 1.0),
            "asinh": lambda a: scip.log(a + scip.sqrt(a * a + 1.0)),
            "acosh": lambda a: scip.log(a + scip.sqrt(a * a - 1.0)),
            "atanh": lambda a: 0.5 * scip.log((1.0 + a) / (1.0 - a)),
        }
        if name not in forms:
            raise UnsupportedModel(
                f"SCIP knows no {name}, so that no global bound is found; write it with products, quotients, powers, "
                "exp, log, sqrt, sin and cos, or leave out the objective and use requires_grad=True for a local "
                "search"
            )
        return forms[name](*u)

    # --- the run ---

    def _solution(self, x: FloatVector) -> Any:
        solution = self.model.createOrigSol()
        for variable, value in zip(self.x, x.tolist(), strict=True):
            self.model.setSolVal(solution, variable, value)
        for variable, function in self.added:
            self.model.setSolVal(solution, variable, function(x))
        return solution

    def _relaxed(self) -> FloatVector | None:
        """Return the point of the present node's relaxation, None where it has none."""
        if self.model.getLPSolstat() != self.scip.SCIP_LPSOLSTAT.OPTIMAL:  # type: ignore[attr-defined]
            return None
        x = np.array([self.model.getSolVal(None, one) for one in self.x])
        return x if (np.abs(x) < LARGEST).all() else None

    def _watched_by(self, ends: Watcher | None, improves: Improver | None, silence: _Silence) -> _Watched:
        """Let SCIP ask after each node whether the search ends, and now and then for a better point."""
        scip, own, watched = self.scip, self, _Watched(self.model, self.unit, silence)
        event = scip.SCIP_EVENTTYPE

        class Nodes(scip.Eventhdlr):  # type: ignore[misc, name-defined]
            def eventinit(self) -> None:
                self.model.catchEvent(event.NODESOLVED, self)

            def eventexit(self) -> None:
                self.model.dropEvent(event.NODESOLVED, self)

            def eventexec(self, _: Any) -> None:
                if ends is not None and watched.call(ends, *watched.reached()):
                    self.model.interruptSolve()

        class Points(scip.Heur):  # type: ignore[misc, name-defined]  # an event is no place to add solutions
            next_nodes = FIRST

            def heurexec(self, *_: Any) -> dict[str, Any]:
                nodes, better = watched.reached()[2], None
                if improves is not None and nodes >= self.next_nodes:
                    self.next_nodes = GROWTH * nodes
                    better = watched.call(improves, own._relaxed())
                is_found = better is not None and self.model.trySol(own._solution(better))
                return {"result": scip.SCIP_RESULT.FOUNDSOL if is_found else scip.SCIP_RESULT.DIDNOTFIND}

        self.model.includeEventhdlr(Nodes(), "lcp_plugin", "asks whether the search ends")
        after = scip.SCIP_HEURTIMING.AFTERLPNODE
        self.model.includeHeur(Points(), "lcp_plugin", "asks for a better point", "l", timingmask=after)
        return watched


class _Watched:
    """Calls of ours from within a model's run, whose C code would swallow what they raise."""

    def __init__(self, model: Any, unit: float, silence: _Silence) -> None:
        self.model, self.unit, self.silence = model, unit, silence
        self.error: BaseException | None = None

    def reached(self) -> tuple[float, float, int]:
        """Return value, bound and nodes."""
        value, bound = (math.copysign(math.inf, one) if abs(one) >= LARGEST else one * self.unit
                        for one in (self.model.getPrimalbound(), self.model.getDualbound()))
        return value, bound, int(self.model.getNTotalNodes())

    def call(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Return what a function returns, None where it raises, which ends the run, or did before."""
        if self.error is not None:
            return None
        try:
            with self.silence.lifted():
                return function(*arguments)
        except BaseException as error:
            self.error = error
            self.model.interruptSolve()
            return None


class _Silence:
    """Sends what C writes to stderr nowhere: SCIP's linear solver warns there, whatever its output is set to.

    SCIP holds Python's lock, so that no other thread writes meanwhile; it is lifted for what is called back.
    """

    def __enter__(self) -> None:
        self._stderr: int | None = None
        with suppress(OSError):  # nobody may have opened it
            self._stderr = os.dup(2)
            self._begin()

    def __exit__(self, *raised: object) -> None:
        if self._stderr is not None:
            os.dup2(self._stderr, 2)
            os.close(self._stderr)

    def _begin(self) -> None:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, 2)
        os.close(nowhere)

    @contextmanager
    def lifted(self) -> Iterator[None]:
        """Let stderr be what it was."""
        if self._stderr is None:
            yield
            return
        os.dup2(self._stderr, 2)
        try:
            yield
        finally:
            self._begin()


def _power_below(program: QuadraticProgram) -> float:
    """Return the power of two below the largest entry of c and P, 1 where there is none."""
    largest = max(float(np.abs(one).max(initial=0.0)) for one in (program.c, sp.csr_array(program.P).data))
    return math.ldexp(1.0, math.frexp(largest)[1] - 1) if largest > 0.0 else 1.0


def _is_number(term: Any) -> bool:
    return isinstance(term, (int, float))


def _log(scip: Any, term: Any) -> Any:
    return math.log(term) if _is_number(term) else scip.log(term)


def _exp(scip: Any, term: Any) -> Any:
    return math.exp(term) if _is_number(term) else scip.exp(term)
