"""Sphinx configuration of the manual: ``python -m sphinx -W -c examples/manual examples FOLDER`` builds the site.

The pages are the Markdown files of ``examples``, and the reference is read from the docstrings. Formulas are Unicode,
so that the site needs no network.
"""

import posixpath
import re
from pathlib import Path

from docutils import nodes
from sphinx import addnodes

import lcp_plugin

project = "lcp_plugin"
author = "The lcp_plugin authors"
version = release = lcp_plugin.__version__
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
]
root_doc = "index"
exclude_patterns = ["notebooks"]
myst_heading_anchors = 3
myst_enable_extensions = ["html_image"]
autodoc_typehints = "none"  # numpydoc has the types, with shapes
autodoc_member_order = "bysource"
napoleon_use_param = False  # types are prose: "shape (n,)" is not a link
napoleon_use_ivar = True
napoleon_use_rtype = False
python_use_unqualified_type_names = True
suppress_warnings = ["ref.python"]  # the type "n" in a docstring is the attribute of two classes
html_theme = "alabaster"
html_show_copyright = False
html_title = f"lcp_plugin {release}"
html_copy_source = html_show_sourcelink = False
html_static_path, templates_path = ["static"], ["templates"]
html_scaled_image_link = False  # a figure leads to its script
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True
html_css_files = ["site.css"]
html_theme_options = {
    "description": "Complementarity problems in Python and cvxpy",
    "fixed_sidebar": True,
    "page_width": "940px",
    "sidebar_width": "250px",
    "show_powered_by": False,
    "show_relbar_bottom": True,
    "font_family": "system-ui, -apple-system, 'Segoe UI', sans-serif",
    "head_font_family": "system-ui, -apple-system, 'Segoe UI', sans-serif",
}

CODE_SPAN = re.compile(r"(``.+?``|`[^`]+`)")


def escape_bars(line: str) -> str:
    """Return a line of a docstring in which bars outside code are escaped."""
    parts = CODE_SPAN.split(line)
    return "".join(part if k % 2 else part.replace("|", "\\|") for k, part in enumerate(parts))


def repair_docstring(app, what, name, thing, options, lines: list[str]) -> None:
    """Turn Markdown tables of a docstring into list tables, and |x| into text; in place."""
    repaired: list[str] = []
    table: list[list[str]] = []
    block: int | None = None  # indentation of the line that a literal block follows
    for line in [*lines, ""]:
        stripped, indent = line.strip(), len(line) - len(line.lstrip())
        block = None if stripped and block is not None and indent <= block else block
        if stripped.startswith("|") and stripped.endswith("|") and len(stripped) > 1:
            cells = [cell.strip() for cell in re.split(r"(?<!\\)\|", stripped)[1:-1]]
            if not all(set(cell) <= set("-: ") for cell in cells):
                table.append(cells)
            continue
        if table:
            repaired += ["", ".. list-table::", "   :header-rows: 1", ""]
            for row in table:
                texts = [escape_bars(cell.replace("\\|", "|")) for cell in row]
                repaired += [
                    f"   {'* -' if k == 0 else '  -'} {text}" for k, text in enumerate(texts)
                ]
            repaired.append("")
            table = []
        is_code = block is not None or stripped.startswith((">>>", "..."))
        repaired.append(line if is_code else escape_bars(line))
        block = indent if stripped.endswith("::") and block is None else block
    lines[:] = repaired


def split_table(app, docname: str, source: list[str]) -> None:
    """Turn each row of the wide table of algorithms into a short section, in place."""
    head = "| name | algorithm |"
    if head not in source[0]:
        return
    before, table = source[0].split(head)
    table, after = table.split("\n\n", 1)
    sections = []
    for row in table.splitlines()[2:]:
        name, title, update, needs, proved, options = row[2:-2].split(" | ")
        facts = {"Needs": needs, "Proved to converge on": proved, "Options": options}
        lines = [f"- {key}: {fact}" for key, fact in facts.items() if fact.strip("|– ")]
        sections.append("\n".join([f"### {name}: {title}", "", f"    {update}", "", *lines, ""]))
    source[0] = before + "\n".join(sections) + "\n" + after


def expand_names(app, docname: str, source: list[str]) -> None:
    """Turn each block ``{names}`` of the reference into one directive per name, in place."""

    def expand(block: re.Match[str]) -> str:
        (kind, *options), names = block[1].split(), block[2].split()
        texts = []
        for name in names:
            directive = "automodule" if kind == "topic" else kind
            flags = (
                ["no-members", *["no-index"] * (name != "lcp_plugin")]
                if kind == "topic"
                else options
            )
            lines = [
                "```{eval-rst}",
                ".. currentmodule:: lcp_plugin",
                "",
                f".. {directive}:: {name}",
            ]
            title = f"### {name}\n\n" if kind == "topic" else ""
            texts.append(
                "\n".join(
                    [title + lines[0], *lines[1:], *(f"   :{flag}:" for flag in flags), "```"]
                )
            )
        return "\n\n".join(texts)

    source[0] = re.sub(r"^```\{names\} (.*)\n([^`]*)```", expand, source[0], flags=re.M)


def link_scripts(app, tree) -> None:
    """Turn links to Python scripts into links to their pages, in place."""
    here = posixpath.dirname(app.env.current_document.docname)
    for link in list(tree.findall(addnodes.download_reference)):
        script = posixpath.normpath(posixpath.join(here, link["reftarget"]))
        if script.endswith(".py") and "/" not in script:
            uri = posixpath.relpath(f"scripts/{script.removesuffix('.py')}.html", here or ".")
            link.replace_self(nodes.reference("", "", *link.children, refuri=uri))


def collect_scripts(app):
    """Yield a page with the highlighted code of each script."""
    for file in sorted(Path(app.srcdir).glob("*.py")):
        code = app.builder.highlighter.highlight_block(file.read_text("utf-8"), "python")
        body = f"<h1>{file.name}</h1>{code}"
        yield f"scripts/{file.stem}", {"title": file.name, "body": body}, "page.html"


def setup(app) -> None:
    """Register the repair of docstrings, the sections of algorithms and names, and the pages of scripts."""
    app.connect("autodoc-process-docstring", repair_docstring, priority=900)
    app.connect("source-read", split_table)
    app.connect("source-read", expand_names)
    app.connect("doctree-read", link_scripts)
    app.connect("html-collect-pages", collect_scripts)
