"""Nonlinear complementarity problems: F, steps by linearisation, certificate; here, what takes the kind."""

from ...core.kind import Kind

NONLINEAR_PROBLEM = Kind(
    "nonlinear complementarity problem",
    "NonlinearProblem",
    ("solve", "derivative", "pickle", "cvxpy", "Pyomo", "AMPL", "lcp-plugin solve"),
    "problem.linearised(x) is the LCP at a point x",
    {
        "z0=": "a start is called x0 here",
        "prove_infeasibility=": "nothing proves a nonlinear problem infeasible, leave it out",
        "error_bound=": "nothing bounds the error of a nonlinear problem, leave it out",
        "tolerance_on=": "nothing bounds the error of a nonlinear problem, leave it out",
        "solve_batch": "write [solve(problem, x0=…) for problem in problems]",
        "march": "write solve(problem, x0=result.x) for each step",
        "Certificate.of": "solve(problem, x0=x, max_iterations=0).certificate is that of x",
        "error_bound": "nothing bounds the error of a nonlinear problem; compare solutions from several starts",
        "certify": "solve(problem, x0=x, max_iterations=0).certificate has the residuals of any x",
        "save": "it is made of functions: state it in cvxpy, Pyomo or AMPL, whose .nl files are read",
        "qpsolvers": "its program has no place for it: write solve(problem, x0=…)",
        "lcp-plugin check": "a convex solver has nothing to compare with: lcp-plugin solve judges it",
    },
)
