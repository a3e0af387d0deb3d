"""The kind of linear complementarity problems: what solves them, and which ways take them."""

from .kinds import WAYS, Kind

LINEAR_COMPLEMENTARITY_PROBLEM = Kind(
    "linear complementarity problem", "core.lcp:LCP", "core.solving.driver:solve", "core.solving.result:Result",
    tuple(way for way in WAYS if way not in ("certify", "qpsolvers", "lcp-plugin certify")), "",
    {
        "x0=": "a start is called z0 here",
        "certify": "Certificate.of(problem, z) has the residuals of a z, error_bound(problem, z) bounds its "
                   "distance from the solution",
        "qpsolvers": "problem.to_qp() makes a program of a symmetric M",
        "lcp-plugin certify": "lcp-plugin solve judges an LCP, --error-bound bounds the error",
    },
)
