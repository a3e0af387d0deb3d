"""Complementarity over cones, and contact with friction as it is.

`data` states problems and checks them, `frictional_contact` contacts, one problem or many in arrays. Everything else
works on stacks of problems with the same blocks (`stack`), one problem is a stack of one: `sweeps` has the compiled
loop, `newton` the steps of Newton's method with the systems of `systems`, `central_path` the interior point, `programs`
the convex programs, `certificate` the stopping criterion, `infeasibility` the proof that there is no solution.
`methods` names these, `solving` chains them, `derivative` differentiates a solution, `files` reads and writes.
"""
