"""Complementarity problems and quadratic programs in cvxpy.

``import lcp_plugin`` registers the method, before or after cvxpy is imported. If cvxpy raises ``KeyError: 'LCP'``,
this import is missing.

**Pairs.** List them in ``cp.Problem(cp.Minimize(0), [...])`` and call ``problem.solve(method="LCP")``:

- ``complements(x >= 0, F >= 0)``: in either order. Both sides have the same shape; nothing is broadcast.
- ``complements(F >= 0, G >= 0)`` with two expressions, affine or not: an unknown s == F is added, and s ≥ 0 is
  complementary to G ≥ 0. Each row counts as an equation and needs a variable without a pair.
- ``complements(box(x, lower, upper), F)``: two bounds; F ≤ 0 at an upper bound. x may be an expression.
- ``complements(x, F)``: the attributes of the variable state the bounds, for example ``cp.Variable(2, nonneg=True)``.
  Without bounds the pair means F == 0, and a ``ModelWarning`` is issued.
- ``complements(cp.SOC(t, x), F)`` over second-order cones: F is affine, its first row is the slack of t. Two cones
  also form a pair. Coulomb friction: ``complements(friction_cone(r, mu), W @ r + b)``; of each contact the normal
  impulse is first, then the tangents. Only definitions may be listed with friction.
- ``complements(y, G == 0)``, or ``G == 0`` in the list: a free variable and its equation. If y is bounded, G == 0 is
  required only if y is strictly between its bounds, and a ``ModelWarning`` is issued.
- Bounds of a variable that equations define, for example ``w == M @ x + q`` with w nonneg. If the solution violates
  bounds that no pair states, the search for the best of all solutions looks for another one.

Parameters may be used in every expression. A second solve starts from the first. cvxpy stores sparse constants by
columns; ``M @ x`` costs one conversion of M.

**After a solve** ``pair.dual_value`` is w (the second expression if neither side is a variable), and
``pair.violation()`` is the largest natural residual. The inequalities in the pair have the dual values of a quadratic
program. The status "infeasible" comes with a proof, ``problem.solver_stats.extra_stats.proof``. ``extra_stats`` is a
`Result`; with an objective an `EquilibriumResult`, for a program a `QuadraticProgramResult`.

>>> import cvxpy as cp
>>> import numpy as np
>>> from lcp_plugin import box, complements
>>> x, y = cp.Variable(2), cp.Variable()
>>> pair = complements(box(x, 0, [1, 4]), 2 * x - y - [3, 1])
>>> _ = cp.Problem(cp.Minimize(0), [pair, y == cp.sum(x) / 2]).solve(method="LCP")
>>> x.value.round(6), pair.dual_value.round(6), pair.violation() < 1e-8
(array([1., 1.]), array([-2.,  0.]), True)

**Smooth nonlinear expressions** may replace affine ones on both sides of a pair: products and quotients of variables,
real powers, ``exp log log1p logistic entr xexp rel_entr kl_div``, ``geo_mean prod sum_squares quad_form quad_over_lin
log_sum_exp``, with affine expressions around and inside them. Curvature is not restricted. The options are those of
:func:`lcp_plugin.problems.nonlinear.solving.solve_nonlinear`.

- The run starts at the values of the variables: set ``x.value``. If F or its derivative is not finite there, or a
  variable has no value, the run starts at the point of the bounds nearest to 0, or else to 1.
- A step that leaves a domain, for example of ``log``, is shortened. State a bound that keeps the solution inside.
- ``abs``, ``maximum``, norms and integers raise UnsupportedModel. ``abs(x)`` is x + 2 s with
  ``complements(s >= 0, x + s >= 0)``; the search for the best of all solutions makes this substitution.
- An expression in every row, for example ``cp.power(cp.sum(x), -1.1)``, makes the Jacobian dense. Give it a variable
  and an equation: ``total == cp.sum(x)``.
- Write vectors: thousands of scalar expressions take seconds to read, one vector takes milliseconds.

>>> x = cp.Variable(2, nonneg=True)
>>> x.value = np.ones(2)
>>> pair = complements(x, cp.exp(x) + cp.multiply(x, x[::-1]) - [3, 0.5])
>>> problem = cp.Problem(cp.Minimize(0), [pair])
>>> _ = problem.solve(method="LCP", tolerance=1e-12)
>>> x.value.round(6), pair.dual_value.round(6)
(array([1.098612, 0.      ]), array([0. , 0.5]))

**The best of all solutions.** With an objective, ``method="LCP"`` searches for the best point that satisfies all pairs,
equations and inequalities: leader and followers, tolls, the best design of a contact. The objective, sides and rows
may be smooth, convex or not, with ``abs``; of a maximum write bounds: t >= x, t >= y. Variables may be ``integer`` or
``boolean``. Install SCIP for the search: ``pip install '.[global]'``; without SCIP only convex pieces are
searched completely.

>>> price, sold = cp.Variable(nonneg=True), cp.Variable(nonneg=True)
>>> follower = complements(sold >= 0, price + sold - 4 >= 0)  # buys until a unit is worth its price
>>> leader = cp.Problem(cp.Minimize(cp.square(sold - 1) + 2 * price), [follower])
>>> value = leader.solve(method="LCP", prove=True)
>>> leader.status, *(round(float(number), 6) for number in (value, price.value, sold.value))
('optimal', 5.0, 2.0, 2.0)
>>> best = leader.solver_stats.extra_stats
>>> best.gap <= 1e-6, best.bound_by, best.verify()
(True, 'proof', True)
>>> income = cp.Problem(cp.Maximize(cp.multiply(price, sold)), [follower, price <= 4])
>>> _ = income.solve(method="LCP")
>>> round(float(income.value), 6), round(float(price.value), 3), income.solver_stats.extra_stats.bound_by
(4.0, 2.0, 'SCIP')

- The status "optimal" requires a gap of ``tolerance`` (1e-6) relative to the terms of the objective.
  ``extra_stats.bound_by`` is "proof", or "SCIP" for a bound in floating point. ``prove=True`` requires a proof if sides
  and rows are affine, the objective is convex and no variable is an integer.
- The search starts at the values of the variables; if they are an equilibrium, the solution is not worse. If no point
  is found, variables keep their values. If ``max_seconds``, ``max_nodes`` or Ctrl-C ends the search, the status is
  "user_limit" with the best point, ``extra_stats.lower_bound`` and ``gap``; for ``cp.Maximize(f)`` these are for −f.
- Proved bounds are exact for the stored numbers. One side of every pair is exactly at its bound; other constraints
  hold to 1e-7 in units of the data. "infeasible" and "unbounded" require proofs; ``extra_stats.verify()`` repeats the
  checks. If only SCIP reports infeasibility, the status is "user_limit".
- State bounds for free decisions, for example prices and tolls: without bounds SCIP may find no lower bound.
- For arrays: ``solve(EquilibriumProgram(…))``.

**Agents.** ``optimal(program, over=[x])`` states that x solves an agent's program for the values of all other
variables; list one for each agent, with pairs and equations as needed. ``best.gap()`` is the gain that the agent could
make by itself, ``best.dual_value`` has the dual values of the program's constraints.

>>> from lcp_plugin import optimal
>>> x, y = cp.Variable(nonneg=True), cp.Variable(nonneg=True)
>>> firms = [
...     optimal(cp.Problem(cp.Maximize(cp.multiply(9 - x - y, sold))), over=[sold]) for sold in (x, y)
... ]
>>> _ = cp.Problem(cp.Minimize(0), firms).solve(method="LCP")
>>> round(float(x.value), 6), round(float(y.value), 6), max(firm.gap() for firm in firms) <= 1e-6
(3.0, 3.0, True)

**Variational inequalities.** ``variational(F, over=[x], constraints=[…])``, in the place of an agent, states that
F(x)ᵀ(y − x) ≥ 0 for all y that satisfy the constraints; ``gap()`` is the maximum of F(x)ᵀ(x − y).

**Convex quadratic and linear programs**: ``solver=lcp_plugin.QPSolver``, or ``method="LCP"``; dual values included.

>>> import lcp_plugin
>>> A, b = np.random.default_rng(0).standard_normal((30, 5)), np.ones(30)
>>> x = cp.Variable(5)
>>> problem = cp.Problem(cp.Minimize(cp.sum_squares(A @ x - b)), [x >= 0])
>>> _ = problem.solve(solver=lcp_plugin.QPSolver)
>>> problem.status, problem.solver_stats.extra_stats.status.name
('optimal', 'SOLVED')

The residuals of the program that cvxpy compiles decide the status. "infeasible" and "unbounded" require a proof; after
``method="LCP"`` ``extra_stats.explain()`` names the inconsistent constraints in your words. Bounds that cvxpy infers
for its own variables are not used. Tolerances are relative to the data of the program, not to x.

**Certificates.** ``lcp_plugin.certify(problem)`` proves values and status of any solver; objective and constraints are
evaluated as they are written in the model:

>>> lcp_plugin.certify(problem).verdict
'proved'

**Derivatives.** After a solve of a model with pairs, ``lcp_plugin.derivative(problem)`` differentiates variables and
dual values by parameters. ``vjp`` maps gradients by variables, and by constraints for dual values, to gradients by
parameters. ``jvp`` maps changes of parameters to changes of variables and dual values.

>>> x, rate, load = cp.Variable(2), cp.Parameter(value=2.0), cp.Parameter(2, value=[6.0, -1.0])
>>> pair = complements(x >= 0, rate**2 * x - load >= 0)
>>> problem = cp.Problem(cp.Minimize(0), [pair])
>>> _ = problem.solve(method="LCP")
>>> derivative = lcp_plugin.derivative(problem)
>>> gradients = derivative.vjp({x: [1.0, 1.0]})  # x = (load / rate², 0)
>>> gradients[load], float(gradients[rate])
(array([0.25, 0.  ]), -1.5)
>>> changes = derivative.jvp({rate: 0.01})
>>> changes[x].round(12), changes[pair].round(12)
(array([-0.015,  0.   ]), array([0., 0.]))

- Parameters may be used in M, q, bounds, friction and definitions, and need not enter affinely. Integer, Boolean,
  symmetric, PSD, diagonal, sparse and complex parameters raise UnsupportedModel.
- Write ``L @ (L.T @ x)``, not ``(L @ L.T) @ x``: of two matrices of parameters the product has n³ terms.
- Write ``p * (S @ x)``, not ``(p * S) @ x``, for a large sparse S: all n² entries of p * S are computed.
- The parameters must have the values of the solve; otherwise `derivative` raises an error: solve again.
- If an entry is at a bound and its w is zero, ``jvp`` is the one-sided change, and ``vjp`` the gradient of one of the
  adjacent pieces (an element of the B-subdifferential); ``lcp_plugin.derivative(extra_stats).is_unique`` is False.
- Quadratic programs: use cvxpy's ``problem.solve(requires_grad=True)``, or ``optimal(program, over=[x])``.
"""

from __future__ import annotations

from typing import Any

try:
    import cvxpy as cp
except ImportError as error:
    raise ImportError("models need cvxpy; install it with: pip install cvxpy") from error


def _solve(problem: cp.Problem, *args: Any, **options: Any) -> Any:
    from .registration import solve_model

    return solve_model(problem, *args, **options)


for _method in ("LCP", "lcp"):
    cp.Problem.register_solve(_method, _solve)
