"""LCPs solved by operations of JAX: is_solved is a proof, derivatives, transformations; batches in arrays of JAX."""

import doctest
import pickle

import numpy as np
import pytest
from inputs.planted import planted
from tools.refusals import assert_refused, refusals

jax = pytest.importorskip("jax")

import jax.numpy as jnp  # noqa: E402

import lcp_plugin.methods.small_lcps_in_jax as kernel  # noqa: E402
from lcp_plugin import (  # noqa: E402
    LCP,
    InvalidOption,
    InvalidProblem,
    QuadraticProgram,
    certify,
    derivative,
    prepare,
    solve,
    solve_batch,
)
from lcp_plugin.interfaces.learn.jax import lcp_layer, qp_layer, solve_lcp  # noqa: E402

INF, COUNT, N = np.inf, 24, 6


pytestmark = pytest.mark.usefixtures("double_precision")


def test_examples_of_its_help():
    """The doctests of the module, which others leave out."""
    assert doctest.testmod(kernel).failed == 0


def families():
    """Arrays of 24 problems with 6 unknowns, and how many at least are solved."""
    rng = np.random.default_rng(0)
    A, q = rng.normal(size=(COUNT, N, N)), rng.normal(size=(COUNT, N))
    dominant = np.where(np.eye(N) > 0, 1.05 * abs(A).sum(-1)[..., None], A)
    half = A[..., : N // 2] @ A[..., : N // 2].transpose(0, 2, 1)
    z = np.maximum(rng.normal(size=(COUNT, N)).round(), 0.0)
    w = np.where((z == 0.0) & (q > 0.0), 1.0, 0.0)
    blocks = A @ A.transpose(0, 2, 1) * (np.arange(N)[:, None] // 3 == np.arange(N) // 3)
    plane = np.eye(N) * 2.0
    plane[:3, 5], plane[5, :3], plane[5, 5] = 1.0, -1.0, 0.0
    free = np.array([0, 0, 0, 0, 0, -INF])
    return {
        "boxes": ((planted(COUNT, N, 3)), COUNT),
        "H+": ((dominant, q, 0.0, INF), COUNT),
        "P": ((np.linalg.solve(dominant, dominant[::-1]), q, 0.0, INF), COUNT - 1),
        "semidefinite and degenerate": ((half, w - (half @ z[..., None])[..., 0], 0.0, INF), COUNT),
        "two parts": ((blocks + np.eye(N), np.where(np.arange(N) < 3, abs(q), q), 0.0, INF), COUNT),
        "an equation": ((plane, q + 3.0 * (free < 0.0), free, INF), COUNT),
        "infeasible": ((-abs(A), -abs(q) - 0.1, 0.0, INF), 0),
        "random": ((A, q, 0.0, INF), 1),
    }


@pytest.mark.parametrize("kind", [np.float64, np.float32])
def test_is_solved_is_a_proof(kind):
    """`certify` proves each point with is_solved at the tolerance of the type; no z is NaN; enough are solved."""
    solve_all, tolerance = jax.jit(solve_lcp), {np.float64: 1e-8, np.float32: 1e-3}[kind]
    for name, ((M, *vectors), least) in families().items():
        arrays = [np.broadcast_to(M, (COUNT, N, N)).astype(kind)]
        arrays += [np.broadcast_to(x, (COUNT, N)).astype(kind) for x in vectors]
        z, is_solved = map(np.asarray, solve_all(*arrays))
        assert z.dtype == kind
        assert np.isfinite(z).all()
        assert not z[~is_solved].any()
        assert is_solved.sum() >= (least if kind is np.float64 else least // 2), name
        for k in np.flatnonzero(is_solved):
            A, q, lower, upper = (array[k].astype(float) for array in arrays)
            found = certify(
                LCP(A, q, lower=lower, upper=upper), z[k].astype(float), tolerance=tolerance
            )
            assert found.verdict == "proved", (name, k)


def test_the_test_accepts_no_wrong_point():
    """Disturbed solutions, other active sets, points outside of bounds, subnormal data: none is accepted."""
    M, q, lower, upper = planted(COUNT, N, 3)
    z = np.asarray(solve_lcp(M, q, lower, upper)[0])
    moved = z + 1e-5 * np.random.default_rng(1).normal(size=z.shape)
    arrays = [jnp.moveaxis(jnp.asarray(x), 0, -1) for x in (M, q, lower, upper)]
    accepted = jax.jit(kernel._accepted)
    assert (accepted(*arrays, jnp.asarray(z.T), 1e-8)[1] < 1e-8).all()
    for wrong in (moved, -z, z + 1.0, np.full_like(z, np.nan), 0.0 * z):
        at, bound = map(np.asarray, accepted(*arrays, jnp.asarray(wrong.T), 1e-8))
        for k in np.flatnonzero(bound < INF):
            problem = LCP(M[k], q[k], lower=lower[k], upper=upper[k])
            assert certify(problem, at[:, k], tolerance=1e-8).verdict == "proved"
    assert not solve_lcp(np.eye(2), np.array([-1.0, 1e-310]))[1]
    assert not solve_lcp(np.eye(2), np.array([-1.0, np.nan]))[1]
    assert not jax.jit(solve_lcp)(np.eye(2), np.ones(2), 1.0, 0.0)[1]


def test_derivatives_are_those_of_derivative_and_of_differences():
    """In M, q and both bounds, forward and backward, mapped and compiled; 0 for a problem without a solution."""
    M, q, lower, upper = planted(3, N, 7)
    weights = np.random.default_rng(0).normal(size=N)
    loss = lambda *data: solve_lcp(*data)[0] @ weights  # noqa: E731
    mapped = jax.jit(jax.vmap(jax.grad(loss, (0, 1, 2, 3))))(M, q, lower, upper)
    forward = jax.jit(jax.vmap(jax.jacfwd(loss, 1)))(M, q, lower, upper)
    for k in range(3):
        problem = LCP(M[k], q[k], lower=lower[k], upper=upper[k])
        gradient = derivative(solve(problem)).vjp(weights)
        for ours, name in zip(mapped, ("M", "q", "lower", "upper"), strict=True):
            exact = getattr(gradient, name)
            exact = exact.toarray() if name == "M" else exact
            np.testing.assert_allclose(ours[k], exact, rtol=1e-9, atol=1e-11)
        np.testing.assert_allclose(forward[k], gradient.q, rtol=1e-9, atol=1e-11)
        dq, h = np.random.default_rng(k).normal(size=N), 1e-6
        ends = [solve(problem.with_q(q[k] + s * h * dq)).z @ weights for s in (1.0, -1.0)]
        np.testing.assert_allclose((ends[0] - ends[1]) / (2 * h), gradient.q @ dq, rtol=1e-6)
    wrong = jax.grad(lambda M, q: solve_lcp(M, q)[0].sum(), (0, 1))
    for A, b in ((-np.eye(2), -np.ones(2)), (np.full((2, 2), np.nan), np.ones(2))):
        assert not any(np.any(x) for x in wrong(jnp.asarray(A), jnp.asarray(b)))


def test_at_a_degenerate_row_the_derivative_is_that_of_derivative():
    """With w = 0 at a bound the row stays there, unless the free block is singular without it."""
    for M, q in (([[2.0, 1.0], [1.0, 2.0]], [-2.0, -1.0]), ([[0.0, 1.0], [-1.0, 0.0]], [0.0, 1.0])):
        found = derivative(solve(LCP(M, q))).vjp(np.ones(2))
        by_M, by_q = jax.grad(lambda M, q: solve_lcp(M, q)[0].sum(), (0, 1))(
            jnp.array(M), jnp.array(q)
        )
        np.testing.assert_allclose(by_q, found.q, atol=1e-12)
        np.testing.assert_allclose(by_M, found.M.toarray(), atol=1e-12)


def test_transformations_need_no_callback():
    """jit(vmap(grad)), a scan of 200 steps, jacfwd of the layers within jit, a hessian: their text has no callback."""
    M, q = jnp.array([[2.0, 1.0], [1.0, 2.0]]), jnp.array([[-5.0, 1.0], [1.0, -4.0]])

    def trajectory(x):
        step = lambda x, _: (0.9 * x + solve_lcp(M, x)[0], None)  # noqa: E731
        return jax.lax.scan(step, x, None, length=200)[0].sum()

    def program(c):
        return qp_layer(jnp.eye(2), c, jnp.ones((1, 2)), jnp.array([2.0])).sum()

    functions = (
        jax.jit(jax.vmap(jax.grad(lambda q: solve_lcp(M, q)[0].sum()))),
        jax.jit(jax.vmap(jax.grad(trajectory))),
        jax.jit(jax.jacfwd(lambda q: lcp_layer(M, q))),
        jax.jit(jax.vmap(jax.jacfwd(program))),
        jax.jit(jax.hessian(lambda q: (solve_lcp(M, q)[0] ** 2).sum())),
    )
    for function in functions:
        assert "callback" not in str(jax.make_jaxpr(function)(q))
        assert np.isfinite(function(q)).all()
    x = q[0]
    for _ in range(200):
        x = 0.9 * x + solve(LCP(M, x)).z
    np.testing.assert_allclose(trajectory(q[0]), x.sum(), rtol=1e-9, atol=1e-12)


def test_layers_within_jit_solve_as_on_the_host():
    """Programs with rows, equations and bounds; what is not solved, or not convex, is NaN, masked or the host's."""
    P, c = jnp.diag(jnp.array([1.0, 2.0, 3.0])), jnp.array([[-1.0, -2.0, 1.0], [3.0, -2.0, -1.0]])
    rows = jnp.ones((1, 3)), jnp.array([1.0]), jnp.array([[1.0, -1.0, 0.0]]), jnp.zeros(1)
    layer = lambda P, c, **options: qp_layer(P, c, *rows, lower=0.0, **options)  # noqa: E731
    found = jax.jit(lambda c: layer(P, c))(c)
    np.testing.assert_allclose(found, layer(P, c), rtol=1e-6, atol=1e-8)
    x, is_solved = jax.jit(lambda P: layer(P, c, mask=True))(-P)
    assert not is_solved.any()
    assert not x.any()
    assert np.isnan(jax.jit(lambda P: layer(P, c))(-P)).all()
    M = jnp.stack([jnp.eye(2), -jnp.eye(2)])
    on_host = jax.jit(lambda q: lcp_layer(M[:1], q, fallback="host"))
    assert on_host(-jnp.ones(2)).tolist() == [[1.0, 1.0]]
    with pytest.raises(Exception, match="NotConverged: the layer found no solution"):
        jax.block_until_ready(jax.jit(lambda M: lcp_layer(M, -jnp.ones(2), fallback="host"))(M))
    with pytest.raises(InvalidOption, match="fallback must be"):
        lcp_layer(M, -jnp.ones(2), fallback="gpu")


def test_solve_batch_of_jax_arrays_returns_jax_arrays(monkeypatch):
    """Solved on their device, in several parts; what is not comes back with the host's status and errors."""
    M, q, lower, upper = planted(COUNT, N, 3)
    M, q = M.copy(), q.copy()
    M[2], q[5, 0] = -np.eye(N), np.nan
    lower[2], upper[2], q[2] = 0.0, INF, -1.0
    monkeypatch.setattr("lcp_plugin.problems.batches.jax_arrays.LARGEST_PART", 8 * N**2)
    found = solve_batch(*map(jnp.asarray, (M, q)), lower=jnp.asarray(lower), upper=upper)
    ours = solve_batch(M, q, lower=lower, upper=upper)
    assert isinstance(found.z, jax.Array)
    assert list(found.status) == list(ours.status)
    np.testing.assert_allclose(found.z, ours.z, rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose(found.w, ours.w, rtol=1e-9, atol=1e-11)
    assert found[0].is_solved
    assert found[2].status is ours[2].status
    with pytest.raises(InvalidProblem, match=r"q\[0\] = nan"):
        found[5]
    assert found.errors.keys() == {5}
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(found)).z, found.z)
    by, ours = (
        derivative(found).vjp(jnp.ones((COUNT, N))).q,
        derivative(ours).vjp(np.ones((COUNT, N))).q,
    )
    np.testing.assert_allclose(by, ours, rtol=1e-9, atol=1e-11)


def test_solve_batch_of_a_problem_takes_its_vectors_from_jax():
    """As q of an LCP, of a prepared LCP, and as the costs of a program."""
    M, q = np.array([[2.0, 1.0], [1.0, 2.0]]), jnp.array([[-5.0, 1.0], [1.0, 1.0]])
    for stated in (LCP(M, q[0]), prepare(LCP(M, q[0])), QuadraticProgram(M, q[0], lower=0)):
        np.testing.assert_allclose(solve_batch(stated, q).x, [[2.5, 0.0], [0.0, 0.0]], atol=1e-8)


def test_lists_are_double_precision_and_a_batch_may_be_empty():
    """Python numbers are not rounded to single precision; also an empty mapped axis has a result."""
    assert solve_lcp([[2, 1], [1, 2]], [-5, 1])[0].dtype == np.float64
    assert solve_lcp(jnp.eye(2), jnp.zeros((0, 2)))[0].shape == (0, 2)
    assert jax.vmap(lambda q: solve_lcp(jnp.eye(2), q)[0])(jnp.zeros((0, 2))).shape == (0, 2)


def test_extreme_data_are_not_decided():
    """If q / m underflows, z = 0 would pass; a tolerance of 1 or more is refused."""
    for M, q, dtype in ((2e30, -1e-300, np.float64), (2e30, -3e-30, np.float32)):
        assert not solve_lcp(jnp.array([[M]], dtype), jnp.array([q], dtype))[1]
    with pytest.raises(InvalidOption, match="less than 1"):
        solve_lcp(jnp.eye(1), jnp.ones(1), tolerance=2.0)


def test_slacks_of_single_precision_arrays_are_double():
    """Without x64 in JAX, w = M z + q is computed from doubles: 1e-9 next to 1 is not lost."""
    jax.config.update("jax_enable_x64", False)
    found = solve_batch(jnp.eye(2), np.array([[-1.0, 1.0 + 1e-9]]))
    np.testing.assert_allclose(found.w, [[0.0, 1.0 + 1e-9]], rtol=0, atol=1e-15)


@refusals(r"""
jax.jit(solve_batch)(M, q) → InvalidProblem: there call solve_lcp
solve_batch(M, q[:1]) → InvalidProblem: q must have shape
solve_lcp(np.eye(129), np.ones(129)) → InvalidProblem: 1 ≤ n ≤ 128
solve_lcp(M, 1j * q) → InvalidProblem: got complex
solve_batch(1j * M, q) → InvalidProblem: got complex
solve_batch(M, 1j * q) → InvalidProblem: got complex
jax.jit(lambda q: solve_batch(LCP(np.eye(2), np.ones(2)), q))(q) → InvalidProblem: q must have shape .* traced array
solve_lcp(LCP(M, q), q) → InvalidProblem: M must be an array
solve_lcp(sp.csr_array(M), q) → InvalidProblem: use \.toarray
solve_lcp(M, q, 1.0, 0.0) → InvalidProblem: lower exceeds upper
solve_lcp(M, q, "a") → InvalidProblem: lower must be an array
solve_lcp(M, q, tolerance="a") → InvalidOption: tolerance must be
solve_lcp(M) → InvalidOption: missing
solve_lcp(M, q, lowr=0) → InvalidOption: did you mean 'lower'
jax.jit(lambda q: lcp_layer(M, q, tolerance=-1.0))(q) → InvalidOption: got -1
lcp_layer(M, q, foo=1) → InvalidOption: no option 'foo'
""")
def test_what_arrays_of_jax_do_not_have_is_refused(call, words):
    """Options of the host, arrays without values, other shapes, types and arguments; not by a raw error of JAX."""
    assert_refused(call, words, {**globals(), "M": jnp.eye(2), "q": -jnp.ones(2)})
