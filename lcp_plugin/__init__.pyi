# The public names and the module of each, for editors and mypy; __init__.py has the same table.

from . import gallery as gallery
from . import strategies as strategies
from .api import solve as solve
from .core import lcp
from .core.errors import InvalidOption as InvalidOption
from .core.errors import InvalidProblem as InvalidProblem
from .core.errors import LCPError as LCPError
from .core.errors import ModelWarning as ModelWarning
from .core.errors import NotConverged as NotConverged
from .core.errors import UnknownAlgorithm as UnknownAlgorithm
from .core.errors import UnreadableFile as UnreadableFile
from .core.errors import UnsuitableMatrix as UnsuitableMatrix
from .core.errors import UnsuitableProblem as UnsuitableProblem
from .core.errors import UnsupportedModel as UnsupportedModel
from .core.settings import Status as Status
from .evidence.cross_check import cross_validate as cross_validate
from .evidence.study import error_against_time as error_against_time
from .evidence.study import study as study
from .interfaces.program_files import load_problem as load_problem
from .judges.certificate import Certificate as Certificate
from .lcp import from_contacts, from_qp, load, save
from .methods.search import all_solutions as all_solutions
from .modeling.agents import optimal as optimal
from .modeling.constraint import box as box
from .modeling.constraint import complements as complements
from .modeling.constraint import friction_cone as friction_cone
from .modeling.qp_solver import QPSolver as QPSolver
from .modeling.registration import lcp_stated_by, stated_in_cvxpy
from .problems.batches.batch import solve_batch as solve_batch
from .problems.cones.data import ConeProblem as ConeProblem
from .problems.cones.frictional_contact import FrictionalContact as FrictionalContact
from .problems.equilibria.equilibrium_program import EquilibriumProgram as EquilibriumProgram
from .problems.least_squares.data import BoundedLeastSquares as BoundedLeastSquares
from .problems.march import march as march
from .problems.nonlinear.data import NonlinearProblem as NonlinearProblem
from .problems.parametric.tracing import trace as trace
from .problems.portable import check_proof as check_proof
from .problems.portable import exact as exact
from .problems.prepared import prepare as prepare
from .problems.programs.certification import certify as certify
from .problems.programs.conversion import qp_from_lcp
from .problems.programs.program import QuadraticProgram as QuadraticProgram
from .problems.reformulations import lcp_from_bimatrix_game
from .problems.sensitivity import derivative as derivative
from .problems.variational import variational as variational
from .proofs.bounds import error_bound as error_bound
from .ranks.petsc import RowsOnPETSc
from .ranks.problem import RowsOnRanks
from .solving.analysis import analyze as analyze
from .solving.explanation import convergence_guarantee as convergence_guarantee
from .solving.result import Result as Result

class LCP(lcp.LCP):
    # The types of the conversions and files, which `Door` loads at run time. Through a second name: in place of the
    # first, mypy would take the type of the base class, which is Any.
    from_rows = _1 = staticmethod(RowsOnRanks.from_rows)
    from_petsc = _2 = staticmethod(RowsOnPETSc.from_petsc)
    from_qp = _3 = staticmethod(from_qp)
    from_contacts = _4 = staticmethod(from_contacts)
    from_game = _5 = staticmethod(lcp_from_bimatrix_game)
    from_cvxpy = _6 = staticmethod(lcp_stated_by)
    load = _7 = staticmethod(load)
    to_qp, to_cvxpy, save = qp_from_lcp, stated_in_cvxpy, save

__version__: str
