"""The site of the manual: no warning, which a dead link is, and no network."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

import lcp_plugin

ROOT = Path(__file__).parents[2]

pytest.importorskip("sphinx", reason="the extra [manual] is not installed")
pytest.importorskip("myst_parser", reason="the extra [manual] is not installed")
pytestmark = pytest.mark.full


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Build the site; a warning is an error."""
    folder = tmp_path_factory.mktemp("site")
    command = ["-m", "sphinx", "-q", "-W", "-c", "examples/manual", "examples", str(folder)]
    done = subprocess.run(
        [sys.executable, *command], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return folder


def test_pages_load_nothing_from_the_network(site):
    """No page has a script, a style or a picture from another host."""
    for page in site.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        assert not re.search(r'(?:src|<link[^>]*href)="(?:https?:)?//', text), page.name


def test_reference_has_every_public_name(site):
    """The reference has an anchor for each public name, except the gallery, which is a module."""
    page = (site / "manual" / "reference.html").read_text(encoding="utf-8")
    anchors = set(re.findall(r'\bid="([^"]*)"', page))
    names = {name for name in lcp_plugin.__all__ if name[0] != "_"} - {"gallery"}
    assert names <= {anchor.removeprefix("lcp_plugin.") for anchor in anchors}


def test_scripts_and_help_pages_are_not_empty(site):
    """The picture of an example leads to its highlighted code, and each module of the topics has its text."""
    readme = (site / "README.html").read_text(encoding="utf-8")
    assert 'href="scripts/american_put.html"' in readme
    assert 'class="k">def' in (site / "scripts" / "american_put.html").read_text(encoding="utf-8")
    page = (site / "manual" / "reference.html").read_text(encoding="utf-8")
    for part in page.partition("<h2>Topics")[2].split("<h3>")[1:]:
        assert "<p>" in part
