"""Solve a contact problem by Siconos: ``python3 siconos_contacts.py PROBLEM.npz NSGS|NSN_AC TOLERANCE ANSWER.npz``.

A script for the system's Python, which has Debian's python3-siconos; nothing of this package is loaded. W is given as
Siconos keeps it, by columns with 64-bit indices; to Newton's method dense as well, and what serves it better counts.
The least seconds of three runs are kept, of a long one those of one.
"""

import sys
import time

import numpy as np
import scipy.sparse as sp

SWEEPS, STEPS = 100_000, 2_000  # Newton's default, 200, ends on capsules before it is there
LONG = 0.5  # s


def main(source: str, name: str, tolerance: str, target: str) -> None:
    """Write r, the seconds, and whether Siconos calls it solved."""
    data = np.load(source)
    W = sp.csc_matrix((data["data"], data["indices"], data["indptr"]), shape=tuple(data["shape"]))
    W.sort_indices()  # where they are not, Siconos' sweeps find no diagonal blocks
    W.indices, W.indptr = W.indices.astype(np.int64), W.indptr.astype(np.int64)
    forms = [W] if name == "NSGS" else [W, W.toarray()]
    found = [
        timed(one, data["b"], data["mu"], data["start"], name, float(tolerance)) for one in forms
    ]
    is_solved, seconds, r = min(found, key=lambda one: (not one[0], one[1]))
    np.savez(target, r=r, seconds=seconds, is_solved=is_solved)


def timed(W, b, mu, start, name: str, tolerance: float):  # type: ignore[no-untyped-def]
    """Return whether it is solved, the seconds, and r."""
    import siconos.numerics as sn  # here, as pytest collects this file where it is not installed

    seconds: list[float] = []
    is_solved, r = False, np.zeros(b.size)
    while len(seconds) < 3 and not any(one > LONG for one in seconds):
        problem = sn.FrictionContactProblem(3, W, b.copy(), mu.copy())
        options = sn.SolverOptions(getattr(sn, f"SICONOS_FRICTION_3D_{name}"))
        options.dparam[sn.SICONOS_DPARAM_TOL] = tolerance
        options.iparam[sn.SICONOS_IPARAM_MAX_ITER] = SWEEPS if name == "NSGS" else STEPS
        call = sn.fc3d_nsgs if name == "NSGS" else sn.fc3d_nonsmooth_Newton_AlartCurnier
        r, u = start.copy(), np.zeros(b.size)
        began = time.process_time()
        is_solved = call(problem, r, u, options) == 0
        seconds.append(time.process_time() - began)
    return is_solved, min(seconds), r


if __name__ == "__main__":
    main(*sys.argv[1:])
