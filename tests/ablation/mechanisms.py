"""The mechanisms: name, purpose and replacements."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from .switching import Instead, Patch

DIRECT, LEAST, CONES, EQUILIBRIA = (
    "methods.direct",
    "problems.least_squares",
    "problems.cones",
    "problems.equilibria",
)
INTERIOR, NEWTON, PROGRAMS = (
    "methods.interior_point",
    "methods.newton.semismooth_newton",
    "problems.programs",
)
CALLS = f"{PROGRAMS}.engine_calls"
STEPS, BOUNDS = "problems.nonlinear.josephy_newton:_NewtonRun", f"{PROGRAMS}.dual_bounds:DualBounds"


class Mechanism(NamedTuple):
    """A mechanism that can be switched off.

    Attributes
    ----------
    name : str
    purpose : str
    off : dict
        Replacement for each patched definition, by its location.
    claim : str
        A test of this folder's parent that fails without it, ``path::name``, if the inputs here show no loss.
    """

    name: str
    purpose: str
    off: dict[str, Instead]
    claim: str = ""

    @property
    def patches(self) -> list[Patch]:
        """Return the patches that switch the mechanism off."""
        return [Patch(place, instead) for place, instead in self.off.items()]


# --- replacements
# ---------------------------------------------------------------------------------------------------


def says(answer: Any) -> Instead:
    """Return a function with a constant result."""
    return differing(lambda old: lambda *_, **__: answer)


def skipped() -> Instead:
    """Return a function that does nothing."""
    return Instead(lambda old: lambda *_, **__: None)


def given_back(position: int = 0) -> Instead:
    """Return a function that returns one of its arguments."""
    return differing(lambda old: lambda *given, **_: given[position])


def differing(off: Callable[[Any], Any]) -> Instead:
    """Return a cheap replacement, for a comparison of both results."""

    def watch(old: Any, note: Callable[[], None]) -> Any:
        other = off(old)

        def noted(*given: Any, **named: Any) -> Any:
            found = old(*given, **named)
            if not is_same(found, other(*given, **named)):
                note()
            return found

        return noted

    return Instead(off, watch)


def is_same(one: Any, other: Any) -> bool:
    """Return whether two results are one object, or the same numbers."""
    if one is other:
        return True
    try:
        return bool(np.array_equal(one, other, equal_nan=True))
    except (TypeError, ValueError):
        return False


def yielding(is_kept: Callable[[int, Any], bool], *, to_the_end: bool = True) -> Instead:
    """Return a generator that keeps only some items, or ends at the first item that is not kept."""

    def made(old: Any, note: Callable[[], None] | None) -> Any:
        def generator(*given: Any, **named: Any) -> Any:
            for k, one in enumerate(old(*given, **named)):
                is_left = is_kept(k, one)
                if not is_left and note is not None:
                    note()
                if is_left or note is not None:
                    yield one
                elif not to_the_end:
                    return

        return generator

    return Instead(lambda old: made(old, None), made)


def without(*names: str) -> Instead:
    """Return a generator without methods of these names."""
    return yielding(lambda _, choice: choice.algorithm.name not in names)


def nothing() -> Instead:
    """A generator that yields nothing, and returns False."""

    def off(old: Any) -> Any:
        def empty(*_: Any, **__: Any) -> Any:
            return False
            yield

        return empty

    def watch(old: Any, note: Callable[[], None]) -> Any:
        def noted(*given: Any, **named: Any) -> Any:
            steps = old(*given, **named)
            while True:
                try:
                    step = next(steps)
                except StopIteration as end:
                    if end.value:
                        note()
                    return end.value
                note()
                yield step

        return noted

    return Instead(off, watch)


def only_start() -> Instead:
    """Return only the start, without steps of least squares."""
    return Instead(lambda old: lambda start, *_: iter([start]))


def without_engines(*names: str) -> Instead:
    """Return a generator of the requested engines without engines of these names."""
    return yielding(lambda _, asked: asked[0].name not in names)


def unfolded(old: Any) -> Any:
    def of(cls: Any, program: Any) -> Any:
        rows, none = program.h.size + program.b.size, np.full(program.n, -1)
        return cls(program, program, np.arange(rows), none, none, np.ones(rows))

    return of


def if_folded(old: Any, note: Callable[[], None]) -> Any:
    def of(cls: Any, program: Any) -> Any:
        found = old(cls, program)
        if found.reduced is not program:
            note()
        return found

    return of


def nothing_found(old: Any) -> Any:
    """An engine of least squares that finds nothing."""
    return lambda problem, A, b: np.full(A.shape[1], np.nan)


def no_point(old: Any) -> Any:
    """The same of PIQP."""

    def by_piqp(*statement: Any) -> Any:
        from lcp_plugin.engines import EngineAnswer, EngineStatus, ProgramData

        program = ProgramData(*statement)
        x, y = np.full(program.c.size, np.nan), np.full(program.h.size + program.b.size, np.nan)
        return program, EngineAnswer(x, y, 0, EngineStatus.GAVE_UP)

    return by_piqp


MECHANISMS = (
    # --- LCPs: first methods
    Mechanism(
        "banded",
        "rounds of active sets on narrow bands",
        {"methods.banded:banded_passes": says(math.inf)},
    ),
    Mechanism(
        "multigrid",
        "truncated V-cycles where sweeps are slow",
        {"auto:_cycle_passes": says(math.inf)},
    ),
    Mechanism(
        "psor",
        "relaxation found during the run, after npsor",
        {"auto:_psor_passes": says(math.inf)},
    ),
    Mechanism(
        "last system",
        "long runs end with the linear system of the case they found",
        {"core.solving.lcp_run:LCPRun._polish": given_back(1)},
    ),
    # --- LCPs: the direct methods
    Mechanism(
        "search",
        "all cases of few unknowns: solutions and proofs",
        {f"{DIRECT}:direct_methods": without("search")},
    ),
    Mechanism(
        "feasibility",
        "a linear program looks for a proof that there is no solution",
        {f"{DIRECT}:direct_methods": without("feasibility")},
    ),
    Mechanism(
        "one row",
        "a row that contradicts its bounds by itself is looked for first",
        {"proofs.no_solution.infeasibility:contradictory_row": says(None)},
    ),
    Mechanism(
        "some pivots",
        "pivots before a factor of a dense M",
        {
            f"{DIRECT}:direct_methods": yielding(
                lambda _, one: getattr(one.algorithm, "max_pivots", None) is None
            )
        },
        claim="core/test_choice.py::test_a_budget_row_is_pivoted_before_it_is_factorised",
    ),
    Mechanism(
        "lemke",
        "complementary pivoting",
        {f"{DIRECT}:direct_methods": without("lemke")},
    ),
    Mechanism(
        "newton",
        "semismooth Newton on LCPs",
        {f"{DIRECT}:direct_methods": without("newton")},
        claim="core/test_choice.py::test_a_grid_with_strong_flows_is_solved_by_newton",
    ),
    Mechanism(
        "interior point",
        "PIQP on the program of an LCP",
        {f"{DIRECT}:direct_methods": without("interior_point")},
    ),
    Mechanism(
        "games",
        "paths of Lemke and Howson on bimatrix games",
        {"methods.lemke.games:bimatrix_players": says(None)},
    ),
    Mechanism(
        "damped steps",
        "a line search on the function of Fischer and Burmeister",
        {f"{NEWTON}:damped_steps": nothing()},
    ),
    # --- multigrid
    Mechanism(
        "nested start",
        "multigrid begins on the coarsest grid",
        {"methods.multigrid.multigrid_run:MultigridRun._nested_start": skipped()},
    ),
    Mechanism(
        "Krylov",
        "conjugate steps preconditioned by V-cycles",
        {"methods.multigrid.multigrid_run:MultigridRun._krylov": nothing()},
    ),
    # --- interior points
    Mechanism(
        "cases",
        "the linear system of the case that an engine's point of an LCP shows",
        {f"{INTERIOR}:_cases": nothing()},
    ),
    Mechanism(
        "signs",
        "the program of a saddle point problem rather than that of its gap",
        {f"{INTERIOR}:signs_of": says(None)},
    ),
    # --- programs
    Mechanism(
        "engines",
        "programs answered by solvers of others, judged here",
        {f"{CALLS}:attempts": without_engines("daqp", "piqp", "clarabel", "highs")},
    ),
    Mechanism(
        "daqp",
        "the engine of small dense programs",
        {f"{CALLS}:attempts": without_engines("daqp")},
    ),
    Mechanism(
        "PIQP",
        "the engine of all other programs",
        {f"{CALLS}:attempts": without_engines("piqp")},
    ),
    Mechanism(
        "HiGHS",
        "the engine of linear programs",
        {f"{CALLS}:attempts": without_engines("highs")},
    ),
    Mechanism(
        "engine polish",
        "the linear system of the case that an engine's point names",
        {"engines.polish:polish_steps": nothing()},
    ),
    Mechanism(
        "folded rows",
        "rows with one entry become bounds",
        {f"{PROGRAMS}.reductions:FoldedRows.of": Instead(unfolded, if_folded)},
    ),
    # --- least squares
    Mechanism(
        "nnls",
        "scipy's nnls on dense problems with bounds on one side",
        {f"{LEAST}.engines:_solve_by_nnls": Instead(nothing_found)},
    ),
    Mechanism(
        "PIQP of least squares",
        "PIQP on normal equations, the dual, and the problem as it stands",
        {f"{LEAST}.engines:_answer": Instead(no_point)},
    ),
    Mechanism(
        "face of an engine's point",
        "an engine's point solved on the face that it names",
        {f"{LEAST}.engines:minimize_on_face": Instead(lambda old: lambda point, A, b: point)},
        "problems/least_squares/test_least_squares.py::test_boxed_problems_as_by_scipy_bvls",
    ),
    Mechanism(
        "projected steps",
        "projected gradients and conjugate steps",
        {f"{LEAST}.solving:projected_steps": only_start()},
    ),
    Mechanism(
        "repaired duals",
        "dual points repaired for the certificate of least squares",
        {f"{LEAST}.certificate:_repair": nothing()},
    ),
    # --- cones
    Mechanism(
        "cone bodies",
        "contacts of few bodies: the systems of Newton's steps and of the central path over their velocities",
        {f"{CONES}.systems:Arms.are_fewer": says(False)},
    ),
    Mechanism(
        "late stages",
        "sweeps until nothing changes, and Newton's method from points nearby, at the end",
        {f"{CONES}.solving:ConeRun._late_stages": nothing()},
        "problems/cones/test_cones.py::test_the_answer_is_in_the_cone_where_a_diagonal_cancels",
    ),
    Mechanism(
        "cone interior",
        "an interior point along the central path of contacts",
        {f"{CONES}.solving:path_points": nothing()},
    ),
    Mechanism(
        "cone proofs",
        "a conic program looks for a proof that there is no answer",
        {f"{CONES}.solving:infeasibility_proof": skipped()},
    ),
    Mechanism(
        "components of cones",
        "components that a common run leaves open, each alone",
        {f"{CONES}.solving:ConeRun._solve_components": skipped()},
    ),
    Mechanism(
        "last step of cones",
        "the linear system of the active set that a run found",
        {
            f"{CONES}.solving:polish_points": Instead(
                lambda old: lambda stack, z: (z, stack.measure(z).largest)
            )
        },
    ),
    # --- nonlinear
    Mechanism(
        "nonlinear restarts",
        "other starts of small nonlinear problems",
        {f"{STEPS}.start_elsewhere": says(False)},
    ),
    # --- equilibria
    Mechanism(
        "own nodes",
        "branch and bound of ours before and after SCIP",
        {f"{EQUILIBRIA}.branch_and_bound:BranchAndBound._search": skipped()},
    ),
    Mechanism(
        "SCIP",
        "another's global search where ours is long",
        {"interfaces.scip:minimize_or_none": says(None)},
        "problems/equilibria/test_best_equilibrium_by_scip.py::test_a_bilinear_leader_is_solved_by_scip",
    ),
    Mechanism(
        "incumbents",
        "solutions from the points of relaxations",
        {f"{EQUILIBRIA}.incumbents:LocalSearch.from_point": says(None)},
    ),
    # --- certify
    Mechanism(
        "dual slack",
        "dual points repaired to have the signs that are needed",
        {f"{BOUNDS}._with_slack": given_back(1)},
    ),
    Mechanism(
        "exact dual",
        "the dual bound in exact arithmetic",
        {f"{BOUNDS}._exact_value": says(-math.inf)},
    ),
    Mechanism(
        "implied box",
        "bounds of unknowns that the rows imply",
        {
            f"{PROGRAMS}.dual_bounds:implied_box": differing(
                lambda old: lambda one: (one.lower, one.upper)
            )
        },
    ),
    # --- many
    Mechanism(
        "lesson",
        "a step of a march begins with what ended the one before",
        {"problems.march:beginning_of_next": says(None)},
    ),
    Mechanism(
        "march loop",
        "steps on narrow bands, judged a block at a time",
        {"problems.march:take_steps_on_band": says(None)},
    ),
    Mechanism(
        "batch loop",
        "small problems of a batch in one compiled loop",
        {"problems.batches.batch_run:BatchRun.solve_at_once": skipped()},
    ),
    Mechanism(
        "batch of programs",
        "small programs of a batch judged together",
        {"problems.batches.program_batch:ProgramBatchRun.solve_at_once": skipped()},
    ),
    Mechanism(
        "threads",
        "loops shared among threads: batches, worlds and marches 1.55–1.95 × on the wall of two cores",
        {
            "core.kernels.threads:threads_for.__init__": Instead(
                lambda old: lambda self, count: old(self, 1)
            )
        },
    ),
)
NAMES = {one.name: one for one in MECHANISMS}
