"""Refused calls as a table of text, a line ``call → words`` each; the words are a pattern of the message."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

import lcp_plugin
from lcp_plugin.core import errors

PUBLIC = frozenset(dir(lcp_plugin))
BUILTIN_BASE: dict[type[Exception], type[Exception]] = {
    errors.InvalidProblem: ValueError,
    errors.InvalidOption: TypeError,
    errors.UnsuitableMatrix: ValueError,
    errors.UnsuitableProblem: ValueError,
    errors.UnknownAlgorithm: LookupError,
    errors.UnreadableFile: OSError,
    errors.NotConverged: RuntimeError,
    errors.UnsupportedModel: ValueError,
}
UNREADABLE = r"Traceback|File \"|<class |<function |<bound | at 0x|gufunc|\w+Error\("


def refusals(table: str) -> Any:
    """Return the decorator of a test with the parameters `call` and `words`, for each line of a table.

    A line that begins with → continues the line before.
    """
    lines = re.sub(r"\n\s*→", " →", table).strip().splitlines()
    rows = [[part.strip() for part in line.split("→")] for line in lines]
    return pytest.mark.parametrize(("call", "words"), rows, ids=[call for call, _ in rows])


def state(names: Mapping[str, Any]) -> list[Any]:
    """Return every byte of arrays and LCPs, random numbers, floating-point errors and warning filters."""
    arrays = [one for one in names.values() if isinstance(one, np.ndarray)]
    for one in names.values():
        if isinstance(one, lcp_plugin.LCP):
            arrays += [one.q, one.lower, one.upper, one.csr.data, one.csr.indices, one.csr.indptr]
    generator = np.random.get_state()  # noqa: NPY002 - that it is left alone is the claim
    own = [(a.tobytes(), a.shape, a.dtype, a.flags.writeable) for a in arrays]
    return [own, generator[1].tobytes(), generator[2], np.geterr(), list(warnings.filters)]


def assert_refused(
    call: str, words: str, names: Mapping[str, Any], error: type[Exception] = lcp_plugin.LCPError
) -> None:
    """Require that a call raises a readable error with these words, and changes nothing that it sees.

    Words ``Name: pattern`` have the class of the error. The call sees `names`, the package's names, np and sp.
    """
    found = re.match(r"([A-Z]\w+): (.*)", words)
    kind, words = (getattr(errors, found[1]), found[2]) if found else (error, words)
    public = {name: getattr(lcp_plugin, name) for name in PUBLIC & {*re.findall(r"\w+", call)}}
    names = {"np": np, "sp": sp, **public, **names}
    before = state(names)
    with pytest.raises(lcp_plugin.LCPError, match=words) as caught:
        eval(call, names)
    assert state(names) == before
    assert isinstance(caught.value, kind)
    assert all(
        issubclass(caught.type, base)
        for one, base in BUILTIN_BASE.items()
        if issubclass(caught.type, one)
    )
    assert not re.search(UNREADABLE, str(caught.value)), caught.value
    assert len(str(caught.value)) >= 20
