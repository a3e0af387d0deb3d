"""Convex quadratic and linear programs; what can be stated as a linear complementarity problem, and back.

``solve(QuadraticProgram(…))`` is `solving.solve_program`, whoever calls it. In order, until one decides:

1. A small dense program goes to an active set as it stands (`engine_calls.solved_as_given`).
2. Each engine that `engine_calls.engines_for` names: the program made smaller (`reductions`) and prepared
   (`engines.statement`), the engine's point polished (`engines.polish`) and judged here (`criterion`). Where it says
   that there is no minimum, a proof is looked for (`no_minimum`).
3. A run on the complementarity problem (`conversion`), as of an LCP; its z is taken back to an x and judged here.
4. A proof that there is no minimum. Without one, `solving._status` says what is missing.

| file | what is in it |
|---|---|
| `program`, `program_matrices`, `constraints`, `convexity`, `contradictions` | the data, and what they alone say |
| `reductions` | smaller programs, step by step, and the way back |
| `engine_calls` | the way to an answer without a run: engines of others, polished and judged |
| `conversion` | the complementarity problem of a program, and the answer that its z is |
| `criterion`, `solution` | what is optimal, and by how much an answer misses it |
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
| linear program | ``problems.programs.conversion.lcp_from_lp`` |
| least squares within bounds | ``solve(BoundedLeastSquares(A, b))``, or ``LCP.from_qp(A.T @ A, −A.T @ b, lower=0)`` |
| bimatrix game, QuantEcon's too | ``LCP.from_game(A, B)`` |
| contacts with friction | ``LCP.from_contacts(W, friction, velocities)`` or of bodies; back: impulses, slip, stick |
| absolute value equation A x − abs(x) = b | ``LCP(solve(A − I, A + I), solve(A − I, b))`` by numpy; x = w − z |
| model of complementarities in cvxpy | ``LCP.from_cvxpy(problem)``; back: ``problem.to_cvxpy()`` |

Quadratic programs must be convex; others are refused (`UnsupportedModel`): up to n = 5000 where P has a negative
eigenvalue beyond rounding, above where single entries show it. ``is_optimal`` of an answer asks whether P is shown, up
to rounding, to be semidefinite, ``is_stationary`` does not.
"""
