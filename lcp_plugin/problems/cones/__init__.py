"""Complementarity over cones, and contact with quadratic Coulomb cones.

`data` defines and checks problems, `frictional_contact` contact problems, one or a batch in arrays. All other
modules use stacks of problems with the same blocks (`stack`), in which one problem is a stack of one. `sweeps` has
the compiled loop, `newton` the steps of Newton's method with the systems of `systems`, and `central_path` the
interior point. `programs` has the convex programs, `certificate` the stopping criterion, and `infeasibility` the
proof of infeasibility. `methods` names the algorithms, `solving` runs them in order, and `derivative`
differentiates a solution.
"""
