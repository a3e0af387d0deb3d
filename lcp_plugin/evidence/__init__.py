"""Evidence: error against time, studies, cross-validation, plots.

`error_against_time(problem)` measures several methods, and convex solvers as references, on one problem. The result can
be printed, or saved as a plot. `study` does this on families of problems of several sizes: a row
is a measurement; tables and curves are functions of rows. `cross_validate` compares a solution
with a result of a convex solver.
`lcp-plugin compare` is the first of these.

Other packages. No package is best at everything.

- PATH (in GAMS, AMPL, JuMP) is better at nonlinear complementarity and has decades of hard models behind it. This
  package adds open source without a license key, grids with a million unknowns, proofs of infeasibility.
- Siconos simulates whole mechanisms: it detects contacts, integrates, and handles rolling friction. This package adds,
  for the contact problem of a step, statuses computed on your data, gradients and cvxpy.
- PETSc SNESVI is better at nonlinear problems on several machines. For an LCP, this package needs only M and q,
  also on several machines with MPI (``help("lcp_plugin.ranks")``).
- QuantEcon's ``lcp_lemke`` solves a dense LCP with ten unknowns a hundred times faster than one call of `solve`.
  lemkelcp has few dependencies. This package adds sparse matrices, other algorithms, bounds and verified statuses.
- Pyomo, JuMP and GAMSPy are better at nonlinear and mixed-integer models and interface to many solvers. This package
  adds the solver itself, and the language of cvxpy.
- PIQP, OSQP, Clarabel and HiGHS (through cvxpy or not) solve convex programs faster than `solve`, which calls PIQP and
  then verifies the result; they also support general cones. This package adds verified statuses, proofs, and
  nonsymmetric M without a reformulation.

The manual has measured times: ``examples/manual/speed.md``.
"""
