"""What can be proved about a matrix, a method and an answer, from the data of the caller alone.

>>> from lcp_plugin import LCP, analyze, error_bound, solve
>>> from lcp_plugin.proofs.guarantees import convergence_guarantee
>>> problem = LCP([[4, -1, 0], [-1, 4, -1], [0, -1, 4]], [-3, 5, -1])
>>> print(analyze(problem).is_h_plus)  # print(analyze(problem)) shows every verdict with its evidence
True
>>> convergence_guarantee(problem, "npsor").verdict  # also the theorem, and the rate that it proves
'guaranteed'
>>> result = solve(problem, error_bound=True, tolerance=1e-12)
>>> result.status.name, result.error_bound.infinity <= 1e-10
('SOLVED', True)
>>> bound = error_bound(problem, [0.8, 0.0, 0.2])  # of any z; row by row in bound.componentwise
>>> bound.proven_active.tolist()
[False, True, False]

**Verdicts.** `analyze` says True, False or None (undecided). True and False are proved for the stored doubles, rounding
included. M is an H₊-matrix where its diagonal is positive and ⟨M⟩v > 0 for some v > 0, with ⟨M⟩ the comparison matrix;
the report keeps such a v. P-matrices are decided up to n = 16, or by a sufficient class. Positive semidefinite is exact
up to n = 10; beyond that a singular matrix stays undecided, and the evidence says λ_min ≥ −δ, with δ.

**Error bounds** exist for H₊-matrices and where the symmetric part is proven positive definite; they hold with all
rounding. On other matrices there is no bound. If a factorization would fill in too much (3-D grids above some 40³,
random graphs above some thousand unknowns) and nothing cheaper decides, there is no verdict and no bound.

**In a result.** With ``error_bound=True`` the bound is part of the result, computed when you look at it
(``result.error_bound.seconds`` says in what time).

**Without a bound.** SOLVED speaks of the residual; on stiff data a small one can go with a larger error in z.
``explain()`` says so where the diagonal spans more than six decades, where M is so nearly singular on the free rows
that the error may exceed 1 % of z, and where a product (z_i − bound) w_i is large beside the residual.

**Guarantees** are "guaranteed" or "not covered". ``scaling="auto"``, the default of the np* methods, is a row scaling
with which every H₊-matrix is covered: S = θ_i/d_i with θ_i = 1, or up to 2 where the row sums of M prove that too.
`solve` analyses nothing that you did not ask for: ``result.guarantee`` (or `convergence_guarantee`) looks whether a
theorem covers what you named, and so does ``explain()`` after a run that failed.

**Programs.** `certify` says what is proved about anybody's answer to a convex quadratic or linear program: of a cvxpy
problem that some solver has filled, or of an x for a `QuadraticProgram`. "proved" is a violation and a distance from a
proved lower bound of at most the tolerance, unless x is proved to be wrong although its objective is not;
``certify(problem).reason`` tells.

>>> import lcp_plugin
>>> program = lcp_plugin.QuadraticProgram([[2, 0], [0, 2]], [-2, -4], G=[[1, 1]], h=[2])
>>> said = lcp_plugin.certify(program, [0.5, 1.5])
>>> said.verdict, round(said.lower, 9), said.distance < 1e-6
('proved', -4.5, True)

**No solution.** ``result.infeasibility`` proves it for the stored doubles, and ``verify()`` checks it again. Its
``margin`` is the smallest relative residual that it leaves to any z, as SOLVED measures it.
If it is within the tolerance the methods go on, and
the proof stays in the result.
"auto" looks for a proof where its methods find no solution, and so does a run with newton, interior_point or lemke;
sweeps alone end STALLED or DIVERGED.
"""
