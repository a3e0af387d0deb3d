"""Sphinx configuration of the manual: ``python -m sphinx -W -c examples/manual examples FOLDER`` builds the site.

The pages are the Markdown files of ``examples``, and the reference is read from the docstrings. Formulas are Unicode,
so that the site needs no network.
"""

import re

import lcp_plugin

project = "lcp_plugin"
author = "The lcp_plugin authors"
version = release = lcp_plugin.__version__
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
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
html_static_path = ["static"]
html_css_files = ["site.css"]
html_theme_options = {
    "description": "Complementarity problems in Python and cvxpy",
    "fixed_sidebar": True,
    "page_width": "940px",
    "sidebar_width": "250px",
    "show_powered_by": False,
    "show_relbars": False,
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


def setup(app) -> None:
    """Register the repair of docstrings."""
    app.connect("autodoc-process-docstring", repair_docstring, priority=900)
