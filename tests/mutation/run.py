"""Do the tests notice a changed certificate? A seeded sample of mutants, each against the tests of its file.

    pip install "lcp_plugin[mutation]"
    python tests/mutation/run.py --sample 220 --seed 1 --workers 2

A mutant is one operator, comparison, number, branch or loop of the files below changed by cosmic-ray. Places are drawn
with equal chances and one mutant at each, so that a place with many variants does not count often; what differs in
annotations only is none. A place is drawn by the hash of its own line: the rest of the file may change, the sample
stays. A mutant is killed by a failing test of the quick suite (of all tests with PYTEST_ADDOPTS=--full around) or by
five times the time that the tests take. Those that no test can kill stand in equivalent.toml, with the reason. Exit
code 1 where fewer than 85 % of the others are killed.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from difflib import SequenceMatcher
from pathlib import Path
from queue import SimpleQueue
from typing import NamedTuple

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator, operator_names

ROOT = Path(__file__).parents[2]
ENOUGH = 0.85
CERTIFICATES, BOUNDS, CLASSES = (
    "lcp_plugin/core/certificates",
    "lcp_plugin/proofs/bounds",
    "lcp_plugin/proofs/verdicts",
)
BOUND_TESTS = (
    "tests/proofs/test_error_bounds.py",
    "tests/proofs/test_error_bounds.py",
    CERTIFICATES,
)
CLASS_TESTS = (
    "tests/proofs/test_matrix_classes.py",
    "tests/proofs/test_matrix_classes.py",
    CLASSES,
    "tests/proofs/test_error_bounds.py",
)
# The files, each with its tests, those first that fail soonest.
TESTS = {
    f"{CERTIFICATES}/residuals.py": (
        "tests/proofs/test_error_bounds.py",
        "tests/core/test_certificate.py",
        CERTIFICATES,
    ),
    f"{BOUNDS}/error_bounds.py": BOUND_TESTS,
    f"{BOUNDS}/solution_bounds.py": BOUND_TESTS,
    f"{BOUNDS}/row_inequality.py": BOUND_TESTS,
    **dict.fromkeys(
        [f"{BOUNDS}/curvature.py"]
        + [f"lcp_plugin/problems/programs/{name}.py" for name in ("dual_bounds", "feasible_points")]
        + ["lcp_plugin/problems/programs/certification.py"],
        ("tests/problems/programs/test_certify.py",),
    ),
    "lcp_plugin/proofs/exact/rational.py": BOUND_TESTS,
    "lcp_plugin/core/rounding.py": (
        "tests/core/test_rounding.py",
        "tests/proofs/test_error_bounds.py",
    ),
    **{
        str(file.relative_to(ROOT)): CLASS_TESTS
        for file in sorted(
            file
            for folder in (CLASSES, "lcp_plugin/core/matrix", "lcp_plugin/systems")
            for file in (ROOT / folder).glob("[a-z]*.py")
        )
    },
}
# Operators are exchanged within a group: floats have no shifts, and `x is None` is `x == None`.
GROUPS = (
    {"Add", "Sub", "Mul", "Div", "FloorDiv", "Mod", "Pow"},
    {"BitOr", "BitAnd", "BitXor"},
    {"Eq", "NotEq", "Lt", "LtE", "Gt", "GtE"},
    {"Is", "IsNot"},
)


class Mutant(NamedTuple):
    """One change of one file; `before` and `after` are the lines that differ."""

    path: str
    line: int
    before: str
    after: str
    code: str

    @property
    def name(self) -> str:
        """What tells it from others, wherever the line stands."""
        return f"{self.path}: {self.before}  →  {self.after}"


def offered_operators() -> Iterator[str]:
    """Yield the names of the operators that change what runs."""
    for name in operator_names():
        kind, *pair = name.removeprefix("core/").split("_")
        if kind.startswith("Variable"):
            continue
        if kind in ("ReplaceBinaryOperator", "ReplaceComparisonOperator") and not any(
            set(pair) <= g for g in GROUPS
        ):
            continue
        yield name


def without_annotations(code: str) -> str:
    """Return the syntax tree as text, annotations left out."""
    tree = ast.parse(code)
    for node in ast.walk(tree):
        for field in ("annotation", "returns"):
            if getattr(node, field, None) is not None:
                setattr(node, field, ast.Constant(None))
    return ast.dump(tree)


def digest(*parts: object) -> str:
    """Return a random-looking number that depends on the parts alone."""
    return hashlib.sha256(repr(parts).encode()).hexdigest()


def places(path: str, seed: int) -> Iterator[tuple[str, list[tuple[str, str, int]]]]:
    """Yield each place of a file with its rank in the draw, and the mutants there, in an order drawn too."""
    code = (ROOT / path).read_text(encoding="utf-8")
    lines, found = code.splitlines(), {}
    nodes = list(ast_nodes(get_ast(code)))
    for name in offered_operators():
        operator = get_operator(name)()
        spans = [span for node in nodes for span in operator.mutation_positions(node)]
        for occurrence, (start, end) in enumerate(spans):
            found.setdefault((start, end), []).append((path, name, occurrence))
    seen: Counter[tuple[str, int]] = Counter()
    for (start, end), mutants in sorted(found.items()):
        text = lines[start[0] - 1].strip()
        seen[text, start[1]] += 1
        rank = digest(
            seed, path, text, start[1], end[1] if end[0] == start[0] else -1, seen[text, start[1]]
        )
        yield rank, sorted(mutants, key=lambda mutant: digest(rank, mutant[1]))


def made(path: str, operator: str, occurrence: int) -> Mutant | None:
    """Return the mutant, or None where it does the same or is no Python."""
    code = (ROOT / path).read_text(encoding="utf-8")
    changed = mutate_code(code, get_operator(operator)(), occurrence)
    try:
        if changed is None or without_annotations(changed) == without_annotations(code):
            return None
    except SyntaxError:
        return None
    old, new = code.splitlines(), changed.splitlines()
    _, first, last, new_first, new_last = next(
        change
        for change in SequenceMatcher(None, old, new, autojunk=False).get_opcodes()
        if change[0] != "equal"
    )
    before, after = (
        " ".join(map(str.strip, old[first:last])),
        " ".join(map(str.strip, new[new_first:new_last])),
    )
    return Mutant(path, first + 1, before, after, changed)


def sampled(size: int, seed: int) -> list[Mutant]:
    """Return that many mutants at different places, drawn from all files."""
    drawn: list[Mutant] = []
    for _, mutants in sorted(place for path in TESTS for place in places(path, seed)):
        mutant = next(
            (m for m in (made(*candidate) for candidate in mutants) if m is not None), None
        )
        drawn += [mutant] if mutant else []
        if len(drawn) == size:
            break
    return drawn


class Workplace:
    """A copy of the tree in which one mutant at a time is tested."""

    def __init__(self, folder: Path) -> None:
        self.root, self.stamp = folder / "tree", int(time.time())
        left_out = shutil.ignore_patterns(".git", "__pycache__", ".*_cache", ".hypothesis")
        shutil.copytree(ROOT, self.root, ignore=left_out)
        self.environment = os.environ | {
            "PYTHONPATH": str(self.root),
            "NUMBA_CACHE_DIR": str(folder / "numba"),
            "OMP_NUM_THREADS": "1",
        }

    def write(self, path: str, code: str) -> None:
        """Write the file with a time of its own, so that nothing compiled from another version is taken for it."""
        self.stamp += 2
        (self.root / path).write_text(code, encoding="utf-8")
        os.utime(self.root / path, (self.stamp, self.stamp))

    def passes(self, tests: tuple[str, ...], limit: float | None) -> bool:
        """Return whether the tests pass within the limit in seconds."""
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *tests]
        run = subprocess.Popen(
            command,
            cwd=self.root,
            env=self.environment,
            start_new_session=True,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            return run.wait(limit) == 0
        except subprocess.TimeoutExpired:
            os.killpg(run.pid, signal.SIGKILL)
            run.wait()
            return False

    def survives(self, mutant: Mutant, limit: float) -> bool:
        """Return whether no test notices the mutant."""
        original = (ROOT / mutant.path).read_text(encoding="utf-8")
        self.write(mutant.path, mutant.code)
        try:
            return self.passes(TESTS[mutant.path], limit)
        finally:
            self.write(mutant.path, original)


def clean_times(workplace: Workplace) -> dict[tuple[str, ...], float]:
    """Return how long each set of tests takes without a mutant, kernels compiled."""
    times = {}
    for tests in dict.fromkeys(TESTS.values()):
        for _ in range(2):
            began = time.monotonic()
            if not workplace.passes(tests, None):
                raise SystemExit(f"without any mutant the tests fail: {' '.join(tests)}")
            times[tests] = time.monotonic() - began
    return times


def tested(mutants: list[Mutant], workers: int) -> list[Mutant]:
    """Return the survivors."""
    with tempfile.TemporaryDirectory() as folder:
        free: SimpleQueue[Workplace] = SimpleQueue()
        for k in range(workers):
            free.put(Workplace(Path(folder) / str(k)))
        first = free.get()
        times = clean_times(first)
        free.put(first)

        def judge(mutant: Mutant) -> bool:
            workplace = free.get()
            survives = workplace.survives(mutant, 5.0 * times[TESTS[mutant.path]])
            free.put(workplace)
            print(
                "survived" if survives else "killed  ",
                f"{mutant.path}:{mutant.line}",
                mutant.after,
                flush=True,
            )
            return survives

        with ThreadPoolExecutor(workers) as pool:
            return [
                mutant
                for mutant, survives in zip(mutants, pool.map(judge, mutants), strict=True)
                if survives
            ]


def main() -> int:
    """Draw, test, and print what survived."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sample", type=int, default=220)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--record", type=Path, help="write the names of the survivors to this file")
    parser.add_argument(
        "--only", type=Path, help="test only the mutants named in this file, as --record wrote it"
    )
    options = parser.parse_args()

    mutants = sampled(options.sample, options.seed)
    if options.only:
        wanted = set(json.loads(options.only.read_text(encoding="utf-8")))
        mutants = [mutant for mutant in mutants if mutant.name in wanted]
    listed = tomllib.loads((Path(__file__).parent / "equivalent.toml").read_text(encoding="utf-8"))[
        "mutant"
    ]
    reasons = {f"{m['path']}: {m['before']}  →  {m['after']}": m["reason"] for m in listed}
    equivalent = [mutant for mutant in mutants if mutant.name in reasons]
    judged = [mutant for mutant in mutants if mutant.name not in reasons]
    survivors = tested(judged, options.workers)

    print(
        f"\n{len(mutants)} mutants, seed {options.seed}: {len(judged) - len(survivors)} killed, "
        f"{len(survivors)} survived, {len(equivalent)} equivalent"
    )
    for mutant in survivors:
        print(f"\n{mutant.path}:{mutant.line}\n  - {mutant.before}\n  + {mutant.after}")
    for mutant in equivalent:
        print(f"\nequivalent: {mutant.name}\n  {reasons[mutant.name]}")
    if options.record:
        options.record.write_text(
            json.dumps([mutant.name for mutant in survivors], indent=1), encoding="utf-8"
        )
    return int(len(survivors) > (1.0 - ENOUGH) * len(judged))


if __name__ == "__main__":
    raise SystemExit(main())
