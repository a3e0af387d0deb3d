"""What every solve needs: the sweeps of the core, the judge, limits and words, on planted solutions."""

from __future__ import annotations

import pickle
from fractions import Fraction

import numpy as np
import pytest
import scipy.sparse as sp

from lcp_plugin import LCP, Certificate, Status, solve
from lcp_plugin.algorithms import REGISTRY
from lcp_plugin.core.errors import NotConverged, UnknownAlgorithm, UnsuitableMatrix

SPLITTINGS = [name for name, kind in REGISTRY.items() if kind.__module__.startswith("lcp_plugin.core.")]


def planted(n: int, seed: int, *, is_dense: bool = False) -> tuple[LCP, np.ndarray]:
    """A strictly dominant M with a solution that was chosen first: at both bounds, between them, degenerate."""
    rng = np.random.default_rng(seed)
    rows = sp.random_array((n, n), density=min(1.0, 4.0 / n), rng=rng, format="csr")
    M = sp.csr_array(rows + sp.diags_array(1.0 + abs(rows).sum(axis=1)))
    z, w = rng.integers(0, 3, n) / 2.0, np.zeros(n)
    w[z == 0.0] = rng.integers(0, 3, n)[z == 0.0]
    w[z == 1.0] = -rng.integers(0, 3, n)[z == 1.0]
    return LCP(M.toarray() if is_dense else M, w - M @ z, upper=1.0), z


def test_the_splittings_are_the_core_s() -> None:
    """The paper's sweeps and the projected ones lie in the core."""
    assert {"npj", "npgs", "npsor", "npaor", "pj", "pgs", "psor", "paor", "gfp"} == {*SPLITTINGS}


@pytest.mark.parametrize("name", SPLITTINGS)
@pytest.mark.parametrize("is_dense", [False, True])
def test_every_splitting_finds_the_planted_solution(name: str, is_dense: bool) -> None:
    """On a strictly dominant M, sparse and dense."""
    problem, z = planted(40, 1, is_dense=is_dense)
    result = solve(problem, name, tolerance=1e-10).require_solved()
    np.testing.assert_allclose(result.z, z, atol=1e-8)


@pytest.mark.parametrize("n", [1, 2, 30, 300, 3000])
def test_auto_finds_the_planted_solution(n: int) -> None:
    """Small ones and such that sweeps alone are for."""
    problem, z = planted(n, n)
    result = solve(problem, tolerance=1e-10)
    assert result.status is Status.SOLVED, result.explain()
    np.testing.assert_allclose(result.z, z, atol=1e-8)


def test_a_certificate_is_no_less_than_the_exact_residual() -> None:
    """In fractions: the largest |z − mid(lower, upper, z − w/d)| beside that of the point nearest to zero."""
    problem, z = planted(6, 3, is_dense=True)
    z = z + 1e-7

    def exact(x: np.ndarray) -> Fraction:
        rows = []
        for i, row in enumerate(problem.csr.toarray()):
            entries = [Fraction(a) * Fraction(b) for a, b in zip(row.tolist(), x.tolist(), strict=True)]
            step = Fraction(x[i]) - (sum(entries) + Fraction(problem.q[i])) / Fraction(problem.diagonal[i])
            rows.append(abs(Fraction(x[i]) - min(max(step, Fraction(problem.lower[i])), Fraction(problem.upper[i]))))
        return max(rows)

    measured = Certificate.of(problem, z).relative_residual
    assert measured >= exact(z) / exact(problem.nearest_to_zero)


def test_a_run_can_be_watched_and_ended() -> None:
    """A callback sees each step, its truth ends the run, and record keeps samples; none of it changes the answer."""
    problem, _ = planted(400, 4)
    plain = solve(problem, "psor")
    seen: list[int] = []
    watched = solve(problem, "psor", record=True, callback=lambda sample, z: seen.append(sample.iteration))
    assert watched.z.tobytes() == plain.z.tobytes()
    assert seen[-1] == watched.iterations
    assert watched.history[0].iteration == 0
    assert solve(problem, "psor", callback=lambda sample, z: sample.iteration == 2).status is Status.INTERRUPTED


def test_limits_and_statuses_are_said() -> None:
    """MAX_ITERATIONS, an unsuitable matrix, an unknown name: each says what to do."""
    problem, _ = planted(400, 5)
    result = solve(problem, "psor", max_iterations=1)
    assert result.status is Status.MAX_ITERATIONS
    assert "raise max_iterations" in result.advice
    with pytest.raises(NotConverged, match="MAX_ITERATIONS after 1 iterations of psor"):
        result.require_solved()
    with pytest.raises(UnsuitableMatrix, match=r"psor needs a positive diagonal, but M\[1, 1\] = -1.0"):
        solve(LCP([[1.0, 0.0], [0.0, -1.0]], [1.0, 1.0]), "psor")
    with pytest.raises(UnknownAlgorithm, match="did you mean 'psor'"):
        solve(problem, "psr")


def test_verbose_prints_the_run(capsys: pytest.CaptureFixture[str]) -> None:
    """A header, lines and an end, whatever else is said of M."""
    solve(planted(50, 6)[0], "pgs", verbose=True)
    printed = capsys.readouterr().out
    assert "LCP(n=50" in printed
    assert "SOLVED: relative residual" in printed


def test_problems_and_results_can_be_pickled() -> None:
    """A copy has the same data and the same answer."""
    problem, _ = planted(30, 7)
    copy = pickle.loads(pickle.dumps(problem))
    assert pickle.loads(pickle.dumps(solve(problem))).z.tobytes() == solve(copy).z.tobytes()


def test_sweeps_are_equivariant() -> None:
    """Two rows exchanged and another unit of z give the solution of the same problem."""
    problem, _ = planted(60, 8)
    order, unit = np.random.default_rng(8).permutation(60), 8.0
    other = LCP(problem.csr[order][:, order], unit * problem.q[order], upper=unit * problem.upper[order])
    one, two = solve(problem, "pj"), solve(other, "pj")
    np.testing.assert_allclose(two.z, unit * one.z[order], rtol=1e-12)
