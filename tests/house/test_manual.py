"""The manual in a browser: every public name and example, guides whose code runs, no broken link, a search."""

from __future__ import annotations

import contextlib
import inspect
import io
import json
import re
import shutil
import subprocess
import textwrap
from html import unescape
from html.parser import HTMLParser
from pathlib import Path

import pytest
from manual import site
from manual.contents import (
    EXAMPLES,
    SUBJECTS,
    TRADES,
    Example,
    Guide,
    examples,
    guides,
    is_member,
    subject_of,
)
from manual.docstrings import CODE, render, to_markdown
from manual.formulas import HIGH, LOW, mathml, set_formulas
from manual.notebooks import NAMES, NOTEBOOKS, cells_of, notebook
from manual.pictures import LARGEST, PICTURES, shown
from public_names import PUBLIC

import lcp_plugin.ranks

PICTURE = EXAMPLES / "pictures" / "three_problems.png"
BROWSER = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
BLOCK = re.compile(r"^```python\n(.*?)^```\n(?:\n```text\n(.*?)^```\n)?", re.S | re.M)
ONE_SCREEN = 60  # lines
NOT_SHOWN = re.compile(r"[_{}^\s]")


class Page(HTMLParser):
    """What a page links to, what it loads, and its anchors."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.anchors: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Keep what the page refers to."""
        told = {name: value or "" for name, value in attrs}
        if "id" in told:
            self.anchors.append(told["id"])
        if tag == "a":
            self.links.append(told["href"])
        elif tag in ("img", "script", "link", "iframe"):
            self.loaded.append(told.get("src") or told.get("href") or "")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A manual whose examples have one picture, since drawing all takes minutes."""
    folder = tmp_path_factory.mktemp("manual")
    (folder / "examples").mkdir()
    for example in examples():
        shutil.copy(PICTURE, folder / "examples" / f"{example.name}.png")
        (folder / "examples" / f"{example.name}.txt").write_text("check: 0 < 1\n", encoding="utf-8")
    site.write(folder)
    return folder


@pytest.fixture(scope="module")
def pages(folder: Path) -> dict[Path, Page]:
    """Every page by its file."""
    return {file: Page(file.read_text(encoding="utf-8")) for file in folder.rglob("*.html")}


@pytest.mark.full
def test_every_link_leads_to_a_page_and_an_anchor_of_it(pages: dict[Path, Page]) -> None:
    """Of more than 1000 links none is broken; those that leave the manual, as to a doi, are not followed."""
    followed = 0
    for file, page in pages.items():
        assert len(page.anchors) == len({*page.anchors}), file
        for link in page.links:
            if link.startswith("https://"):
                continue
            name, _, anchor = link.partition("#")
            target = pages[(file.parent / name).resolve() if name else file]
            assert not anchor or anchor in target.anchors, f"{file.name} → {link}"
            followed += 1
    assert followed > 1000


@pytest.mark.full
def test_no_page_needs_a_network(pages: dict[Path, Page]) -> None:
    """What a page loads lies beside it; the search alone has scripts, and they fetch nothing."""
    for file, page in pages.items():
        for name in filter(None, page.loaded):
            assert (file.parent / name).is_file(), f"{file.name} loads {name}"
        text = file.read_text(encoding="utf-8")
        assert not re.search(r"@import|url\(|fetch\(|XMLHttp", text)
        assert ("<script" in text) == (file.name == "search.html")


@pytest.mark.parametrize("guide", guides(), ids=lambda guide: guide.name)
def test_the_code_of_a_guide_prints_what_stands_below_it(guide: Guide) -> None:
    """Its blocks run one after the other; a script for ranks is the one that tests/distributed runs."""
    namespace: dict[str, object] = {"__name__": "guide"}
    blocks = BLOCK.findall(guide.source)
    assert blocks
    for code, printed in blocks:
        if "mpi4py" in code:
            assert textwrap.indent(code, "    ") in (lcp_plugin.ranks.__doc__ or "")
            continue
        if "import torch" in code:
            try:
                import torch  # noqa: F401
            except ImportError:
                continue
        found = io.StringIO()
        with contextlib.redirect_stdout(found):
            exec(compile(code, guide.name, "exec", dont_inherit=True), namespace)
        assert found.getvalue() == printed


def test_every_guide_has_a_picture_that_an_example_draws() -> None:
    """The start page of the manual shows the first one."""
    drawn = {f"examples/{example.name}.png" for example in examples()}
    for guide in guides():
        assert guide.picture in drawn


@pytest.mark.sampled
@pytest.mark.parametrize("name", TRADES)
def test_a_trade_is_told_on_one_screen(name: str) -> None:
    """Words, code that prints, a picture, what was checked and the time, in this order and in at most 60 lines."""
    screen = Guide(name).source.partition("\n## ")[0]
    places = [
        screen.find(part)
        for part in ("```python", "```text", "![", "**Validation.**", "**Run time.** On ")
    ]
    assert -1 not in places
    assert places == sorted(places)
    assert len(screen.splitlines()) <= ONE_SCREEN


def test_the_pictures_of_the_pages_are_small_and_are_those_of_examples() -> None:
    """Each is kept beside the pages, of at most 100 kB, and an example draws it; no other one is kept."""
    names = {example.name for example in examples()} | {"three_problems"}
    for name in shown():
        assert name in names
        assert PICTURES.joinpath(f"{name}.png").stat().st_size <= LARGEST, name
    assert {file.stem for file in PICTURES.glob("*.png")} == {*shown(), "three_problems"}


def test_the_notebooks_are_those_of_the_examples_without_outputs() -> None:
    """Each is what its script makes, which `python tests/manual FOLDER --keep` writes; none is left over."""
    assert sorted(file.stem for file in NOTEBOOKS.iterdir()) == sorted(NAMES)
    for name in NAMES:
        kept = NOTEBOOKS.joinpath(f"{name}.ipynb").read_text(encoding="utf-8")
        assert kept == notebook(name)
        assert all(not cell.get("outputs") for cell in json.loads(kept)["cells"])


@pytest.mark.full
@pytest.mark.parametrize("name", NAMES)
def test_a_notebook_runs(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Its cells, one after the other, print the checks of the example and leave its figure."""
    import matplotlib.pyplot as plt

    plt.switch_backend("agg")
    namespace: dict[str, object] = {"__name__": "notebook"}
    with plt.rc_context():
        for kind, text in cells_of(name):
            if kind == "code":
                exec(compile(text, name, "exec", dont_inherit=True), namespace)
    assert "check: " in capsys.readouterr().out
    assert len(plt.get_fignums()) == 1
    plt.close("all")


@pytest.mark.full
@pytest.mark.skipif(BROWSER is None, reason="no Chromium installed: apt-get install chromium")
def test_the_manual_in_a_browser(folder: Path, tmp_path: Path) -> None:
    """In Chromium, 1280 and 390 pixels wide: no page is wider than that, every picture is there; words are found."""
    names = [
        "index.html",
        *(guide.address for guide in guides()),
        "class.LCP.html",
        "search.html?q=from_contacts",
    ]
    script = """
      const names = NAMES, widths = [1280, 390], found = {};
      const look = (name, width) => new Promise(done => {
        const frame = document.createElement("iframe");
        frame.style.cssText = `width: ${width}px; height: 900px`;
        frame.onload = () => {
          const page = frame.contentDocument;
          page.querySelectorAll("img").forEach(image => image.loading = "eager");
          setTimeout(() => {
            found[`${name} ${width}`] = {
              width: page.documentElement.scrollWidth,
              missing: [...page.images].filter(image => !image.naturalWidth).length,
              links: [...page.querySelectorAll("#found a")].map(link => link.getAttribute("href")),
            };
            frame.remove();
            done();
          }, 300);
        };
        frame.src = name;
        document.body.append(frame);
      });
      (async () => {
        for (const name of names) for (const width of widths) await look(name, width);
        document.getElementById("answer").textContent = JSON.stringify(found);
      })();
    """.replace("NAMES", json.dumps(names))
    harness = folder / "harness.htm"
    harness.write_text(
        f'<!doctype html><body><pre id="answer"></pre><script>{script}</script>', encoding="utf-8"
    )
    run = subprocess.run(
        [
            str(BROWSER),
            "--headless=new",
            "--no-sandbox",
            "--disable-gpu",
            "--no-first-run",
            "--disable-background-networking",
            "--allow-file-access-from-files",
            f"--user-data-dir={tmp_path}",
            "--window-size=1400,1000",
            "--enable-logging=stderr",
            "--v=0",
            "--host-resolver-rules=MAP * ~NOTFOUND",
            "--virtual-time-budget=60000",
            "--dump-dom",
            harness.as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    harness.unlink()
    answer = re.search(r'<pre id="answer">(.+?)</pre>', run.stdout, re.S)
    assert answer is not None, run.stdout[-500:]
    assert [line for line in run.stderr.splitlines() if "CONSOLE" in line] == []
    found = json.loads(unescape(answer[1]))
    assert len(found) == 2 * len(names)
    for name, page in found.items():
        assert page["width"] <= int(name.rpartition(" ")[2]), name
        assert page["missing"] == 0, name
    assert "guide.contact.html" in found["search.html?q=from_contacts 1280"]["links"]


@pytest.mark.full
def test_every_public_name_has_its_place(folder: Path) -> None:
    """A page or an anchor of its own tells each; no two files differ by case alone."""
    addresses = site.Site().addresses
    for name, thing in PUBLIC.items():
        if not (inspect.isclass(thing) or inspect.ismodule(thing) or is_member(thing)):
            continue  # a field, of which its class tells; or the version, which stands on every page
        own = (
            getattr(thing, "__name__", name).rpartition(".")[2] if inspect.isclass(thing) else name
        )
        address = addresses.get(name) or addresses[own]
        assert (folder / address.partition("#")[0]).is_file()
    files = [file.name.lower() for file in folder.iterdir()]
    assert len(files) == len({*files})


@pytest.mark.full
def test_every_example_has_its_picture_its_code_and_what_it_printed(folder: Path) -> None:
    """Beside the story; the start page shows all of them."""
    start = Page((folder / "index.html").read_text(encoding="utf-8"))
    for example in examples():
        page = folder.joinpath(example.address)
        text = page.read_text(encoding="utf-8")
        assert f"{example.name}.png" in Page(text).loaded
        assert "check: 0 &lt; 1" in text
        code = unescape(re.sub("<[^>]*>", "", text))
        assert 'if __name__ == "__main__":' in code
        assert example.address in start.links


def test_a_name_without_a_subject_is_an_error() -> None:
    """Every subpackage of a public name belongs to a subject, the longest match first; the message says what to do."""
    assert [
        subject_of(subpackage) for subpackage in ("api", "problems.sensitivity", "interfaces")
    ] == [
        "solve",
        "differentiate",
        "interfaces",
    ]
    with pytest.raises(
        LookupError, match=r"no subject of the manual shows lcp_plugin\.garden: add it to SUBJECTS"
    ):
        subject_of("garden")
    assert list(SUBJECTS) == [
        "solve",
        "model",
        "prove",
        "batch",
        "differentiate",
        "measure",
        "interfaces",
    ]


def test_help_that_is_nowhere_is_an_error() -> None:
    """A docstring that names a page which is none stops the build."""
    with pytest.raises(ValueError, match="nowhere"):
        render('See ``help("lcp_plugin.nowhere")``.', {"lcp_plugin.modeling": "modeling.html"}.get)


def formulas_in(text: str) -> list[str]:
    """Return the formulas of a text, which is otherwise left as it is."""
    found: list[str] = []

    def put(formula: str) -> str:
        found.append(formula)
        return formula

    assert set_formulas(text, put) == text
    return found


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("text", "formulas"),
    [
        (
            "z with lower ≤ z ≤ upper and w = M z + q complementary",
            ["z", "lower ≤ z ≤ upper", "w = M z + q"],
        ),
        ("where ‖z_k − z_{k−1}‖_v ≤ cᵏ, n = 20 000 rows", ["‖z_k − z_{k−1}‖_v ≤ cᵏ", "n = 20 000"]),
        ("the largest of max_j |a_ij| + |b_i| is a bound of A", ["max_j |a_ij| + |b_i|", "A"]),
        (
            "A put of 10 s, a P-matrix, M's rows, J. Finance 3, and/or 2-D; (n, 5) and 40 % more",
            ["n"],
        ),
        ("−∇·(h³ ∇p) ≥ ε sin θ,   and at every point", ["−∇·(h³ ∇p) ≥ ε sin θ"]),
        ("a utility of d_ch = α_ch p_c^−σ_h, say", ["d_ch = α_ch p_c^−σ_h"]),
        (
            "x below √tolerance, and mid(lower, upper, z − w/d)",
            ["x", "√tolerance", "mid(lower, upper, z − w/d)"],
        ),
        ("*z* is printed in italics, **n** in bold", []),
    ],
)
def test_formulas_are_found_in_sentences(text: str, formulas: list[str]) -> None:
    """From the first operand to the last, and no word, unit or initial beside."""
    assert formulas_in(text) == formulas


def test_a_formula_keeps_its_characters() -> None:
    """MathML of each of the hundreds in our docstrings shows the same signs; a root is drawn."""
    plain = str.maketrans({**HIGH, **LOW, "*": "∗"})
    texts = (
        text
        for thing in PUBLIC.values()
        for text in CODE.split(to_markdown(inspect.getdoc(thing) or ""))[::2]
    )
    found = {formula for text in texts for formula in formulas_in(text)}
    assert len(found) > 300
    for formula in found:
        shown = unescape(re.sub(r"<[^>]*>", "", mathml(formula).replace("<msqrt>", "√")))
        assert sorted(NOT_SHOWN.sub("", shown)) == sorted(
            NOT_SHOWN.sub("", formula).translate(plain)
        ), formula


@pytest.mark.full
def test_the_command_draws_what_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An example runs where its picture is not there yet, and not a second time."""
    monkeypatch.setattr(site, "examples", lambda: [Example("two_by_two_in_cvxpy", "", "")])
    assert list(site.run_examples(tmp_path)) == ["python examples/two_by_two_in_cvxpy.py"]
    assert (tmp_path / "examples" / "two_by_two_in_cvxpy.png").read_bytes().startswith(b"\x89PNG")
    assert "check: " in (tmp_path / "examples" / "two_by_two_in_cvxpy.txt").read_text(
        encoding="utf-8"
    )
    assert not list(site.run_examples(tmp_path))
