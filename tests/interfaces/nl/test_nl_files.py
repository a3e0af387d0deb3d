""".nl files: text and binary round trips, and errors with line or byte for corrupt files."""

from __future__ import annotations

import re
import struct
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp
from binary_nl import write_form
from hypothesis import given
from hypothesis import strategies as st
from oracles.relations import bits
from random_nl import difference, mutilated, random_content
from tools.nl_files import content_of_rows, read_sol

from lcp_plugin import LCP, NonlinearProblem
from lcp_plugin.core import errors
from lcp_plugin.interfaces.nl import read_content, write_nl, write_sol
from lcp_plugin.interfaces.nl.reading import number_tree

FORMS = {"text": {}, "little": {"binary": True}, "big": {"binary": True, "big_endian": True}}
SMALL = b"""g3 1 1 0	# two variables, x0 + exp(x1) - 2 complementary to x0 >= 0, x0 x1 = 1
 2 2 0 0 1 0
 2 0 0 1 0 0
 0 0
 2 0 0
 0 0 0 1
 0 0 0 0 0
 4 0
 0 0
 0 1 0 0 0
V2 1 0	#e
0 -1.5
o44	# exp
v1
C0	#row
o0	#+
v2
n-2
C1
o2
v0
v1
x1	# start
1 0.5
r
5 1 1
4 1.0
b
2 0
3
k1
2
J0 2
0 1
1 0
J1 2
0 0
1 0
"""


def read(folder: Path, data: bytes) -> object:
    (folder / "m.nl").write_bytes(data)
    return read_content(folder / "m.nl")


@given(st.integers(0, 2**32))
def test_what_is_written_is_read_bit_for_bit(tmp_path, seed):
    """Text and both binary orders return the arrays that were written."""
    content = random_content(np.random.default_rng(seed))
    for form in FORMS.values():
        write_form(content, tmp_path / "m.nl", **form)
        assert difference(content, read_content(tmp_path / "m.nl")) == ""


def test_a_small_file_says_what_it_says(tmp_path):
    """Bounds, partners, linear terms, expressions and the start are read from their segments."""
    content = read(tmp_path, SMALL)
    assert content.lower.tolist() == [0, -np.inf]
    assert (content.partners.tolist(), content.partner_bounds.tolist()) == ([0, -1], [1, 0])
    assert content.row_lower.tolist() == [-np.inf, 1]
    assert content.linear.toarray().tolist() == [[1, 0], [0, 0]]
    assert content.defined_linear.toarray().tolist() == [[-1.5, 0, 0]]
    assert content.trees[0] == [("o", 0, 2), ("v", 2, 0), ("n", -2.0, 0)]
    assert content.trees[1] == [("o", 2, 2), ("v", 0, 0), ("v", 1, 0)]
    assert (content.start.tolist(), content.has_start.tolist()) == ([0, 0.5], [False, True])
    assert content.options == (3, 1, 1, 0)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (b" 2 2 0 0 1 0", b" 2 2 0 0 1 2", "2 logical constraints"),
        (b"C1\no2", b"F0 1 -1 gsl\nC1\no2", "calls external functions"),
    ],
)
def test_logical_rows_and_external_functions_are_refused(tmp_path, old, new, words):
    """A file with logical constraints or external functions raises an error that names them."""
    assert SMALL.count(old) == 1
    with pytest.raises(errors.UnsupportedModel, match=words):
        read(tmp_path, SMALL.replace(old, new))


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        (b"g3 1 1 0", b"q3 1 1 0", 1, "begins with g"),
        (b" 2 2 0 0 1 0", b" 999999999999 2 0 0 1 0", 2, "bytes follow"),
        (b" 2 0 0 1 0 0", b" 2 0 0 2 0 0", 3, "complementarity rows"),
        (b"V2 1 0", b"V2 9 0", 13, "neither a number"),
        (b"0 -1.5", b"2 -1.5", 12, "one of 2"),
        (b"0 -1.5", b"0 -1_5", 12, "neither a number"),
        (b"0 -1.5", "0 \u0661".encode(), 12, "neither a number"),
        (b"g3 1 1 0", b"g3 1 1_0 0", 1, "integers"),
        (b"o44", b"o99", 13, "operator number is unknown"),
        (b"C1\no2", b"C7\no2", 19, "one of 2"),
        (b"5 1 1", b"5 1 3", 26, "from 1 to 2"),
        (b"2 0\n3\n", b"2 0\n", 30, "kind is 0 to 5"),
        (b"J1 2", b"J0 1", 38, "no segment begins"),
        (b"J0 2\n0 1", b"J0 2\n1 1", 8, "an index occurs twice in a row in the segments J"),
        (b"J0 2\n0 1", b"J0 2\n0 inf", 34, "finite"),
        (b"o2\nv0", b"o2\n\x01", 21, "neither a number"),
    ],
)
def test_a_wrong_line_is_named(tmp_path, old, new, line, words):
    """A line inconsistent with the format or other lines raises an error with its number."""
    assert SMALL.count(old) == 1
    with pytest.raises(errors.UnreadableFile, match=rf"line {line} \(.*\): .*{words}"):
        read(tmp_path, SMALL.replace(old, new))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b"\n", b"\r\n"), (b"\t#", b" # a # b"), (b"k1\n2", b"K1\n2"), (b"k1\n2\n", b""),
        (b"J1 2\n0 0\n1 0\n", b"J1 2\n0 0\n1 0\n\n \n"), (b"1 0\nJ1 2\n0 0\n1 0\n", b"1 0\nJ1 2\n0 0\n1 0"),
        (b" 2 2 0 0 1 0\n 2 0 0 1 0 0", b" 2 2 0 0 1\n 2 0 0 1"), (b"J0 2\n0 1\n1 0", b"J0 2\n1 0\n0 1.0e+00"),
        (b"n-2", b"l-2"), (b"x1\t", b"d1\n1 3.5\nx1\t"), (b"V2 1 0", b"S4 1 scaling\n0 nan\nS0 1 kind\n1 2.5\nV2 1 0"),
    ],
    ids=["CRLF", "comments", "K", "no k", "blank end", "no last newline", "short head", "order", "long", "d", "S"],
)  # fmt: skip
def test_what_writers_differ_in_says_the_same(tmp_path, old, new):
    """Line ends, comments, missing counts, the order of entries and suffixes change nothing."""
    assert old in SMALL
    content, plain = read(tmp_path, SMALL.replace(old, new)), read(tmp_path, SMALL)
    assert difference(content, plain) == ""


def test_suffixes_of_binary_files_are_passed_over(tmp_path):
    """Integers take four bytes, floats eight, and the segments after suffixes are read."""
    plain = read(tmp_path, SMALL)
    write_form(plain, tmp_path / "m.nl", binary=True)
    data, name = (tmp_path / "m.nl").read_bytes(), struct.pack("<i", 4) + b"kind"
    whole = b"S" + struct.pack("<ii", 0, 1) + name + struct.pack("<ii", 1, 3)
    real = b"S" + struct.pack("<ii", 4, 1) + name + struct.pack("<id", 1, 2.5)
    at = data.index(b"V" + struct.pack("<i", 2))
    assert difference(read(tmp_path, data[:at] + whole + real + data[at:]), plain) == ""


def test_names_are_read_where_the_head_announces_them(tmp_path):
    """Names come from .col and .row; where none are announced or some are missing, such files are left alone."""
    (tmp_path / "m.col").write_text("price\nquantity [a b]\n")
    (tmp_path / "m.row").write_text("balance\nproduct\nan objective\n")
    named = SMALL.replace(b" 4 0\n 0 0\n", b" 4 0\n 7 14\n")
    content = read(tmp_path, named)
    assert (content.names, content.row_names) == (
        ["price", "quantity [a b]"],
        ["balance", "product"],
    )
    assert read(tmp_path, SMALL).names is None
    (tmp_path / "m.col").write_text("price\n")
    assert read(tmp_path, named).names is None


def test_the_ending_may_be_left_out(tmp_path):
    """A stub is read as AMPL reads it; a file that is not there is named with its ending."""
    read(tmp_path, SMALL)
    assert read_content(tmp_path / "m").lower.size == 2
    with pytest.raises(errors.UnreadableFile, match=r"no such file: .*other\.nl"):
        read_content(tmp_path / "other")


@pytest.mark.quick(7)
@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("seed", range(170))
def test_a_mutilated_file_is_refused_with_its_place_or_valid(tmp_path, form, seed):
    """A corrupt file gives a content, or an UnreadableFile that names line or byte."""
    rng = np.random.default_rng([seed, len(form)])
    write_form(random_content(rng, 30), tmp_path / "m.nl", **FORMS[form])
    require_refused_or_valid(tmp_path, mutilated((tmp_path / "m.nl").read_bytes(), rng))


def require_refused_or_valid(folder: Path, data: bytes) -> None:
    """Read data within ten times its size and the memory for an empty file."""
    message = ""
    tracemalloc.start()
    try:
        read(folder, data)
    except errors.UnreadableFile as error:
        message = str(error)
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert not message or re.search(r"(line \d+ \(.*\)|byte \d+): ", message)
    assert peak <= 10 * len(data) + 300_000


@pytest.mark.full
@pytest.mark.parametrize(
    ("form", "end"), [("text", b"n1.0\n"), ("little", b"n" + struct.pack("<d", 1.0))]
)
def test_depth_costs_nothing(tmp_path, form, end):
    """A tree of 10⁵ levels is read, or raises an error if its end is missing, without recursion."""
    levels = 100_000
    trees = [number_tree(0.0), [("o", 16, 1)] * levels + number_tree(1.0)]
    write_form(replace(read(tmp_path, SMALL), trees=trees), tmp_path / "m.nl", **FORMS[form])
    data = (tmp_path / "m.nl").read_bytes()
    assert read(tmp_path, data).trees == trees
    with pytest.raises(
        errors.UnreadableFile, match=r"ends within a segment|part of an expression is needed"
    ):
        read(tmp_path, data.replace(end, b""))


@pytest.mark.parametrize(
    "old", [b" 2 2 0", b"V2 1", b"x1", b"k1", b"J1 2", b"o0\t#+\nv2", b" 0 1 0 0 0"]
)
def test_huge_counts_allocate_nothing(tmp_path, old):
    """A count larger than the file raises an error before memory of this size is allocated."""
    for count in (b"999999999999", b"9" * 30, b"1e12"):
        new = {
            b"V2 1": b"V2 " + count,
            b"J1 2": b"J1 " + count,
            b"o0\t#+\nv2": b"o54\n" + count + b"\nv2",
        }.get(old, re.sub(rb"\d", count, old, count=1))
        with pytest.raises(errors.UnreadableFile):
            require_refused_or_valid(tmp_path, SMALL.replace(old, new)) or read(
                tmp_path, SMALL.replace(old, new)
            )


@pytest.mark.parametrize("options", [(3, 1, 1, 0), (5, 0, 1, 0, 7, 2021), (3, 1, 3, 0)])
@pytest.mark.parametrize("has_values", [True, False])
def test_answers_are_read_by_ourselves_and_by_both_readers_of_pyomo(tmp_path, options, has_values):
    """Message, values, multipliers and code are read, with and without values, for all options."""
    x, y = (np.array([1.5, -1e-7, 0.1]), np.array([0.0, 1e300])) if has_values else (None, None)
    path, message = tmp_path / "m.sol", "lcp_plugin: solved\n\nOptions in a message\nresidual 1e-9"
    content = content_of_rows(
        np.zeros(3), np.ones(3), sp.csr_array((2, 3)), [number_tree(0.0)] * 2, (np.zeros(2), np.ones(2)),
        np.full(2, -1), np.zeros(2, dtype=np.int64),
    )  # fmt: skip
    tolerance = 0.5 if options[2] == 3 else None
    write_sol(path, replace(content, options=options, tolerance=tolerance), message, x, y, 200)
    found = read_sol(path)
    assert (found.options, found.code, found.rows, found.variables) == (options, 200, 2, 3)
    assert found.message.startswith("lcp_plugin: solved\n- Options")
    assert found.tolerance == (0.5 if options[2] == 3 else None)
    for values, wanted in ((found.values, x), (found.duals, y)):
        assert (values is None) == (wanted is None)
        assert wanted is None or values.tobytes() == wanted.tobytes()
    read_by_pyomo(path, x, y, options)


def read_by_pyomo(path: Path, x: object, y: object, options: tuple[int, ...]) -> None:
    pytest.importorskip("pyomo")
    from pyomo.opt.plugins.sol import ResultsReader_sol

    values, duals = ([] if part is None else list(part) for part in (x, y))
    try:
        from pyomo.contrib.solver.solvers.asl_sol_reader import parse_asl_sol_file
    except ImportError:  # before Pyomo 6.10 this reader needs the model
        pass
    else:
        with path.open() as file:
            new = parse_asl_sol_file(file)
        assert (new.solve_code, "residual 1e-9" in new.message) == (200, True)
        assert (list(new.primals or []), list(new.duals or [])) == (values, duals)
    if options[0] == 3:  # the older reader takes any five options for three and a tolerance
        old = ResultsReader_sol()(str(path), suffixes=["dual"])
        assert old.solver.id == 200
        assert [old.solution(0).variable[f"v{j}"]["Value"] for j in range(len(values))] == values


@pytest.mark.parametrize("seed", range(6))
def test_problems_are_written_and_read_back(seed, tmp_path):
    """An LCP comes back to the bit, with every kind of bounds."""
    rng, n = np.random.default_rng(seed), 1 + seed
    lower = np.where(rng.random(n) < 0.3, -np.inf, rng.integers(-2, 1, n))
    upper = np.where(rng.random(n) < 0.5, np.inf, rng.integers(1, 3, n))
    M = np.where(rng.random((n, n)) < 0.5, rng.standard_normal((n, n)), 0.0) + 3.0 * np.eye(n)
    problem = LCP(M, rng.standard_normal(n), lower=lower, upper=upper)
    for write in (
        lambda: problem.save(tmp_path / "m.nl"),
        lambda: write_nl(problem, tmp_path / "m.nl"),
    ):
        write()
        again = LCP.load(tmp_path / "m.nl")
        assert bits(again.csr.toarray(), again.q, again.lower, again.upper) == bits(
            problem.csr.toarray(), problem.q, problem.lower, problem.upper
        )


def test_what_no_file_can_state_is_refused_in_words(tmp_path):
    """A Python function, and an object that is not a problem, raise errors."""
    problem = NonlinearProblem(np.exp)
    with pytest.raises(errors.InvalidProblem, match=r"got NonlinearProblem"):
        write_nl(problem, tmp_path / "m.nl")
