"""The pages of the manual: their code runs, their pictures and notebooks are those of the examples."""

import contextlib
import io
import json
import multiprocessing
import os
import re
import sys
import textwrap
from importlib.util import find_spec

import pytest
from pages import (
    GUIDES,
    LARGEST,
    NAMES,
    NOTEBOOKS,
    PICTURES,
    TRADES,
    cells_of,
    examples,
    guide,
    masked,
    shown,
)

import lcp_plugin.ranks

BLOCK = re.compile(r"^```python\n(.*?)^```\n(?:\n```text\n(.*?)^```\n)?", re.S | re.M)


@pytest.fixture
def spawned():
    """Start worker processes afresh: a process with threads is not to be forked."""
    before = multiprocessing.get_start_method(allow_none=True)
    multiprocessing.set_start_method("spawn", force=True)
    yield
    multiprocessing.set_start_method(before, force=True)


@pytest.mark.quick(1)
@pytest.mark.usefixtures("spawned")
@pytest.mark.parametrize("name", GUIDES)
def test_the_code_of_a_guide_prints_what_stands_below_it(name, monkeypatch, tmp_path):
    """Its blocks run one after the other; a script for ranks is the one that tests/distributed runs."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, sys.path)))
    monkeypatch.chdir(tmp_path)  # a page writes files
    namespace = {"__name__": "__main__"}
    blocks = BLOCK.findall(guide(name))
    assert blocks
    for code, printed in blocks:
        if "mpi4py" in code:
            assert textwrap.indent(code, "    ") in (lcp_plugin.ranks.__doc__ or "")
            continue
        for package in ("torch", "jax", "skfem", "pyomo"):
            if re.search(rf"^(import|from) {package}\b", code, re.M) and not find_spec(package):
                pytest.skip(f"{package} is not installed")
        found = io.StringIO()
        with contextlib.redirect_stdout(found):
            exec(compile(code, name, "exec", dont_inherit=True), namespace)
        assert masked(found.getvalue()) == masked(printed)


def test_the_pictures_of_the_pages_are_small_and_are_those_of_examples():
    """Each is kept beside the pages, of at most 100 kB, and an example draws it; no other one is kept."""
    names = {*examples()} | {"three_problems"}
    for name in shown():
        assert name in names
        assert PICTURES.joinpath(f"{name}.png").stat().st_size <= LARGEST, name
    assert {file.stem for file in PICTURES.glob("*.png")} == {*shown(), "three_problems"}


def test_notebooks_have_the_cells_of_the_examples_and_outputs():
    """Each has the cells of its script, and the outputs stored by `python tests/house/pages.py`."""
    assert sorted(file.stem for file in NOTEBOOKS.glob("*.ipynb")) == sorted(NAMES)
    for name in NAMES:
        file = NOTEBOOKS / f"{name}.ipynb"
        assert file.stat().st_size <= 2 * LARGEST
        cells = json.loads(file.read_text(encoding="utf-8"))["cells"]
        assert [(cell["cell_type"], "".join(cell["source"])) for cell in cells] == [*cells_of(name)]
        outputs = [one for cell in cells for one in cell.get("outputs", [])]
        assert {one["output_type"] for one in outputs} == {"stream", "display_data"}, name
        assert "check: " in str(outputs)


@pytest.mark.full
@pytest.mark.parametrize("name", NAMES)
def test_a_notebook_runs(name, capsys):
    """Its cells, one after the other, print the checks of the example and leave its figure."""
    import matplotlib.pyplot as plt

    plt.switch_backend("agg")
    plt.close("all")  # figures of other tests
    namespace = {"__name__": "notebook"}
    with plt.rc_context(), contextlib.chdir(NOTEBOOKS):
        for kind, text in cells_of(name):
            if kind == "code":
                exec(compile(text, name, "exec", dont_inherit=True), namespace)
    assert "check: " in capsys.readouterr().out
    assert len(plt.get_fignums()) == 1
    plt.close("all")


def test_every_application_has_a_picture_that_an_example_draws():
    """The first picture of a page on an application is drawn by a script of the examples."""
    for name in TRADES:
        picture = re.findall(r"^!\[.*\]\(\.\./pictures/(\w+)\.png\)$", guide(name), re.M)[0]
        assert picture in examples()
