"""The gallery: declared properties are true, and invalid parameters raise errors."""

from __future__ import annotations

import pkgutil
from importlib import import_module
from itertools import pairwise

import numpy as np
import pytest
from applications.flows import paper
from inputs import membranes, scenes
from oracles.truth import ExactData
from tools.refusals import assert_refused, refusals

from lcp_plugin import LCP, InvalidOption, gallery
from lcp_plugin.gallery.problems import CONTACT_RADIUS

# Every scene, and one line per variant, small enough for dense linear algebra and rational arithmetic.
SMALL = [
    *scenes.SMALL,
    "half_active:n=81,delta=0,degenerate=false",
    "convection_diffusion:size=6,diffusion=0,wind_angle=3.6",
    "obstacle_2d:size=12,shifted=true",
    "paper_example_1:n=49,delta=0",
    "paper_example_2:n=49",
]

PLANTED = [text for text in SMALL if membranes.parse(text).exact is not None]


@pytest.fixture(params=SMALL)
def scene(request):
    return membranes.parse(request.param)


def eliminate_with_maximum(problem: LCP) -> np.ndarray:
    """Return z for a tridiagonal M-matrix whose contact set is an initial interval (Brennan and Schwartz)."""
    A, lower = problem.csr, problem.lower
    below, diagonal, above, right = A.diagonal(-1), A.diagonal().copy(), A.diagonal(1), -problem.q
    for i in range(problem.n - 2, -1, -1):
        factor = above[i] / diagonal[i + 1]
        diagonal[i] -= factor * below[i]
        right[i] -= factor * right[i + 1]
    z = np.maximum(lower, right / diagonal)
    for i in range(1, problem.n):
        z[i] = max(lower[i], (right[i] - below[i - 1] * z[i - 1]) / diagonal[i])
    return z


# --- The registry -----------------------------------------------------------------------------------------


def test_every_builder_is_reachable():
    """A builder in any module of the package is registered and exported without further imports."""
    known = gallery.names()
    for module in pkgutil.iter_modules(gallery.__path__):
        import_module(f"{gallery.__name__}.{module.name}")
    assert gallery.names() == known
    assert set(known) <= set(gallery.__all__)
    assert all(isinstance(getattr(gallery, name)().problem, LCP) for name in known)


def test_description_is_one_line_and_every_parameter_is_documented():
    """Each scene has a one-line description ending in a full stop and documents all of its parameters."""
    for name, summary, parameters in gallery.describe():
        documentation = getattr(gallery, name).__doc__
        assert summary.endswith(".")
        assert documentation.startswith(summary + "\n")
        documented = documentation.partition("Parameters\n")[2].partition("Notes\n")[0]
        for parameter in parameters:
            assert parameter in documented.replace(",", " ").split(), (name, parameter)


@refusals(r"""
gallery.build("obstacle2d") → unknown test problem 'obstacle2d'; did you mean 'obstacle_2d'\? \(known: half_active
gallery.build("obstacle_2d", siez=9)
    → test problem 'obstacle_2d' has no parameter 'siez'; did you mean 'size'\?.*shifted
gallery.build("obstacle_2d", size=0) → problem 'obstacle_2d': size must be an integer ≥ 1, as 100, got 0
gallery.build("obstacle_2d", shifted=1) → shifted must be true or false, as False, got 1
gallery.build("paper_example_1", n=99) → n must be a perfect square, got 99
gallery.build("paper_example_1", delta=np.nan) → delta must be a finite number, as 4.0, got nan
""")
def test_bad_parameters_are_refused_by_name_and_value(call, words):
    """A wrong test problem, parameter, type or range raises InvalidOption with the valid values."""
    assert_refused(call, words, {}, InvalidOption)


# --- Declared properties ----------------------------------------------------------------------------------


@pytest.mark.parametrize("text", SMALL)
def test_differential_scenes_have_m_matrices(text):
    """Scenes from differential equations and the paper have no positive off-diagonal entry."""
    M = membranes.parse(text).problem.csr.toarray()
    assert (M - np.diag(M.diagonal())).max() <= 0.0


@pytest.mark.parametrize("text", PLANTED)
def test_exact_answers_are_exact(text):
    """Every declared exact solution is exactly complementary in rational arithmetic."""
    scene = membranes.parse(text)
    assert ExactData(scene.problem).is_solution(scene.exact)


# --- Assembly ---------------------------------------------------------------------------------------------


def test_paper_matrices_are_the_printed_ones_corrected():
    """Both equal the outsider's blocktridiag(·, L₁, ·) + δI, corrected; solution (1, 2, …), start (1, 0, …)."""
    for example in (1, 2):
        scene = gallery.build(f"paper_example_{example}", n=25, delta=3.0)
        assert np.array_equal(scene.problem.csr.toarray(), (paper(example, 5).M - np.eye(25)))
        assert scene.exact[:3].tolist() == [1.0, 2.0, 1.0]
        assert scene.start[:3].tolist() == [1.0, 0.0, 1.0]
        assert not scene.problem.slack(scene.exact).any()


# --- Single scenes ----------------------------------------------------------------------------------------


def test_half_active_is_half_active_and_degenerate_on_request():
    """Exactly half of the nodes are active where the blocks fit; degenerate ones appear only on request."""
    for degenerate, count in [(True, 200), (False, 0)]:
        scene = gallery.build("half_active", n=10_000, degenerate=degenerate)
        w = scene.problem.slack(scene.exact)
        assert np.mean(scene.exact == 0.0) == 0.5
        assert np.count_nonzero((scene.exact == 0.0) & (w == 0.0)) == count


def test_obstacle_converges_to_the_analytic_solution():
    """Refining the grid shrinks the error fast, and the free boundary is met within one mesh width."""
    errors = []
    for size in (15, 30):
        scene = gallery.build("obstacle_2d", size=size)
        z = membranes.active_set(scene.problem, scene.problem.lower)
        errors.append(np.abs(z - scene.continuum).max())
        r = np.sqrt(sum(x**2 for x in np.ix_(*scene.coordinates))).ravel()
        touching, mesh_width = z <= scene.problem.lower, 4.0 / (size + 1)
        assert r[touching].max() < CONTACT_RADIUS + mesh_width
        assert r[~touching].min() > CONTACT_RADIUS - mesh_width
        assert np.mean(touching) == pytest.approx(np.mean(r < CONTACT_RADIUS), abs=mesh_width / 2)
    assert all(fine < coarse / 1.5 for coarse, fine in pairwise(errors))
    assert errors[-1] < 1.0 / 30**1.5


def test_an_american_put_in_steps_agrees_with_the_binomial_tree():
    """Prices at and around the strike, in steps back to today, agree with the tree to 2e-4 of the strike."""
    put = membranes.american_put(size=501)
    problem = put.problem
    for _ in range(put.steps - 1):
        problem = problem.with_q(put.advance(eliminate_with_maximum(problem)))
    z = eliminate_with_maximum(problem)
    assert np.abs(np.minimum(z - problem.lower, problem.slack(z))).max() < 1e-10

    data = {"strike": 100.0, "rate": 0.05, "volatility": 0.2, "maturity": 1.0}
    ratios = np.array([0.8, 0.9, 1.0, 1.1, 1.3])
    tree = gallery.binomial_put(100.0 * ratios, **data)
    ours = np.interp(np.log(ratios), np.linspace(-1.5, 1.5, 503)[1:-1], z)
    assert ours == pytest.approx(tree, abs=0.02)
    assert tree[0] == pytest.approx(20.0, abs=1e-12)
    assert gallery.binomial_put(100.0, **data).shape == ()
