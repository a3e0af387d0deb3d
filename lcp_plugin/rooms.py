"""The front door's list of what rooms offer: what a file further down asks :mod:`lcp_plugin.core.registry` for."""

from .core.registry import offer

OFFERS = {
    "algorithm": {
        "mj": "methods.modulus.modulus:MJ",
        "mgs": "methods.modulus.modulus:MGS",
        "msor": "methods.modulus.modulus:MSOR",
        "maor": "methods.modulus.modulus:MAOR",
        "npsplitting": "methods.npsplitting:NPSplitting",
        "newton": "methods.newton.semismooth_newton:Newton",
        "interior_point": "methods.interior.interior_point:InteriorPoint",
        "banded": "methods.banded:Banded",
        "lemke": "methods.lemke:Lemke",
        "multigrid": "methods.multigrid:Multigrid",
    },
    "kind": {
        "LCP": "core.kinds:LINEAR_COMPLEMENTARITY_PROBLEM",
        "NonlinearProblem": "problems.nonlinear:NONLINEAR_PROBLEM",
        "QuadraticProgram": "problems.programs.kind:QUADRATIC_PROGRAM",
        "EquilibriumProgram": "problems.equilibria:EQUILIBRIUM_PROGRAM",
        "BoundedLeastSquares": "problems.least_squares:BOUNDED_LEAST_SQUARES",
        "ConeProblem": "problems.cones:CONE_PROBLEM",
        "FrictionalContact": "problems.cones:FRICTIONAL_CONTACT",
    },
    "conversion": {
        "from_qp": "problems.programs.conversion:lcp_from_qp",
        "to_qp": "problems.programs.conversion:qp_from_lcp",
        "from_game": "problems.reformulations.bimatrix_game:lcp_from_bimatrix_game",
        "from_contacts": "problems.contact:lcp_from_contacts",
        "from_cvxpy": "modeling.registration:lcp_stated_by",
        "to_cvxpy": "modeling.registration:stated_in_cvxpy",
    },
    "file format": {
        "save": "doors.files.files:save",
        "load": "doors.files.files:load",
        "an LCP in .nl": "doors.nl.model:lcp_in_nl",
        "a program in .nl": "doors.nl.model:program_in_nl",
        "a Pyomo model in .nl": "doors.pyomo.answers:content_of",
        "write .nl": "doors.nl.writing:write_nl",
        "save arrays": "doors.files.files:save_arrays",
        "arrays of cones": "problems.cones.files:arrays_of",
        "a problem over cones": "problems.cones.files:problem_of",
    },
    "global solver": {"SCIP": "doors.scip:minimize_or_none"},
    "ranks": {
        "matrix": "ranks.on_ranks:matrix_of_rows",
        "require_same_numbers": "ranks.on_ranks:require_same_numbers",
        "equal_part": "ranks.on_ranks:equal_part",
        "save": "ranks.on_ranks:save",
        "load": "ranks.on_ranks:load",
        "auto": "ranks.auto:AutoOnRanks",
        "joined_parts": "ranks.joint_facts:joined_parts",
        "has_symmetric_products": "ranks.joint_facts:has_symmetric_products",
        "pivot_weight": "ranks.joint_facts:pivot_weight",
    },
    "algorithm of another package": {
        "class": "doors.packages:class_from_outside",
        "group": "doors.packages:ENTRY_POINT_GROUP",
        "all": "doors.packages:from_other_packages",
    },
    "certification": {"cvxpy": "modeling.certified_problem:certify_problem"},
    "step of auto": {
        "small": "methods.small.small_dense:SmallDenseSolver",
        "direct methods": "methods.direct:Turns",
        "factor passes": "methods.direct:factor_passes",
        "is unheld": "proofs.no_solution.infeasibility:seems_unheld",
        "once more": "methods.direct:Retries",
        "feasibility": "methods.search.stages:FeasibilityCheck",
    },
    "judge": {"error": "proofs.bounds.error_judge:ErrorJudge"},
    "remark": {
        "classes": "proofs.verdicts.report:classes_in_words",
        "sign": "proofs.verdicts.report:sign_remark",
        "misleading": "proofs.misleading:what_may_mislead",
        "guarantee": "proofs.guarantees:convergence_guarantee",
        "uncovered": "proofs.guarantees:warn_where_known_to_be_uncovered",
    },
    "picture": {"answer": "evidence.plots:plot_answer"},
}

for what, places in OFFERS.items():
    offer(what, places)
