"""Evidence: studies, pictures, tables, the report. Heavy; only the commands import it.

``lcp-plugin study`` measures methods on families of problems, yours and ours, into one CSV that a second run goes on
from, and saves tables (LaTeX, Markdown, CSV) and pictures (PDF, SVG, PNG) of it: iterations, passes, seconds, and the
spectral radius that papers print (``--save radius=table.tex``). In Python: `study`.

``lcp-plugin report`` writes one page, ``index.html``, which needs no other file and no network, and the same figures as
CSV and JSON. Scenes and your own files stand in it side by side, each with the paper's methods at its settings and at
ours, beside their relatives; without either, a choice of scenes. ``lcp-plugin tables`` computes the paper's tables
again. In Python: `error_against_time`, `stability_atlas`, `cross_validate`, and `gallery` for the scenes.
`stability_atlas(names, ["ranges"]).plot()` is a map a method.

Other packages. No package is best at everything. As far as we know, none of these bounds the error of an answer.

- PATH (in GAMS, AMPL, JuMP) is better at nonlinear complementarity and has decades of hard models behind it. This one
  adds open source without a licence key, grids with a million unknowns, proofs of infeasibility.
- Siconos simulates whole mechanisms: it detects contacts, integrates, and knows rolling friction. This one adds, for
  the contact problem of a step, answers judged on your data, gradients and cvxpy (``python tests/benchmarks cones``).
- PETSc SNESVI is better at nonlinear problems on several machines. Here are no residual functions and no geometry to
  write where M and q are enough, on one machine or, through PETSc, on several.
- QuantEcon's ``lcp_lemke`` and lemkelcp have few dependencies. This one adds sparse matrices and every method but
  Lemke's.
- Pyomo, JuMP and GAMSPy are better at nonlinear and mixed-integer models and know many solvers. This one adds the
  solver itself, and cvxpy's language.
- PIQP, OSQP, Clarabel and HiGHS (through cvxpy or not) are better at general constraints and cones, PIQP on small
  rank-deficient contact problems. This one adds nonsymmetric M as it is, without a reformulation, and speed on large
  dense and sparse problems (``python tests/benchmarks rivals`` measures nine cases).
"""
