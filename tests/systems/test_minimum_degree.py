"""The workspace that the count of fill asks for."""

import numpy as np
import pytest
import scipy.sparse as sp

from lcp_plugin.systems import minimum_degree


def test_the_count_of_fill_writes_no_more_than_its_workspace_holds(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Also a count that a limit ends; two joined unknowns use all of it."""
    kernel, left_over = minimum_degree.minimum_degree, []

    def watched(begins, workspace, last, entries, operations, limit):  # type: ignore[no-untyped-def]
        n, lists = begins.size - 1, begins[-1]
        for most_touched in (limit, 0, n, 2 * n):
            room = lists + min(most_touched + n, n * (n - 1) // 2)
            assert most_touched != limit or workspace.size >= room
            wide = np.full(room + n * n, -1)
            wide[:lists] = workspace[:lists]
            found = kernel(begins, wide, last, entries, operations, most_touched)
            left_over.append(room - lists - np.count_nonzero(wide[lists:] >= 0))
        return found

    monkeypatch.setattr(minimum_degree, "minimum_degree", watched)
    minimum_degree.factor_sizes(sp.csr_array(np.ones((2, 2))))
    assert left_over[0] == 0
    for seed in range(200):
        rng = np.random.default_rng(seed)
        n = int(rng.integers(2, 14))
        minimum_degree.factor_sizes(sp.random_array((n, n), density=0.3, rng=rng, format="csr"))
    assert min(left_over) == 0
