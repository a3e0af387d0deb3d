"""Bodies stated by sparse matrices: the same contacts as by dense ones, and nothing of them dense."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from tools.refusals import assert_refused, refusals

from lcp_plugin import FrictionalContact, InvalidProblem, solve


def scene(bodies: int, contacts: int, seed: int = 0) -> tuple[Any, Any, Any, Any]:
    """Masses and inertias, normals, tangents (2 k, v), velocities, of bodies that each touch some with near numbers."""
    rng = np.random.default_rng(seed)
    spread = rng.normal(size=(bodies, 3, 3))
    inertia = 0.1 * np.eye(3) + 0.02 * spread @ np.swapaxes(spread, 1, 2)
    mass = sp.block_diag(
        [
            part
            for m, own in zip(rng.uniform(1, 3, bodies), inertia, strict=True)
            for part in (sp.csr_array(m * np.eye(3)), sp.csr_array(own))
        ],
        format="csr",
    )
    frames = np.linalg.qr(rng.normal(size=(contacts, 3, 3)))[0]
    J = sp.lil_array((3 * contacts, 6 * bodies))
    first = rng.integers(bodies, size=contacts)
    second = (first + rng.integers(1, min(bodies, 9), size=contacts)) % bodies
    for c in range(contacts):
        for body, sign in ((first[c], 1.0), (second[c], -1.0)):
            arm = rng.normal(size=3)
            J[3 * c : 3 * c + 3, 6 * body : 6 * body + 6] = sign * np.hstack(
                [frames[c], np.cross(arm, frames[c])]
            )
    J = sp.csr_array(J)
    normals = np.arange(3 * contacts) % 3 == 0
    return (
        sp.csr_array(mass),
        J[np.flatnonzero(normals)],
        J[np.flatnonzero(~normals)],
        rng.normal(size=6 * bodies),
    )


def test_sparse_and_dense_bodies_state_the_same_contacts():
    """W, b, the motion and the bodies' velocities agree; of W given sparse bodies only what is not 0 is kept."""
    mass, normals, tangents, velocities = scene(20, 40)
    whole = mass.toarray(), normals.toarray(), tangents.toarray().reshape(40, 2, -1)
    dense = FrictionalContact(whole, velocities, 0.5)
    for given in (tangents, tangents.toarray(), tangents.toarray().reshape(40, 2, -1)):
        problem = FrictionalContact((mass, normals, given), velocities, 0.5)
        assert sp.issparse(problem.W)
        np.testing.assert_allclose(problem.W.toarray(), dense.W.toarray(), atol=1e-12)
        np.testing.assert_allclose(problem.b, dense.b, atol=1e-12)
    one, other = solve(problem), solve(dense)
    np.testing.assert_allclose(one.motion.body_velocities, other.motion.body_velocities, atol=1e-6)
    np.testing.assert_allclose(
        one.motion.body_velocities,
        velocities + np.linalg.solve(mass.toarray(), problem.bodies.rows.T @ one.z),
        atol=1e-12,
    )


@pytest.mark.full
def test_3_000_contacts_of_1_000_bodies_stay_sparse():
    """A dense W would have 81 million entries; this one has as many as contacts share bodies."""
    mass, normals, tangents, velocities = scene(1000, 3000)
    problem = FrictionalContact((mass, normals, tangents), velocities, 0.5)
    assert problem.n == 9000
    assert problem.nonzeros < 400_000
    result = solve(problem, tolerance=1e-6)
    assert result.is_solved
    assert result.motion.body_velocities.shape == (6000,)


MASS, NORMALS, TANGENTS, VELOCITIES = scene(4, 5)


@refusals(r"""
FrictionalContact((MASS, NORMALS, TANGENTS[:7]), VELOCITIES, 0.5)
    → tangents must have shape \(k, t, 24\) or \(t k, 24\), t = 2
FrictionalContact((MASS, NORMALS[:, :9], TANGENTS), VELOCITIES, 0.5)
    → normals must be a real matrix with 24 columns, got
FrictionalContact((-MASS, NORMALS, TANGENTS), VELOCITIES, 0.5) → the mass matrix must be positive definite
FrictionalContact((MASS[:, :9], NORMALS, TANGENTS), VELOCITIES, 0.5)
    → the mass matrix must be square, got shape \(24, 9\)
FrictionalContact((MASS, 2.0 * NORMALS, TANGENTS), VELOCITIES, 0.5) → must be orthogonal unit vectors, but contact 0
FrictionalContact((MASS, NORMALS), VELOCITIES, 0.5)
    → contacts must be W, or \(mass matrix, normals, tangents\), got 2 arrays
FrictionalContact((MASS + sp.eye_array(24, k=1), NORMALS, TANGENTS), VELOCITIES, 0.5)
    → the mass matrix must be symmetric
FrictionalContact((MASS * np.nan, NORMALS, TANGENTS), VELOCITIES, 0.5) → the mass matrix must be finite
""")
def test_what_does_not_fit_is_refused_in_words(call, words):
    """Shapes, definiteness, directions, numbers."""
    assert_refused(call, words, globals(), InvalidProblem)


def test_a_contact_that_no_impulse_moves_may_be_one_of_many():
    """A sparse W beyond the dense sizes may have a contact without entries: it opens, and the others slide."""
    count = 120
    diagonal = np.ones(3 * count)
    diagonal[30:33] = 0.0
    b = np.tile([-1.0, 3.0, 4.0], (count, 1))
    b[10] = 1.0, 0.0, 0.0
    motion = solve(FrictionalContact(sp.diags_array(diagonal, format="csr"), b, 0.5)).motion
    np.testing.assert_array_equal(motion.touches, np.arange(count) != 10)
    np.testing.assert_allclose(motion.tangential[0], [-0.3, -0.4], atol=1e-12)
