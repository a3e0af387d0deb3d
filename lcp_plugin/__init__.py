"""Linear complementarity problems: model, solve, certify.

Find z with lower ≤ z ≤ upper and w = M z + q complementary: w_i ≥ 0 if z_i = lower_i, w_i ≤ 0 if z_i = upper_i, w_i = 0
between them. Begin with ``help(lcp_plugin.LCP)`` and ``help(lcp_plugin.solve)``. The names below load on first use, so
that ``import lcp_plugin`` loads only numpy. ``help(lcp_plugin.NAME)`` describes each of them; these pages describe a
whole subject:

- ``help("lcp_plugin.core")``: the modules of every solve, and the order in which to read them
- ``help("lcp_plugin.modeling")``: the models that cvxpy may contain, and their statuses
- ``help("lcp_plugin.problems.programs")``: quadratic and linear programs, games
- ``help("lcp_plugin.solving.plan")``: the choice of methods by algorithm="auto"
- ``help("lcp_plugin.solving.direct")``: the direct methods, and their order
- ``help("lcp_plugin.core.splittings")``: sweeps, and how fast they converge
- ``help("lcp_plugin.proofs")``: proofs about a matrix, a method, an error, an infeasible problem
- ``help("lcp_plugin.judges.lcp")``: the stopping criterion behind SOLVED
- ``help("lcp_plugin.judges.program")``: the stopping criterion of quadratic programs
- ``help("lcp_plugin.interfaces.learn")``: layers for PyTorch and JAX
- ``help("lcp_plugin.interfaces")``: Pyomo, AMPL, JuMP, qpsolvers, files, finite elements
- ``help("lcp_plugin.evidence")``: error against time, studies, cross-validation; other packages
- ``help("lcp_plugin.ranks")``: distributed problems on several machines
- ``help("lcp_plugin.strategies")``: hypothesis strategies, and a test of any solver
"""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.util import find_spec
from types import FunctionType
from typing import Any

from .core.errors import public
from .core.problem_classes import DOORS

__version__ = "0.1.0"


# Module of each public name; __init__.pyi has the same names for editors and mypy
_HOME = {
    name: home
    for home, names in {
        "gallery": "gallery",
        "strategies": "strategies",
        "api": "solve",
        "judges.certificate": "Certificate",
        "core.errors": "InvalidOption InvalidProblem LCPError ModelWarning NotConverged UnknownAlgorithm "
        "UnreadableFile UnsuitableMatrix UnsuitableProblem UnsupportedModel",
        "core.lcp": "LCP",
        "core.settings": "Status",
        "evidence.cross_check": "cross_validate",
        "evidence.study": "error_against_time study",
        "interfaces.program_files": "load_problem",
        "methods.search": "all_solutions",
        "modeling.agents": "optimal",
        "modeling.constraint": "box complements friction_cone",
        "modeling.qp_solver": "QPSolver",
        "problems.batches.batch": "solve_batch",
        "problems.prepared": "prepare",
        "problems.cones.data": "ConeProblem",
        "problems.cones.frictional_contact": "FrictionalContact",
        "problems.equilibria.equilibrium_program": "EquilibriumProgram",
        "problems.least_squares.data": "BoundedLeastSquares",
        "problems.march": "march",
        "problems.nonlinear.data": "NonlinearProblem",
        "problems.parametric.tracing": "trace",
        "problems.portable": "check_proof exact",
        "problems.programs.certification": "certify",
        "problems.programs.program": "QuadraticProgram",
        "problems.sensitivity": "derivative",
        "problems.variational": "variational",
        "proofs.bounds": "error_bound",
        "solving.analysis": "analyze",
        "solving.explanation": "convergence_guarantee",
        "solving.result": "Result",
    }.items()
    for name in names.split()
}
_FOR_TESTS = {"strategies"}  # needs hypothesis, so that "import *" does without
_PROOFS = ("ExactSolution", "NoSolutionProof", "QPInfeasibility", "QPUnboundedness")
DOORS.update(
    {
        **{(proof, "save"): "problems.portable:save_proof" for proof in _PROOFS},
        ("RowsOnRanks", "solve"): "ranks.solving:solve_on_ranks",
        ("RowsOnRanks", "measured"): "ranks.solving:measured_on_ranks",
        ("LCP", "from_rows"): "ranks.problem:RowsOnRanks.from_rows",
        ("LCP", "from_petsc"): "ranks.petsc:RowsOnPETSc.from_petsc",
        ("LCP", "from_qp"): "lcp:from_qp",
        ("LCP", "to_qp"): "problems.programs.conversion:qp_from_lcp",
        ("LCP", "from_game"): "problems.reformulations:lcp_from_bimatrix_game",
        ("LCP", "from_contacts"): "lcp:from_contacts",
        ("LCP", "from_cvxpy"): "modeling.registration:lcp_stated_by",
        ("LCP", "to_cvxpy"): "modeling.registration:stated_in_cvxpy",
        ("LCP", "load"): "lcp:load",
        ("LCP", "save"): "lcp:save",
        ("NonlinearProblem", "from_jax"): "interfaces.derivatives:from_jax",
        ("NonlinearProblem", "from_casadi"): "interfaces.derivatives:from_casadi",
        ("BaseResult", "plot"): "evidence.drawing:plot_answer",
        ("Path", "plot"): "evidence.drawing:plot_path",
        ("cvxpy", "certify"): "modeling.registration:certify_model",
        ("cvxpy", "derivative"): "modeling.parameters:derivative_of",
        ("cvxpy", "trace"): "modeling.parameters:trace_model",
        ("cvxpy", "variational"): "modeling.agents:variational_inequality",
        ("pyomo", "certify"): "interfaces.pyomo:certify_model",
        ("pyomo", "content"): "interfaces.pyomo:file_content_of",
    }
)
__all__ = ["__version__", *sorted(_HOME.keys() - _FOR_TESTS)]  # noqa: PLE0604 - the names are strings, from the table


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        message = f"module 'lcp_plugin' has no attribute {name!r}"
        raise AttributeError(message, name=name, obj=sys.modules[__name__])  # Python adds a guess
    home = _HOME[name]
    module = import_module(f"{__name__}.{home}")
    value = module if home == name else getattr(module, name)
    if isinstance(value, FunctionType):
        value = public(value)
        setattr(module, name, value)  # for pickles
    elif isinstance(value, type) and value.__init__.__qualname__ == f"{name}.__init__":  # its own
        value.__init__ = public(value.__init__)  # type: ignore[misc]
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*__all__, *_FOR_TESTS])


def _solve_from_cvxpy(problem: Any, *args: Any, **options: Any) -> Any:
    """Solve a cvxpy problem by ``method="LCP"``: the first call loads the models, which register it themselves."""
    import_module(f"{__name__}.modeling")
    return problem.solve(*args, method="LCP", **options)


def _register(cvxpy: object) -> None:
    for method in ("LCP", "lcp"):
        cvxpy.Problem.register_solve(method, _solve_from_cvxpy)


class _CvxpyImport:
    """Import hook that registers the method when cvxpy is imported later, and goes then."""

    @classmethod
    def find_spec(cls, name: str, *_: Any) -> Any:
        """Return None, or the specification of cvxpy with a loader that registers the method."""
        if name != "cvxpy" or cls not in sys.meta_path:
            return None
        sys.meta_path.remove(cls)  # type: ignore[arg-type]
        if (spec := find_spec(name)) is not None and spec.loader is not None:
            load = spec.loader.exec_module
            spec.loader.exec_module = lambda module: (load(module), _register(module))  # type: ignore[assignment, func-returns-value, method-assign, return-value]
        return spec


if hasattr(_cvxpy := sys.modules.get("cvxpy"), "Problem"):  # imported before
    _register(_cvxpy)
elif "cvxpy" not in sys.modules:
    sys.meta_path.insert(0, _CvxpyImport)  # type: ignore[arg-type]
