"""Linear and convex quadratic programs of MPS and QPS files, in free or in fixed format."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

from ..core.errors import InvalidProblem

Lines = list[list[str]]  # the words of each line
Entries = dict[tuple[int, int], float]
Read = tuple[float, list[str], list[str], Any]
WITH_WORDS = ("NAME", "OBJSENSE", "QSECTION")  # headers that other words may follow
SECTIONS = (*WITH_WORDS, "ROWS", "COLUMNS", "RHS", "RANGES", "BOUNDS", "QUADOBJ", "QMATRIX")
FIELDS = ((1, 3), (4, 12), (14, 22), (24, 36), (39, 47), (49, 61))
MARKED = "columns between markers of integers"
INTEGER = ("BV", "LI", "UI", "SC")
BOUNDS = ("LO", "UP", "FX", "FR", "MI", "PL", *INTEGER)


class Names(dict[str, int]):
    """Numbers of the rows or of the columns by their names."""

    def __init__(self, section: str, names: Iterable[str], remarks: list[str]) -> None:
        self.section, self.remarks = section, remarks
        for name in names:
            if name in self:
                raise InvalidProblem(
                    f"{name} in {section} is stated twice; rename one, or join them"
                )
            self[name] = len(self)

    def find(self, name: str, section: str, words: list[str]) -> int:
        """Return the number of a name in a line of a section; an unknown column is new, without coefficients."""
        if name not in self:
            fault = f'{name} of the line "{" ".join(words)}" in {section} is not in {self.section}'
            if self.section == "ROWS":
                raise InvalidProblem(fault)
            self.remarks.append(f"{fault}; it is a new variable")
            self[name] = len(self)
        return self[name]


def read_mps(source: Path, remarks: list[str]) -> Read:
    """Return −1 if the file maximizes, else 1; names of variables, of integers; the arguments of `from_ranges`.

    Parameters
    ----------
    source : Path
    remarks : list of str
        Remarks for the user are appended.

    Raises
    ------
    InvalidProblem, ValueError
        If the file states no program.
    """
    lines = source.read_bytes().decode("utf-8", "replace").splitlines()
    sections = _sections(lines, str.split)
    has_blanks = any(len(words) != 2 for words in sections["ROWS"])
    if has_blanks or any(len(words) % 2 == 0 for words in sections["COLUMNS"]):  # fixed format
        fields = [slice(*places) for places in FIELDS]
        sections = _sections(
            lines, lambda line: [*filter(None, (line[one].strip() for one in fields))]
        )
    sense = [words[-1].upper()[:3] for words in sections["OBJSENSE"]] or ["MIN"]
    kinds = np.array([words[0].upper() for words in sections["ROWS"]], dtype=np.str_)
    if strange := {*kinds.tolist()} - {*"NLGE"} or {*sense} - {"MIN", "MAX"}:
        raise InvalidProblem(f"{strange.pop()} is not a row N, L, G, E or a sense MIN, MAX")
    rows = Names("ROWS", (words[-1] for words in sections["ROWS"]), remarks)
    names = (name for name, _ in groupby(words[0] for words in sections["COLUMNS"]))
    columns, integers = Names("COLUMNS", names, remarks), [words[0] for words in sections[MARKED]]
    entries = _entries(sections, "COLUMNS", rows, columns)
    right, ranges = (_entries(sections, section, rows) for section in ("RHS", "RANGES"))
    lower, upper = _bounds(sections["BOUNDS"], columns, integers)
    products = [_entries(sections, name, columns, columns) for name in ("QUADOBJ", "QMATRIX")]
    n, m, sign = len(columns), len(rows), -1.0 if sense[-1] == "MAX" else 1.0
    A = _matrix(entries, (n, m)).T.tocsr()
    triangle, whole = (_matrix(one, (n, n)) for one in products)
    P = sign * (triangle + triangle.T - sp.diags_array(triangle.diagonal()) + whole)
    b, width = _row(right, 0.0, m), _row(ranges, np.nan, m)
    reach = np.where(np.isnan(width), np.inf, np.abs(width))
    low = np.where((kinds == "L") | ((kinds == "E") & (width < 0.0)), b - reach, b)
    high = np.where((kinds == "G") | ((kinds == "E") & (width > 0.0)), b + reach, b)
    first, is_row = np.flatnonzero(kinds == "N")[:1], kinds != "N"
    limits = low[is_row], high[is_row], _row(lower, 0.0, n), _row(upper, np.inf, n)
    c, constant = sign * A[first].sum(axis=0), 0.0 - sign * b[first].sum()
    return sign, [*columns], [*dict.fromkeys(integers)], (P, c, A[is_row], *limits, constant)


def _sections(lines: list[str], split: Callable[[str], list[str]]) -> dict[str, Lines]:
    """Return the lines of each section, without comments."""
    found: dict[str, Lines] = {name: [] for name in (*SECTIONS, MARKED)}
    section, known = "NAME", set[str]()  # other words that begin with $ are comments
    for line in lines:
        is_header = not line[:1].isspace()
        words = line.split() if is_header else split(line)
        if "$" in line:
            known |= {"ROWS": {*words[1:2]}, "COLUMNS": {*words[:1]}}.get(section, set())
            ends = (k for k, word in enumerate(words) if word[0] == "$" and word not in known)
            words = words[: next(ends, None)]
        if not words or words[0][0] == "*":
            continue
        name = words[0].upper().rstrip(":")
        if words[1:2] == ["'MARKER'"]:
            section = MARKED if words[-1] == "'INTORG'" else "COLUMNS"
        elif not is_header or not (len(words) == 1 or name in WITH_WORDS):
            found[section].append(words)
        elif name == "ENDATA":
            return found
        elif name[:3] in ("MAX", "MIN"):
            found["OBJSENSE"].append(words)
        elif name not in SECTIONS:
            raise InvalidProblem(f"{words[0]} is not one of the sections {', '.join(SECTIONS)}")
        else:
            section = "QUADOBJ" if name == "QSECTION" else name
            found["OBJSENSE"] += [words] if name == "OBJSENSE" and words[1:] else []
    raise InvalidProblem("it has no line ENDATA: is it complete?")


def _entries(
    sections: dict[str, Lines], section: str, names: Names, columns: Names | None = None
) -> Entries:
    """Return the values by the number of a line's column, 0 if there is none, and of the name before the value."""
    found: Entries = {}
    kept, repeated = "first" if columns is not names else "sum", ""
    for words in sections[section]:
        start = len(words) % 2 if columns is None else 1
        i = 0 if columns is None else columns.find(words[0], section, words)
        for name, text in zip(words[start::2], words[start + 1 :: 2], strict=True):
            j = names[name] if name in names else names.find(name, section, words)
            key, value = (i, j), float(text)
            key = (max(key), min(key)) if section == "QUADOBJ" else key
            if key in found:
                repeated = repeated or " ".join(sorted([name, *words[: columns is not None]]))
                value = found[key] + value if kept == "sum" else found[key]
            found[key] = value
    if repeated:
        names.remarks.append(f"repeated entry of {repeated} in {section}; the {kept} holds")
    return found


def _bounds(lines: Lines, columns: Names, integers: list[str]) -> tuple[Entries, Entries]:
    """Return the lower and upper bounds; of several for one variable the last one holds.

    The lower bound is −∞ for a negative upper bound without a lower one.
    """
    lower, upper = Entries(), Entries()
    for words in lines:
        kind, value = words[0].upper(), np.inf
        if kind not in BOUNDS or len(words) < 2:
            fault = f'"{" ".join(words)}" in BOUNDS begins with none of {", ".join(BOUNDS)}'
            raise InvalidProblem(fault)
        if kind in ("FR", "MI", "PL", "BV"):  # perhaps with a number
            name = next((word for word in words[:0:-1] if word in columns), words[-1])
        else:
            name, value = words[:4][-2], float(words[:4][-1])
        key = 0, columns.find(name, "BOUNDS", words)
        if kind in INTEGER:
            integers.append(name)
        if kind not in ("UP", "PL"):
            lower[key] = value if kind in ("LO", "FX") else -np.inf
        if kind not in ("LO", "MI"):
            upper[key] = value
    for _, j in sorted(key for key in upper if upper[key] < 0.0 and key not in lower):
        lower[0, j] = -np.inf
        columns.remarks.append(
            f"{list(columns)[j]} has the upper bound {upper[0, j]:g} and no lower bound; it is −∞, as in other readers "
            "of MPS files: write MI for −∞, or LO"
        )
    return lower, upper


def _matrix(entries: Entries, shape: tuple[int, int]) -> sp.csr_array:
    places = np.array(list(entries), dtype=np.int64).reshape(-1, 2).T
    return sp.csr_array((list(entries.values()), tuple(places)), shape=shape)


def _row(entries: Entries, default: float, size: int) -> Any:
    values = np.full(size, default)
    values[[j for _, j in entries]] = list(entries.values())
    return values
