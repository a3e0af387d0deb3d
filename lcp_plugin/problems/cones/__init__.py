"""Complementarity over cones, and contact with friction as it is.

`data` states problems and checks them, `frictional_contact` contacts, of one world or of many in arrays, `certificate`
judges an answer, `methods` has the iterations, `kernels` their loops and `central_path` the steps of the interior
point, `small` solves small problems, one or many, in the loop of `small_kernels`, and contacts of bodies in that of
`step_kernels` with the path of `path_kernels`, the systems of `body_kernels` and the factors of `block_factors`,
`infeasibility` proves that there is no answer, `solving` chains them, `derivative` differentiates an answer,
`derivative_kernels` those of many small worlds, `files` reads and writes.
"""
