"""Polymatrix games: published and random ones, judged by regrets computed from the payoffs, and wrong calls."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pytest
from tools.refusals import assert_refused, refusals

from lcp_plugin import LCP, InvalidProblem, NotConverged, all_solutions, solve

SAME = np.eye(2)


def drawn(seed: int, players: int, actions: int, *, integers: bool) -> dict[tuple[int, int], Any]:
    random = np.random.default_rng(seed)
    pairs = [(i, j) for i in range(players) for j in range(players) if i != j]
    shape = actions, actions
    if integers:
        return {pair: random.integers(-3, 4, shape) for pair in pairs}
    return {pair: random.standard_normal(shape) for pair in pairs}


def regret(game: Any, strategies: Any) -> float:
    """Return the most that a player gains by another action."""
    found = 0.0
    for i, own in enumerate(strategies):
        by_action = sum(game[i, j] @ other for j, other in enumerate(strategies) if j != i)
        found = max(found, float(by_action.max() - own @ by_action))
    return found


def test_three_matching_pennies_have_jordans_only_equilibrium():
    """Jordan (1993): each player matches the next one, the last mismatches the first; all toss a coin."""
    game = LCP.from_game({(0, 1): SAME, (1, 2): SAME, (2, 0): 1 - SAME})
    (only,) = all_solutions(game)
    equilibrium = game.origin.recover(only.z)
    assert [one.tolist() for one in equilibrium.strategies] == [[0.5, 0.5]] * 3
    assert equilibrium.payoffs == (0.5, 0.5, 0.5)


@pytest.mark.parametrize("algorithm", ["auto", "lemke"])
@pytest.mark.parametrize("integers", [False, True])
@pytest.mark.parametrize(("players", "actions"), [(3, 2), (3, 10), (5, 4), (8, 8)])
def test_no_player_of_a_random_game_gains(players, actions, integers, algorithm):
    """Regrets by the payoffs themselves; integers have ties."""
    for seed in range(3):
        payoffs = drawn(seed, players, actions, integers=integers)
        game = LCP.from_game(payoffs)
        found = game.origin.recover(solve(game, algorithm).require_solved())
        assert regret(payoffs, found.strategies) <= 1e-9
        assert found.regret == pytest.approx(regret(payoffs, found.strategies), abs=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_all_pure_equilibria_of_two_actions_are_among_all_solutions(seed):
    """The eight profiles of three players are tried one by one."""
    payoffs = drawn(seed, 3, 2, integers=False)
    game = LCP.from_game(payoffs)
    listed = {
        tuple(int(one.argmax()) for one in game.origin.recover(found.z).strategies)
        for found in all_solutions(game)
        if all(one.max() == 1.0 for one in game.origin.recover(found.z).strategies)
    }
    pure = {
        profile
        for profile in product((0, 1), repeat=3)
        if regret(payoffs, [SAME[action] for action in profile]) == 0.0
    }
    assert listed == pure


def test_players_may_have_different_numbers_of_actions_and_payoffs_of_any_unit():
    """Sizes 2, 3, 4; a constant that another player's action adds to all payoffs changes nothing."""
    random, sizes = np.random.default_rng(0), (2, 3, 4)
    payoffs = {
        (i, j): random.standard_normal((sizes[i], sizes[j])) for i, j in ((0, 1), (1, 2), (2, 0))
    }
    one, other = (
        LCP.from_game(payoffs),
        LCP.from_game({k: 1e6 * v + 8.0 for k, v in payoffs.items()}),
    )
    ends = [game.origin.recover(solve(game).require_solved()).strategies for game in (one, other)]
    assert [part.size for part in ends[0]] == [2, 3, 4]
    for first, second in zip(*ends, strict=True):
        np.testing.assert_allclose(first, second, atol=1e-7)


@refusals(r"""
LCP.from_game({}) → numbered from 0
LCP.from_game({(0, 2): SAME}) → numbered from 0
LCP.from_game({(0, 0): SAME}) → write \{\(0, 1\): …
LCP.from_game({(0, 1): SAME, (1, 2): np.ones((3, 2))}) → player 1 has 2 actions elsewhere
LCP.from_game({(0, 1): np.zeros((0, 2))}) → shape
LCP.from_game(SAME) → is \{\(0, 1\): …, \(1, 0\): …\}
""")
def test_a_wrong_game_is_told_what_to_write(call, words):
    """InvalidProblem with the right form."""
    assert_refused(call, words, {"SAME": SAME}, InvalidProblem)


def test_a_point_without_actions_of_a_player_is_no_strategy():
    """The message has the number of the player."""
    game = LCP.from_game({(0, 1): SAME, (1, 2): SAME, (2, 0): 1 - SAME})
    with pytest.raises(NotConverged, match="player 1 has no action"):
        game.origin.recover([1, 0, 0, 0, 1, 0, 1, 1, 1])
