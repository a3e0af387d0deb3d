"""Splitting methods: projected-type (np*), projected relaxation (p*, gfp), modulus-based (m*).

What to expect of sweeps:

- On the paper's two examples, where no constraint is active, NPSOR(1.7) needs 12–17 iterations (``lcp-plugin tables``)
  and plain projected Gauss–Seidel 10–16 (``lcp-plugin solve paper_example_1 -a pgs --measure euclidean --tolerance
  1e-5``, and ``paper_example_2``).
- Where constraints are active, the np* methods need their row scaling, which is on by default.
- psor finds a relaxation that needs at most twice the iterations of the best fixed one on a plain obstacle problem.
- On a fine grid all of them are slow: with the best relaxation the iterations grow with the number of nodes across,
  without it with its square. multigrid takes about ten V-cycles whatever n. It needs no geometry, only M.
- They are not for every matrix. On bimatrix games, circuits, saddle points and infeasible problems they end STALLED or
  DIVERGED, on rank-deficient contact sometimes; "auto" goes on with direct methods there.

The paper's formulas for NPSOR and NPAOR contain misprints; implemented as printed they converge to a wrong point, which
a test demonstrates. The modulus rows of its tables are those of Ω = D/2 (MGS) and D/(2α²) (MSOR).
"""
