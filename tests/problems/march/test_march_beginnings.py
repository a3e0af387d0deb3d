"""A step of a march begins with what ended the one before: the same answers, from less work."""

from __future__ import annotations

import marches
import numpy as np
import pytest

from lcp_plugin import LCP, Status, march, solve
from lcp_plugin.problems import march as marching

SMALL = {
    "heston": lambda: marches.heston(60, 24, 6)[0],
    "basket": lambda: marches.basket(40, 6),
    "parabolic": lambda: marches.parabolic(48, 6),
    "contact": lambda: marches.contact(48, 6),
}


def marched(steps: marches.Steps, **options: object) -> object:
    return march(steps.problem, steps.forcing, steps.propagator, z0=steps.z0, **options)


@pytest.mark.few(3)
@pytest.mark.parametrize("name", SMALL)
def test_each_step_is_what_solve_finds_from_the_one_before(name: str) -> None:
    """Every step is SOLVED, with the z that solve() finds for its q, to 1e-8 of the largest."""
    steps = SMALL[name]()
    done, state = marched(steps, tolerance=1e-10), steps.z0
    assert done.all_solved
    assert len(done) == len(steps.forcing)
    for force, z in zip(steps.forcing, done.z, strict=True):
        alone = solve(
            steps.problem.with_q(force + steps.propagator @ state), z0=state, tolerance=1e-10
        ).z
        assert np.abs(z - alone).max() <= 1e-8 * max(np.abs(alone).max(), 1e-300)
        state = z


@pytest.mark.few(2)
@pytest.mark.parametrize("name", ["basket", "parabolic", "contact"])
def test_a_march_gives_the_same_bits_however_it_is_looked_at(name: str) -> None:
    """The same bits in two runs, for any number of threads, and where answers are computed once more."""
    steps = SMALL[name]()
    first = np.array(list(marched(steps, threads=1).z))
    fresh = steps._replace(problem=LCP(steps.problem.M, steps.problem.q, lower=steps.problem.lower))
    for again in (marched(fresh), marched(steps, threads=2)):
        np.testing.assert_array_equal(first, np.array(list(again.z)))


def test_time_that_runs_out_keeps_the_steps_before() -> None:
    """With max_seconds a march ends with a step that says so, and all before it are SOLVED."""
    steps = marches.basket(60, 400)
    done = marched(steps, max_seconds=0.2)
    assert 0 < len(done) < len(steps.forcing)
    assert all(step.is_solved for step in done[:-1])
    assert done[-1].status in (Status.MAX_SECONDS, Status.SOLVED)


def test_ctrl_c_keeps_the_steps_before(monkeypatch: pytest.MonkeyPatch) -> None:
    """An interruption in the fourth step leaves three, all of them SOLVED."""
    steps, asked = SMALL["basket"](), []

    def interrupted(*_: object) -> None:
        asked.append(0)
        if len(asked) == 4:
            raise KeyboardInterrupt

    monkeypatch.setattr(marching, "beginning_of_next", interrupted)
    done = marched(steps)
    assert not done.all_solved
    assert [step.is_solved for step in done] == [True] * 3 + [False] * (len(done) - 3)


def test_a_put_in_heston_s_model_has_its_published_value() -> None:
    """On a moderate grid the values of the literature are met to one per cent of the strike's half."""
    steps, spots, variances = marches.heston(79, 33, 20)
    z = marched(steps).z[-1].reshape(variances.size, spots.size)
    at = [np.interp(marches.HESTON_VARIANCE, variances, column) for column in z.T]
    assert np.abs(np.interp(marches.HESTON_SPOTS, spots, at) - marches.HESTON_VALUES).max() < 0.03
