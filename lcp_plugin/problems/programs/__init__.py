"""Convex quadratic and linear programs; what can be stated as a linear complementarity problem, and back.

``solve(QuadraticProgram(…))`` is `solving.solve_program`, whoever calls it. In order, until one decides:

1. External solvers, in the order of `engine_calls.ATTEMPTS`: rows of one variable become bounds (`reductions`), the
   program is scaled (`engines.scaling`); the point, without noise and polished (`engines.polish`), is tested
   (`criterion`). If the solver says that there is no minimum, a proof is looked for (`no_minimum`).
2. A run on the complementarity problem (`conversion`), if the program is small; before, if it has bounds alone and is
   large.
3. A proof that there is no minimum; otherwise PRECISION_LIMIT or STALLED with the two measures of the best point.

| file | what is in it |
|---|---|
| `program`, `program_matrices`, `constraints`, `convexity` | the data, and what they alone say |
| `reductions` | rows of one variable as bounds, and the way back |
| `criterion`, `solution` | the one test of a point, and its two measures |
| `engine_calls`, `solving` | points of external solvers, and the status |
| `conversion` | the complementarity problem of a program, and the answer that its z is |
| `no_minimum` | proofs that a program is infeasible or unbounded |
| `certification`, `dual_bounds`, `feasible_points` | what is proved of anybody's answer |
| `kind` | what the package asks of a kind: messages, names, ways in |
| `stacked_programs` | many programs of one shape |

Every function ``lcp_from_…`` returns an :class:`~lcp_plugin.core.lcp.LCP` whose ``origin`` remembers where it came
from: ``origin.recover(result)``, with a result of ``solve`` or any z, gives the answer in the terms of the problem that
was asked, together with a measure of how wrong it is there.

| problem | function |
|---|---|
| convex quadratic program | ``LCP.from_qp(P, c, G, h, A, b, lower, upper)``; back: ``problem.to_qp()`` |
| programs with the same matrices | ``solve_batch(prepare(program), [{"b": b}, …])``, ``program.with_vectors(b=b)`` |
| many programs of one shape | ``solve_batch(QuadraticProgramBatch(P, c, G, h, A, b, lower, upper))``, stacked data |
| least squares within bounds | ``solve(BoundedLeastSquares(A, b))``, or ``LCP.from_qp(A.T @ A, −A.T @ b, lower=0)`` |
| bimatrix game, QuantEcon's too | ``LCP.from_game(A, B)`` |
| contacts with friction | ``LCP.from_contacts(W, friction, velocities)`` or of bodies; back: impulses, slip, stick |
| absolute value equation A x − abs(x) = b | ``LCP(solve(A − I, A + I), solve(A − I, b))`` by numpy; x = w − z |
| model of complementarities in cvxpy | ``LCP.from_cvxpy(problem)``; back: ``problem.to_cvxpy()`` |

Quadratic programs must be convex to the rounding of single precision; others are refused (`UnsupportedModel`).
"""
