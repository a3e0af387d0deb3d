"""The pages as files: guides, signatures, docstrings, examples with their pictures, what links them, and a search."""

from __future__ import annotations

import ast
import inspect
import json
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from html import unescape
from pathlib import Path
from typing import Any

import pdoc
import pygments
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup
from pdoc.render_helpers import format_signature
from pygments.formatters import HtmlFormatter
from pygments.lexers import PythonLexer

import lcp_plugin

from .contents import (
    EXAMPLES,
    SUBJECTS,
    Example,
    Page,
    examples,
    guides,
    is_function,
    members_of,
    pages,
    subject_of,
    to_look_up,
)
from .docstrings import render, summary

HERE = Path(__file__).parent
CODE = HtmlFormatter(cssclass="pdoc-code", style="default")


class AsWritten(str):
    """An annotation that is shown as its source says it."""

    __repr__ = str.__str__


def written(annotation: Any) -> Any:
    """Return an annotation as the source says it."""
    text = getattr(annotation, "__forward_arg__", annotation)
    return AsWritten(text) if isinstance(text, str) else annotation


def signature(thing: Any) -> Markup:
    """Return how something is called, with the annotations of the source; "" of what is not called."""
    try:
        told = inspect.signature(thing)
    except (TypeError, ValueError):
        return Markup("")
    given = [
        each.replace(annotation=written(each.annotation))
        for each in told.parameters.values()
        if each.name != "self"
    ]
    returned = told.empty if inspect.isclass(thing) else written(told.return_annotation)
    return format_signature(told.replace(parameters=given, return_annotation=returned), colon=False)


def breakable(name: str) -> Markup:
    """Return a long name that a narrow column may break after a dot or an underscore."""
    return Markup(re.sub(r"(?<=[._])", "<wbr>", name))


class Site:
    """All pages, and where each name stands."""

    def __init__(self) -> None:
        self.package, self.pages, self.examples = lcp_plugin, pages(), examples()
        self.guides, self.to_look_up = guides(), to_look_up()
        self.addresses = {
            name: address for page in reversed(self.pages) for name, address in page.anchors()
        }
        self.templates = Environment(
            loader=FileSystemLoader(HERE),
            autoescape=True,
            undefined=StrictUndefined,
            trim_blocks=True,
            lstrip_blocks=True,
        )
        self.templates.filters["breakable"] = breakable
        self.templates.globals.update(
            site=self,
            subjects=SUBJECTS,
            version=lcp_plugin.__version__,
            summary=summary,
            members_of=members_of,
            signature=self.signature,
            isclass=inspect.isclass,
            is_function=is_function,
        )

    def of_subject(self, subject: str) -> list[Page]:
        """Return the pages of a subject, help first."""
        return [page for page in self.pages if subject_of(page.subpackage) == subject]

    def using(self, name: str) -> list[Example]:
        """Return the examples that use a public name, where these are few enough to say something."""
        found = [example for example in self.examples if example.uses(name)]
        return found if len(found) <= 6 else []

    def signature(self, thing: Any, up: str = "") -> Markup:
        """Return a signature in which public classes are links."""

        def linked(found: re.Match[str]) -> str:
            address = self.addresses.get(found[1])
            return (
                f'<span class="n"><a href="{up}{address}">{found[1]}</a></span>'
                if address
                else found[0]
            )

        return Markup(re.sub(r'<span class="n">([A-Z]\w+)</span>', linked, signature(thing)))

    def docstring(self, text: str, scope: str = "", up: str = "") -> Markup:
        """Return a docstring as HTML; names are looked up in its scope first."""

        def links(name: str) -> str | None:
            starts = (
                [scope.rsplit(".", k)[0] + "." for k in range(scope.count(".") + 1)]
                if scope
                else []
            )
            address = next(
                (found for start in [*starts, ""] if (found := self.addresses.get(start + name))),
                None,
            )
            return address and up + address

        return Markup(render(text, links))

    def help(self, thing: Any, scope: str = "") -> Markup:
        """Return what help() tells, without the signature; of a module without the title too."""
        told = inspect.getdoc(thing) or ""
        return self.docstring(told.partition("\n\n")[2] if inspect.ismodule(thing) else told, scope)

    def files(self, folder: Path) -> Iterator[tuple[str, str]]:
        """Yield the name of each file with its text."""
        make = {
            name: self.templates.get_template(f"{name}.html.jinja2").render
            for name in ("start", "guide", "subject", "page", "example", "search")
        }
        yield "index.html", make["start"](up="", subject=None)
        yield "search.html", make["search"](up="", subject=None)
        for k, guide in enumerate(told := self.guides + self.to_look_up):
            yield (
                guide.address,
                make["guide"](
                    up="",
                    subject=None,
                    guide=guide,
                    text=self.docstring(guide.body),
                    following=told[k + 1 : k + 2],
                ),
            )
        for subject in SUBJECTS:
            yield f"subject.{subject}.html", make["subject"](up="", subject=subject)
        for page in self.pages:
            yield page.address, make["page"](up="", subject=subject_of(page.subpackage), page=page)
        for k, example in enumerate(self.examples):
            story, code = told_and_code(example)
            output = (folder / "examples" / f"{example.name}.txt").read_text(encoding="utf-8")
            yield (
                example.address,
                make["example"](
                    up="../",
                    subject=None,
                    example=example,
                    title=summary_of(story),
                    output=output,
                    story=self.docstring(story.partition("\n\n")[2], up="../"),
                    code=code,
                    following=self.examples[(k + 1) % len(self.examples)],
                ),
            )
        style = HERE.joinpath("style.css").read_text(encoding="utf-8")
        yield "style.css", style + CODE.get_style_defs(".pdoc-code") + "\n"


def summary_of(story: str) -> str:
    """Return the title of an example."""
    return story.partition("\n")[0].rstrip(".")


def told_and_code(example: Example) -> tuple[str, Markup]:
    """Return an example's docstring and the code below it."""
    tree = ast.parse(example.source)
    story, end = ast.get_docstring(tree) or "", tree.body[0].end_lineno or 0
    code = "\n".join(example.source.splitlines()[end:]).strip("\n")
    return story, Markup(pygments.highlight(code, PythonLexer(), CODE))


def run_examples(folder: Path) -> Iterator[str]:
    """Draw the pictures that are not there or older than their example, and keep what was printed; yield the names."""
    pictures = folder / "examples"
    pictures.mkdir(parents=True, exist_ok=True)
    for example in examples():
        script, picture = EXAMPLES / f"{example.name}.py", pictures / f"{example.name}.png"
        if picture.exists() and picture.stat().st_mtime > script.stat().st_mtime:
            continue
        yield f"python {script.relative_to(EXAMPLES.parent)}"
        command = [sys.executable, script, "--out", pictures]
        printed = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout
        picture.with_suffix(".txt").write_text(printed, encoding="utf-8")


def document(address: str, page: str) -> dict[str, str]:
    """Return what the search knows of a page: where it is, its title and the words of its main part."""
    main = page.partition("<main>")[2].partition("</main>")[0]
    words = " ".join(
        unescape(
            re.sub(r"<[^>]*>", "", re.sub(r"(?=<(p|h\d|li|td|pre|div|dt|dd)\b)", " ", main))
        ).split()
    )
    title = re.search(r"<title>(.*?) · lcp_plugin</title>", page)
    return {"address": address, "title": unescape(title[1]) if title else address, "text": words}


def write(folder: Path) -> int:
    """Write every page into a folder that holds the pictures, with the search; return how many pages."""
    files = dict(Site().files(folder))
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
    pages = {name: text for name, text in files.items() if name.endswith(".html")}
    searched = [
        document(name, text)
        for name, text in pages.items()
        if name not in ("index.html", "search.html")
    ]
    (folder / "documents.js").write_text(
        f"const DOCUMENTS = {json.dumps(searched)};\n", encoding="utf-8"
    )
    shutil.copy(
        Path(pdoc.__file__).parent / "templates" / "resources" / "elasticlunr.min.js", folder
    )
    shutil.copy(EXAMPLES / "pictures" / "three_problems.png", folder)
    return len(pages)
