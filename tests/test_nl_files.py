""".nl files: what is written is read again, text or binary; what is damaged is refused with its line or byte."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from random_nl import difference, random_content

from lcp_plugin import errors
from lcp_plugin.modeling.nl import read_nl, write_nl

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
    return read_nl(folder / "m.nl")


@given(st.integers(0, 2**32))
def test_what_is_written_is_read_bit_for_bit(tmp_path: Path, seed: int) -> None:
    """Text and both binary orders give the same arrays, and those are the ones that were written."""
    content = random_content(np.random.default_rng(seed))
    for form in FORMS.values():
        write_nl(content, tmp_path / "m.nl", **form)
        assert difference(content, read_nl(tmp_path / "m.nl")) == ""


def test_a_small_file_says_what_it_says(tmp_path: Path) -> None:
    """Bounds, partners, linear terms, expressions and the start stand where the format has them."""
    content = read(tmp_path, SMALL)
    assert content.lower.tolist() == [0, -np.inf]
    assert (content.partners.tolist(), content.partner_bounds.tolist()) == ([0, -1], [1, 0])
    assert content.row_lower.tolist() == [-np.inf, 1]
    assert content.linear.toarray().tolist() == [[1, 0], [0, 0]]
    assert content.defined_linear.toarray().tolist() == [[-1.5, 0, 0]]
    assert content.trees.values.tolist() == [0, 2, -2, 2, 0, 1]
    assert (content.start.tolist(), content.has_start.tolist()) == ([0, 0.5], [False, True])
    assert content.options == (3, 1, 1, 0)


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        (b"g3 1 1 0", b"q3 1 1 0", 1, "begins with g"),
        (b" 2 2 0 0 1 0", b" 999999999999 2 0 0 1 0", 2, "bytes follow"),
        (b" 2 2 0 0 1 0", b" 2 x 0 0 1 0", 2, "whole numbers"),
        (b" 2 0 0 1 0 0", b" 2 0 0 2 0 0", 3, "complementarity rows"),
        (b" 4 0", b" 5 0", 8, "nonzeros"),
        (b"V2 1 0", b"V2 9 0", 11, "announced"),
        (b"0 -1.5", b"2 -1.5", 12, "not before it"),
        (b"o44", b"o99", 13, "no operator"),
        (b"o44", b"v2", 13, "complete here"),
        (b"C1\no2", b"C0\no2", 19, "second segment"),
        (b"C1\no2", b"C7\no2", 19, "0 to 1"),
        (b"n-2", b"v3", 18, "numbered from 0"),
        (b"n-2\n", b"", 17, "lacks"),
        (b"5 1 1", b"5 1 3", 26, "from 1 to 2"),
        (b"4 1.0", b"5 1 1", 3, "announced"),
        (b"2 0\n3\n", b"2 0\n", 28, "2 are needed"),
        (b"k1\n2", b"k1\n1", 31, "segments J"),
        (b"J1 2", b"J0 2", 36, "second segment"),
        (b"J0 2\n0 1", b"J0 2\n1 1", 35, "second entry"),
        (b"J0 2\n0 1", b"J0 2\n0 inf", 34, "finite"),
        (b"J0 2\n0 1", b"J0 2\n0 1x", 34, "neither a number"),
        (b"x1\t", b"y1\t", 23, "neither a number"),
    ],
)
def test_a_wrong_line_is_named(tmp_path: Path, old: bytes, new: bytes, line: int, words: str) -> None:
    """What contradicts the format or itself is refused with its line."""
    assert SMALL.count(old) == 1
    with pytest.raises(errors.UnreadableFile, match=f"line {line}: .*{words}"):
        read(tmp_path, SMALL.replace(old, new))
