"""Linter for plain technical English: a table of phrases, each with a suggestion, counted per file.

    python .ci/plain_english.py [FILE ...]    print the findings (default: README, examples, package, tests)
    python .ci/plain_english.py --write       store the number of findings per file as the new baseline
    python .ci/plain_english.py --check       fail if a file has more findings than its baseline

Checked are Markdown pages and the docstrings, comments and messages of Python files. ``plain: ok`` exempts a line.
"""

from __future__ import annotations

import ast
import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
BASELINE = Path(__file__).with_suffix(".json")
FOLDERS = ("examples", "lcp_plugin", "tests")
MAX_PER_1000_WORDS = 8.0  # in a new file; cvxpy has 2, qpsolvers 3, optimistix 4
MIN_SPACES = 3  # in a string literal; shorter literals are keys and names

START = r"(?:^|(?<=[.:;!?] ))"  # of a sentence
RULES = {  # regular expression: suggestion
    r"\bbeside\b": "relative to (sizes), next to (place), in addition to",
    r"\bown (terms?|sizes?|units?|reference)\b": "componentwise; the row's terms; unscaled",
    r"\b(foreign|own) (rows?|values?|parts?)\b": "ghost, local (MPI)",
    r"\bexcus(e|es|ed|ing)\b|\breckon(s|ed)?\b": "is tolerated; is estimated",
    r"\bblur (of|may|is)\b|\bno more than rounding\b|\bis rounding\b": "rounding error bound; at rounding level",
    r"\bsome (\d[\d ]*|ten|twenty|fifty|hundreds?|thousands?) |\bat the (most|least|best)\b": "about N; at most",
    r"\bfar (out|away)\b": "of large norm, far from the feasible set",
    r"\bunheld\b|\bnothing (seems to )?holds?\b": "has a zero-energy mode, has a recession direction",
    r"\bcases? (that|of (a|the|each|every) (row|point|pair))\b": "active set, complementarity piece",
    r"\bhow wrong\b|\bwrong (in|beside) (its|their)\b|\bleft over\b": "residual, violation, remainder",
    r"\b(leaves?|left) open\b": "leaves undecided, does not solve",
    r"\b(rows?|constraints?|they) contradict\b|\bcontradict (one another|each other)\b": "are inconsistent, infeasible",
    r"\bwithout (an )?end\b|\bendless descent\b|\bfor ever\b": "unbounded below; recession direction; indefinitely",
    r"\bthere is no best\b|\bno minimum\b": "infeasible or unbounded",
    r"\b(goes|go|going|went) on\b|\b(comes?|came|coming) out\b": "continues; results",
    r"\b(says?|said|tells?|told|asks|asked|believe[sd]?|knows|wants|wishes|hears)\b": "returns, reports, requires",
    r"(?<!\.)\bjudg(e|es|ed|ing)\b(?!\.)": "checks, verifies, certifies",  # not the room lcp_plugin.judges
    r"\brefus(e|es|ed|al|als|ing)\b": "rejects; raises (name the exception)",
    r"\bin words\b|\bstory\b": "with an explanatory message; summary",
    r"\b(nobody|somebody|anybody|everybody|whoever)\b": "the user, the caller, another package",
    r"\b(of|by) (others|ours|somebody else)\b|\bother people's\b": "third-party, external, built-in",
    r"\b(stands?|stood)\b(?! for)": "is, is stored, appears",
    r"\bas (it|they) (is|are|was|were|stands?)\b|\bas (given|stated)\b": "unchanged, original",
    r"\b(is|are|was|were|be) made (of|from)\b": "consists of, is computed from",
    r"\bwhole numbers?\b|\bin doubles\b": "integer; in double precision",
    r"\bmend(s|ed|ing)?\b|\bspoil(s|t|ed)?\b|\bdamaged\b": "repair, corrupt, invalid",
    r"\b(caller's|in other|mixed|fitted) units?\b": "scaling; unscaled data",
    r"\bkinds? of problems?\b|\bof (every|each|this|another) kind\b": "problem class, type",
    r"\bworlds?\b|\bscenes?\b": "instance; test problem",
    r"\bbut for\b|\bto be had\b|\bhas its say\b": "except; is available; is used",
    r"\bas a rule\b|\ball the same\b|\bin vain\b|\bonce more\b|\banew\b": "usually, nevertheless, again",
    r", (too|either)[.,;:]|\balone[.,;:]": "also, only (before the verb or noun)",
    r"\b(Return|Yield)s? (what|that|those|them|it|the same|which|how)\b": "Return + noun",
    r"\bwhat(?! (is|are|was|does|do|if)\b)\b|\bwhatever\b": "the noun: the residual, the status",
    r"\b(that|those) (of|by|in|with|without|from)\b": "the noun again",
    rf"{START}(?-i:Of) (?!course)": "subject first: For an LCP, ...",
    rf"{START}(?-i:Where) (?!\w+ (is|denotes))|\b(None|True|False|NaN|SOLVED|nothing|only) where\b": "if, when",
    r"\b(one|two|three|rows?|ms|columns?) an? (contact|row|step|rank|node|problem|column|body)\b": "one X per Y",
    r"\b(is|are|was|were) no (?!longer|more|less|larger|smaller|better|worse)": "is not a",
    r"\b\w+([mt]is|lis|ris)(ed|es?|ing|ation)\b(?<!wise)(?<!rise)(?<!promise)|\bneighbour": "-ize; neighbor (American)",
}
PATTERNS = {re.compile(rule, re.M | re.I): hint for rule, hint in RULES.items()}
COMMENT = re.compile(r"(?:^ *|  )#:? (.+)")
CODE_SPAN = re.compile(r"``[^`]*``|`[^`\n]*`|\]\([^)]*\)")


def read_markdown(source: str) -> Iterator[tuple[int, str]]:
    """Yield (line number, text) of the prose of a page; blank for code."""
    is_code = False
    for number, line in enumerate(source.splitlines(), 1):
        is_code ^= line.lstrip().startswith("```")
        yield number, "" if is_code or line.startswith(("    ", "```")) else line


def read_docstring(text: str, first: int) -> Iterator[tuple[int, str]]:
    """Yield (line number, text) of a docstring; blank for doctests and literal blocks."""
    indent_of_code: int | None = None
    is_example = False
    for number, line in enumerate(text.splitlines(), first):
        indent, stripped = len(line) - len(line.lstrip()), line.strip()
        is_example = bool(stripped) and (is_example or stripped.startswith(">>>"))
        if stripped and indent_of_code is not None and indent <= indent_of_code:
            indent_of_code = None
        yield number, "" if is_example or indent_of_code is not None else line
        if stripped.endswith("::"):
            indent_of_code = indent


def read_python(source: str) -> Iterator[tuple[int, str]]:
    """Yield (line number, text) of docstrings, one-line messages and comments, separated by blanks."""
    docstrings = set()
    for node in ast.walk(ast.parse(source)):  # parents first
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            docstrings.add(node.value)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            if node in docstrings:
                yield from read_docstring(node.value, node.lineno)
            elif node.value.count(" ") >= MIN_SPACES and "\n" not in node.value:
                yield node.lineno, node.value
            yield 0, ""
    for number, line in enumerate(source.splitlines(), 1):
        if comment := COMMENT.search(line):
            yield from ((number, comment[1]), (0, ""))


def check_file(path: Path) -> tuple[list[str], int]:
    """Return the findings in a file, as ``line: text -> suggestion``, and the number of words of prose."""
    source = path.read_text(encoding="utf-8")
    exempt = {k for k, line in enumerate(source.splitlines(), 1) if "plain: ok" in line}
    numbered = [(0, ""), *(read_python if path.suffix == ".py" else read_markdown)(source)]
    lines = ["" if k in exempt else CODE_SPAN.sub("`x`", line).strip() for k, line in numbered]
    text = "\n".join(lines)
    prose = re.sub(r"(?<=.)\n(?=.)", " ", text)  # a paragraph becomes one line of the same length
    found = [
        f"{numbered[text.count(chr(10), 0, match.start())][0]}: {match[0].strip()} -> {hint}"
        for pattern, hint in PATTERNS.items()
        for match in pattern.finditer(prose)
    ]
    return found, len(re.findall(r"[A-Za-z][A-Za-z']+", prose))


def list_files(*folders: str) -> list[Path]:
    """Return README and all checked files of the folders, without this one."""
    names = folders or FOLDERS
    files = [ROOT / "README.md", *(file for name in names for file in (ROOT / name).rglob("*"))]
    return sorted(
        file for file in files if file.suffix in (".py", ".md") and file.stem != BASELINE.stem
    )


def main(arguments: list[str]) -> None:
    """Print the findings in files, or write the baseline."""
    if arguments == ["--write"]:
        counts = {str(file.relative_to(ROOT)): len(check_file(file)[0]) for file in list_files()}
        BASELINE.write_text(json.dumps(counts, indent=0) + "\n", encoding="utf-8")
        return
    if arguments == ["--check"]:
        baseline, worse = json.loads(BASELINE.read_text(encoding="utf-8")), []
        for file in list_files("lcp_plugin", "examples"):
            (found, words), name = check_file(file), file.relative_to(ROOT).as_posix()
            limit = baseline.get(name, int(MAX_PER_1000_WORDS * words / 1000))
            if len(found) > limit:
                worse.append(f"{name}: {len(found)} findings, at most {limit}")
        sys.exit("\n".join(worse) or 0)
    for file in map(Path, arguments) if arguments else list_files():
        print(*(f"{file}:{finding}\n" for finding in check_file(file)[0]), sep="", end="")


if __name__ == "__main__":
    main(sys.argv[1:])
