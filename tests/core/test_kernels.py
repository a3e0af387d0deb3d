"""The compiled sweeps against their formulas written out row by row on dense arrays."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.sparse as sp
from fresh_process import printed_by
from numpy.testing import assert_allclose

from lcp_plugin import LCP, Certificate, gallery
from lcp_plugin.algorithms import REGISTRY, create
from lcp_plugin.core.kernels import splitting_sweeps as kernels

WIDTHS = [np.int32, np.int64]
DIRECTIONS = pytest.mark.parametrize("backward", [False, True], ids=["forward", "backward"])


# --- The formulas, literally -------------------------------------------------------------------------------


def clamp(value: float, lower: float, upper: float) -> float:
    return min(max(value, lower), upper)


def row_order(n: int, backward: bool) -> range:
    return range(n - 1, -1, -1) if backward else range(n)


def splitting_sweep(
    M: np.ndarray, rows: np.ndarray, coupling: float, projected: bool, backward: bool, z: np.ndarray
) -> tuple[np.ndarray, float]:
    """One sweep of an AOR-type splitting, as the kernel's docstring states it: (new, largest)."""
    new, largest = z.copy(), 0.0  # as long as row j has not been done, new_j − z_j = 0
    for i in row_order(len(z), backward):
        q, lower, upper, inverse_scale, step, inverse_pivot = rows[i]
        w = q + M[i] @ z
        c = M[i] @ (new - z)
        r = z[i] - clamp(z[i] - step * w, lower, upper)
        drive = 2.0 * r + coupling * step * c if projected else step * (w + coupling * c)
        new[i] = clamp(z[i] - drive * inverse_pivot, lower, upper)
        largest = max(largest, abs(z[i] - clamp(z[i] - w * inverse_scale, lower, upper)))
    return new, largest


def relaxation_sweep(
    M: np.ndarray, rows: np.ndarray, relaxation: float, backward: bool, z: np.ndarray
) -> tuple[np.ndarray, float, float]:
    """One sweep of projected SOR: (new, largest change, sum of changes)."""
    new = z.copy()
    for i in row_order(len(z), backward):
        q, lower, upper, inverse_scale = rows[i]
        new[i] = clamp(new[i] - relaxation * inverse_scale * (M[i] @ new + q), lower, upper)
    change = abs(new - z)
    return new, change.max(initial=0.0), change.sum()


def modulus_sweep(
    M: np.ndarray, rows: np.ndarray, alpha: float, beta: float, backward: bool, x: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """One modulus sweep: (new, z, largest)."""
    new, positive, largest = x.copy(), np.maximum(x, 0.0), 0.0
    for i in row_order(len(x), backward):
        q, _, inverse_scale, omega, inverse_pivot = rows[i]
        w = M[i] @ positive + q
        c = M[i] @ (new - x)
        new[i] = x[i] - (2.0 * alpha * (w - omega * max(-x[i], 0.0)) + beta * c) * inverse_pivot
        largest = max(largest, abs(min(positive[i], w * inverse_scale)))
    return new, rows[:, 1] + positive, largest


# --- Matrices of every shape -------------------------------------------------------------------------------


@dataclass
class Compressed:
    """A CSR matrix as the kernels take it, and the same one dense."""

    dense: np.ndarray
    arrays: tuple[np.ndarray, np.ndarray, np.ndarray]
    splits: dict[bool, np.ndarray]

    def of(self, backward: bool) -> tuple[np.ndarray, ...]:
        indptr, indices, data = self.arrays
        return indptr, self.splits[backward], indices, data


def compressed(dense: np.ndarray, width: type) -> Compressed:
    matrix = sp.csr_array(dense)
    arrays = (matrix.indptr.astype(width), matrix.indices.astype(width), matrix.data)
    for array in arrays:
        array.flags.writeable = False  # as an LCP keeps them
    given = SimpleNamespace(shape=dense.shape, indptr=arrays[0], indices=arrays[1])
    return Compressed(
        dense, arrays, {way: kernels.row_splits(given, backward=way) for way in (False, True)}
    )


def shapes() -> dict[str, np.ndarray]:
    generator = np.random.default_rng(0)

    def random(n: int, density: float) -> np.ndarray:
        return generator.normal(size=(n, n)) * (generator.random((n, n)) < density)

    no_diagonal = random(12, 0.5)
    np.fill_diagonal(no_diagonal, 0.0)
    empty_rows = random(12, 0.4)
    empty_rows[[0, 5, 11]] = 0.0
    dense_row = random(12, 0.1)
    dense_row[[0, 6, 11]] = generator.normal(size=(3, 12))
    tridiagonal = np.triu(np.tril(random(12, 1.0), 1), -1)
    return {
        "n=0": np.zeros((0, 0)), "n=1": np.array([[2.0]]), "n=1 empty": np.array([[0.0]]), "n=2": random(2, 1.0),
        "sparse": random(15, 0.2), "dense": random(9, 1.0), "no diagonal": no_diagonal, "empty rows": empty_rows,
        "dense rows": dense_row, "tridiagonal": tridiagonal, "lower": np.tril(random(8, 1.0)),
        "upper": np.triu(random(8, 1.0)), "zero": np.zeros((4, 4)),
    }  # fmt: skip


SHAPES = shapes()
EVERY_SHAPE = pytest.mark.parametrize("shape", SHAPES)
EVERY_WIDTH = pytest.mark.parametrize("width", WIDTHS, ids=["int32", "int64"])


def vectors(n: int, seed: int = 0) -> dict[str, np.ndarray]:
    """Anything a row may hold: boxes, half lines, free rows; z on both sides of everything."""
    generator = np.random.default_rng(seed)
    lower, upper = np.sort(generator.normal(size=(2, n)), axis=0)
    lower[generator.random(n) < 0.3] = -np.inf
    upper[generator.random(n) < 0.3] = np.inf
    positive = generator.uniform(0.1, 2.0, size=(4, n))
    names = ("inverse_scale", "step", "inverse_pivot", "omega")
    return {
        "q": generator.normal(size=n), "lower": lower, "upper": upper, "z": 2.0 * generator.normal(size=n),
        **dict(zip(names, positive, strict=True)),
    }  # fmt: skip


def packed(n: int, *names: str, seed: int = 0) -> np.ndarray:
    values = vectors(n, seed)
    return kernels.packed(*(values[name] for name in names))


def close(actual: object, expected: object) -> None:
    assert_allclose(actual, expected, rtol=1e-12, atol=1e-13)


# --- Each sweep --------------------------------------------------------------------------------------------


@EVERY_SHAPE
@EVERY_WIDTH
def test_splits_cut_each_row_at_its_diagonal(shape: str, width: type) -> None:
    """Before the cut stand the columns < i (backward: ≤ i), behind it the rest, stored diagonal or not."""
    matrix = compressed(SHAPES[shape], width)
    indptr, indices, _ = matrix.arrays
    for backward in (False, True):
        split = matrix.splits[backward]
        assert split.dtype == width
        for i in range(len(matrix.dense)):
            before, behind = indices[indptr[i] : split[i]], indices[split[i] : indptr[i + 1]]
            assert all(before <= i) if backward else all(before < i)
            assert all(behind > i) if backward else all(behind >= i)


@EVERY_SHAPE
@EVERY_WIDTH
@DIRECTIONS
@pytest.mark.parametrize("projected", [True, False])
def test_splitting_sweep_is_its_formula(
    shape: str, width: type, backward: bool, projected: bool
) -> None:
    """New iterate and the norm are those of the literal loop; the incoming iterate is left alone."""
    matrix = compressed(SHAPES[shape], width)
    n = len(matrix.dense)
    rows = packed(n, "q", "lower", "upper", "inverse_scale", "step", "inverse_pivot")
    z = vectors(n)["z"]
    before, new = z.copy(), np.full(n, np.nan)
    largest = kernels.splitting_sweep(*matrix.of(backward), rows, 0.7, projected, backward, z, new)
    expected, expected_largest = splitting_sweep(matrix.dense, rows, 0.7, projected, backward, z)
    close(new, expected)
    close(largest, expected_largest)
    assert np.array_equal(z, before)


@EVERY_SHAPE
@EVERY_WIDTH
@DIRECTIONS
def test_relaxation_sweep_is_its_formula(shape: str, width: type, backward: bool) -> None:
    """The iterate in place, its largest and its total change are those of the literal loop."""
    matrix = compressed(SHAPES[shape], width)
    n = len(matrix.dense)
    rows = packed(n, "q", "lower", "upper", "inverse_scale")
    z = vectors(n)["z"]
    expected, *expected_norms = relaxation_sweep(matrix.dense, rows, 1.3, backward, z)
    norms = kernels.relaxation_sweep(*matrix.of(backward), rows, 1.3, backward, z)
    close(z, expected)
    close(norms, expected_norms)


@EVERY_SHAPE
@EVERY_WIDTH
@DIRECTIONS
def test_modulus_sweep_is_its_formula(shape: str, width: type, backward: bool) -> None:
    """New modulus vector, z and the norm are those of the literal loop; the incoming vector is left alone."""
    from lcp_plugin.methods.modulus.kernels.modulus_sweep import modulus_sweep as kernel

    matrix = compressed(SHAPES[shape], width)
    n = len(matrix.dense)
    values = vectors(n)
    lower = np.where(np.isfinite(values["lower"]), values["lower"], 0.5)
    rows = kernels.packed(
        values["q"], lower, values["inverse_scale"], values["omega"], values["inverse_pivot"]
    )
    x = values["z"]
    before, new, z = x.copy(), np.full(n, np.nan), np.full(n, np.nan)
    largest = kernel(*matrix.of(backward), rows, 1.2, 0.6, backward, x, new, z)
    expected, expected_z, expected_largest = modulus_sweep(
        matrix.dense, rows, 1.2, 0.6, backward, x
    )
    close(new, expected)
    close(z, expected_z)
    close(largest, expected_largest)
    assert np.array_equal(x, before)


@DIRECTIONS
def test_sweeps_are_triangular_solves(backward: bool) -> None:
    """Without bounds a sweep with step 1 solves (P + coupling T)(new − z) = −2 w, T the triangle already updated."""
    M = SHAPES["dense"]
    n, matrix = len(M), compressed(M, np.int32)
    values = vectors(n)
    z, pivot = values["z"], 1.0 / values["inverse_pivot"]
    free, ones = np.full(n, np.inf), np.ones(n)
    rows = kernels.packed(values["q"], -free, free, ones, ones, values["inverse_pivot"])
    new = np.empty(n)
    kernels.splitting_sweep(*matrix.of(backward), rows, 0.7, True, backward, z, new)
    triangle = np.triu(M, 1) if backward else np.tril(M, -1)
    w = M @ z + values["q"]
    close(new, z - np.linalg.solve(np.diag(pivot) + 0.7 * triangle, 2.0 * w))


@pytest.mark.parametrize("count", [1, 4, 6])
@pytest.mark.parametrize("n", [0, 1, 7])
def test_packing_puts_vectors_side_by_side(count: int, n: int) -> None:
    """Column k of the packed rows is vector k, from contiguous and strided vectors alike, in C order."""
    columns = np.random.default_rng(1).normal(size=(n, 2 * count))[:, ::2]
    packed_rows = kernels.packed(*columns.T)
    assert packed_rows.flags.c_contiguous
    assert np.array_equal(packed_rows, columns)


# --- What the algorithms make of them ----------------------------------------------------------------------


@pytest.mark.parametrize("name", REGISTRY)
@pytest.mark.parametrize(
    "text", ["random_h_plus:n=60,row_scale=10,column_scale=3", "obstacle_2d:size=8,shifted=true"]
)
def test_residuals_of_steps_are_the_certificate_s(name: str, text: str) -> None:
    """Where a step brings residuals along, they are those of the certificate of its z, at every step."""
    problem = gallery.parse(text).problem
    steps = create(name, {}).iterates(problem, np.ones(problem.n))
    for step in islice(steps, 8):
        certificate = Certificate.of(problem, step.z)
        if name in ("npj", "npgs", "npsor", "npaor"):
            assert step.residual is not None  # of the pass that they make anyway
        if step.residual is not None:
            assert step.residual == pytest.approx(certificate.scaled_residual, rel=1e-11)


@pytest.mark.parametrize("name", REGISTRY)
@pytest.mark.parametrize("kind", [np.asarray, sp.csr_array], ids=["dense", "sparse"])
def test_the_caller_s_arrays_are_never_written(name: str, kind: type) -> None:
    """Matrix, q, bounds and start survive twenty steps and the clean-up bit for bit, and stay writable."""
    scene = gallery.random_h_plus(n=30, row_scale=3, column_scale=3)
    M, q, lower, upper = (
        kind(scene.problem.csr.toarray()),
        scene.problem.q.copy(),
        np.zeros(30),
        np.full(30, np.inf),
    )
    data = [M.data, M.indices, M.indptr] if sp.issparse(M) else [M]
    given = [*data, q, lower, upper]
    before = [array.copy() for array in given]
    problem = LCP(M, q, lower=lower, upper=upper)
    algorithm = create(name, {})
    for step in islice(algorithm.iterates(problem, np.ones(30)), 20):
        z = step.z.copy()
    kept = z.copy()
    algorithm.finish(problem, z)
    assert np.array_equal(z, kept)
    assert all(map(np.array_equal, given, before))
    assert all(array.flags.writeable for array in given)


# --- NaN ---------------------------------------------------------------------------------------------------


@DIRECTIONS
@pytest.mark.parametrize("place", range(5))
def test_nan_survives_every_norm(backward: bool, place: int) -> None:
    """A NaN in any component of the incoming vector makes every norm of every sweep NaN."""
    generator = np.random.default_rng(2)
    matrix = compressed(generator.uniform(1.0, 2.0, size=(5, 5)), np.int32)
    z = generator.uniform(1.0, 2.0, size=5)
    z[place] = np.nan
    ones, zeros, none = np.ones(5), np.zeros(5), np.full(5, np.inf)
    for projected in (True, False):
        rows = kernels.packed(ones, zeros, none, ones, ones, ones)
        assert np.isnan(
            kernels.splitting_sweep(
                *matrix.of(backward), rows, 0.5, projected, backward, z, np.empty(5)
            )
        )
    rows = kernels.packed(ones, zeros, none, ones)
    assert np.isnan(
        kernels.relaxation_sweep(*matrix.of(backward), rows, 1.0, backward, z.copy())
    ).all()


@DIRECTIONS
@pytest.mark.parametrize("dense", [np.eye(5), np.zeros((5, 5))], ids=["diagonal", "zero"])
def test_nan_that_no_other_row_reads_survives(backward: bool, dense: np.ndarray) -> None:
    """Also where only its own row meets the NaN, or where no row reads it at all."""
    matrix = compressed(dense, np.int32)
    ones, zeros, none = np.ones(5), np.zeros(5), np.full(5, np.inf)
    for place in range(5):
        z = np.linspace(1.0, 2.0, 5)
        z[place] = np.nan
        rows = kernels.packed(ones, zeros, none, ones, ones, ones)
        assert np.isnan(
            kernels.splitting_sweep(*matrix.of(backward), rows, 0.5, True, backward, z, np.empty(5))
        )
        rows = kernels.packed(ones, zeros, none, ones)
        assert np.isnan(
            kernels.relaxation_sweep(*matrix.of(backward), rows, 1.0, backward, z)
        ).all()


@DIRECTIONS
@pytest.mark.parametrize("place", range(5))
@pytest.mark.parametrize(
    "dense", [np.eye(5), np.zeros((5, 5)), 1.0 + np.eye(5)], ids=["diagonal", "zero", "full"]
)
def test_nan_survives_the_norms_of_the_modulus_sweep(
    backward: bool, place: int, dense: np.ndarray
) -> None:
    """A NaN in any component of the incoming vector makes the norm NaN, whoever reads it."""
    from lcp_plugin.methods.modulus.kernels.modulus_sweep import modulus_sweep as kernel

    ones, x = np.ones(5), np.linspace(1.0, 2.0, 5)
    x[place] = np.nan
    rows = kernels.packed(ones, np.zeros(5), ones, ones, ones)
    operands = (
        *compressed(dense, np.int32).of(backward),
        rows,
        1.0,
        1.0,
        backward,
        x,
        np.empty(5),
        np.empty(5),
    )
    assert np.isnan(kernel(*operands))


# --- The same again ----------------------------------------------------------------------------------------


def run_of(name: str, problem: LCP, steps: int) -> np.ndarray:
    iterates = create(name, {}).iterates(problem, np.ones(problem.n))
    for _ in range(steps):
        next(iterates)
    return next(iterates).z.copy()


@pytest.mark.parametrize("name", ["npsor", "psor", "maor", "gfp"])
def test_repeated_runs_agree_bit_for_bit(name: str) -> None:
    """Two runs on the same data, and one on data built anew, give the same bits."""
    problem, again = (
        gallery.random_h_plus(n=300, row_scale=2, column_scale=2).problem for _ in range(2)
    )
    first = run_of(name, problem, 30)
    assert np.array_equal(first, run_of(name, problem, 30))
    assert np.array_equal(first, run_of(name, again, 30))


@pytest.mark.sampled(1)
@pytest.mark.parametrize("name", ["npsor", "psor", "maor", "gfp"])
def test_threads_share_a_problem(name: str) -> None:
    """Eight runs at once on one problem, its cache still empty, give the bits of a run alone."""
    alone = run_of(name, gallery.half_active(n=40_000).problem, 30)
    problem = gallery.half_active(n=40_000).problem
    with ThreadPoolExecutor(8) as pool:
        together = list(pool.map(lambda _: run_of(name, problem, 30), range(8)))
    assert all(np.array_equal(alone, z) for z in together)


def test_threads_share_the_arrays_of_a_sweep() -> None:
    """Sweeps started at once from Python threads on the same matrix, rows and z do not disturb each other."""
    scene = gallery.half_active(n=90_000)
    M, n = scene.problem.csr, scene.n
    split = kernels.row_splits(M, backward=False)
    zeros, none, ones, sixteenths = np.zeros(n), np.full(n, np.inf), np.ones(n), np.full(n, 1 / 16)
    rows = kernels.packed(scene.problem.q, zeros, none, sixteenths, ones, sixteenths)
    z = np.random.default_rng(3).uniform(0.0, 2.0, size=n)

    def sweep(_: int) -> tuple[np.ndarray, float]:
        new = np.empty(n)
        return new, kernels.splitting_sweep(
            M.indptr, split, M.indices, M.data, rows, 1.0, True, False, z, new
        )

    expected, expected_largest = sweep(0)
    with ThreadPoolExecutor(8) as pool:
        for new, largest in pool.map(sweep, range(32)):
            assert np.array_equal(new, expected)
            assert largest == expected_largest


@pytest.mark.full
def test_kernels_work_where_nothing_can_be_cached(tmp_path: Path) -> None:
    """Without a writable folder for compiled code the kernels compile in memory and solve."""
    code = (
        "import numba.core.caching as caching\n"
        "caching.CacheImpl._locator_classes = []\n"
        "from lcp_plugin import LCP, solve\n"
        "print(solve(LCP([[2, 1], [1, 2]], [-5, 1]), 'npsor').status.name)"
    )
    assert printed_by(code) == "SOLVED"
