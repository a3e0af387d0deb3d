"""Linear complementarity problems: model, solve, certify.

Find z with lower ≤ z ≤ upper and w = M z + q complementary. The names below load on first use, so that
``import lcp_plugin`` costs no more than numpy and scipy.sparse. Each has its help; these are pages on a whole subject:

- ``help("lcp_plugin.core")``: what every solve needs, and in which order to read it
- ``help("lcp_plugin.modeling")``: what may be stated in cvxpy, and how its status is judged
- ``help("lcp_plugin.problems.programs")``: quadratic and linear programs, games, absolute value equations
- ``help("lcp_plugin.core.policy.choice")``: what algorithm="auto" does
- ``help("lcp_plugin.methods.direct")``: how it goes on without sweeps
- ``help("lcp_plugin.core.splittings")``: what to expect of sweeps
- ``help("lcp_plugin.proofs")``: what is proved of a matrix, a method, an error, a problem without solution
- ``help("lcp_plugin.core.certificates.criterion")``: what SOLVED means, in which units
- ``help("lcp_plugin.doors.learn")``: layers for PyTorch and JAX
- ``help("lcp_plugin.doors")``: Pyomo, AMPL, JuMP, qpsolvers, cvxpylayers, QuantEcon, files, finite elements
- ``help("lcp_plugin.evidence")``: scenes and the report; other packages
- ``help("lcp_plugin.ranks")``: several machines
- ``help("lcp_plugin.strategies")``: hypothesis strategies, and a test of any solver
"""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.abc import FileLoader
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import TYPE_CHECKING, Any

from . import rooms as rooms

__version__ = "0.1.0"

if TYPE_CHECKING:
    from .core.certificates.residuals import Certificate as Certificate
    from .core.lcp import LCP as LCP
    from .core.settings import Status as Status
    from .core.solving.driver import solve as solve
    from .core.solving.result import Result as Result
    from .core.solving.result import Sample as Sample
    from .doors.files.program_files import load_problem as load_problem
    from .doors.qpsolvers import register_with_qpsolvers as register_with_qpsolvers
    from .doors.quantecon import lemke as lemke
    from .evidence.cross_check import CrossCheck as CrossCheck
    from .evidence.cross_check import cross_validate as cross_validate
    from .evidence.error_against_time import error_against_time as error_against_time
    from .evidence.results import Study as Study
    from .evidence.stability import stability_atlas as stability_atlas
    from .evidence.study import study as study
    from .methods.search import all_solutions as all_solutions
    from .modeling.constraint import box as box
    from .modeling.constraint import complements as complements
    from .modeling.qp_solver import QPSolver as QPSolver
    from .modeling.registration import ComplementarityProblem as ComplementarityProblem
    from .modeling.registration import is_complementarity_problem as is_complementarity_problem
    from .modeling.registration import register as register
    from .problems.batches.batch import prepare as prepare
    from .problems.batches.batch import solve_batch as solve_batch
    from .problems.batches.batch import solve_many as solve_many
    from .problems.batches.batch_run import BatchResult as BatchResult
    from .problems.batches.program_batch import ProgramBatchResult as ProgramBatchResult
    from .problems.cones.data import ConeProblem as ConeProblem
    from .problems.cones.data import FrictionalContact as FrictionalContact
    from .problems.cones.solving import ConeResult as ConeResult
    from .problems.equilibria.branch_and_bound import minimize_over_solutions as minimize_over_solutions
    from .problems.equilibria.equilibrium_program import EquilibriumProgram as EquilibriumProgram
    from .problems.equilibria.result import EquilibriumResult as EquilibriumResult
    from .problems.least_squares.data import BoundedLeastSquares as BoundedLeastSquares
    from .problems.least_squares.solving import LeastSquaresResult as LeastSquaresResult
    from .problems.least_squares.solving import bounded_least_squares as bounded_least_squares
    from .problems.march import March as March
    from .problems.march import march as march
    from .problems.march.march_derivative import MarchDerivative as MarchDerivative
    from .problems.march.march_derivative import MarchGradient as MarchGradient
    from .problems.march.march_many import march_many as march_many
    from .problems.nonlinear.data import NonlinearProblem as NonlinearProblem
    from .problems.nonlinear.solving import solve_nonlinear as solve_nonlinear
    from .problems.programs.certification import Certification as Certification
    from .problems.programs.certification import certify as certify
    from .problems.programs.conversion import QuadraticProgram as QuadraticProgram
    from .problems.programs.solving import QuadraticProgramResult as QuadraticProgramResult
    from .problems.programs.stacked_programs import QuadraticProgramBatch as QuadraticProgramBatch
    from .problems.sensitivity import Derivative as Derivative
    from .problems.sensitivity import Gradient as Gradient
    from .problems.sensitivity import derivative as derivative
    from .problems.sensitivity.batch_derivative import BatchDerivative as BatchDerivative
    from .problems.sensitivity.batch_derivative import BatchGradient as BatchGradient
    from .proofs.bounds.error_bounds import ErrorBound as ErrorBound
    from .proofs.bounds.error_bounds import error_bound as error_bound
    from .proofs.guarantees import convergence_guarantee as convergence_guarantee
    from .proofs.guarantees.theorems import Guarantee as Guarantee
    from .proofs.verdicts import MatrixReport as MatrixReport
    from .proofs.verdicts import analyze as analyze

_HOME = {
    "LCP": "core.lcp",
    "NonlinearProblem": "problems.nonlinear.data",
    "BoundedLeastSquares": "problems.least_squares.data",
    "ConeProblem": "problems.cones.data",
    "FrictionalContact": "problems.cones.data",
    "ConeResult": "problems.cones.solving",
    "solve_nonlinear": "problems.nonlinear.solving",
    "Certificate": "core.certificates.residuals",
    "ErrorBound": "proofs.bounds.error_bounds",
    "error_bound": "proofs.bounds.error_bounds",
    "Guarantee": "proofs.guarantees.theorems",
    "convergence_guarantee": "proofs.guarantees",
    "MatrixReport": "proofs.verdicts",
    "analyze": "proofs.verdicts",
    "Result": "core.solving.result",
    "Sample": "core.solving.result",
    "Status": "core.settings",
    "solve": "core.solving.driver",
    "certify": "problems.programs.certification",
    "Certification": "problems.programs.certification",
    "derivative": "problems.sensitivity",
    "Derivative": "problems.sensitivity",
    "Gradient": "problems.sensitivity",
    "BatchDerivative": "problems.sensitivity.batch_derivative",
    "BatchGradient": "problems.sensitivity.batch_derivative",
    "prepare": "problems.batches.batch",
    "solve_batch": "problems.batches.batch",
    "BatchResult": "problems.batches.batch_run",
    "ProgramBatchResult": "problems.batches.program_batch",
    "QuadraticProgramResult": "problems.programs.solving",
    "solve_many": "problems.batches.batch",
    "march": "problems.march",
    "March": "problems.march",
    "march_many": "problems.march.march_many",
    "MarchDerivative": "problems.march.march_derivative",
    "MarchGradient": "problems.march.march_derivative",
    "bounded_least_squares": "problems.least_squares.solving",
    "LeastSquaresResult": "problems.least_squares.solving",
    "ComplementarityProblem": "modeling.registration",
    "QPSolver": "modeling.qp_solver",
    "QuadraticProgram": "problems.programs.conversion",
    "QuadraticProgramBatch": "problems.programs.stacked_programs",
    "load_problem": "doors.files.program_files",
    "EquilibriumProgram": "problems.equilibria.equilibrium_program",
    "minimize_over_solutions": "problems.equilibria.branch_and_bound",
    "EquilibriumResult": "problems.equilibria.result",
    "CrossCheck": "evidence.cross_check",
    "cross_validate": "evidence.cross_check",
    "box": "modeling.constraint",
    "complements": "modeling.constraint",
    "is_complementarity_problem": "modeling.registration",
    "register": "modeling.registration",
    "register_with_qpsolvers": "doors.qpsolvers",
    "lemke": "doors.quantecon",
    "error_against_time": "evidence.error_against_time",
    "stability_atlas": "evidence.stability",
    "study": "evidence.study",
    "Study": "evidence.results",
    "gallery": "gallery",
    "all_solutions": "methods.search",
    "strategies": "strategies",
    **{
        error: "core.errors"
        for error in (
            "ConvergenceWarning", "InvalidOption", "InvalidProblem", "LCPError", "ModelWarning", "NotConverged",
            "UnknownAlgorithm", "UnreadableFile", "UnsuitableMatrix", "UnsuitableProblem", "UnsupportedModel",
        )
    },
}

_FOR_TESTS = {"strategies"}  # needs hypothesis, so that "import *" does without
__all__ = ["__version__", *sorted(_HOME.keys() - _FOR_TESTS)]  # noqa: PLE0604 - the names are strings, from the table


def __getattr__(name: str) -> Any:
    home = _HOME.get(name)
    if home is None:
        raise AttributeError(f"module 'lcp_plugin' has no attribute {name!r}")
    module = import_module(f"{__name__}.{home}")
    if home.startswith("modeling"):
        import_module(f"{__name__}.modeling.registration").register()
    # A room of that name is the thing itself; otherwise the thing lives in the room.
    value = module if home.split(".")[-1] == name and not hasattr(module, name) else getattr(module, name)
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
        found = (finder.find_spec(name, path, target) for finder in [*sys.meta_path] if finder is not self)
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
