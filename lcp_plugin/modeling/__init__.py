"""The cvxpy side: complementarity between expressions, quadratic programs, and who judges the status.

**What you may write** in the list of ``cp.Problem(cp.Minimize(0), [...])``, solved with ``method="LCP"``:

- ``complements(x >= 0, F >= 0)``: in either order; both sides have one shape, nothing is broadcast.
- ``complements(F >= 0, G >= 0)`` with two expressions, affine or not: an unknown s == F is added, and s ≥ 0 goes with
  G ≥ 0. A row of such a pair counts as an equation, and needs a variable that no other pair holds.
- ``complements(box(x, lower, upper), F)``: bounds on both sides; at an upper bound F ≤ 0. x may be an expression.
- ``complements(x, F)``: the bounds are those of the variable, as in ``cp.Variable(2, nonneg=True)``; where it has none,
  F == 0 is what that means, and a ``ModelWarning`` says so.
- ``complements(cp.SOC(t, x), F)`` over second-order cones, F affine, with the slack of t in its first row; or with
  ``cp.SOC(s, y)``. Coulomb friction: ``complements(friction_cone(r, mu), W @ r + b)``, r of each contact its normal
  impulse, then the tangents; nothing but definitions may stand beside it.
- ``complements(y, G == 0)``, or plainly ``G == 0`` in the list: a free variable and its equation. If y is bounded,
  G == 0 is required only where y is strictly between its bounds; a ``ModelWarning`` tells you.
- Bounds of a variable that equations define, as in ``w == M @ x + q`` with w nonneg. If the answer violates bounds that
  no pair states, the search for the best of all solutions looks for one that does not.

Parameters may stand anywhere, and a second solve starts from the first. cvxpy keeps sparse constants by columns, so
that ``M @ x`` costs one conversion of M.

**Afterwards** ``pair.dual_value`` is w, of two expressions the second, and ``pair.violation()`` the largest natural
residual; the inequalities inside carry the duals that a quadratic program would give them. A model that is proved to
have no solution gets the status "infeasible", and the proof is ``problem.solver_stats.extra_stats.proof``;
``extra_stats`` is a `Result`, with an objective an `EquilibriumResult`, of a program a `QuadraticProgramResult`.

>>> import cvxpy as cp
>>> import numpy as np
>>> from lcp_plugin import box, complements
>>> x, y = cp.Variable(2), cp.Variable()
>>> pair = complements(box(x, 0, [1, 4]), 2 * x - y - [3, 1])
>>> _ = cp.Problem(cp.Minimize(0), [pair, y == cp.sum(x) / 2]).solve(method="LCP")
>>> x.value.round(6), pair.dual_value.round(6), pair.violation() < 1e-8
(array([1., 1.]), array([-2.,  0.]), True)

**Smooth nonlinear expressions** may stand wherever an affine one may, on both sides of a pair too: products and
quotients of variables, real powers, ``exp log log1p logistic entr xexp rel_entr kl_div``, ``geo_mean prod sum_squares
quad_form quad_over_lin log_sum_exp``, and whatever is affine around and inside them. Convexity plays no role. Then the
model is solved by :func:`lcp_plugin.problems.nonlinear.solving.solve_nonlinear`, whose options hold.

- The run begins at the values of the variables, so set ``x.value``. Where F or its derivative is not finite there, or a
  variable has no value, it begins at the point of the bounds nearest to 0, or else to 1.
- What leaves a domain, as ``log`` below zero, shortens a step. State the bound that keeps a solution inside.
- ``abs``, ``maximum``, norms and integers are refused. ``abs(x)`` is x + 2 s with ``complements(s >= 0, x + s >= 0)``,
  which the search for the best of all solutions writes itself in objectives and rows.
- An expression that enters all rows, as ``cp.power(cp.sum(x), -1.1)``, makes the Jacobian dense. Give it a variable and
  an equation: ``total == cp.sum(x)``.
- Write with vectors: thousands of scalar expressions take seconds to read, a vector of them milliseconds.

>>> x = cp.Variable(2, nonneg=True)
>>> x.value = np.ones(2)
>>> pair = complements(x, cp.exp(x) + cp.multiply(x, x[::-1]) - [3, 0.5])
>>> problem = cp.Problem(cp.Minimize(0), [pair])
>>> _ = problem.solve(method="LCP", tolerance=1e-12)
>>> x.value.round(6), pair.dual_value.round(6)
(array([1.098612, 0.      ]), array([0. , 0.5]))

**The best of all solutions.** An objective beside pairs, equations and inequalities asks for the best point that
satisfies all of it: leader and followers, tolls, the best design of a contact, the conditions of an inner problem.
Objective, sides and rows may be smooth, convex or not (price × quantity), or convex and piecewise linear beside affine
sides; variables may be ``integer`` or ``boolean``. SCIP searches where it is installed: ``pip install
'lcp_plugin[global]'``; without it only convex pieces are searched to the end.

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

- "optimal" is said only with a gap of ``tolerance`` (1e-6), beside max(1, |value|). ``extra_stats.bound_by`` says
  whose bound it is: a "proof", or that of "SCIP", in floating point. ``prove=True`` asks for a proof, where sides and
  rows are affine, the objective convex and nothing an integer.
- Values that the variables have are tried first: where they are an equilibrium, the answer is no worse. Where nothing
  is found, variables keep their values. Where ``max_seconds``,
  ``max_nodes`` or Ctrl-C ends the search first, the status is "user_limit", with the best point found and
  ``extra_stats.lower_bound`` and ``gap``; of ``cp.Maximize(f)`` they speak of −f.
- Proved bounds are exact for the stored numbers. In every pair of the point found one side is at its bound; its other
  constraints hold as those of an optimal program do, to 1e-7 in units of the data: SCIP's point gives the cases of the
  pairs, and these are solved again. "infeasible" and "unbounded" come with proofs; ``extra_stats.verify()`` checks all
  of it again. What SCIP alone says, that there is no solution or no least one, is "user_limit" with its words.
- State bounds for what the problem leaves open, as prices and tolls: without them SCIP may find no bound at all.
  Arrays: ``solve(EquilibriumProgram(…))``.

**Convex quadratic and linear programs** are solved as complementarity problems by ``solver=lcp_plugin.QPSolver``, duals
included; then ``method="LCP"`` is known too.

>>> import lcp_plugin
>>> A, b = np.random.default_rng(0).standard_normal((30, 5)), np.ones(30)
>>> x = cp.Variable(5)
>>> problem = cp.Problem(cp.Minimize(cp.sum_squares(A @ x - b)), [x >= 0])
>>> _ = problem.solve(solver=lcp_plugin.QPSolver)
>>> problem.status, problem.solver_stats.extra_stats.status.name
('optimal', 'SOLVED')

Their status is judged by the residuals of the program that cvxpy compiles; ``certify(problem)`` measures the objective
and the constraints as you stated them. Infeasible and unbounded are not said without a proof; after
``method="LCP"`` ``extra_stats.contradiction`` names the constraints that contradict one another. Bounds that cvxpy
derives for its own variables are not used. All this is in units of the program's data, never relative to x: row i's
violation counts beside max_j |a_ij| + |b_i|, and a program is infeasible only where every x violates some row by more
than what is called optimal (1e-7 by default).

**Whoever solved it**, ``lcp_plugin.certify(problem)`` tells what is proved of the values and the status:

>>> lcp_plugin.certify(problem).verdict
'proved'

**Derivatives.** After a solve of a model, ``lcp_plugin.derivative(problem)`` differentiates variables and dual values
by parameters: ``vjp`` takes gradients by variables and constraints (for their dual values) and returns those by
parameters, ``jvp`` takes changes of parameters and returns those of variables and dual values.

>>> x, rate, load = cp.Variable(2), cp.Parameter(value=2.0), cp.Parameter(2, value=[6.0, -1.0])
>>> pair = complements(x >= 0, rate**2 * x - load >= 0)
>>> problem = cp.Problem(cp.Minimize(0), [pair])
>>> _ = problem.solve(method="LCP")
>>> found = lcp_plugin.derivative(problem)
>>> gradients = found.vjp({x: [1.0, 1.0]})  # x = (load / rate², 0)
>>> gradients[load], float(gradients[rate])
(array([0.25, 0.  ]), -1.5)
>>> changes = found.jvp({rate: 0.01})
>>> changes[x].round(12), changes[pair].round(12)
(array([-0.015,  0.   ]), array([0., 0.]))

- Parameters may stand in M, q, bounds, friction and definitions, and need not enter affinely. Integer, Boolean,
  symmetric, PSD, diagonal, sparse and complex parameters are refused.
- The parameters must have the values of the solve; otherwise `derivative` asks you to solve again.
- Where an entry is at a bound and its w is zero, ``jvp`` gives the one-sided change, and ``vjp`` the gradient of one of
  the pieces that meet there (an element of the B-subdifferential). Whether a model's solution is such a place,
  ``lcp_plugin.derivative(problem.solver_stats.extra_stats).is_unique`` says.
- Quadratic programs: use cvxpy's own ``problem.solve(requires_grad=True)``, or state the optimality conditions with
  ``complements``.
"""

from __future__ import annotations

from typing import Any

import cvxpy as cp


def _solve(problem: cp.Problem, *args: Any, **options: Any) -> Any:
    from .registration import solve_model

    return solve_model(problem, *args, **options)


for _method in ("LCP", "lcp"):
    cp.Problem.register_solve(_method, _solve)
