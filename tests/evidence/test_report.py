"""The report: one page that needs nothing else, and a run that can be stopped."""

from __future__ import annotations

import functools
import html
import http.server
import json
import os
import re
import shutil
import signal
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from lcp_plugin import LCP, InvalidOption, gallery, solve
from lcp_plugin.commands.cli import app
from lcp_plugin.evidence.report.page import (
    QUICK_SCENES,
    SCENES,
    Collected,
    Part,
    collect,
    plan,
    write_report,
)

BROWSER = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
TINY = [
    "half_active:n=64",
    "paper_example_1:n=64",
    "obstacle_bumps:size=9",
    "market_equilibrium:goods=4,activities=4",
]


@pytest.fixture(scope="module")
def collected() -> Collected:
    """Every kind of part, each of them small."""
    found = Collected()
    parts = plan(TINY, quick=True)
    for part in parts:
        found.contents[part.kind, part.name] = part.compute(lambda text: None)
    return found


@pytest.fixture(scope="module")
def folder(collected: Collected, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page and its tables."""
    path = tmp_path_factory.mktemp("report")
    write_report(collected, path, is_quick=False)
    return path


# --- The page -------------------------------------------------------------------------------------------------


@pytest.mark.full
def test_page_needs_no_other_file(folder: Path) -> None:
    """No address, script or style sheet is fetched; every picture stands in the page, and no two share an id."""
    page = (folder / "index.html").read_text(encoding="utf-8")
    fetched = re.findall(
        r'(?:src|href)="(?!#|data:)([^"]*)"|url\((?!#|data:)([^)]*)\)|@import|<script', page
    )
    assert fetched == []
    assert page.count("<svg") == 2 * len(TINY)
    ids = re.findall(r'\bid="([^"]*)"', page)
    assert len(ids) == len(set(ids))
    references = set(re.findall(r'href="#([^"]*)"|url\(#([^)]*)\)', page))
    assert {a or b for a, b in references} <= set(ids)


@pytest.mark.full
def test_page_says_everything(folder: Path, collected: Collected) -> None:
    """Each section stands there, with every scene, its axis, and why something was left out."""
    page = html.unescape((folder / "index.html").read_text(encoding="utf-8"))
    for anchor in ("scenes", "reading", "machine"):
        assert f'id="{anchor}"' in page
    for name, report in collected.of("scene").items():
        assert name in page
        for what, reason in report.left_out:
            assert f"{what}: {reason}" in page


@pytest.mark.full
def test_tables_lie_beside_the_page(folder: Path) -> None:
    """The figures are there as CSV and JSON too."""
    names = {path.name for path in folder.iterdir()}
    assert names >= {"index.html", "report.json", "curves.csv", "left_out.csv"}
    content = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    assert {part["kind"] for part in content["parts"]} == {"scene"}


HARNESS = """<!DOCTYPE html><meta charset="utf-8"><link rel="icon" href="data:,"><body><script>
const found = {};
function look(width) {
  return new Promise(done => {
    const frame = document.createElement('iframe');
    frame.style.cssText = `width:${width}px;height:900px;border:0`;
    frame.onload = () => {
      const page = frame.contentDocument, root = page.documentElement;
      page.querySelectorAll('details').forEach(one => one.open = true);
      const cut = [];
      page.querySelectorAll('body *').forEach(one => {
        const box = one.getBoundingClientRect();
        if (!one.closest('svg') && box.width > 0 && (box.right > width + 1 || box.left < -1))
          cut.push(one.tagName + '.' + one.className + ' ' + (one.textContent || '').slice(0, 30));
      });
      page.querySelectorAll('.scroll').forEach(one => {
        if (one.scrollWidth > one.clientWidth + 1)
          cut.push('table ' + one.scrollWidth + ' > ' + one.clientWidth + ' ' + one.textContent.trim().slice(0, 30));
      });
      page.querySelectorAll('svg').forEach(svg => {
        const frame = svg.getBoundingClientRect();
        svg.querySelectorAll('g[id*="text_"]').forEach(text => {
          const box = text.getBoundingClientRect();
          if (box.left < frame.left - 1 || box.right > frame.right + 1 ||
              box.top < frame.top - 1 || box.bottom > frame.bottom + 1)
            cut.push('label in ' + svg.getAttribute('aria-label') + ' ' + text.id);
        });
      });
      const svgs = [...page.querySelectorAll('figure svg')];
      found[width] = {
        cut, width: root.scrollWidth, figures: svgs.length,
        empty: svgs.filter(svg => svg.getBoundingClientRect().height < 100).length,
        fetched: frame.contentWindow.performance.getEntriesByType('resource').map(entry => entry.name),
      };
      done();
    };
    frame.src = 'index.html';
    document.body.append(frame);
  });
}
look(1280).then(() => look(390)).then(() => {
  const answer = document.createElement('pre');
  answer.id = 'answer';
  answer.textContent = JSON.stringify(found);
  document.body.replaceChildren(answer);
});
</script></body>"""


@pytest.fixture(scope="module")
def server(folder: Path) -> Iterator[tuple[str, list[str]]]:
    """The folder on a local port, and the paths that are asked for."""
    asked: list[str] = []

    class Handler(http.server.SimpleHTTPRequestHandler):
        def log_message(self, format: str, *args: Any) -> None:
            asked.append(self.path)

    (folder / "harness.html").write_text(HARNESS, encoding="utf-8")
    with http.server.ThreadingHTTPServer(
        ("127.0.0.1", 0), functools.partial(Handler, directory=str(folder))
    ) as one:
        threading.Thread(target=one.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{one.server_port}", asked
        one.shutdown()


@pytest.mark.full
@pytest.mark.skipif(BROWSER is None, reason="no Chromium installed: apt-get install chromium")
def test_page_in_a_browser(server: tuple[str, list[str]], tmp_path: Path) -> None:
    """In Chromium, 1280 and 390 pixels wide: a silent console, nothing fetched, plots there, nothing cut off."""
    address, asked = server
    run = subprocess.run(
        [
            str(BROWSER),
            "--headless=new",
            "--no-sandbox",
            "--disable-gpu",
            "--no-first-run",
            "--disable-background-networking",
            f"--user-data-dir={tmp_path}",
            "--window-size=1400,1000",
            "--enable-logging=stderr",
            "--v=0",
            "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
            "--virtual-time-budget=20000",
            "--dump-dom",
            f"{address}/harness.html",
        ],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    answer = re.search(r'<pre id="answer">(.*?)</pre>', run.stdout, re.S)
    assert answer is not None, run.stdout[-500:]
    found = json.loads(html.unescape(answer[1]))
    assert [line for line in run.stderr.splitlines() if "CONSOLE" in line] == []
    assert set(asked) == {"/harness.html", "/index.html"}
    for width in ("1280", "390"):
        assert found[width]["cut"] == [], "\n".join(found[width]["cut"])
        assert found[width]["fetched"] == []
        assert found[width]["width"] <= int(width)
        assert found[width]["figures"] == 2 * len(TINY)
        assert found[width]["empty"] == 0


# --- The plan -------------------------------------------------------------------------------------------------


def test_default_plan_keeps_the_promise() -> None:
    """The default report and the quick one hold at least five scenes with 10 to 90 % of the constraints active."""
    for texts in (SCENES, QUICK_SCENES):
        shares = []
        for text in texts:
            name, _, parameters = text.partition(":")
            if "delta=0" in parameters:
                continue
            scene = gallery.build(name, **({"size": 20} if "size" in parameters else {}))
            z = solve(scene.problem, z0=scene.start).z
            at_bound = (z <= scene.problem.lower) | (z >= scene.problem.upper)
            shares.append(float(at_bound.mean()))
        assert sum(0.1 <= share <= 0.9 for share in shares) >= 5


def test_unknown_scene_is_refused_before_anything_runs() -> None:
    """A misspelt scene ends the command at once, with a guess."""
    with pytest.raises(InvalidOption, match="did you mean 'half_active'"):
        plan(["halfactive"])


# --- Stopping and going on ------------------------------------------------------------------------------------


def part(name: str, compute: Any) -> Part:
    return Part("scene", name, compute)


@pytest.mark.parametrize("swallowed", [True, False])
def test_interruption_keeps_what_is_finished(swallowed: bool) -> None:
    """Ctrl-C gives up the part under way, even where its solver swallows it, and keeps the others."""

    def interrupted(say: Any) -> dict[str, Any]:
        try:
            os.kill(os.getpid(), signal.SIGINT)
        except KeyboardInterrupt:
            if not swallowed:
                raise
        return {"is": "half of the truth"}

    parts = [part("a", lambda say: {}), part("b", interrupted), part("c", lambda say: {})]
    before = signal.getsignal(signal.SIGINT)
    found = collect(parts, None)
    assert (list(found.contents), found.missing) == ([("scene", "a")], ["scene b", "scene c"])
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.full
def test_command_from_start_to_end(tmp_path: Path) -> None:
    """The command writes the page and exits with 0; a bad name or folder is exit code 2."""
    run = CliRunner().invoke(
        app, ["report", "half_active:n=16", "--out", str(tmp_path / "new" / "r"), "--quick"]
    )
    assert run.exit_code == 0, run.output
    assert (tmp_path / "new" / "r" / "index.html").exists()
    (tmp_path / "file").write_text("", encoding="utf-8")
    for arguments, words in (
        (["half_activ"], "did you mean 'half_active'"),
        (["half_active:n=16", "--out", str(tmp_path / "file")], "--out names a folder"),
    ):
        refused = CliRunner().invoke(app, ["report", *arguments])
        assert refused.exit_code == 2
        assert words in refused.output


@pytest.mark.full
def test_command_takes_files_as_solve_does(tmp_path: Path) -> None:
    """A file and a folder get a section each, with a proved bound."""
    paths = [tmp_path / "own.npz", tmp_path / "folder"]
    for path in paths:
        LCP([[4, -1], [-1, 4]], [-3, 5]).save(path)
    command = ["report", *map(str, paths), "--out", str(tmp_path / "r"), "--quick"]
    run = CliRunner().invoke(app, command)
    assert run.exit_code == 0, run.output
    page = (tmp_path / "r" / "index.html").read_text(encoding="utf-8")
    assert all(f"<h3>{path}</h3>" in page for path in paths)
    assert page.count("axis: rigorous bound") == 2
    for name, words in (("no.npz", "no such file"), ("own", "neither a file nor a scene")):
        refused = CliRunner().invoke(app, ["report", name, "--out", str(tmp_path / "r")])
        assert refused.exit_code == 2
        assert words in refused.output


def test_interruption_between_two_parts_is_remembered() -> None:
    """Ctrl-C while nothing is computed, a second one too."""

    def stop(done: int, total: int, label: str) -> None:
        os.kill(os.getpid(), signal.SIGINT)
        os.kill(os.getpid(), signal.SIGINT)

    assert collect([part("a", lambda say: {}), part("b", lambda say: {})], None, stop).missing == [
        "scene a",
        "scene b",
    ]


def test_interrupted_command_says_what_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After Ctrl-C the page holds what is there and says what is missing; the exit code is 1."""
    from lcp_plugin.evidence.report import page as module

    def stop(*_: Any) -> Any:
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "measured", stop)
    run = CliRunner().invoke(app, ["report", "half_active:n=16", "--out", str(tmp_path), "--quick"])
    assert run.exit_code == 1
    assert "holds 0 of 1 parts" in run.output
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert "1 part is missing (scene half_active:n=16)" in page
