"""Least squares within bounds: steps that find the face, and steps that solve on it; here, what takes the kind."""

from ...core.kind import LANGUAGES, Kind

BOUNDED_LEAST_SQUARES = Kind(
    "bounded least squares problem",
    "BoundedLeastSquares",
    ("solve", "solve_batch", "trace", "pickle", *LANGUAGES, "lcp-plugin solve"),
    "LCP(AᵀA, −Aᵀb, lower=…, upper=…) states it as an LCP",
    {
        "z0=": "a start is called x0 here",
        "algorithm=": "what suits A is chosen",
        "certify": "solve(problem).gap is proved",
        "error_bound": "solve(problem).gap is proved",
        "error_bound=": "result.gap is proved",
        "Certificate.of": "solve(problem, x0=x, max_iterations=0) judges x",
        "save": "numpy.savez(path, A=A, b=b) saves it, and load_problem(path) reads it",
        **{
            f"lcp-plugin {name}": "lcp-plugin solve proves a gap"
            for name in ("check", "analyze", "compare")
        },
    },
)
