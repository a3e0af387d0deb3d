"""The front door's list of what rooms offer: what a file further down asks :mod:`lcp_plugin.registry` for."""

from .registry import offer

OFFERS = {
    "algorithm": {
        "npsplitting": "algorithms.splittings.np_splitting:NPSplitting",
        "newton": "algorithms.active_sets.semismooth_newton:Newton",
        "interior_point": "algorithms.interior_points.interior_point:InteriorPoint",
        "banded": "algorithms.active_sets.banded:Banded",
        "lemke": "algorithms.pivots.lemke:Lemke",
        "multigrid": "algorithms.multigrid:Multigrid",
    },
    "kind": {
        "LCP": "problem.lcp_kind:LINEAR_COMPLEMENTARITY_PROBLEM",
        "NonlinearProblem": "problem.nonlinear_kind:NONLINEAR_PROBLEM",
        "QuadraticProgram": "conversions.program_kind:QUADRATIC_PROGRAM",
        "EquilibriumProgram": "conversions.equilibrium_kind:EQUILIBRIUM_PROGRAM",
        "BoundedLeastSquares": "problem.least_squares_kind:BOUNDED_LEAST_SQUARES",
    },
    "conversion": {
        "from_qp": "conversions.quadratic_program:lcp_from_qp",
        "to_qp": "conversions.quadratic_program:qp_from_lcp",
        "from_game": "conversions.bimatrix_game:lcp_from_bimatrix_game",
        "from_cvxpy": "modeling.registration:lcp_stated_by",
        "to_cvxpy": "modeling.registration:stated_in_cvxpy",
    },
    "file format": {
        "save": "problem.files:save",
        "load": "problem.files:load",
        "an LCP in .nl": "modeling.nl.model:lcp_in_nl",
        "a program in .nl": "modeling.nl.model:program_in_nl",
    },
    "ranks": {
        "matrix": "problem.on_ranks:matrix_of_rows",
        "require_same_numbers": "problem.on_ranks:require_same_numbers",
        "equal_part": "problem.on_ranks:equal_part",
        "save": "problem.on_ranks:save",
        "load": "problem.on_ranks:load",
    },
    "certification": {"cvxpy": "modeling.certified_problem:certify_problem"},
    "step of auto": {
        "small": "algorithms.small_dense:SmallDenseSolver",
        "direct methods": "policy.direct_methods:Turns",
        "once more": "policy.direct_methods:Retries",
        "feasibility": "algorithms.search.stages:FeasibilityCheck",
    },
    "watch": {"error": "solving.error_watch:ErrorWatch"},
    "remark": {
        "classes": "matrix.sign:classes_in_words",
        "sign": "matrix.sign:sign_remark",
        "estimated error": "certificates.active_rows:estimated_error",
        "guarantee": "solving.guarantees:convergence_guarantee",
        "uncovered": "solving.guarantees:warn_where_known_to_be_uncovered",
    },
    "picture": {"answer": "evidence.plots:plot_answer"},
}

for what, places in OFFERS.items():
    offer(what, places)
