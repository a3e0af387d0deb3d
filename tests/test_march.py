"""Marches in time: what is kept of them, what they give for derivatives."""

from __future__ import annotations

import pickle
import tracemalloc
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

from lcp_plugin import LCP, InvalidOption, march
from lcp_plugin.solving.march import March

# --- What is kept ---------------------------------------------------------------------------------------------


def heated(n: int, k: int, seed: int = 0, **options: Any) -> March:
    """A rod in k implicit steps between two temperatures, by forces that change."""
    rng = np.random.default_rng(seed)
    A = sp.diags_array([-1.0, 2.5, -1.2], offsets=[-1, 0, 1], shape=(n, n))
    problem = LCP(sp.eye_array(n) + A, np.zeros(n), lower=-1.0, upper=1.0)
    return march(problem, rng.normal(scale=2.0, size=(k, n)), z0=rng.normal(size=n), **options)


@pytest.mark.parametrize("algorithm", ["auto", "psor"])
@pytest.mark.parametrize("keep_every", [2, 7, 10, 23, 100])
def test_answers_that_were_not_kept_are_the_same_bits(algorithm: str, keep_every: int) -> None:
    """Whatever is kept, z and results are those of a march that keeps all, in any order of looking."""
    whole = heated(12, 23, algorithm=algorithm)
    sparse = heated(12, 23, algorithm=algorithm, keep_every=keep_every)
    assert (len(sparse), sparse.all_solved) == (23, True)
    for k in (*range(22, -1, -1), 5, -1, 0):
        assert np.array_equal(sparse.z[k], whole.z[k])
        assert np.array_equal(sparse[k].w, whole[k].w)
        assert (sparse[k].iterations, sparse[k].algorithm) == (whole[k].iterations, whole[k].algorithm)
    assert all(map(np.array_equal, sparse.z, whole.z))
    assert len(pickle.loads(pickle.dumps(heated(12, 5, algorithm="psor", keep_every=2))).z[:3]) == 3


def test_a_march_that_keeps_little_takes_little_memory() -> None:
    """Of 1600 steps, one in 40 kept, no more than a tenth of what keeping all takes."""
    taken = {}
    for keep_every in (1, 40):
        heated(500, 70, keep_every=keep_every)
        tracemalloc.start()
        before = tracemalloc.get_traced_memory()[0]
        rod = LCP(sp.diags_array([-1.0, 4.0, -1.0], offsets=[-1, 0, 1], shape=(500, 500)), np.zeros(500))
        done = march(rod, np.broadcast_to(-1.0, (1600, 500)), keep_every=keep_every)
        taken[keep_every] = tracemalloc.get_traced_memory()[0] - before
        tracemalloc.stop()
        assert len(done) == 1600
    assert taken[40] <= 0.1 * taken[1]


def test_what_keep_every_refuses() -> None:
    """Anything but a positive integer, in words."""
    for wrong in (0, -3, 2.5, True, "all"):
        with pytest.raises(InvalidOption, match="keep_every must be an integer ≥ 1, got"):
            heated(3, 2, keep_every=wrong)
