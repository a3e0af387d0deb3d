"""Convex quadratic and linear programs, and their conversion to linear complementarity problems and back.

``solve(QuadraticProgram(…))`` runs `solving.solve_program`. By default daqp alone first tries a small program; its
point is returned if it passes far below the tolerance. Otherwise `ProgramRun.all_stages` yields, until a stage decides:

1. costs only; the complementarity problem (`conversion`) of a large program with bounds only; least squares
   (`regression`);
2. external solvers, in the order of `engine_points.ATTEMPTS`: rows of one variable become bounds
   (`program.FoldedRows`), the program is scaled (`engines.scaling`), first with unknowns fixed that a huge cost
   forbids; the point, without noise and polished (`engines.polish`), is tested (`judges.program`). If the solver
   reports infeasible or unbounded, `no_minimum` searches for a proof;
3. the complementarity problem of a small program.

If none decides, `no_minimum` searches for a proof; without one, the status is PRECISION_LIMIT or STALLED, with the two
measures of the best point.

| file | what is in it |
|---|---|
| `program` | the data, convexity, rows of one variable as bounds |
| `program_matrices`, `fitted_units`, `constraints` | facts about the matrices only, a scaling, one list of rows |
| :mod:`lcp_plugin.judges.program` | the one test of a point, and its two measures |
| `solving`, `engine_points`, `regression` | points of external solvers and of least squares, and the status |
| `conversion` | the complementarity problem of a program, and the solution that its z encodes |
| `no_minimum` | proofs that a program is infeasible or unbounded |
| `certification`, `value_bounds` | proofs about a point from any solver |

Every function ``lcp_from_…`` returns an :class:`~lcp_plugin.core.lcp.LCP` whose ``origin`` stores the original problem.
Call ``origin.recover(result)`` with a result of ``solve`` or any z: it returns the solution of the original problem and
its residual there.

| problem | function |
|---|---|
| convex quadratic program | ``LCP.from_qp(P, c, G, h, A, b, lower, upper)``; back: ``problem.to_qp()`` |
| programs with the same matrices | ``solve_batch(prepare(program), [{"b": b}, …])``, ``program.with_vectors(b=b)`` |
| many programs of one shape | ``solve_batch(program, C)``, ``solve_batch([program, …])`` |
| least squares within bounds | ``solve(BoundedLeastSquares(A, b))``, or ``LCP.from_qp(A.T @ A, −A.T @ b, lower=0)`` |
| bimatrix game, QuantEcon's too | ``LCP.from_game(A, B)`` |
| contacts with friction | ``LCP.from_contacts(W, friction, velocities)`` or of bodies; back: impulses, slip, stick |
| absolute value equation A x − abs(x) = b | ``LCP(solve(A − I, A + I), solve(A − I, b))`` by numpy; x = w − z |
| model of complementarities in cvxpy | ``LCP.from_cvxpy(problem)``; back: ``problem.to_cvxpy()`` |

Quadratic programs must be convex to the rounding of single precision; otherwise `UnsupportedModel` is raised.
"""
