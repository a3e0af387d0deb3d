"""Nonlinear complementarity problems: F, steps by linearisation, certificate, proof; here, what takes the kind."""

from ...core.kind import Kind

NONLINEAR_PROBLEM = Kind(
    "nonlinear complementarity problem",
    "NonlinearProblem",
    ("solve", "derivative", "pickle", "cvxpy", "Pyomo", "AMPL", "lcp-plugin solve"),
    "problem.linearised(x) is the LCP at a point x",
    {
        "z0=": "a start is called x0 here",
        "prove_infeasibility=": "nothing proves a nonlinear problem infeasible, leave it out",
        "tolerance_on=": "error_bound=True proves a solution near x, given an enclosure",
        "solve_batch": "write [solve(problem, x0=…) for problem in problems]",
        "march": "write solve(problem, x0=result.x) for each step",
        "Certificate.of": "solve(problem, x0=x, max_iterations=0).certificate is that of x",
        "error_bound": "solve(problem, x0=x, error_bound=True).error_bound proves a solution near x, given an "
        "enclosure",
        "certify": "solve(problem, x0=x, max_iterations=0).certificate has the residuals of any x",
        "save": "it is made of functions: state it in cvxpy, Pyomo or AMPL, whose .nl files are read",
        "qpsolvers": "its program has no place for it: write solve(problem, x0=…)",
        "lcp-plugin check": "a convex solver has nothing to compare with: lcp-plugin solve judges it",
        "lcp-plugin certify": "lcp-plugin solve judges it",
    },
)
