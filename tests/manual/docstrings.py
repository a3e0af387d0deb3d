"""A docstring as HTML: numpydoc by pdoc, formulas as MathML, names and ``help("…")`` as links."""

from __future__ import annotations

import ast
import inspect
import re
from collections.abc import Callable
from html import escape, unescape
from textwrap import dedent

from pdoc import docstrings
from pdoc.render_helpers import to_html

from .formulas import mathml, set_formulas

Links = Callable[[str], str | None]  # name → address, None where it has no page
OF_ENTRIES = ("Parameters", "Returns", "Yields", "Raises", "Warns", "Attributes")
CODE = re.compile(r"(^ *```.*?^ *```$|^ *>>> .*?(?=\n *\n|\Z)|``.+?``|`[^`\n]+`)", re.S | re.M)
IN_HTML = re.compile(r"(<pre.*?</pre>|<a .*?</a>)|<code>(.*?)</code>", re.S)


def summary(thing: object, paragraph: int = 0) -> str:
    """Return the first sentence of a docstring's paragraph, without a full stop."""
    told = (inspect.getdoc(thing) or "").split("\n\n")[paragraph]
    return re.split(r"(?<=[^.])\.(?:\s|$)", told)[0].replace("\n", " ")


def fenced(block: str) -> str:
    """Return an indented block that "::" announces as fenced code, Python if it is that."""
    code = dedent(block).strip("\n")
    try:
        ast.parse(code)
        language = "python"
    except SyntaxError:
        language = "toml" if code.startswith("[") else "bash"
    return f"\n```{language}\n{code}\n```\n"


def displayed(block: str) -> str:
    """Return an indented block of formulas, a line each."""
    return "\n" + "\n".join(f"\ue002{line.strip()}\n" for line in block.strip("\n").splitlines())


def with_blocks(text: str) -> str:
    """Replace the indented blocks of a text that is not a list of entries."""

    def replaced(found: re.Match[str]) -> str:
        is_code = found["before"].endswith("::")
        before = found["before"].removesuffix(":") if is_code else found["before"]
        return before + "\n" + (fenced if is_code else displayed)(found["block"])

    return re.sub(
        r"(?P<before>^(?![-*] | ).*)\n\n(?P<block>(?: {4}.*\n?|\n(?= {4}))+)",
        replaced,
        text,
        flags=re.M,
    )


def to_markdown(text: str) -> str:
    """Return a numpydoc docstring as Markdown."""
    text = re.sub(r":\w+:`~?\.?([^`]+)`", r"`\1`", text)
    parts = re.split(r"^(\w[\w ]*)\n-{3,}\n", text, flags=re.M)
    out = with_blocks(parts[0])
    for title, content in zip(parts[1::2], parts[2::2], strict=True):
        out += f"{title}\n{'-' * len(title)}\n{content if title in OF_ENTRIES else with_blocks(content)}"
    return re.sub(
        r"^( - .*\)):\n\s*\n", r"\1\n", docstrings.convert(out, "numpy", None), flags=re.M
    )


def render(text: str, links: Links) -> str:
    """Return a docstring as HTML."""
    kept: list[str] = []

    def keep(markup: str) -> str:
        kept.append(markup)
        return f"\ue000{len(kept) - 1}\ue001"

    def cited(found: re.Match[str]) -> str:
        number = found[2].rstrip(".,;)")
        site = "https://doi.org/" if found[1] == "doi" else "https://arxiv.org/abs/"
        return (
            keep(f'<a href="{site}{number}">{escape(found[1])}:{escape(number)}</a>')
            + found[2][len(number) :]
        )

    def formulas(words: str) -> str:
        words = re.sub(r"\b(doi|arXiv):(\S+)", cited, words)
        return set_formulas(words, lambda formula: keep(mathml(formula)))

    def linked(found: re.Match[str]) -> str:
        if found[2] is None:
            return found[0]
        name = unescape(found[2])
        page = re.fullmatch(r'help\("?([\w.]+)"?\)', name)
        address = links(page[1] if page else name.removesuffix("()"))
        if page and address is None:
            raise ValueError(f"{name} is told to be a page, and is none")
        return f'<a href="{address}">{found[0]}</a>' if address else found[0]

    pieces = CODE.split(to_markdown(text))
    pieces[::2] = map(formulas, pieces[::2])
    html = IN_HTML.sub(linked, str(to_html("".join(pieces))))
    html = re.sub(r'<(h\d) id="[^"]*"', r"<\1", html)  # "Parameters" is a heading of many
    html = html.replace("<p>\ue002", '<p class="display">')
    while "\ue000" in html:
        html = re.sub("\ue000(\\d+)\ue001", lambda found: kept[int(found[1])], html)
    return html
