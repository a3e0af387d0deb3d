"""Checks that test_certificates.py runs under MPI."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from checks import check, run_checks

from lcp_plugin import LCP, Certificate, error_bound
from lcp_plugin.core.certificates.criterion import reference_residual
from lcp_plugin.core.certificates.residuals import MEASURED
from lcp_plugin.core.errors import UnsuitableMatrix
from lcp_plugin.proofs.verdicts import comparison_certificate

NUMBERS = (
    "scaled_residual",
    "relative_residual",
    "natural_residual",
    "euclidean_residual",
    "bound_violation",
    "complementarity",
)


def problem(rng: np.random.Generator, n: int) -> LCP:
    """A problem with boxes, one-sided and free rows, a nonsymmetric M, some diagonals negligible."""
    M = sp.random_array(
        (n, n), density=min(1.0, 4.0 / max(n, 1)), rng=rng, format="csr", data_sampler=rng.normal
    )
    M = sp.csr_array(M + sp.diags_array(np.where(rng.random(n) < 0.9, 3.0, 0.0)))
    lower = np.where(rng.random(n) < 0.3, -np.inf, rng.normal(size=n))
    upper = np.where(
        rng.random(n) < 0.4, np.inf, np.where(np.isfinite(lower), lower + rng.random(n), 1.0)
    )
    return LCP(M, rng.normal(size=n), lower=lower, upper=upper)


def own_part(parts: LCP, vector: Any) -> Any:
    """The part of a whole vector that belongs to this rank."""
    return vector[parts.first : parts.last]


def require_same_on_all(comm: Any, judged: Any) -> None:
    """Every number of a certificate, not its own rows, is the same on every rank, bit for bit."""
    numbers = [
        repr(getattr(judged, name)) for name in MEASURED if name not in ("w", "term_residuals")
    ]
    assert len(set(comm.allgather(tuple(numbers)))) == 1


def require_equal(comm: Any, whole: LCP, z: Any) -> None:
    """The certificate of the parts is that of the whole, but for the order of sums."""
    parts = LCP.from_problem(whole, comm)
    judged, truth = Certificate.of(parts, own_part(parts, z)), Certificate.of(whole, z)
    require_same_on_all(comm, judged)
    size = float(
        np.nan_to_num(np.abs(whole.csr) @ np.abs(z) + np.abs(whole.q), posinf=0.0).max(initial=1.0)
    )
    for name in NUMBERS:
        own, other = getattr(judged, name), getattr(truth, name)
        slack = {
            "relative_residual": 1.0 / (reference_residual(whole) or 1.0),
            "complementarity": size,
        }.get(name, 1.0)
        assert np.isclose(own, other, rtol=1e-13, atol=1e-14 * size * slack, equal_nan=True), (
            name,
            own,
            other,
            z,
        )
    assert np.allclose(
        judged.w, own_part(parts, truth.w), rtol=1e-13, atol=1e-14 * size, equal_nan=True
    )
    assert np.array_equal(judged.z, own_part(parts, z), equal_nan=True)
    assert judged.is_at_rounding_level == truth.is_at_rounding_level
    if (
        not truth.scaled_residual <= 1e-9 * size or not whole.n
    ):  # else rounding says which row is the worst
        assert judged.worst_index == truth.worst_index
    if np.isfinite(z).all() and truth.scaled_residual > 1e-9 * size:
        own, other = (
            [line.split("  (") for line in str(each).splitlines()] for each in (judged, truth)
        )
        assert [line[0] for line in own] == [line[0] for line in other]
        assert [len(line) for line in own] == [
            len(line) for line in other
        ]  # on ranks a remark names no row


@check(1, 2, 3, 4)
@np.errstate(all="ignore")
def certificates_are_those_of_the_whole_problem(comm: Any) -> None:
    """All residuals, the worst row and the rounding level agree for points near, far, NaN and infinite."""
    for seed in range(30):
        rng = np.random.default_rng(seed)
        n = int(rng.integers(0, 25)) if seed else 0
        whole = problem(rng, n)
        points = [
            rng.normal(size=n),
            1e8 * rng.normal(size=n),
            np.zeros(n),
            np.array(whole.nearest_to_zero),
        ]
        for wrong in (np.nan, np.inf, -np.inf, 1e308):
            z = rng.normal(size=n)
            z[rng.integers(0, n, min(n, 1))] = wrong
            points.append(z)
        for z in points:
            require_equal(comm, whole, z)


@check(1, 2, 3, 4)
def a_residual_that_rounding_hides_is_seen_on_all_ranks(comm: Any) -> None:
    """Where the products of one rank cancel, all rows are judged by their proved enclosure, as on one process."""
    n = 8
    M = np.eye(n)
    M[6, 6:], M[7, 6:] = [0.1, 0.3], [0.2, 0.6]
    z, q = np.full(n, 1e-6), np.full(n, -1e-6)
    z[6:], q[6:] = [3e9, -1e9], 0.0
    whole = LCP(sp.csr_array(M), q, lower=-np.inf)
    require_equal(comm, whole, z)
    truth = Certificate.of(whole, z)
    assert truth.scaled_residual == 0.0 < truth.relative_residual
    parts = LCP.from_problem(whole, comm)
    assert Certificate.of(parts, own_part(parts, z)).relative_residual == truth.relative_residual


def h_plus_matrix(rng: np.random.Generator, n: int) -> Any:
    """An H₊-matrix of small whole numbers, dominant after a scaling of its columns by powers of two."""
    M = rng.integers(-3, 4, (n, n)) * (rng.random((n, n)) < 0.4)
    np.fill_diagonal(M, 0)
    np.fill_diagonal(M, np.abs(M).sum(axis=1) + rng.integers(1, 3, n))
    return M * 2.0 ** rng.integers(0, 4, n)


def answered(rng: np.random.Generator, n: int) -> tuple[LCP, Any]:
    """A problem with a known exact solution: all numbers are whole, so q = w* − M z* is exact."""
    M, z = h_plus_matrix(rng, n), rng.integers(-8, 9, n).astype(float)
    state = rng.integers(0, 4, n)  # at lower, at upper, between, free
    w = np.where(
        state == 0, rng.integers(0, 5, n), np.where(state == 1, -rng.integers(0, 5, n), 0)
    ).astype(float)
    lower = np.where(state == 0, z, np.where(state == 3, -np.inf, z - rng.integers(1, 9, n)))
    upper = np.where(state == 1, z, np.where(state == 3, np.inf, z + rng.integers(1, 9, n)))
    return LCP(sp.csr_array(M), w - M @ z, lower=lower, upper=upper), z


@check(1, 2, 3, 4)
def error_bounds_are_rigorous(comm: Any) -> None:
    """|z − z*| ≤ the bound in fractions, for random H₊-matrices and any z; what is proven active or not is so."""
    for seed in range(40):
        rng = np.random.default_rng(seed)
        n = int(rng.integers(1, 14))
        whole, exact = answered(rng, n)
        parts = LCP.from_problem(whole, comm)
        own_exact = own_part(parts, exact)
        z = exact + 10.0 ** rng.integers(-17, 9) * rng.normal(size=n) * (rng.random(n) < 0.7)
        bound = error_bound(parts, own_part(parts, z))
        for near, far, most in zip(own_part(parts, z), own_exact, bound.componentwise, strict=True):
            assert abs(Fraction(near) - Fraction(far)) <= Fraction(most)
        error = max(
            (abs(Fraction(a) - Fraction(b)) for a, b in zip(z, exact, strict=True)),
            default=Fraction(0),
        )
        assert error <= Fraction(bound.infinity)
        assert bound.relative == np.inf or error <= Fraction(bound.relative) * Fraction(
            float(np.abs(z).max())
        )
        assert bound.infinity <= 1e6 * max(float(error), 1e-12)
        is_active = (own_exact == parts.lower) | (own_exact == parts.upper)
        assert is_active[bound.proven_active].all()
        assert not is_active[bound.proven_inactive].any()
        told = (bound.infinity, bound.relative, bound.n, bound.is_active_set_proven, str(bound))
        assert len(set(comm.allgather(told))) == 1
        assert bound.n == n
        counts = comm.allgather((bound.proven_active.sum(), bound.proven_inactive.sum()))
        assert (bound.active, bound.inactive) == tuple(map(sum, zip(*counts, strict=True)))


@check(1, 2, 3, 4)
def the_bound_of_a_point_that_is_not_finite_is_infinite(comm: Any) -> None:
    """NaN or ∞ on one rank: the bound is ∞ on all, and only what bounds alone prove is proven."""
    whole, exact = answered(np.random.default_rng(5), 9)
    parts = LCP.from_problem(whole, comm)
    for wrong in (np.nan, np.inf):
        z = exact.copy()
        z[0] = wrong
        bound = error_bound(parts, own_part(parts, z))
        assert bound.infinity == bound.relative == np.inf
        assert np.array_equal(bound.proven_inactive, np.isinf(parts.lower) & np.isinf(parts.upper))


@check(1, 2, 3, 4)
def the_exact_solution_has_the_bound_zero(comm: Any) -> None:
    """Where nothing is rounded the bound of z* is 0, and so is the relative one, even where z* = 0."""
    whole, exact = answered(np.random.default_rng(6), 9)
    for given, z in (
        (whole, exact),
        (LCP(whole.csr, np.ones(9)), np.zeros(9)),
        (LCP(sp.csr_array((0, 0)), []), []),
    ):
        parts = LCP.from_problem(given, comm)
        bound = error_bound(parts, np.asarray(own_part(parts, z)))
        assert (bound.infinity, bound.relative) == (0.0, 0.0)


@check(1, 2, 3, 4)
def what_is_not_h_plus_gets_no_bound_and_a_reason(comm: Any) -> None:
    """A diagonal entry that is not positive, or couplings too strong: UnsuitableMatrix, the same on all ranks."""
    strong = np.full((6, 6), 1.0) + np.eye(6)  # positive definite, not H₊
    negative = np.eye(6)
    negative[5, 5] = -1.0
    for M in (strong, negative, np.zeros((6, 6))):
        parts = LCP.from_problem(LCP(sp.csr_array(M), np.ones(6)), comm)
        assert comparison_certificate(parts.matrix) is None
        with pytest.raises(UnsuitableMatrix, match="H₊") as caught:
            error_bound(parts, np.zeros(parts.last - parts.first))
        assert len(set(comm.allgather(str(caught.value)))) == 1


if __name__ == "__main__":
    run_checks()
