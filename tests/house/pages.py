"""Write the notebooks of the examples and the pictures of the pages of ``examples/manual``.

    python tests/house/pages.py

writes ``examples/notebooks``, runs each example whose picture a page shows, and makes its picture small enough to
commit. ``python -m sphinx -W -c examples/manual examples FOLDER`` builds the site of all pages.
"""

from __future__ import annotations

import ast
import base64
import contextlib
import io
import json
import re
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from PIL import Image

EXAMPLES = Path(__file__).parents[2] / "examples"
# in examples/manual: the problem, its code and picture, a validation and the time, on one screen
TRADES = ("first_model", "options", "contact", "equilibria", "data", "control", "algorithms")
GUIDES = (
    *TRADES,
    *("agents", "traffic", "relays", "nonlinear", "nonlinear_obstacles", "quadratic_programs"),
    *("layers", "many_machines", "instead_of_path", "which_package", "browser", "stalled"),
    *("solved", "what_is_proved", "paper", "developing"),
)
NOTEBOOKS = EXAMPLES / "notebooks"
NAMES = (
    *("two_by_two_in_cvxpy", "american_put", "nnls_svm_portfolio", "model_predictive_control"),
    *("add_an_algorithm", "learn_friction", "cournot_oligopoly"),
)
STYLE = 'Path(__file__).with_name("plots.mplstyle")', '"../plots.mplstyle"'  # in a notebook
# what saves the picture, and reads the command line
OF_SCRIPTS = ("import typer", "from pathlib import Path")

PICTURES = EXAMPLES / "pictures"
LARGEST = 100_000  # bytes


def masked(text: str) -> str:
    """Return a text without its times and residuals, which differ between runs and machines."""
    return re.sub(r"[\d.]+(?: s\b|e-\d+)", "…", text)


def guide(name: str) -> str:
    """Return a page of the manual, in Markdown."""
    return (EXAMPLES / "manual" / f"{name}.md").read_text(encoding="utf-8")


def examples() -> list[str]:
    """Return the names of the examples in the order of their table."""
    table = EXAMPLES.joinpath("README.md").read_text(encoding="utf-8")
    return re.findall(r"^\| `(\w+)\.py` \|", table, re.M)


def cells_of(name: str) -> Iterator[tuple[str, str]]:
    """Yield the kind and the text of each cell: the docstring, imports, functions, then the steps of main."""
    script = (EXAMPLES / f"{name}.py").read_text(encoding="utf-8").replace(*STYLE)
    tree, lines = ast.parse(script), script.splitlines()
    title, _, story = (ast.get_docstring(tree) or "").partition("\n")
    yield (
        "markdown",
        f"# {title.rstrip('.')}\n{story}\n\nThe same as a script: [`{name}.py`](../{name}.py).",
    )
    *before, main, _ = tree.body[1:]
    yield from (("code", part) for part in _parts(before, lines))
    assert isinstance(main, ast.FunctionDef)
    assert main.name == "main"
    steps = [part for part in _parts(main.body[1:], lines) if part]
    # a figure is shown below its cell
    drawn = next(k for k, part in enumerate(steps) if "plt.subplots" in part)
    yield from (("code", part) for part in (*steps[:drawn], "\n\n".join(steps[drawn:])))


def _parts(statements: list[ast.stmt], lines: list[str]) -> Iterator[str]:
    """Yield the source of statements, apart at blank lines, imports together; none that saves."""
    part: list[str] = []
    for k, statement in enumerate(statements):
        first = (
            min(
                [
                    statement.lineno,
                    *(each.lineno for each in getattr(statement, "decorator_list", [])),
                ]
            )
            - 1
        )
        source = textwrap.dedent("\n".join(lines[first : statement.end_lineno]))
        if k and not lines[first - 1].strip():
            if isinstance(statement, (ast.Import, ast.ImportFrom)):
                part.append("")
            else:
                yield "\n".join(part).strip()
                part = []
        if source not in OF_SCRIPTS and "savefig(" not in source:
            part.append(source)
    yield "\n".join(part).strip()


def run_cell(text: str, name: str, namespace: dict[str, Any]) -> list[dict[str, Any]]:
    """Run a cell, and return its outputs: the printed lines, and figures that it opened as small pictures."""
    import matplotlib.pyplot as plt

    before, printed = {*plt.get_fignums()}, io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(text, name, "exec", dont_inherit=True), namespace)
    lines = printed.getvalue().splitlines(keepends=True)
    outputs: list[dict[str, Any]] = []
    if lines:
        outputs.append({"output_type": "stream", "name": "stdout", "text": lines})
    for number in sorted({*plt.get_fignums()} - before):
        drawn = io.BytesIO()
        plt.figure(number).savefig(drawn, dpi=90)
        data = {"image/png": base64.b64encode(small(drawn)).decode()}
        outputs.append({"output_type": "display_data", "data": data, "metadata": {}})
    return outputs


def notebook(name: str) -> str:
    """Return the notebook of an example with its outputs, as a file holds it."""
    import matplotlib.pyplot as plt

    plt.switch_backend("agg")
    namespace: dict[str, Any] = {"__name__": "notebook"}
    cells: list[dict[str, Any]] = []
    count = 0
    with plt.rc_context(), contextlib.chdir(NOTEBOOKS):
        for kind, text in cells_of(name):
            cell = {"cell_type": kind, "metadata": {}, "source": text.splitlines(keepends=True)}
            if kind == "code":
                count += 1
                cell |= {"execution_count": count, "outputs": run_cell(text, name, namespace)}
            cells.append(cell)
    plt.close("all")
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    content = {
        "cells": cells,
        "metadata": {"kernelspec": kernel, "language_info": {"name": "python"}},
        "nbformat": 4,
        "nbformat_minor": 4,
    }
    return json.dumps(content, indent=1, ensure_ascii=False) + "\n"


def write_notebooks() -> Iterator[str]:
    """Write them next to the examples; yield the names."""
    NOTEBOOKS.mkdir(exist_ok=True)
    for name in NAMES:
        file: Path = NOTEBOOKS / f"{name}.ipynb"
        file.write_text(notebook(name), encoding="utf-8")
        yield f"examples/notebooks/{file.name}"


def shown() -> list[str]:
    """Return the names of the pictures that the pages and the index of the examples show."""
    pages = [EXAMPLES / "README.md", *sorted((EXAMPLES / "manual").glob("*.md"))]
    return sorted(
        {
            name
            for page in pages
            for name in re.findall(r"pictures/(\w+)\.png", page.read_text("utf-8"))
        }
    )


def small(picture: Path | io.BytesIO) -> bytes:
    """Return a picture of 256 colors, narrowed until it fits."""
    image = Image.open(picture).convert("RGB")
    while True:
        written = io.BytesIO()
        image.quantize(256, dither=Image.Dither.NONE).save(written, "PNG", optimize=True)
        if len(written.getvalue()) <= LARGEST:
            return written.getvalue()
        image = image.resize(
            (round(0.9 * image.width), round(0.9 * image.height)), Image.Resampling.LANCZOS
        )


def write_pictures() -> Iterator[str]:
    """Run the examples whose pictures the pages show; yield the names."""
    with TemporaryDirectory() as folder:
        for name in set(shown()) & {*examples()}:
            command = [sys.executable, str(EXAMPLES / f"{name}.py"), "--out", folder]
            subprocess.run(command, check=True, capture_output=True)
            (PICTURES / f"{name}.png").write_bytes(small(Path(folder) / f"{name}.png"))
            yield f"examples/pictures/{name}.png"


if __name__ == "__main__":
    for line in (*write_notebooks(), *write_pictures()):
        print(line, flush=True)
