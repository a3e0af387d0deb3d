"""Evidence: error against time, studies, cross-validation, stability, plots.

`error_against_time(problem)` measures several methods, and convex solvers as references, on one problem. The result can
be printed, plotted, or saved as CSV or as a plot. `study` does this on families of problems of several sizes: a row
is a measurement. Tables, curves and performance profiles are functions of rows. `cross_validate` compares a solution
with a result of a convex solver. `stability_atlas` has status, residual and true error of each algorithm on stiff and
extreme problems.
`lcp-plugin compare` and `lcp-plugin check` are the first and the third of these.

Other packages. No package is best at everything. As far as we know, none of these bounds the error of a solution.

- PATH (in GAMS, AMPL, JuMP) is better at nonlinear complementarity and has decades of hard models behind it. This one
  adds open source without a licence key, grids with a million unknowns, proofs of infeasibility.
- Siconos simulates whole mechanisms: it detects contacts, integrates, and handles rolling friction. This one adds, for
  the contact problem of a step, statuses computed on your data, gradients and cvxpy.
- PETSc SNESVI is better at nonlinear problems on several machines. Here M and q are enough, without residual functions
  and geometry, on one machine or, through PETSc, on several.
- QuantEcon's ``lcp_lemke`` and lemkelcp have few dependencies. This one adds sparse matrices and every method but
  Lemke's.
- Pyomo, JuMP and GAMSPy are better at nonlinear and mixed-integer models and know many solvers. This one adds the
  solver itself, and cvxpy's language.
- PIQP, OSQP, Clarabel and HiGHS (through cvxpy or not) are better at general constraints and cones, PIQP on small
  rank-deficient contact problems. This one adds nonsymmetric M without a reformulation, and speed on large
  dense and sparse problems.
"""
