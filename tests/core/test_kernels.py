"""The compiled sweeps against their formulas written out row by row on dense arrays."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.sparse as sp
from numpy.testing import assert_allclose

from lcp_plugin import Certificate, gallery
from lcp_plugin.algorithms import REGISTRY, create
from lcp_plugin.core.kernels import splitting_sweeps as kernels

WIDTHS = [np.int32, np.int64]
DIRECTIONS = pytest.mark.parametrize("backward", [False, True], ids=["forward", "backward"])


# --- The formulas, literally -------------------------------------------------------------------------------


def clamp(value: float, lower: float, upper: float) -> float:
    return min(max(value, lower), upper)


def row_order(n: int, backward: bool) -> range:
    return range(n - 1, -1, -1) if backward else range(n)


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
    return kernels.pack_vectors(*(values[name] for name in names))


def close(actual: object, expected: object) -> None:
    assert_allclose(actual, expected, rtol=1e-12, atol=1e-13)


# --- Each sweep --------------------------------------------------------------------------------------------


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
