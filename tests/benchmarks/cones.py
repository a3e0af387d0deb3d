"""Contact with friction as it is: answers from scratch and warm steps in time, beside pyramids and Siconos.

Siconos (Debian's python3-siconos) is compared with where Python finds it: its block Gauss–Seidel and its Alart–Curnier
Newton on the same problems, and the performance profile of all, as text.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from typing import Any

import numpy as np
from cone_families import planted_contacts

from lcp_plugin import LCP, FrictionalContact, solve

TOLERANCE, RATIOS = 1e-8, (1.0, 2.0, 5.0, 10.0)
SOLVERS = {"NSGS": "SICONOS_FRICTION_3D_NSGS", "NSN_AC": "SICONOS_FRICTION_3D_NSN_AC"}


def run(*, quick: bool = False) -> Iterator[str]:
    """Yield a line for each size, for a pile in time, and for the profile."""
    ways: dict[str, Callable[[FrictionalContact], bool]] = {"auto": _ours, "pyramids of 8 edges": _pyramids}
    if find_spec("siconos") is not None:
        ways |= {name: _siconos(constant) for name, constant in SOLVERS.items()}
    seconds: dict[str, list[float]] = {name: [] for name in ways}
    for count, bodies in ((4, 2), (10, 5)) if quick else ((4, 2), (10, 5), (30, 15), (100, 50)):
        begun = len(seconds["auto"])
        for seed in range(2 if quick else 10):
            problem = planted_contacts(count, bodies, 10.0, np.random.default_rng(seed), most=1.0)[0]
            for name, way in ways.items():
                if seed == 0:
                    way(problem)  # compiles
                began = time.perf_counter()
                is_solved = way(FrictionalContact(problem.W, problem.b, problem.friction))
                seconds[name].append(time.perf_counter() - began if is_solved else np.inf)
        told = (f"{name} {1e3 * statistics.median(own[begun:]):.2f} ms" for name, own in seconds.items())
        yield f"{count} contacts: {', '.join(told)}; 1.0 s holds {1.0 / statistics.median(seconds['auto'][begun:]):.0f}"
    least = [min(own) for own in zip(*seconds.values(), strict=True)]
    for name, own in seconds.items():
        shares = [np.mean([mine <= ratio * best for mine, best in zip(own, least, strict=True)]) for ratio in RATIOS]
        within = ", ".join(f"{ratio:g} × {share:.0%}" for ratio, share in zip(RATIOS, shares, strict=True))
        yield f"{name}: solved {np.isfinite(own).mean():.0%}, within so many times the quickest: {within}"
    yield _pile(5 if quick else 100, 5 if quick else 200)


def _ours(problem: FrictionalContact) -> bool:
    return solve(problem, tolerance=TOLERANCE).is_solved


def _pyramids(problem: FrictionalContact) -> bool:
    lcp = LCP.from_contacts(problem.W, problem.friction, problem.b.reshape(-1, 3), directions=8)
    return solve(lcp, tolerance=TOLERANCE).is_solved


def _siconos(constant: str) -> Callable[[FrictionalContact], bool]:
    import siconos.numerics as sn

    def way(problem: FrictionalContact) -> bool:
        stated = sn.FrictionContactProblem(3, problem.rows.csr.toarray(), problem.b.copy(), problem.friction.copy())
        options = sn.SolverOptions(getattr(sn, constant))
        options.dparam[sn.SICONOS_DPARAM_TOL] = TOLERANCE
        r, u = np.zeros(problem.n), np.zeros(problem.n)
        call = sn.fc3d_nsgs if constant.endswith("NSGS") else sn.fc3d_nonsmooth_Newton_AlartCurnier
        return bool(call(stated, r, u, options) == 0)

    return way


def _pile(count: int, steps: int) -> str:
    """Return what a step of a pile costs that is shaken, each begun where the last one ended."""
    rng: Any = np.random.default_rng(0)
    problem = planted_contacts(count, max(count // 2, 1), 2.0, rng, most=0.8)[0]
    result, seconds, unsolved = solve(problem), [], 0
    for _ in range(steps):
        problem = problem.with_q(problem.b + 1e-3 * rng.standard_normal(problem.n))
        began = time.perf_counter()
        result = solve(problem, z0=result.z)
        seconds.append(time.perf_counter() - began)
        unsolved += not result.is_solved
    return (f"a shaken pile of {count} contacts, {steps} steps: {1e3 * statistics.median(seconds):.2f} ms a warm step, "
            f"{max(seconds):.2g} s at the most, {unsolved} unsolved")
