"""The site of the manual: no warning, no dead link, no network, and a browser that searches and shows it."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from shutil import which
from typing import Any
from urllib.parse import unquote, urlsplit

import pytest

import lcp_plugin

ROOT = Path(__file__).parents[2]
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
NARROW = 390  # pixels: a telephone

pytest.importorskip("sphinx", reason="the extra [manual] is not installed")
pytest.importorskip("myst_parser", reason="the extra [manual] is not installed")
pytestmark = pytest.mark.full


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the site; a warning is an error."""
    folder = tmp_path_factory.mktemp("site")
    command = ["-m", "sphinx", "-q", "-W", "-c", "examples/manual", "examples", str(folder)]
    done = subprocess.run(
        [sys.executable, *command], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return folder


class Links(HTMLParser):
    """Targets of links and pictures, and the anchors of a page."""

    def __init__(self) -> None:
        super().__init__()
        self.targets: list[str] = []
        self.anchors: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Collect the link and the anchor of a tag."""
        found = dict(attrs)
        self.anchors.add(found.get("id") or "")
        self.targets += [found.get("href") or "", found.get("src") or ""]


def read_links(page: Path) -> Links:
    """Return the links of a page."""
    links = Links()
    links.feed(page.read_text(encoding="utf-8"))
    return links


def test_every_internal_link_has_a_target(site: Path) -> None:
    """Each link leads to a file of the site and to an anchor of it; scripts, styles and pictures come with the site."""
    pages = {page: read_links(page) for page in site.rglob("*.html")}
    for page, links in pages.items():
        for target in filter(None, links.targets):
            parts = urlsplit(target)
            if parts.scheme in ("https", "http", "data", "mailto"):
                continue
            file = (page.parent / unquote(parts.path)).resolve() if parts.path else page
            assert file.exists(), f"{page.name} → {target}"
            if parts.fragment and file in pages:
                assert unquote(parts.fragment) in pages[file].anchors, f"{page.name} → {target}"


def test_pages_load_nothing_from_the_network(site: Path) -> None:
    """No page has a script, a style or a picture from another host."""
    for page in site.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        assert not re.search(r'(?:src|<link[^>]*href)="(?:https?:)?//', text), page.name


def test_reference_has_every_public_name(site: Path) -> None:
    """The reference has an anchor for each public name, except the gallery, which is a module."""
    anchors = read_links(site / "manual" / "reference.html").anchors
    names = {name for name in lcp_plugin.__all__ if name[0] != "_"} - {"gallery"}
    assert names <= {anchor.removeprefix("lcp_plugin.") for anchor in anchors}


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Start the system's Chromium by Playwright."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    path = next(filter(None, map(which, BROWSERS)), None)
    if path is None:
        pytest.skip("the system has no chromium")
    with playwright.sync_playwright() as started:
        opened = started.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield opened
        opened.close()


@pytest.fixture
def page(browser: Any) -> Iterator[Any]:
    """Open a page that fails if it requests anything but files."""
    tab = browser.new_page()
    requests: list[str] = []
    tab.on("request", lambda request: requests.append(request.url))
    yield tab
    tab.close()
    assert all(url.startswith(("file:", "data:")) for url in requests)


@pytest.mark.parametrize(
    ("word", "title"),
    {
        "friction": "Contact",
        "mpc": "Model predictive control (MPC)",
        "licence": "Guarantees and limitations",
        "license": "Guarantees and limitations",
        "sklearn": "Coming from another package",
        "cuda": "PyTorch, JAX and cvxpy gradients",
        "gpu": "PyTorch, JAX and cvxpy gradients",
        "float32": "PyTorch, JAX and cvxpy gradients",
        "tutorial": "Manual and examples",
        "quantlib": "American options",
        "only_last": "American options",
        "bug": "lcp_plugin",
        "contribute": "lcp_plugin",
        "spectral radius": "lcp_plugin.proofs.guarantees.Guarantee.spectral_radius",
    }.items(),
)
def test_search_finds_a_word(site: Path, page: Any, word: str, title: str) -> None:
    """The search box of the site finds the page on a subject."""
    page.goto((site / "index.html").as_uri())
    page.fill("input[name=q]", word)
    page.press("input[name=q]", "Enter")
    page.wait_for_selector("ul.search li a")
    page.wait_for_timeout(500)
    found = page.eval_on_selector_all("ul.search li a", "all => all.map(one => one.textContent)")
    assert title in found


def test_pages_have_a_menu_buttons_and_neighbors(site: Path, page: Any) -> None:
    """On a telephone a menu leads to other pages; code has copy buttons; a page has links to the next one."""
    page.set_viewport_size({"width": NARROW, "height": 800})
    page.goto((site / "manual" / "options.html").as_uri())
    assert page.locator("button.copybtn").count() > 0
    assert page.locator("#rellinks a").all_inner_texts() == ["Glossary", "Contact"]
    page.click("details.menu summary")
    page.click("details.menu >> text=Glossary")
    assert page.inner_text("div.body h1").startswith("Glossary")


def test_scripts_and_help_pages_are_not_empty(site: Path) -> None:
    """The picture of an example leads to its highlighted code, and each module of the topics has its text."""
    readme = (site / "README.html").read_text(encoding="utf-8")
    assert 'href="scripts/american_put.html"' in readme
    assert 'class="k">def' in (site / "scripts" / "american_put.html").read_text(encoding="utf-8")
    for part in (site / "manual" / "subjects.html").read_text(encoding="utf-8").split("<h2>")[1:]:
        assert "<p>" in part


def test_formulas_and_pictures_are_shown(site: Path, page: Any) -> None:
    """A formula is text with its symbols, and every picture of each page has a size."""
    page.goto((site / "manual" / "solved.html").as_uri())
    assert "r_i(z) = z_i − mid(lower_i, upper_i, z_i − w_i/d_i)" in page.inner_text("div.body")
    for file in sorted(site.rglob("*.html")):
        page.goto(file.as_uri())
        widths = page.eval_on_selector_all(
            "div.body img", "all => all.map(one => one.naturalWidth)"
        )
        assert all(width > 0 for width in widths), file.name


def test_pages_fit_a_narrow_screen(site: Path, page: Any) -> None:
    """On a telephone no page is wider than the screen: tables and code scroll, pictures shrink."""
    page.set_viewport_size({"width": NARROW, "height": 800})
    for file in sorted(site.rglob("*.html")):
        page.goto(file.as_uri())
        assert page.evaluate("document.documentElement.scrollWidth") <= NARROW, file.name
