"""Change one place of the package and see whether a test fails: ``python tests/mutate.py --seed 0 --count 60``.

A mutant is a place that a quick test runs, by ``tests/of.py``. Kinds: a comparison with or without equality, a sign, a
constant times 2, ``and`` for ``or``, a dropped ``not``, an early return passed over, two arguments exchanged, one
argument of a maximum. The tests of the line run on a copy, those of the folder first. Some survivors change no answer,
and tests that take too long may only have met a busy machine: they are counted by themselves, as neither.
"""

from __future__ import annotations

import argparse
import ast
import copy
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from of import ROOT, tests_of

PACKAGE = ROOT / "lcp_plugin"
MAX_TESTS, MAX_SECONDS = 400, 240  # of one mutant
# the last: names of tests that pytest does not find
OUTCOMES = KILLED, SURVIVED, TIMED_OUT, NOT_RUN = "killed", "survived", "timed out", "not run"
LEFT_OUT = ("ranks", "learn", "jax")  # the quick suite does not run them
EXCHANGED = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt,
             ast.Add: ast.Sub, ast.Sub: ast.Add, ast.And: ast.Or, ast.Or: ast.And}  # fmt: skip


class Mutant(NamedTuple):
    """A place in a file, its kind, its text, the text instead, and the tests of its line."""

    file: Path
    node: ast.expr
    kind: str
    before: str
    after: str
    tests: tuple[str, ...]


def change(node: ast.AST) -> tuple[str, ast.expr, ast.expr] | None:
    """Return the kind of change, the expression and the expression instead; None if the node has none."""
    new = copy.deepcopy(node)
    match node, new:
        case ast.Compare(ops=[op]), ast.Compare() if type(op) in EXCHANGED:
            new.ops = [EXCHANGED[type(op)]()]
            return "comparison", node, new
        case ast.BinOp(op=ast.Add() | ast.Sub() as op), ast.BinOp():
            new.op = EXCHANGED[type(op)]()
            return "sign", node, new
        case ast.Constant(value=value), _ if type(value) in (int, float) and value:
            return "constant", node, ast.Constant(2 * value)
        case ast.BoolOp(op=op), ast.BoolOp():
            new.op = EXCHANGED[type(op)]()
            return "and, or", node, new
        case ast.UnaryOp(op=ast.Not()), _:
            return "not", node, node.operand
        case ast.If(body=[ast.Return()], orelse=[]), _:
            return "early return", node.test, ast.Constant(False)
        case ast.Call(func=ast.Name(id="max" | "min") | ast.Attribute(attr="maximum")), _:
            return ("maximum", node, node.args[0]) if len(node.args) == 2 else None
        case ast.Call(args=[*_, a, b]), ast.Call() if not isinstance(b, ast.Starred):
            new.args[-2:] = [b, a]
            return "arguments", node, new
    return None


def mutants(file: Path) -> Iterator[Mutant]:
    """Yield the mutants of a file on lines that tests run."""
    lines, text = tests_of(file), file.read_text(encoding="utf-8")
    for node in ast.walk(ast.parse(text)):
        found = lines.get(getattr(node, "lineno", 0)) and change(node)
        if found:
            kind, old, new = found
            before = ast.get_source_segment(text, old) or ""
            tests = tuple(sorted(lines[old.lineno] if old.lineno in lines else lines[node.lineno]))
            yield Mutant(file, old, kind, before, f"({ast.unparse(new)})", tests)


def outcome_of(mutant: Mutant, tree: Path, rng: random.Random) -> str:
    """Return one of OUTCOMES of the tests of a mutant in a copy of the checkout, those of its folder first."""
    file = tree / mutant.file.relative_to(ROOT)
    text, node = file.read_bytes(), mutant.node
    rows = text.splitlines(keepends=True)
    head, tail = rows[: node.lineno - 1], rows[node.end_lineno :]
    first = rows[node.lineno - 1][: node.col_offset]
    last = rows[node.end_lineno - 1][node.end_col_offset :]
    file.write_bytes(b"".join([*head, first, mutant.after.encode(), last, *tail]))
    folder = mutant.file.parent.name
    order = sorted(mutant.tests, key=lambda test: (folder not in test, rng.random()))
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([str(tree), os.environ.get("PYTHONPATH", "")]),
    }
    command = [
        sys.executable,
        *["-m", "pytest", "-x", "-q", "-p", "no:cacheprovider"],
        *order[:MAX_TESTS],
    ]
    try:
        done = subprocess.run(
            command, cwd=tree, env=environment, capture_output=True, timeout=MAX_SECONDS
        )
        return SURVIVED if done.returncode == 0 else KILLED if done.returncode < 4 else NOT_RUN
    except subprocess.TimeoutExpired:
        return TIMED_OUT
    finally:
        file.write_bytes(text)


def main() -> None:
    """Draw mutants, a kind first, and print what no test killed, and the score by folder."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=60)
    asked = parser.parse_args()
    rng, kinds = random.Random(asked.seed), defaultdict(list)
    for file in sorted(PACKAGE.rglob("*.py")):
        if not any(word in file.as_posix() for word in LEFT_OUT):
            for mutant in mutants(file):
                kinds[mutant.kind].append(mutant)
    drawn = [rng.choice(kinds[rng.choice(sorted(kinds))]) for _ in range(asked.count)]
    score: dict[str, Counter[str]] = defaultdict(Counter)
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "checkout"
        shutil.copytree(ROOT, tree, ignore=shutil.ignore_patterns(".git", ".coverage"))
        for mutant in drawn:
            outcome = outcome_of(mutant, tree, rng)
            place = mutant.file.relative_to(PACKAGE)
            score[place.parts[0]][outcome] += 1
            if outcome != KILLED:
                change = f"{mutant.kind}: {mutant.before} → {mutant.after}"
                where = f"{outcome}: {place}:{mutant.node.lineno}"
                print(where, change, f"({len(mutant.tests)} tests)", flush=True)
    print(f"{'':20}", *(f"{outcome:>10}" for outcome in OUTCOMES))
    for name, counts in [*sorted(score.items()), ("all", sum(score.values(), Counter()))]:
        print(f"{name:20}", *(f"{counts[outcome]:10}" for outcome in OUTCOMES))


if __name__ == "__main__":
    main()
