"""Linear complementarity problems: model, solve, certify.

Find z with lower ≤ z ≤ upper and w = M z + q complementary. The names below load on first use, so that
``import lcp_plugin`` costs no more than numpy and scipy.sparse. Each has its help; these are pages on a whole subject:

- ``help("lcp_plugin.core")``: what every solve needs, and in which order to read it
- ``help("lcp_plugin.modeling")``: what may be stated in cvxpy, and how its status is judged
- ``help("lcp_plugin.problems.programs")``: quadratic and linear programs, games
- ``help("lcp_plugin.auto")``: what algorithm="auto" does
- ``help("lcp_plugin.methods.direct")``: how it goes on without sweeps
- ``help("lcp_plugin.core.splittings")``: what to expect of sweeps
- ``help("lcp_plugin.proofs")``: what is proved of a matrix, a method, an error, a problem without solution
- ``help("lcp_plugin.core.certificates.criterion")``: what SOLVED means, in which scaling
- ``help("lcp_plugin.problems.programs.criterion")``: the same of a quadratic program
- ``help("lcp_plugin.interfaces.learn")``: layers for PyTorch and JAX
- ``help("lcp_plugin.interfaces")``: Pyomo, AMPL, JuMP, qpsolvers, files, finite elements
- ``help("lcp_plugin.evidence")``: error against time, studies, cross-validation; other packages
- ``help("lcp_plugin.ranks")``: several machines
- ``help("lcp_plugin.strategies")``: hypothesis strategies, and a test of any solver
"""

from __future__ import annotations

import sys
import warnings
from importlib import import_module
from importlib.abc import FileLoader
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import Any

__version__ = "0.1.0"


def _homes() -> dict[str, str]:
    """Return the module of each public name, as ``__init__.pyi`` says, which editors and mypy read."""
    lines = Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8").splitlines()
    said = [
        line.split() for line in lines if line.startswith("from ")
    ]  # from .home import name as name
    return {name: home[1:] or name for _, home, _, name, *_ in said}


_HOME = _homes()
_FOR_TESTS = {"strategies"}  # needs hypothesis, so that "import *" does without
_MOVED = {  # public names of before: these still work for one release, with a warning
    "core.solving.result": "Sample",
    "evidence.cross_check": "CrossCheck",
    "evidence.study": "Study",
    "interfaces.qpsolvers": "register_with_qpsolvers",
    "modeling.registration": "is_complementarity_problem register",
    "problems.batches.batch_run": "BatchResult",
    "problems.batches.program_batch": "ProgramBatchResult",
    "problems.cones.frictional_contact": "FrictionalContactBatch",
    "problems.cones.solving": "ConeResult",
    "problems.equilibria.branch_and_bound": "minimize_over_solutions",
    "problems.equilibria.result": "EquilibriumResult",
    "problems.least_squares.solving": "LeastSquaresResult bounded_least_squares",
    "problems.march": "March",
    "problems.march.march_derivative": "MarchDerivative MarchGradient",
    "problems.nonlinear.solving": "solve_nonlinear",
    "problems.programs.certification": "Certification",
    "problems.programs.solving": "QuadraticProgramResult",
    "problems.sensitivity": "Derivative Gradient",
    "problems.sensitivity.batch_derivative": "BatchDerivative BatchGradient",
    "proofs.bounds.error_bounds": "ErrorBound",
    "proofs.guarantees": "convergence_guarantee",
    "proofs.guarantees.theorems": "Guarantee",
    "proofs.verdicts": "MatrixReport",
}
_SINCE = {
    "FrictionalContactBatch": "FrictionalContact(W, b, friction), which takes an axis in front for the worlds"
}
_NEW_HOME = {name: home for home, names in _MOVED.items() for name in names.split()}
__all__ = ["__version__", *sorted(_HOME.keys() - _FOR_TESTS)]  # noqa: PLE0604 - the names are strings, from the table


def __getattr__(name: str) -> Any:
    home = _HOME.get(name) or _NEW_HOME.get(name)
    if home is None:
        raise AttributeError(f"module 'lcp_plugin' has no attribute {name!r}")
    if name in _NEW_HOME:
        write = _SINCE.get(name, f"from lcp_plugin.{home} import {name}")
        what = f"lcp_plugin.{name} has moved; write {write}"
        warnings.warn(what, DeprecationWarning, stacklevel=2)
    module = import_module(f"{__name__}.{home}")
    if home.startswith("modeling"):
        import_module(f"{__name__}.modeling.registration").register()
    value = module if home == name else getattr(module, name)
    if name in _HOME:
        globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*__all__, *_FOR_TESTS])


def _solve_model(problem: Any, *args: Any, **options: Any) -> Any:
    registration = import_module(f"{__name__}.modeling.registration")
    registration.register()
    return registration.solve_model(problem, *args, **options)


def _offer_to(cvxpy: Any) -> bool:
    """Register the method with cvxpy, where it is loaded, and return whether it is."""
    problem = getattr(cvxpy, "Problem", None)
    if problem is not None:
        for method in ("LCP", "lcp"):
            problem.register_solve(method, _solve_model)
    return problem is not None


class _UntilCvxpy:
    """Stands in ``sys.meta_path`` until cvxpy is imported, registers the method, and leaves.

    Other imports are none of its business, and cvxpy comes from where it would, by its own loader. Nothing smaller
    hears of it: cvxpy has no entry points, and who writes method="LCP" need use no name of ours.
    """

    def find_spec(self, name: str, path: Any = None, target: Any = None) -> ModuleSpec | None:
        """Return what the other finders find, its loader being told to call us once."""
        if name != "cvxpy":
            return None
        found = (
            finder.find_spec(name, path, target)
            for finder in [*sys.meta_path]
            if finder is not self
        )
        spec = next((spec for spec in found if spec is not None), None)
        if spec is None or not isinstance(spec.loader, FileLoader):
            return spec
        loader, load = spec.loader, spec.loader.exec_module

        def exec_module(module: ModuleType) -> None:
            del loader.exec_module  # which hid the method of its class
            load(module)
            if _offer_to(module) and self in sys.meta_path:
                sys.meta_path.remove(self)

        loader.exec_module = exec_module  # type: ignore[method-assign]
        return spec


if not _offer_to(sys.modules.get("cvxpy")):
    sys.meta_path.insert(0, _UntilCvxpy())
