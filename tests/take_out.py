"""Does the rest work without a room?  ``python tests/take_out.py ROOM [--all]``; ``ROOM`` may be ``everything``.

The package is copied to a temporary folder, the room removed and with it those that README's picture draws above it.
All that is left is imported, and the tests of the core run against it, with ``--all`` those of every room that is left.
A test that asks for what was removed and is told so is skipped; any other failure is one. Exit code 0: the rest works.
"""

from __future__ import annotations

import argparse
import ast
import io
import os
import shutil
import subprocess
import sys
import tempfile
import tokenize
from pathlib import Path

from picture import ARROWS, FOLDERS, ROOT, above

LEFT_OUT = shutil.ignore_patterns(".*", "__pycache__", "*.egg-info", "build", "dist")
IMPORT_ALL = """
import importlib, pkgutil, lcp_plugin

def is_from_outside(error):
    while error is not None:
        if isinstance(error, ImportError) and (error.name or "") and not error.name.startswith("lcp_plugin"):
            return True
        error = error.__cause__ or error.__context__
    return False

count = 0
for module in pkgutil.walk_packages(lcp_plugin.__path__, "lcp_plugin.", onerror=lambda name: None):
    if module.name.endswith("__main__"):
        continue
    try:
        importlib.import_module(module.name)
        count += 1
    except Exception as error:
        if not is_from_outside(error):  # the extras are not here
            raise
print(count, "modules imported from", lcp_plugin.__path__[0])
"""


def code_lines(file: Path) -> int:
    """Lines of a file that are neither blank nor comments nor docstrings."""
    text = file.read_text(encoding="utf-8")
    told: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef)) and ast.get_docstring(node) is not None:
            told |= set(range(node.body[0].lineno, (node.body[0].end_lineno or 0) + 1))
    silent = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}
    tokens = [one for one in tokenize.generate_tokens(io.StringIO(text).readline) if one.type not in silent]
    return len({k for one in tokens for k in range(one.start[0], one.end[0] + 1)} - told)


def size(room: str) -> int:
    """Lines of code of a room."""
    folder = FOLDERS[room]
    return sum(map(code_lines, [folder] if folder.is_file() else folder.rglob("*.py")))


def removed(room: str) -> set[str]:
    """The room, and what goes with it."""
    return set(ARROWS) - {"core"} if room == "everything" else {room, *above(room)}


def take_out(room: str, *, only: str = "", all_tests: bool = False, options: tuple[str, ...] = ()) -> int:
    """Return 0 where what is left works, else the exit code of what failed."""
    rooms = removed(room)
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "copy"
        shutil.copytree(ROOT, copy, ignore=LEFT_OUT)
        for one in sorted(rooms):
            path = copy / FOLDERS[one].relative_to(ROOT)
            tests = copy / "tests" / FOLDERS[one].relative_to(ROOT / "lcp_plugin").with_suffix("")
            shutil.rmtree(tests, ignore_errors=True)
            path.unlink() if path.is_file() else shutil.rmtree(path)
            (copy / "lcp_plugin" / f"{one}.py").unlink(missing_ok=True)  # the name that users import
        print(f"without {', '.join(sorted(rooms))}", flush=True)
        environment = os.environ | {"PYTHONPATH": str(copy), "LCP_PLUGIN_TAKEN_OUT": room}
        done = subprocess.run([sys.executable, "-c", IMPORT_ALL], cwd=copy, env=environment, check=False)
        if done.returncode:
            return done.returncode
        left = [FOLDERS[one].relative_to(ROOT / "lcp_plugin").with_suffix("") for one in ARROWS if one not in rooms]
        tests = [only or "tests/core"]
        if all_tests:
            tests = [f"tests/{one}" for one in left if (copy / "tests" / one).is_dir()]
        command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *tests, *options]
        return subprocess.run(command, cwd=copy, env=environment, check=False).returncode


def main() -> int:
    """Read the command line."""
    parser = argparse.ArgumentParser("python tests/take_out.py", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("room", choices=[*(room for room in ARROWS if room != "core"), "everything", "sizes"])
    parser.add_argument("--only", default="", metavar="PATH", help="run these tests of the core alone")
    parser.add_argument("--all", action="store_true", help="run the tests of every room that is left")
    given, options = parser.parse_known_args()
    if given.room == "sizes":
        print("\n".join(f"{room:<16}{size(room):>6}" for room in ARROWS))
        return 0
    return take_out(given.room, only=given.only, all_tests=given.all, options=tuple(options))


if __name__ == "__main__":
    sys.exit(main())
