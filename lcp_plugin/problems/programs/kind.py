"""The kind of quadratic and linear programs: which ways take them."""

from ...core.kind import LANGUAGES, Kind

QUADRATIC_PROGRAM = Kind(
    "quadratic program",
    "QuadraticProgram",
    (
        "solve",
        "solve_batch",
        "prepare",
        "trace",
        "certify",
        "pickle",
        *LANGUAGES,
        "lcp-plugin solve",
    ),
    "LCP.from_qp(program.P, program.c, …) makes an LCP of it",
    {
        "x0=": "z0=result.z goes on from an earlier result",
        "derivative": "cvxpy's own requires_grad=True; or derivative(solve(LCP.from_qp(…))), by the data of its "
        "complementarity problem",
        **{
            f"{name}=": "certify(program, result.x) bounds the objective and the distance"
            for name in ("error_bound", "tolerance_on")
        },
        "absolute_tolerance=": "a program is judged by its own residuals, leave it out",
        "error_bound": "certify(program, x) bounds the objective and the distance",
        "analyze": "program.is_convex says whether P is positive semidefinite, analyze(program.P) the rest",
        "cross_validate": "certify(program, x) judges anybody's answer",
        "save": "numpy.savez(path, P=…, c=…, …) saves its arrays, and load_problem(path) reads them",
        **{
            f"lcp-plugin {name}": "lcp-plugin solve takes a program, certify(program, x) proves a solution"
            for name in ("check", "analyze", "compare")
        },
    },
)
