"""A life with one problem: whatever is done in whatever order, answers stay right and bits those of a fresh start."""

from __future__ import annotations

import copy
import pickle
import tempfile
from contextlib import suppress
from pathlib import Path

import numpy as np
import scipy.sparse as sp
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule
from inputs.families import BOUNDED
from oracles.relations import bits, data_of, surroundings

from lcp_plugin import LCP, Status, analyze, convergence_guarantee, error_bound, prepare, solve

with suppress(ImportError):  # its import sets a variable of the environment
    import threadpoolctl  # noqa: F401

SEEDS = st.integers(0, 2**32 - 1)
NAMES = ["auto", *BOUNDED]
ACCURACY = 1e-6


class Life(RuleBasedStateMachine):
    """One matrix of the caller, many q, and everything that can be asked of them."""

    @initialize(seed=SEEDS, n=st.integers(1, 6), is_sparse=st.booleans())
    def state(self, seed: int, n: int, is_sparse: bool) -> None:
        rng = np.random.default_rng(seed)
        M = rng.integers(-3, 4, (n, n)) * (rng.random((n, n)) < 0.6).astype(float)
        np.fill_diagonal(M, 0.0)
        np.fill_diagonal(M, abs(M).sum(axis=1) + rng.integers(1, 4, n))
        self.M = sp.csr_array(M) if is_sparse else M
        self.matrix, self.around = bits(self.M), surroundings()
        self.problem = LCP(self.M, np.zeros(n))
        self.truth = np.zeros(n)
        self.last: np.ndarray | None = None
        self.plant(seed)

    @rule(seed=SEEDS)
    def plant(self, seed: int) -> None:
        """Another q, and often other bounds: rows of every kind, active, inactive and degenerate."""
        rng, n = np.random.default_rng(seed), self.problem.n
        z = rng.integers(-3, 4, n).astype(float)
        below, above = rng.choice([0.0, 1.0, np.inf], (2, n))
        lower, upper = z - below, z + above
        sign = np.where(lower == upper, rng.choice([-1, 1], n), (z == lower) * 1.0 - (z == upper))
        q = sign * rng.integers(0, 3, n) - self.problem.csr @ z
        given = bits(q, lower, upper)
        self.problem = self.problem.with_q(q, lower=lower, upper=upper)
        self.truth = z
        assert bits(q, lower, upper) == given

    def fresh(self) -> LCP:
        """The same problem, stated anew from copies."""
        p = self.problem
        return LCP(p.M.copy(), p.q.copy(), lower=p.lower.copy(), upper=p.upper.copy())

    def check(self, z: np.ndarray) -> None:
        assert abs(z - self.truth).max() <= ACCURACY * (1.0 + abs(self.truth).max())

    @rule(name=st.sampled_from(NAMES), is_warm=st.booleans(), record=st.booleans())
    def solve(self, name: str, is_warm: bool, record: bool) -> None:
        """Solved, right, and bit for bit the answer to a fresh problem, warm or cold, recorded or not."""
        z0 = self.last if is_warm else None
        result = solve(self.problem, name, z0=z0, tolerance=1e-10, record=record)
        other = solve(self.fresh(), name, z0=z0, tolerance=1e-10)
        assert bits(result.z, result.w) == bits(other.z, other.w)
        assert (result.status, result.iterations) == (other.status, other.iterations)
        assert result.work <= other.work  # what is shared need not be computed again
        if name != "interior_point":  # H₊-matrices need not be monotone
            assert result.status in (Status.SOLVED, Status.PRECISION_LIMIT)
        if result.is_solved:
            self.check(result.z)
            self.last = result.z

    @rule()
    def prepare(self) -> None:
        self.problem = prepare(self.problem).problem

    @rule()
    def save_and_load(self) -> None:
        """What comes back from a file takes the place of what was saved."""
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "p.npz")
            self.problem.save(path)
            loaded = LCP.load(path)
        assert bits(loaded.csr, loaded.q, loaded.lower, loaded.upper) == bits(
            self.problem.csr, self.problem.q, self.problem.lower, self.problem.upper
        )
        self.problem = loaded.with_q(loaded.q)

    @rule(
        duplicate=st.sampled_from(
            [copy.copy, copy.deepcopy, lambda p: pickle.loads(pickle.dumps(p))]
        )
    )
    def duplicate(self, duplicate: object) -> None:
        before = data_of(self.problem)
        self.problem = duplicate(self.problem)  # type: ignore[operator]
        assert data_of(self.problem) == before

    @rule(name=st.sampled_from(["auto", "npsor", "newton", "lemke"]))
    def solve_with_another_q(self, name: str) -> None:
        """The shared facts about M give the bits of a fresh problem."""
        z = solve(self.problem.with_q(2.0 * self.problem.q), name).z
        assert bits(z) == bits(solve(self.fresh().with_q(2.0 * self.problem.q), name).z)

    @rule()
    def analyze(self) -> None:
        """What is known of the matrix does not depend on what was done before."""
        report, other = analyze(self.problem.M), analyze(self.fresh().M)
        assert report.is_h_plus is True
        assert bits(report.v, report.margin) == bits(other.v, other.margin)
        mine, fresh = (convergence_guarantee(p, "npsor") for p in (self.problem, self.fresh()))
        assert (
            (mine.verdict, mine.rate) == (fresh.verdict, fresh.rate) == ("guaranteed", fresh.rate)
        )

    @rule(seed=SEEDS, sharp=st.booleans())
    def bound(self, seed: int, sharp: bool) -> None:
        """The bound holds, and its bits are those of a fresh problem."""
        z = self.truth + np.random.default_rng(seed).normal(size=self.truth.size)
        bound, other = (error_bound(p, z, sharp=sharp) for p in (self.problem, self.fresh()))
        assert (abs(z - self.truth) <= bound.componentwise * (1.0 + 1e-15)).all()
        assert bits(bound.componentwise, bound.infinity) == bits(
            other.componentwise, other.infinity
        )

    @rule(step=st.integers(0, 3))
    def disturb(self, step: int) -> None:
        """A callback that raises in the middle of a run."""

        def raises(sample: object, z: np.ndarray) -> None:
            if sample.iteration == step:  # type: ignore[attr-defined]
                raise ZeroDivisionError

        with suppress(ZeroDivisionError):
            solve(self.problem, "psor", callback=raises)

    @invariant()
    def nothing_of_the_caller_has_changed(self) -> None:
        if hasattr(self, "matrix"):
            assert bits(self.M) == self.matrix
            assert surroundings() == self.around


Life.TestCase.settings = settings(settings.get_profile("few"), stateful_step_count=10)
TestLife = Life.TestCase
