"""Marches in time, and their derivatives."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from applications.finance import heston
from inputs import membranes
from tools.refusals import assert_refused, refusals

from lcp_plugin import (
    LCP,
    InvalidOption,
    InvalidProblem,
    NonlinearProblem,
    Status,
    UnsuitableProblem,
    derivative,
    march,
    solve,
)
from lcp_plugin.gallery.problems import five_point_matrix
from lcp_plugin.problems.march import BandSteps, March
from lcp_plugin.problems.sensitivity import Derivative

# --- What is kept ---------------------------------------------------------------------------------------------


def heated(n: int, k: int, seed: int = 0, **options: Any) -> March:
    """A rod in k implicit steps between two temperatures, by forces that change."""
    rng = np.random.default_rng(seed)
    A = sp.diags_array([-1.0, 2.5, -1.2], offsets=[-1, 0, 1], shape=(n, n))
    problem = LCP(sp.eye_array(n) + A, np.zeros(n), lower=-1.0, upper=1.0)
    return march(problem, rng.normal(scale=2.0, size=(k, n)), z0=rng.normal(size=n), **options)


@pytest.mark.parametrize("n", [3, 40], ids=["dense", "band"])
def test_the_solutions_of_a_march_are_one_array(n):
    """Row k is the solution of kept step k, also before and after more steps, and without any step."""
    done = heated(n, 6)
    assert done.z.shape == (6, n)
    np.testing.assert_array_equal(done.z, np.array([one.z for one in done]))
    np.testing.assert_array_equal(done.z[:, 1], [one.z[1] for one in done])
    assert heated(n, 6, keep="last").z.shape == (1, n)
    assert march(LCP(np.eye(n), np.zeros(n)), np.zeros((0, n))).z.shape == (0, n)


@pytest.mark.quick(1)
@pytest.mark.parametrize("algorithm", ["auto", "npsor"])
@pytest.mark.parametrize(("keep", "steps"), [(1, range(10)), (4, [3, 7, 9]), ("last", [9])])
def test_keep_leaves_every_kth_step_and_the_last(keep, steps, algorithm):
    """The kept steps are steps of the whole march, also if the march has several blocks of a band."""
    whole, some = (heated(5, 10, algorithm=algorithm, keep=one) for one in (1, keep))
    assert some.steps == [*steps]
    np.testing.assert_array_equal(some.z, [whole.z[k] for k in steps])
    np.testing.assert_array_equal(some[-1].certificate.problem.q, whole[-1].certificate.problem.q)
    assert some.taken == 10
    assert some.all_solved
    kept = "" if keep == 1 else f", {len(steps)} kept"
    assert f"10 of 10 steps{kept}: {len(steps)} SOLVED" in some.explain()
    long = heated(5, 150, algorithm=algorithm, keep=50)
    np.testing.assert_array_equal(long.z[1], heated(5, 150, algorithm=algorithm).z[99])
    if keep != 1:
        with pytest.raises(UnsuitableProblem, match="leave out keep"):
            derivative(some)


def test_keep_is_a_number_of_steps_or_last():
    """Another value is an error before the first step."""
    for wrong in (0, "first", 2.5):
        with pytest.raises(InvalidOption, match='keep must be an integer ≥ 1, or "last"'):
            heated(5, 3, keep=wrong)
    with pytest.raises(IndexError, match="none has the number -2; keep=1 keeps all steps"):
        heated(5, 3, keep="last")[-2]


# --- Derivatives ----------------------------------------------------------------------------------------------

INF = np.inf


def drawn(n: int, seed: int, width: int = 1, *, z: bool = False) -> tuple[LCP, sp.csr_array]:
    """Return a box problem on a nonsymmetric band and a propagator; with `z`, M is an M-matrix."""
    rng = np.random.default_rng(seed)

    def banded(below: int, above: int) -> sp.csr_array:
        offsets = [k for k in range(-below, above + 1) if k]
        return sp.csr_array(
            sp.diags_array([rng.normal(size=n - abs(k)) for k in offsets], offsets=offsets)
        )

    M = banded(width, width + (0 if z else 1))
    M = -abs(M) if z else M
    M = sp.csr_array(M + sp.diags_array(1.0 + abs(M).sum(axis=1)))
    propagator = sp.csr_array(banded(1, 2) - sp.eye_array(n))
    lower, upper = -rng.uniform(0.0, 0.6, n), rng.uniform(0.0, 0.6, n)
    lower[::5], upper[1::5] = -INF, INF
    lower[3] = upper[3] = 0.1
    return LCP(M, np.zeros(n), lower=lower, upper=upper), propagator


def marched(problem: LCP, propagator: sp.csr_array, k: int, seed: int, **options: Any) -> March:
    rng = np.random.default_rng(seed)
    return march(
        problem,
        rng.normal(size=(k, problem.n)),
        propagator,
        z0=rng.normal(size=problem.n),
        **options,
    )


def stacked(done: March) -> Derivative:
    """Return the derivative of the march as one problem: M in diagonal blocks, C below."""
    k, problem = len(done), done.problem
    M = sp.csr_array(
        sp.kron(sp.eye_array(k), problem.csr) + sp.kron(sp.eye_array(k, k=-1), done.propagator)
    )
    q = np.array(done.forcing)
    q[0] += done.propagator @ done.z0
    return derivative(
        solve(
            LCP(M, q.ravel(), lower=np.tile(problem.lower, k), upper=np.tile(problem.upper, k)),
            tolerance=1e-13,
        )
    )


CASES = {
    "tridiagonal M-matrix": lambda: marched(*drawn(20, 1, z=True), 6, 1),
    "band": lambda: marched(*drawn(24, 2, width=2), 5, 2),
    "psor": lambda: marched(*drawn(20, 3, z=True), 5, 3, algorithm="psor", tolerance=1e-13),
    "dense": lambda: marched(
        LCP(grid(3).toarray(), np.zeros(9), lower=-0.2, upper=0.3), drawn(9, 4)[1], 4, 4
    ),
    "one by one": lambda: marched(
        LCP(grid(6), np.zeros(36), lower=-0.2, upper=0.3), -sp.csr_array(grid(6).T), 3, 5
    ),
    "a wide band": lambda: marched(*drawn(40, 6, width=35), 3, 6),
}


def grid(m: int) -> sp.csr_array:
    """A five-point stencil with a drift, its rows in an order with no band."""
    rows = np.random.default_rng(0).permutation(m * m)
    return five_point_matrix(m, 4.4, (-1.0, -0.8))[rows][:, rows]


def change_of(done: March, seed: int) -> dict[str, Any]:
    """A direction in everything that a march has for data."""
    rng, n = np.random.default_rng(seed), done.problem.n
    move = rng.normal(size=n)
    return {
        "dM": sp.random_array((n, n), density=0.3, rng=rng),
        "dpropagator": rng.normal(size=(n, n)),
        "dforcing": rng.normal(size=(len(done), n)),
        "dz0": rng.normal(size=n),
        "dlower": move,
        "dupper": move,
    }


@pytest.mark.parametrize("case", CASES)
def test_a_march_has_the_derivative_of_one_large_problem(case):
    """Forward derivatives of all steps equal the derivatives of one stacked problem."""
    done = CASES[case]()
    k, n, change = len(done), done.problem.n, change_of(done, 7)
    dq = np.array(change["dforcing"])
    dq[0] += change["dpropagator"] @ done.z0 + done.propagator @ change["dz0"]
    expected = (
        stacked(done)
        .jvp(
            dM=sp.kron(sp.eye_array(k), change["dM"])
            + sp.kron(sp.eye_array(k, k=-1), change["dpropagator"]),
            dq=dq.ravel(),
            dlower=np.tile(change["dlower"], k),
            dupper=np.tile(change["dupper"], k),
        )
        .reshape(k, n)
    )
    found = derivative(done)
    assert all(one.free.any() and not one.free.all() for one in found)
    each = {name: np.tile(change[name], (k, 1)) for name in ("dlower", "dupper")}
    for changes in (change, change | each | {"dM": [change["dM"]] * k}):
        np.testing.assert_allclose(
            found.jvp(**changes), expected, rtol=0, atol=1e-11 * abs(expected).max()
        )
    np.testing.assert_array_equal(found.jvp(**change, only_last=True), found.jvp(**change)[-1])


@pytest.mark.parametrize("case", CASES)
def test_gradients_go_backwards_what_changes_go_forwards(case):
    """The product ⟨g, dz⟩ equals the product of gradients and changes, for all steps."""
    done = CASES[case]()
    found, change, rng = derivative(done), change_of(done, 8), np.random.default_rng(9)
    # on the patterns
    change["dM"] = sp.csr_array(done.problem.csr * rng.normal(size=done.problem.csr.shape))
    change["dpropagator"] = sp.csr_array(done.propagator * rng.normal(size=done.propagator.shape))
    dz = found.jvp(**change)
    for g in (rng.normal(size=dz.shape), rng.normal(size=done.problem.n)):
        gradient = found.vjp(g)
        assert gradient.M.nnz == done.problem.csr.nnz
        assert gradient.propagator.nnz == done.propagator.nnz
        terms = [
            gradient.M.multiply(change["dM"]).sum(),
            gradient.propagator.multiply(change["dpropagator"]).sum(),
            (gradient.forcing * change["dforcing"]).sum(),
            gradient.z0 @ change["dz0"],
            gradient.lower @ change["dlower"],
            gradient.upper @ change["dupper"],
        ]
        expected = (g * dz).sum() if g.ndim == 2 else g @ dz[-1]
        assert sum(terms) == pytest.approx(expected, rel=0, abs=1e-11 * sum(map(abs, terms)))


def test_kinks_are_held_backwards_and_one_sided_forwards():
    """A row with z = lower and w = 0 has one-sided changes, and gradients with the row fixed."""
    rod = LCP(sp.diags_array([-1.0, 3.0, -1.0], offsets=[-1, 0, 1], shape=(40, 40)), np.zeros(40))
    forcing = np.zeros((3, 40))
    forcing[:, :10] = -1.0
    # the others far right are 0 with w ≥ 0, and rounding decides nothing there
    forcing[1, 30] = 1.0
    wide = march(rod, forcing, propagator=0.0)
    still = march(rod, np.zeros((3, 40)))
    found = derivative(still)
    assert (found.is_unique, len(found.degenerate)) == (False, 120)
    up = found.jvp(dforcing=np.full(40, -1.0))
    assert (up[0] > 0.0).all()
    assert not found.jvp(dforcing=np.full(40, 1.0)).any()
    assert not found.vjp(np.ones(40)).forcing.any()
    assert np.array_equal(found.vjp(np.ones((3, 40))).lower, np.full(40, 3.0))
    assert derivative(wide).jvp(dforcing=forcing).shape == (3, 40)
    assert derivative(marched(*drawn(20, 1, z=True), 6, 1)).is_unique is True


@refusals(r"""
found.jvp(**{'dz0': np.zeros(2)}) → dz0 must be
found.jvp(**{'dforcing': np.zeros((2, 5))})
    → dforcing must be a finite array of shape \(4, 5\), or \(5,\) for all steps
found.jvp(**{'dforcing': np.full((4, 5), np.nan)}) → dforcing must be .* but dforcing\[0, 0\] = nan
found.jvp(**{'dM': np.eye(4)}) → dM must be
found.jvp(**{'dM': 3}) → dM must be a real matrix of shape \(5, 5\)
found.jvp(**{'dM': [np.eye(5)] * 3}) → dM must have one entry per step, 4
found.jvp(**{'dM': [np.eye(5)] * 3 + [np.eye(4)]}) → dM must be a real matrix of shape \(5, 5\), got shape \(4, 4\)
found.jvp(**{'dM': [[1.0, [2.0]]]}) → dM must
found.jvp(**{'dlower': np.zeros((3, 5))}) → dlower must be a finite array of shape \(4, 5\), or \(5,\) for all
found.jvp(**{'dpropagator': np.eye(4)}) → dpropagator must be
found.jvp(**{'dlower': np.inf}) → dlower must be finite
found.jvp(dq=np.ones(5)) → InvalidOption: no option 'dq'.*dforcing
found.vjp(np.zeros((3, 5))) → g must be a finite array of shape \(4, 5\), or \(5,\) for the last
found.vjp([0.0, 0.0, np.nan, 0.0, 0.0]) → but g\[2\] = nan
derivative([done, done]) → InvalidOption: write \[derivative\(result\) for result
derivative(heated(5, 4, algorithm="psor", max_iterations=0))
    → UnsuitableProblem: only a march solved to its end.* 1 of 4 steps, and step 0 ended
derivative(march(LCP([[1.0]], [0.0]), [[-1.0]] * 3, propagator=-1e200))
    → UnsuitableProblem: it took 2 of 3 steps, and step 1 q must be
""")
def test_what_changes_are_refused(call, words):
    """Changes of another shape, or not finite; and marches that did not get to their end."""
    done = heated(5, 4)
    names = {"heated": heated, "done": done, "found": derivative(done)}
    assert_refused(call, words, names, InvalidProblem)


def test_a_march_without_steps_has_a_derivative():
    """The derivative without steps has no changes, and its gradients are 0."""
    found = derivative(march(LCP(np.eye(3), np.zeros(3)), np.zeros((0, 3))))
    assert found.jvp(dz0=np.ones(3)).shape == (0, 3)
    assert not found.vjp(np.zeros((0, 3))).z0.any()


# --- A march on a grid: American puts in Heston's model ---


def heston_march(m: int, k: int, steps: int) -> tuple[LCP, Any, Any, Any]:
    """Return problem, forcing, propagator and z0 of the put for a quarter of a year, m prices by k variances."""
    one = heston(m, k, 0.25 / steps)
    forcing = np.broadcast_to(one.q + one.lower, (steps, one.q.size))
    propagator = sp.csr_array(-sp.eye_array(one.q.size))
    return LCP(one.M, 0.0 * one.q, lower=one.lower), forcing, propagator, one.lower


def test_time_that_runs_out_keeps_the_steps_before():
    """A march with max_seconds ends with MAX_SECONDS, and all earlier steps are SOLVED."""
    problem, forcing, propagator, z0 = heston_march(80, 32, 400)
    done = march(problem, forcing, propagator, z0=z0, max_seconds=0.2)
    assert 0 < len(done) < len(forcing)
    assert all(step.is_solved for step in done[:-1])
    assert done[-1].status in (Status.MAX_SECONDS, Status.SOLVED)


def test_a_put_in_heston_s_model_has_its_published_value():
    """The values of Clarke and Parrott 1999, doi:10.1080/135048699334528, that later papers agree upon."""
    problem, forcing, propagator, z0 = heston_march(80, 32, 20)
    z = march(problem, forcing, propagator, z0=z0).z[-1].reshape(80, 33)
    at = [np.interp(0.0625, np.linspace(0.0, 1.0, 33), row) for row in z]
    values = np.interp((8.0, 9.0, 10.0, 11.0, 12.0), np.linspace(0.0, 20.0, 81)[1:], at)
    assert values == pytest.approx((2.0000, 1.107641, 0.520030, 0.213668, 0.082036), abs=0.01)


# --- A march equals single steps ---


def test_a_march_is_its_steps_one_by_one():
    """A march has the z, bit for bit, and the status of single solves, with every algorithm."""
    scene = membranes.american_put(size=101, steps=25)
    forcing = np.broadcast_to(scene.advance(np.zeros(101)), (25, 101))
    for algorithm in ("auto", "banded", "psor"):
        steps = march(scene.problem, forcing, z0=scene.problem.lower, algorithm=algorithm)
        problem, z = scene.problem, np.array(scene.problem.lower)
        for step, state in zip(steps, steps.z, strict=True):
            alone = solve(problem, algorithm, z0=z)
            assert np.array_equal(step.certificate.problem.q, problem.q)
            assert np.array_equal(state, step.z)
            assert np.array_equal(step.z, alone.z)
            assert np.array_equal(step.w, alone.w)
            assert step.status is alone.status
            assert step.certificate.relative_residual == alone.certificate.relative_residual
            z = step.z
            problem = problem.with_q(scene.advance(z))
        assert steps[-1].is_solved


def test_a_march_takes_what_a_solve_takes():
    """Options, a callback, an error measure and a limit in seconds have the meaning of `solve`."""
    scene = membranes.american_put(size=31, steps=4)
    forcing, heard = np.broadcast_to(scene.problem.q, (4, scene.problem.n)), []
    priced = partial(march, scene.problem, forcing, z0=scene.problem.lower)
    plain, psor = priced(), partial(priced, algorithm="psor")
    watched = psor(
        relaxation=1.2, record=True, callback=lambda sample, z: heard.append(sample.iteration)
    )
    assert watched.all_solved
    assert len(watched) == 4
    assert len(heard) == sum(
        len(result.history) > 0 and result.iterations + 1 for result in watched
    )
    for ours, theirs in zip(watched.z, plain.z, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-6)
    late = psor(tolerance=0.0, max_seconds=0.0)
    assert [result.status for result in late] == [Status.MAX_SECONDS]
    with pytest.raises(InvalidOption, match="has no option 'relaxaton'; did you mean 'relaxation'"):
        march(scene.problem, forcing, algorithm="psor", relaxaton=1.2)


def test_a_march_ends_where_a_step_is_not_solved():
    """A march ends at an unsolved step; others run outside of the compiled loop."""
    problem = LCP(
        sp.diags_array([0.5, 1.0, 0.5], offsets=[-1, 0, 1], shape=(30, 30)), np.zeros(30), upper=1.0
    )
    forcing = np.random.default_rng(0).normal(size=(5, 30))
    assert len(march(problem, forcing, 0.0)) == 5
    cut = march(problem, forcing, 0.0, max_iterations=0)
    assert [one.status for one in cut] == [Status.MAX_ITERATIONS]
    # z° solves the third
    idle = march(problem, np.vstack([forcing[:2], np.ones((1, 30)), forcing[2:]]), 0.0)
    assert idle.all_solved
    assert len(idle) == 6
    assert not idle.z[2].any()


@refusals(r"""
march(still, np.zeros(3)) → forcing must be .* \(k, n\), a row per step, n = 3, got shape \(3,\)
march(still, [[0.0, np.nan, 0.0]]) → forcing\[0, 1\] = nan; repair it
march(still, [[0, 0, 0]], np.eye(2)) → propagator must be a real matrix of shape \(3, 3\), got shape \(2, 2\)
march(still, [[0, 0, 0]], np.full((3, 3), np.inf)) → propagator\[0, 0\] = inf; repair it
march(still, [[0, 0, 0]], z0=np.zeros(2)) → z0 must be
march(np.eye(3), [[0, 0, 0]])
    → InvalidOption: march needs an LCP, NonlinearProblem, ConeProblem or FrictionalContact, got ndarray
march([still, LCP([[1]], [0])], np.zeros((2, 3))) → problem\[1\] must be an LCP, n = 3, got LCP with n = 1
march([still, np.eye(3)], np.zeros((2, 3))) → problem\[1\] must be an LCP, n = 3, got ndarray
march([still] * 2, np.zeros((3, 3))) → problem must have one entry per step, 3 for 3 rows of forcing, got 2
march([still], np.zeros((0, 3))) → problem must have one entry per step, 0 for 0 rows of forcing, got 1
march([still] * 4, np.zeros((3, 3))) → problem must have .* got 4
march([], [[0, 0, 0]]) → InvalidOption: march needs an LCP, .* got list
march(still, [[0, 0, 0]], algorithm="psor", upper=1.0)
    → InvalidOption: no option 'upper': .* of the problem.* \[problem.with_data\(lower=row\) for row in rows\]
march(still, [[0, 0, 0]], M_at=[np.eye(3)]) → InvalidOption: march has no option 'M_at'
march(still, np.zeros((2, 4, 3))) → forcing must be .* \(k, n\), a row per step, n = 3, got shape \(2, 4, 3\)
march(still, [[0, 0, 0]], z0=np.zeros((2, 3))) → z0 must be
""")
def test_what_a_march_refuses(call, words):
    """Data of another shape, or not finite, raise errors before the first step."""
    assert_refused(call, words, {"still": LCP(np.eye(3), np.zeros(3))}, InvalidProblem)


# --- Limits on a band -----------------------------------------------------------------------------------------

BAND = LCP(
    sp.diags_array([[-1.0] * 199, [3.0] * 200, [-1.0] * 199], offsets=[-1, 0, 1]), np.zeros(200)
)


def test_march_on_a_band_after_ctrl_c_keeps_the_steps_so_far(monkeypatch):
    """Ctrl-C in the third block of steps leaves the steps of the first two."""
    solve_block, blocks = BandSteps.solve, []

    def interrupted(self, *given):
        blocks.append(given)
        if len(blocks) == 3:
            raise KeyboardInterrupt
        return solve_block(self, *given)

    monkeypatch.setattr(BandSteps, "solve", interrupted)
    done = march(BAND, np.broadcast_to(-1.0, (400, 200)))
    assert (done.taken, len(done), done.is_interrupted, done.all_solved) == (128, 128, True, False)
    assert {*done.status} == {Status.SOLVED}
    assert done.seconds > 0.0
    blocks[:] = [()] * 2
    with pytest.raises(KeyboardInterrupt):
        march(BAND, np.broadcast_to(-1.0, (400, 200)))


def test_a_step_that_the_method_before_does_not_take_is_planned_by_auto():
    """Sweeps solve the steps of a heat equation; the last matrix has a zero on its diagonal, so they refuse it."""
    nodes, time_step = 20, 0.2
    plate = sp.eye_array(nodes**2) + time_step * five_point_matrix(nodes, 4.0)
    other = plate.tolil()
    other[0, 0], other[0, 1], other[1, 0] = 0.0, 1.0, -1.0
    waves = np.sin(np.linspace(0.0, 9.0, nodes**2))
    forcing = [-1e-2 * np.roll(waves, step) for step in range(4)]
    found = march([*[LCP(plate, 0.0 * waves)] * 3, LCP(other, 0.0 * waves)], forcing)
    assert found.all_solved
    assert found[2].algorithm == "auto: psor"


@pytest.mark.parametrize("upper", [np.inf, 0.6])
def test_march_on_a_band_obeys_max_iterations(upper):
    """Without an iteration no step is solved; a limit of 50 suffices for each step."""
    band = BAND.with_data(upper=upper)
    none = march(band, np.broadcast_to(-1.0, (3, 200)), max_iterations=0)
    assert [one.status for one in none] == [Status.MAX_ITERATIONS]
    assert march(band, np.broadcast_to(-1.0, (3, 200)), max_iterations=50).all_solved


def test_time_ends_a_march_whose_steps_begin_at_their_solutions():
    """Each step is SOLVED where it begins; the march ends nevertheless, and says how far it came."""
    rest = NonlinearProblem(lambda x: x + x**3, lower=np.ones(2))
    for problem in (rest, LCP(2.0 * np.eye(2), np.zeros(2), lower=1.0)):
        done = march(problem, np.zeros((50, 2)), 0.0, z0=np.ones(2), max_seconds=0.0)
        assert len(done) == 1
        assert not done.all_solved
        assert "1 of 50 steps" in done.explain()
