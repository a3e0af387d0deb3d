"""In how many places the package does each of its jobs; ``python tests/house/places.py [--list] [--package FOLDER]``.

A place is a function or a class. Two jobs are found by what is written in them: the residual r_i by its formula (a
middle of z − upper, z − lower and a step, or z less the middle of the bounds and z − w/d), and "solved" by a comparison
of what was measured with a tolerance. The other jobs are found by the names of what did them when the counting began:
`NAMED`. What does the same under another name is missed, what only looks alike is counted: read the list.
"""

from __future__ import annotations

import argparse
import ast
import re
from collections.abc import Iterator
from pathlib import Path

PACKAGE = Path(__file__).parents[2] / "lcp_plugin"
MIDDLES = (
    "min",
    "max",
    "minimum",
    "maximum",
    "clip",
    "fmin",
    "fmax",
    "_clamp",
    "_clamped",
    "clamp",
    "mid",
)
BOUND = re.compile(r"(?i)\b(lower|upper|high|low|bounds)\b")
TOLERANCE = re.compile(r"\b(tolerance|goal)\b")
MEASURED = re.compile(
    r"residual|size|largest|value|optimality|errors?\b|gap|small|ends|relative|least|reached"
)

NAMED = {
    "bring M, q to one scale": (
        "scaling_of",
        "equilibrated",
        "equilibrating_exponents",
        "scaling_exponents",
        "equilibration",
        "equilibrate",
        "_fitted",
        "_scaled_columns",
        "balance_within",
        "_together",
        "_fitted_together",
        "_symmetrising",
    ),
    "take out what is known": (
        "Presolved",
        "fold_simple_rows",
        "substitute_definitions",
        "eliminate_definitions",
        "without_known",
        "fixed_and_free",
        "CanonicalBox",
        "Reduction",
    ),
    "a dense active set of a convex program": (
        "append_row",
        "WorkingSet",
        "add_row",
        "drop_row",
        "dual_active_set",
    ),
    "a tableau": ("follow_path", "_exchange", "pivots", "_hold", "_add"),
    "a form of a program": (
        "DirectForm",
        "KKTForm",
        "DualForm",
        "_is_laplacian",
        "least_multipliers",
    ),
    "a derivative": ("Derivative", "settle", "solve_steps"),
    "many": (
        "solve_batch",
        "BatchRun",
        "ProgramBatchRun",
        "QuadraticProgramBatch",
        "march",
    ),
}
FOLDERS = {  # where such a name means that job; everywhere where none is given
    "a tableau": "methods/",
    "a dense active set of a convex program": "problems/programs/",
    "many": "problems/",
}


def definitions(file: Path) -> Iterator[tuple[str, ast.AST]]:
    """The functions and classes of a file by their dotted names."""
    waiting: list[tuple[str, ast.AST]] = [("", ast.parse(file.read_text(encoding="utf-8")))]
    while waiting:
        name, node = waiting.pop()
        for child in ast.iter_child_nodes(node):
            if isinstance(child, (ast.FunctionDef, ast.ClassDef)):
                inner = f"{name}.{child.name}".lstrip(".")
                yield inner, child
                if isinstance(child, ast.ClassDef):
                    waiting.append((inner, child))


def _is_difference(node: ast.AST) -> bool:
    """Whether it is z less a bound, or what encloses that."""
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Sub):
        return any(BOUND.search(ast.unparse(side)) for side in (node.left, node.right))
    is_enclosed = isinstance(node, ast.Call) and ast.unparse(node.func).endswith("_difference")
    return is_enclosed and bool(BOUND.search(ast.unparse(node)))


def has_residual(function: ast.AST) -> bool:
    """Whether a function computes r_i."""
    differences: set[str] = set()
    for node in ast.walk(function):
        if isinstance(node, ast.Assign):
            for target in node.targets:
                pairs = [(target, node.value)]
                if isinstance(target, ast.Tuple):
                    values = node.value.elts if isinstance(node.value, ast.Tuple) else [node.value]
                    values = values * len(target.elts) if len(values) == 1 else values
                    pairs = list(zip(target.elts, values, strict=False))
                differences |= {ast.unparse(name) for name, value in pairs if _is_difference(value)}

    def is_known(node: ast.AST) -> bool:
        return _is_difference(node) or any(
            ast.unparse(part) in differences for part in ast.walk(node)
        )

    for node in ast.walk(function):
        if isinstance(node, ast.Call) and ast.unparse(node.func).split(".")[-1] in MIDDLES:
            arguments = [*node.args, *(word.value for word in node.keywords)]
            inner = [part for one in arguments if isinstance(one, ast.Call) for part in one.args]
            parts = [
                one for one in arguments if not isinstance(one, ast.Call) or _is_difference(one)
            ] + inner
            known = [is_known(part) for part in parts]
            if len(parts) >= 3 and sum(known) >= 2 and not all(known):
                return True
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Sub):
            text = ast.unparse(node)
            if re.search(r"(min\(max\(|clip\()", text) and re.search(r"- [^,]+, [^,]*lower", text):
                return True
    text = ast.unparse(function)
    return "np.maximum(step, block" in text or "above if above < step" in text  # by steps


def says_solved(function: ast.AST) -> bool:
    """Whether a function compares what was measured with a tolerance, and returns or stores what that says."""
    for node in ast.walk(function):
        if isinstance(node, (ast.Return, ast.Assign, ast.AugAssign, ast.If)):
            part = node.test if isinstance(node, ast.If) else node.value
            tests = (
                [one for one in ast.walk(part) if isinstance(one, ast.Compare)]
                if part is not None
                else []
            )
            if any(
                isinstance(one.ops[-1], (ast.LtE, ast.Gt))
                and TOLERANCE.search(ast.unparse(one.comparators[-1]))
                and MEASURED.search(ast.unparse(one.left))
                for one in tests
            ):
                return True
    return False


ANOTHER_JOB = {  # looked at by eye
    "core/solving/stage.py: Stage.is_due": "when to measure",
    "core/solving/stage.py: Stage.steps_to_go": "a prediction",
    "core/solving/advice.py: advice_of_run": "words",
    "problems/equilibria/equilibrium_program.py: EquilibriumProgram.distances": "distances of pairs",
    "problems/least_squares/certificate.py: _relative_gap": "whether a nearer dual point is worth its work",
    "problems/nonlinear/josephy_newton.py: _NewtonRun._progress": "the goal of a linear problem inside",
    "problems/programs/certification.py: multiplier_error": "multipliers",
    "problems/programs/certification.py: Proved.gap": "a gap",
    "proofs/bounds/error_bounds.py: ErrorBound.proves": "the error, which a bound proves",
    "proofs/misleading.py: _stiffness": "words",
    "systems/comparison.py: ComparisonMatrix.iterated": "a linear system",
    "systems/free_systems.py: FreeSystem._iterated": "a linear system",
    "systems/hierarchy/vectors.py: scaling_of_unknowns": "vectors of a hierarchy",
    "systems/minimum_degree.py: _together": "an order of elimination",
}
READ = {"the residual r_i": has_residual, "say that a problem is solved": says_solved}


def places(package: Path) -> dict[str, list[str]]:
    """The places of each job, as ``file: function``."""
    found: dict[str, list[str]] = {job: [] for job in (*NAMED, *READ)}
    for file in sorted(package.rglob("*.py")):
        where = str(file.relative_to(package))
        for name, node in dict(definitions(file)).items():
            if f"{where}: {name}" in ANOTHER_JOB:
                continue
            for job, names in NAMED.items():
                if name.rpartition(".")[2] in names and re.search(FOLDERS.get(job, ""), where):
                    found[job].append(f"{where}: {name}")
            if isinstance(node, ast.FunctionDef) and not where.startswith(
                ("interfaces/", "modeling/")
            ):  # others' data
                for job, is_one in READ.items():
                    if is_one(node):
                        found[job].append(f"{where}: {name}")
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--list", action="store_true", help="print every place as well")
    parser.add_argument(
        "--package", type=Path, default=PACKAGE, help="the folder lcp_plugin of another version"
    )
    asked = parser.parse_args()
    files = list(asked.package.rglob("*.py"))
    nodes = sum(
        sum(1 for _ in ast.walk(ast.parse(file.read_text(encoding="utf-8")))) for file in files
    )
    print(f"{len(files)} files, {nodes} syntax nodes")
    for job, found in places(asked.package).items():
        print(
            f"{len(found):4}  {job}",
            *(f"        {place}" for place in found if asked.list),
            sep="\n",
        )


if __name__ == "__main__":
    main()
