"""Linear complementarity problems: model, solve, certify.

Find z with lower ≤ z ≤ upper and w = M z + q complementary. The names below load on first use, so that
``import lcp_plugin`` costs no more than numpy and scipy.sparse. Each has its help; these are pages on a whole subject:

- ``help("lcp_plugin.modeling")``: what may be stated in cvxpy, and how its status is judged
- ``help("lcp_plugin.conversions")``: quadratic and linear programs, games, absolute value equations
- ``help("lcp_plugin.policy.choice")``: what algorithm="auto" does
- ``help("lcp_plugin.policy.direct_methods")``: how it goes on without sweeps
- ``help("lcp_plugin.algorithms.splittings")``: what to expect of sweeps
- ``help("lcp_plugin.certificates")``: what is proved of a matrix, a method, an error, a problem without solution
- ``help("lcp_plugin.certificates.criterion")``: what SOLVED means, in which units
- ``help("lcp_plugin.learn")``: layers for PyTorch and JAX
- ``help("lcp_plugin.doors")``: Pyomo, AMPL, JuMP, qpsolvers, cvxpylayers, QuantEcon, files, finite elements
- ``help("lcp_plugin.evidence")``: scenes and the report; other packages
- ``help("lcp_plugin.communicator")``: several machines
- ``help("lcp_plugin.strategies")``: hypothesis strategies, and a test of any solver
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from . import rooms as rooms

__version__ = "0.1.0"

if TYPE_CHECKING:
    from .algorithms.search import all_solutions as all_solutions
    from .certificates.error_bounds import ErrorBound as ErrorBound
    from .certificates.error_bounds import error_bound as error_bound
    from .certificates.residuals import Certificate as Certificate
    from .certificates.theorems import Guarantee as Guarantee
    from .conversions.equilibrium_program import EquilibriumProgram as EquilibriumProgram
    from .conversions.program_batch import QuadraticProgramBatch as QuadraticProgramBatch
    from .conversions.program_files import load_problem as load_problem
    from .conversions.quadratic_program import QuadraticProgram as QuadraticProgram
    from .doors.qpsolvers import register_with_qpsolvers as register_with_qpsolvers
    from .doors.quantecon import lemke as lemke
    from .evidence.cross_check import CrossCheck as CrossCheck
    from .evidence.cross_check import cross_validate as cross_validate
    from .evidence.error_against_time import error_against_time as error_against_time
    from .evidence.results import Study as Study
    from .evidence.stability import stability_atlas as stability_atlas
    from .evidence.study import study as study
    from .matrix import MatrixReport as MatrixReport
    from .matrix import analyze as analyze
    from .modeling.constraint import box as box
    from .modeling.constraint import complements as complements
    from .modeling.qp_solver import QPSolver as QPSolver
    from .modeling.registration import ComplementarityProblem as ComplementarityProblem
    from .modeling.registration import is_complementarity_problem as is_complementarity_problem
    from .modeling.registration import register as register
    from .problem.lcp import LCP as LCP
    from .problem.least_squares import BoundedLeastSquares as BoundedLeastSquares
    from .problem.nonlinear import NonlinearProblem as NonlinearProblem
    from .settings import Status as Status
    from .solving.batch import prepare as prepare
    from .solving.batch import solve_batch as solve_batch
    from .solving.batch import solve_many as solve_many
    from .solving.batch_derivative import BatchDerivative as BatchDerivative
    from .solving.batch_derivative import BatchGradient as BatchGradient
    from .solving.batch_run import BatchResult as BatchResult
    from .solving.certification import certify as certify
    from .solving.derivative import Derivative as Derivative
    from .solving.derivative import Gradient as Gradient
    from .solving.derivative import derivative as derivative
    from .solving.driver import solve as solve
    from .solving.equilibria.branch_and_bound import minimize_over_solutions as minimize_over_solutions
    from .solving.equilibria.result import EquilibriumResult as EquilibriumResult
    from .solving.guarantees import convergence_guarantee as convergence_guarantee
    from .solving.least_squares import LeastSquaresResult as LeastSquaresResult
    from .solving.least_squares import bounded_least_squares as bounded_least_squares
    from .solving.march import March as March
    from .solving.march import march as march
    from .solving.march_derivative import MarchDerivative as MarchDerivative
    from .solving.march_derivative import MarchGradient as MarchGradient
    from .solving.march_many import march_many as march_many
    from .solving.nonlinear import solve_nonlinear as solve_nonlinear
    from .solving.program_batch import ProgramBatchResult as ProgramBatchResult
    from .solving.program_proofs import Certification as Certification
    from .solving.quadratic_program import QuadraticProgramResult as QuadraticProgramResult
    from .solving.result import Result as Result
    from .solving.result import Sample as Sample

_HOME = {
    "LCP": "problem.lcp",
    "NonlinearProblem": "problem.nonlinear",
    "BoundedLeastSquares": "problem.least_squares",
    "solve_nonlinear": "solving.nonlinear",
    "Certificate": "certificates.residuals",
    "ErrorBound": "certificates.error_bounds",
    "error_bound": "certificates.error_bounds",
    "Guarantee": "certificates.theorems",
    "convergence_guarantee": "solving.guarantees",
    "MatrixReport": "matrix",
    "analyze": "matrix",
    "Result": "solving.result",
    "Sample": "solving.result",
    "Status": "settings",
    "solve": "solving.driver",
    "certify": "solving.certification",
    "Certification": "solving.program_proofs",
    "derivative": "solving.derivative",
    "Derivative": "solving.derivative",
    "Gradient": "solving.derivative",
    "BatchDerivative": "solving.batch_derivative",
    "BatchGradient": "solving.batch_derivative",
    "prepare": "solving.batch",
    "solve_batch": "solving.batch",
    "BatchResult": "solving.batch_run",
    "ProgramBatchResult": "solving.program_batch",
    "QuadraticProgramResult": "solving.quadratic_program",
    "solve_many": "solving.batch",
    "march": "solving.march",
    "March": "solving.march",
    "march_many": "solving.march_many",
    "MarchDerivative": "solving.march_derivative",
    "MarchGradient": "solving.march_derivative",
    "bounded_least_squares": "solving.least_squares",
    "LeastSquaresResult": "solving.least_squares",
    "ComplementarityProblem": "modeling.registration",
    "QPSolver": "modeling.qp_solver",
    "QuadraticProgram": "conversions.quadratic_program",
    "QuadraticProgramBatch": "conversions.program_batch",
    "load_problem": "conversions.program_files",
    "EquilibriumProgram": "conversions.equilibrium_program",
    "minimize_over_solutions": "solving.equilibria.branch_and_bound",
    "EquilibriumResult": "solving.equilibria.result",
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
    "gallery": "evidence.gallery",
    "all_solutions": "algorithms.search",
    "strategies": "strategies",
    **{
        error: "errors"
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
