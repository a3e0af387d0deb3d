"""Print lines and syntax nodes of the Python files of folders: ``python .ci/count.py lcp_plugin tests``.

Lines with code, as ``ruff format`` lays them out, without docstrings, comments and blank lines.
"""

import ast
import io
import sys
import tokenize
from pathlib import Path

SILENT = {
    tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER
}  # fmt: skip
DOCUMENTED = ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef


def count(text: str) -> tuple[int, int]:
    """Return the lines and the nodes of a file."""
    nodes = [*ast.walk(ast.parse(text))]
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in SILENT:
            lines.update(range(token.start[0], token.end[0] + 1))
    for node in nodes:
        if isinstance(node, DOCUMENTED) and ast.get_docstring(node, clean=False) is not None:
            lines.difference_update(range(node.body[0].lineno, node.body[0].end_lineno + 1))
    return len(lines), len(nodes)


if __name__ == "__main__":
    for folder in sys.argv[1:]:
        files = sorted(Path(folder).rglob("*.py"))
        found = [count(file.read_text(encoding="utf-8")) for file in files]
        lines, nodes = (sum(column) for column in zip(*found, strict=True))
        print(f"{folder}: {lines} lines, {nodes} nodes, {len(files)} files")
