"""The best solution of a complementarity problem, by branch and bound with proofs; here, what takes the kind."""

from ...core.kind import Kind

EQUILIBRIUM_PROGRAM = Kind(
    "objective over equilibria",
    "EquilibriumProgram",
    ("solve", "solve_batch", "pickle", "cvxpy", "Pyomo", "AMPL", "lcp-plugin solve"),
    "solve(problem) takes it; its pairs alone are an LCP where they determine their unknowns",
    {
        "algorithm=": "SCIP runs where it is installed, prove=True asks for a proof",
        "max_iterations=": "max_nodes limits the search",
        "z0=": "a start is called x0 here",
        "error_bound=": "result.gap is what is left, result.bound_by says whose bound",
        "derivative": "the best of all solutions may jump from one to another",
        "certify": "solve(problem, prove=True).verify() checks its proof again",
        "Certificate.of": "solve(problem, prove=True).verify() checks its proof again",
        "error_bound": "solve(problem).gap is what is left, bound_by says whose bound",
        "save": "state it in AMPL's .nl, which lcp-plugin solve reads",
        "qpsolvers": "its program has no place for pairs: write solve(problem)",
        **{
            f"lcp-plugin {name}": "lcp-plugin solve --option prove=true proves its bound"
            for name in ("check", "analyze", "compare")
        },
    },
)
