"""Complementarity over cones, and contact with friction as it is; here, what takes these kinds.

`data` states problems and checks them, `frictional_contact` contacts, of one world or of many in arrays, `certificate`
judges an answer, `methods` has the iterations, `kernels` their loops and `central_path` the steps of the interior
point, `small` solves small problems, one or many, in the loop of `small_kernels`, and contacts of bodies in that of
`step_kernels` with the path of `path_kernels`, the systems of `body_kernels` and the factors of `block_factors`,
`infeasibility` proves that there is no answer, `solving` chains them, `derivative` differentiates an answer,
`derivative_kernels` those of many small worlds, `files` reads and writes.
"""

from ...core.kind import Kind

_REFUSED: dict[str, str] = {
    "sweeps=": "it is of an algorithm: NPGS(sweeps=…), from lcp_plugin.problems.cones.methods",
    "proximal=": "it is of an algorithm: Newton(proximal=…), from lcp_plugin.problems.cones.methods",
    "x0=": "a start is called z0 here",
    "tolerance_on=": "nothing bounds the error over cones; result.certificate has the residuals",
    "error_bound=": "nothing bounds the error over cones; result.certificate has the residuals",
    "prepare": "what depends on M alone is kept with the problem: problem.with_q(q) shares it",
    "Certificate.of": "solve(problem, z0=z, max_iterations=0).certificate is that of z",
    "error_bound": "nothing bounds the error over cones; result.certificate has the residuals",
    "certify": "solve(problem, z0=z, max_iterations=0).certificate has the residuals of any z",
    "lcp-plugin check": "lcp-plugin solve judges it",
    "lcp-plugin analyze": "lcp-plugin solve takes it",
    "lcp-plugin compare": "lcp-plugin solve takes it",
}


def _kind(name: str, word: str) -> Kind:
    return Kind(
        name,
        word,
        (
            "solve",
            "solve_batch",
            "march",
            "derivative",
            "save",
            "pickle",
            "cvxpy",
            "lcp-plugin solve",
        ),
        "solve(problem) solves it",
        _REFUSED,
    )


CONE_PROBLEM = _kind("complementarity problem over cones", "ConeProblem")
FRICTIONAL_CONTACT = _kind("contact problem with friction", "FrictionalContact")
