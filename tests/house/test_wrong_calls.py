"""Wrong calls raise errors of this package."""

from __future__ import annotations

import warnings

from campaigns.wrong_calls import calls

from lcp_plugin import LCPError


def test_wrong_calls_raise_no_error_of_python(draws):
    """Lists, tables, columns, other shapes, NaN, text, missing and superfluous arguments: an eighth of the sweep."""
    raw, every = [], 8 // len(draws(8))
    for k, (what, call) in enumerate(calls()):
        if k % every:
            continue
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                call()
        except LCPError:
            continue
        except Exception as error:
            raw.append((what, repr(error)))
    assert raw == []
