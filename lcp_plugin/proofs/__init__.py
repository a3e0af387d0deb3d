"""Proofs about a matrix, a method and a solution, from only the caller's data.

>>> from lcp_plugin import LCP, analyze, error_bound, solve
>>> from lcp_plugin import convergence_guarantee
>>> problem = LCP([[4, -1, 0], [-1, 4, -1], [0, -1, 4]], [-3, 5, -1])
>>> print(analyze(problem).is_h_plus)  # print(analyze(problem)) shows every verdict with its evidence
True
>>> convergence_guarantee(problem, "npsor").verdict  # also the theorem, and the rate that it proves
'guaranteed'
>>> result = solve(problem, tolerance=1e-12)
>>> result.status.name, result.error_bound.infinity <= 1e-10
('SOLVED', True)
>>> bound = error_bound(problem, [0.8, 0.0, 0.2])  # of any z; row by row in bound.componentwise
>>> bool(bound.componentwise.max() < 0.2)
True

**Verdicts.** `analyze` of a matrix, or of a problem's matrix, returns True, False or None (undecided). True and False
are proved for the stored double-precision data. M is an H₊-matrix if its diagonal is positive and ⟨M⟩v > 0 for some
v > 0, with ⟨M⟩ the comparison matrix; the report keeps such a v. P-matrices are decided up to n = 16, or by a
sufficient class. Positive semidefinite is exact up to n = 10; beyond that a singular matrix stays undecided, and the
evidence is λ_min ≥ −δ, with the value of δ.

**Error bounds** exist for H₊-matrices and if the symmetric part is proven positive definite; they include all
rounding errors. Other matrices have no bound. If a factorization would fill in too much (3-D grids above about 40³,
random graphs above about 1000 unknowns) and no cheaper test decides, neither a verdict nor a bound exists.

**In a result.** ``result.error_bound`` is the bound, computed on first access, or None; ``explain()`` then prints it
(its time is ``result.error_bound.seconds``).

**Without a bound.** SOLVED refers to the residual; on stiff data a small residual can go with a larger error in z.
``explain()`` warns if the diagonal spans more than six decades, if M is so nearly singular on the free rows that the
error may exceed 1 % of z, and if a product (z_i − bound) w_i is large relative to the residual.

**Guarantees** are "guaranteed" or "not covered". ``scaling="auto"``, the default of the np* methods, is a row scaling
with which every H₊-matrix is covered: S = θ_i/d_i with θ_i = 1, or up to 2 if the row sums of M prove that too.
`solve` does not analyze M by itself: ``result.guarantee`` (or `convergence_guarantee`) reports whether a theorem
covers the named algorithm, and so does ``explain()`` after a run that failed.

**Programs.** `certify` verifies a solution of a convex quadratic or linear program, from any solver: the values in a
cvxpy problem, or an x for a `QuadraticProgram`. "proved" means that the violation and the distance from a proved lower
bound are at most the tolerance, unless x is proved to be wrong for another reason; see ``certify(problem).reason``.

>>> import lcp_plugin
>>> program = lcp_plugin.QuadraticProgram([[2, 0], [0, 2]], [-2, -4], G=[[1, 1]], h=[2])
>>> said = lcp_plugin.certify(program, [0.5, 1.5])
>>> said.verdict, round(said.lower, 9)
('proved', -4.5)

**No solution.** ``result.infeasibility`` proves it for the stored double-precision data, and ``verify()`` checks it
again. Its ``margin`` is a lower bound of the relative residual of every z, as SOLVED measures it. If the margin is
within the tolerance the methods continue, and the proof stays in the result. "auto" searches for a proof if its methods
find no solution, and so does a run with newton, interior_point or lemke;
sweeps alone end STALLED or DIVERGED.
"""
