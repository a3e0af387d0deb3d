"""Hypothesis strategies: matrices whose class is certain, problems whose answer is exact, and a test of any solver.

Everything drawn consists of small integers, so that its class holds in exact arithmetic,
not up to rounding, and it is right by construction: nothing is drawn only to be thrown away. All strategies shrink
towards the 1 × 1 identity, or the simplest matrix of their class, and small integers. Sizes up to about thirty rows are
practical: hypothesis draws every entry and rejects what is too much for it.

`lcps` draws problems, `solved_lcps` with the exact answer, `infeasible_lcps` with a Farkas proof, `convex_qps` with x
and multipliers; each matrix strategy is named after its class and draws arrays; `.map(scipy.sparse.csr_array)` makes
them CSR arrays.
`assert_solves` takes any callable (M, q, lower, upper) → z and reports the smallest problem on which it is wrong.

>>> from lcp_plugin import LCP, Status, solve
>>> def my_solver(M, q, lower, upper):
...     result = solve(LCP(M, q, lower=lower, upper=upper), tolerance=1e-10)
...     return result.z if result.status is Status.SOLVED else None
>>> assert_solves(my_solver, matrices=p_matrices(size=4), bounds=True, max_examples=50)
"""

try:
    import hypothesis  # noqa: F401 - to say what is missing before the modules below do
except ImportError:
    raise ImportError(
        "lcp_plugin.strategies needs hypothesis; install it with: pip install '.[test]'"
    ) from None

from .judge import assert_solves
from .matrices import (
    h_plus_matrices,
    m_matrices,
    not_h_matrices,
    p_matrices,
    positive_definite_matrices,
    positive_semidefinite_matrices,
    strictly_dominant_matrices,
    z_matrices,
)
from .problems import infeasible_lcps, lcps, solved_lcps
from .programs import QPAnswer, convex_qps

__all__ = [
    "QPAnswer",
    "assert_solves",
    "convex_qps",
    "h_plus_matrices",
    "infeasible_lcps",
    "lcps",
    "m_matrices",
    "not_h_matrices",
    "p_matrices",
    "positive_definite_matrices",
    "positive_semidefinite_matrices",
    "solved_lcps",
    "strictly_dominant_matrices",
    "z_matrices",
]
