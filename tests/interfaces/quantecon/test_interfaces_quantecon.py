"""The interface for QuantEcon: its games, and its Lemke by another import."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from fresh_process import printed_by

from lcp_plugin import LCP, InvalidOption, InvalidProblem, solve
from lcp_plugin.interfaces.quantecon import lemke

FEW = np.array([[1.0, 0.0], [2.0, 1.0]]), np.array([-8.0, -12.0])


def lcp_lemke(*given: Any, **options: Any) -> Any:
    """Call QuantEcon's function; its import takes seconds."""
    from quantecon.optimize import lcp_lemke

    return lcp_lemke(*given, **options)


def matrices(n: int, rng: np.random.Generator) -> Iterator[np.ndarray]:
    A = rng.standard_normal((n, n))
    yield A @ A.T + 0.1 * np.eye(n)
    yield A[:, : n // 2] @ A[:, : n // 2].T  # of half the rank: rays, too
    yield A @ A.T / n + A - A.T
    yield A
    yield rng.random((n, n))
    yield A + np.diag(np.abs(A).sum(axis=1) + 1.0)


@pytest.mark.full
@pytest.mark.parametrize("n", [2, 5, 12, 30])
def test_same_path_on_random_problems(n: int) -> None:
    """Status, z and number of pivots are those of QuantEcon, on six classes, with and without a covering vector."""
    rng = np.random.default_rng(n)
    for count in range(6):
        for M in matrices(n, rng):
            q, d = rng.standard_normal(n), None if count % 2 else rng.random(n) + 0.1
            ours, theirs = lemke(M, q, d), lcp_lemke(M, q, d)
            assert (ours.success, ours.status, ours.num_iter) == (
                theirs.success,
                theirs.status,
                theirs.num_iter,
            )
            if ours.success:
                np.testing.assert_allclose(ours.z, theirs.z, rtol=1e-6, atol=1e-8)


@pytest.mark.full
def test_their_own_tests_pass(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each test of QuantEcon's function passes with ours in its place."""
    from quantecon.optimize.tests import test_lcp_lemke as their_tests

    monkeypatch.setattr(their_tests, "lcp_lemke", lemke)
    names = [name for name in dir(their_tests.TestLCPLemke) if name.startswith("test_")]
    assert names
    for name in names:
        getattr(their_tests.TestLCPLemke(), name)()


@pytest.mark.full
def test_limit_of_pivots() -> None:
    """As many pivots as were asked for, status 1, and no success."""
    M, q = FEW
    for limit in (0, 1, 2):
        ours, theirs = lemke(M, q, max_iter=limit), lcp_lemke(M, q, max_iter=limit)
        assert ours[1:] == theirs[1:] == (False, 1, max(limit, 1))


@pytest.mark.full
def test_success_is_measured() -> None:
    """Where rounding misleads QuantEcon's path on a badly scaled matrix, ours says what holds."""
    misled = 0
    for seed in range(8):
        rng = np.random.default_rng(seed)
        A, s = rng.standard_normal((30, 30)), 10.0 ** rng.uniform(-5, 5, 30)
        M, q = (A @ A.T + 0.1 * np.eye(30)) * s[:, None] * s, rng.standard_normal(30) * s
        ours, theirs = lemke(M, q), lcp_lemke(M, q)
        assert not ours.success or is_solution(M, q, ours.z)
        misled += theirs.success and not is_solution(M, q, theirs.z)
    assert misled


def is_solution(M: np.ndarray, q: np.ndarray, z: np.ndarray) -> bool:
    """Whether w has no wrong sign beyond a millionth of its own terms."""
    w, size = M @ z + q, 1e-6 * (np.abs(M) @ np.abs(z) + np.abs(q))
    return bool(((z >= 0.0) & (w >= -size) & ((z == 0.0) | (np.abs(w) <= size))).all())


@pytest.mark.full
def test_nothing_to_do_and_a_place_for_z() -> None:
    """For q ≥ 0 no pivot is made; z is written where the caller wants it, and workspaces are left alone."""
    assert lemke(np.eye(2), np.ones(2))[1:] == (True, 0, 0)
    M, q = FEW
    place, tableau = np.full(2, 7.0), np.full((2, 6), 7.0)
    result = lemke(M, q, None, 10**6, None, tableau, np.zeros(2, dtype=int), place)
    assert result.z is place
    assert place.tolist() == lcp_lemke(M, q).z.tolist()
    assert (tableau == 7.0).all()


@pytest.mark.parametrize(
    ("error", "given", "words"),
    [
        (
            InvalidOption,
            {"d": [1.0, 0.0]},
            r"d must be positive to cover every row, but d\[1\] = 0.0",
        ),
        (InvalidOption, {"d": [1.0]}, "d must be a vector of length 2, got shape"),
        (InvalidOption, {"max_iter": 1e6}, "max_iter must be a whole number ≥ 0, got 1000000.0"),
        (InvalidOption, {"z": [0.0, 0.0]}, r"z must be a writable array of shape \(2,\), got list"),
        (InvalidProblem, {"q": [1.0]}, "q must be a finite vector of length 2"),
        (InvalidProblem, {"M": np.ones((2, 3))}, "square"),
    ],
)
def test_what_is_refused(error: type[Exception], given: dict[str, Any], words: str) -> None:
    """What QuantEcon would compute with is refused in words."""
    M, q = FEW
    with pytest.raises(error, match=words):
        lemke(**{"M": M, "q": q, **given})


@pytest.mark.full
def test_games_of_quantecon() -> None:
    """What comes back from a NormalFormGame, or from its payoffs, QuantEcon finds to be an equilibrium."""
    from quantecon.game_theory import NormalFormGame, Player

    rng = np.random.default_rng(4)
    for _ in range(10):
        A, B = rng.integers(-5, 6, (3, 4)).astype(float), rng.integers(-5, 6, (4, 3)).astype(float)
        game = NormalFormGame([Player(A), Player(B)])
        for problem in (LCP.from_game(game), LCP.from_game(A, B.T)):
            equilibrium = problem.origin.recover(solve(problem, "lemke").require_solved())
            assert equilibrium.regret <= 1e-10
        assert game.is_nash((equilibrium.row_strategy, equilibrium.column_strategy), tol=1e-9)


@pytest.mark.full
def test_a_game_has_two_players() -> None:
    """A game of three is refused, and payoffs of one player alone."""
    from quantecon.game_theory import NormalFormGame

    with pytest.raises(InvalidProblem, match="two players, got a game of 3"):
        LCP.from_game(NormalFormGame((2, 2, 2)))
    with pytest.raises(InvalidProblem, match="B is missing"):
        LCP.from_game([[1.0, 2.0]])


@pytest.mark.full
def test_quantecon_is_not_needed() -> None:
    """Lemke and games run without it."""
    code = (
        "import sys\nsys.modules['quantecon'] = None\nfrom lcp_plugin import LCP\n"
        "from lcp_plugin.interfaces.quantecon import lemke as lcp_lemke\n"
        "print(lcp_lemke([[2.0]], [-1.0]).z, LCP.from_game([[1, -1], [-1, 1]], [[-1, 1], [1, -1]]).n)"
    )
    assert printed_by(code) == "[0.5] 4"
