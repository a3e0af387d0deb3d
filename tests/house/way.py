"""The way of a second, warm solve, as its calls draw it; ``python tests/house/way.py [--calls]`` prints the table.

- files: those of the package whose functions run, kernels being compiled;
- moves: pairs of files in different subpackages, a function of one of which calls one of the other; subpackages are the
  README's, and in the core its folders (its single files are one, ``core``);
- climbs: those of them where the file that calls imports the other neither itself nor through others, the package's
  front left out: what it calls was handed to it, or found by a name in a string.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

sys.path.append(str(Path(__file__).parents[1]))

import scipy.sparse as sp
from picture import PACKAGE, subpackage_of
from test_architecture import IMPORTS, MODULES

import lcp_plugin

Function = tuple[str, str]  # its file and its name


def subpackage(file: str) -> str:
    parts = Path(file).relative_to(PACKAGE).parts
    if parts[0] == "core":
        return f"core.{parts[1]}" if len(parts) > 2 else "core"
    return subpackage_of(Path(file)) if len(parts) > 1 else "front"


def reach() -> dict[str, set[str]]:
    """Of each file those that it imports, itself or through others."""
    file_of = {module: str(file) for module, file in MODULES.items()}
    found: dict[str, set[str]] = {}
    for module, file in file_of.items():
        waiting, found[file] = [module], set()
        while waiting:
            new = {one for one in IMPORTS[waiting.pop()] if file_of[one] not in found[file]}
            found[file] |= {file_of[one] for one in new}
            waiting += new
    return found


def calls_of(run: Callable[[], Any]) -> list[tuple[Function | None, Function]]:
    """Every call of a function of the package, with the function of the package that is nearest above it."""
    seen: list[tuple[Function | None, Function]] = []
    inside = str(PACKAGE)

    def name(frame: FrameType) -> Function:
        return frame.f_code.co_filename, frame.f_code.co_qualname

    def note(frame: FrameType, event: str, argument: object) -> None:
        if event != "call" or not frame.f_code.co_filename.startswith(inside):
            return
        above = frame.f_back
        while above is not None and not above.f_code.co_filename.startswith(inside):
            above = above.f_back
        seen.append((None if above is None else name(above), name(frame)))

    sys.setprofile(note)
    try:
        run()
    finally:
        sys.setprofile(None)
    return seen


def runs() -> dict[str, Callable[[], Any]]:
    """What is solved, as a user would; each call is a solve from its data."""
    rng = np.random.default_rng(0)
    A, q = rng.normal(size=(10, 10)), rng.normal(size=10)
    M, G = A @ A.T + np.eye(10), rng.normal(size=(20, 10))
    lcp, program = lcp_plugin.LCP(M, q), lcp_plugin.QuadraticProgram(M, q, G=G, h=np.ones(20))
    n = 50
    heat = sp.diags_array(
        [-np.ones(n - 1), 2.0 * np.ones(n), -np.ones(n - 1)], offsets=[-1, 0, 1], format="csr"
    )
    first, forcing = (
        lcp_plugin.LCP(heat + sp.eye_array(n), np.zeros(n)),
        np.tile(rng.normal(size=n), (5, 1)),
    )
    found = {
        "LCP, n = 10": lambda: lcp_plugin.solve(lcp),
        "program, n = 10, m = 20": lambda: lcp_plugin.solve(program),
        "march, n = 50, 5 steps": lambda: lcp_plugin.march(
            first, forcing, propagator=-sp.eye_array(n, format="csr")
        ),
    }
    import cvxpy as cp

    x = cp.Variable(10)
    model = cp.Problem(cp.Minimize(cp.quad_form(x, cp.psd_wrap(M)) / 2 + q @ x), [G @ x <= 1.0])
    found["cvxpy model"] = lambda: model.solve(solver=lcp_plugin.QPSolver)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument(
        "--calls", action="store_true", help="print every move between subpackages as well"
    )
    shown = parser.parse_args().calls
    imported = reach()
    print(f"{'warm solve':28} {'calls':>6} {'files':>6} {'moves':>6} {'climbs':>7}")
    for title, run in runs().items():
        run()
        run()
        calls = calls_of(run)
        files = dict.fromkeys(other[0] for _, other in calls)
        moves = dict.fromkeys(
            (one[0], other[0])
            for one, other in calls
            if one is not None and subpackage(one[0]) != subpackage(other[0])
        )
        climbs = [(one, other) for one, other in moves if other not in imported.get(one, ())]
        print(f"{title:28} {len(calls):6} {len(files):6} {len(moves):6} {len(climbs):7}")
        if shown:
            print(*(f"    {Path(file).relative_to(PACKAGE)}" for file in files), sep="\n")
            for one, other in moves:
                mark = "climb" if (one, other) in climbs else ""
                print(
                    f"    {mark:6}{Path(one).relative_to(PACKAGE)} → {Path(other).relative_to(PACKAGE)}"
                )


if __name__ == "__main__":
    main()
