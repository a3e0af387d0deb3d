"""Contact with friction from the collection of Siconos: the laws themselves, by every way in."""

from __future__ import annotations

from typing import Any

import cvxpy as cp
import numpy as np
import pytest
import scipy.sparse as sp
from inputs.published_problems import CONTACTS, errors_of_contact, read

from lcp_plugin import FrictionalContact, complements, friction_cone, solve, solve_batch

TOLERANCE = 1e-6
Published = dict[str, Any]


def sparse(of: Published) -> np.ndarray:
    return solve(FrictionalContact(of["M"], of["q"], of["mu"])).x


def dense(of: Published) -> np.ndarray:
    return solve(FrictionalContact(of["M"].toarray(), of["q"], of["mu"])).x


def in_a_batch(of: Published) -> np.ndarray:
    """Beside itself at a millionth of the velocities."""
    found = solve_batch(
        [FrictionalContact(of["M"], scale * of["q"], of["mu"]) for scale in (1.0, 1e-6)]
    )
    assert errors_of_contact({**of, "q": 1e-6 * of["q"]}, found[1].x) <= TOLERANCE
    return found[0].x


def in_cvxpy(of: Published) -> np.ndarray:
    r = cp.Variable(of["q"].size)
    cp.Problem(
        cp.Minimize(0), [complements(friction_cone(r, of["mu"]), of["M"] @ r + of["q"])]
    ).solve(method="LCP")
    return r.value


@pytest.mark.quick(2)
@pytest.mark.parametrize("way", [sparse, dense, in_a_batch, in_cvxpy])
@pytest.mark.parametrize("name", CONTACTS)
def test_the_laws_of_contact_and_friction_hold(name, way):
    """Impulses in their cones, velocities that do not close, no power but of sliding: in every contact."""
    of = read(f"fc3d_{name}")
    assert errors_of_contact(of, way(of)) <= TOLERANCE


@pytest.mark.quick(1)
@pytest.mark.parametrize("ratio", [1.0, 1e-7])
@pytest.mark.parametrize("other", CONTACTS)
@pytest.mark.parametrize("name", CONTACTS)
def test_two_groups_in_one_problem_are_right_each(name, other, ratio):
    """Neither touches the other: each is right by its own velocities, 1e-7 times the other's or not."""
    groups = [read(f"fc3d_{name}"), read(f"fc3d_{other}")]
    groups[1]["q"] = ratio * groups[1]["q"]
    W = sp.block_diag([sp.csr_array(of["M"]) for of in groups], format="csr")
    q, mu = (np.concatenate([of[key] for of in groups]) for key in ("q", "mu"))
    found = np.split(solve(FrictionalContact(W, q, mu)).x, [groups[0]["q"].size])
    assert max(errors_of_contact(of, r) for of, r in zip(groups, found, strict=True)) <= TOLERANCE
