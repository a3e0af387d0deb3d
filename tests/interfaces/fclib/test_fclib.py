"""Files in the layout of fclib: local and global problems, in the plane and in space; mistakes are told in words."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.linalg import block_diag
from tools.processes import lcp_plugin

from lcp_plugin import (
    LCP,
    FrictionalContact,
    LCPError,
    UnreadableFile,
    UnsupportedModel,
    load_problem,
    solve,
)

h5py = pytest.importorskip("h5py")

LOW = np.array([[2.0, 0.5, 0.0], [0.5, 1.0, 0.0], [0.0, 0.0, 1.5]])
PUSHED = np.array([-1.0, 3.0, 4.0])


def write_matrix(group: Any, matrix: Any, kind: str) -> None:
    """m, n, nz, nzmax, p, i, x; with room behind the entries, as fclib may leave it."""
    M = {"columns": sp.csc_array, "rows": sp.csr_array}.get(kind, sp.coo_array)(matrix)
    spare = [0] if kind in ("columns", "rows") else []
    arrays = {"x": np.append(M.data, spare)}
    if kind in ("columns", "rows"):
        arrays |= {"p": M.indptr, "i": np.append(M.indices, spare)}
    else:
        arrays |= {"p": M.row, "i": M.col} if kind == "entries" else {"p": M.col, "i": M.row}
    numbers = {"m": M.shape[0], "n": M.shape[1], "nzmax": M.nnz + len(spare),
               "nz": {"columns": -1, "rows": -2}.get(kind, M.nnz)}  # fmt: skip
    for name, value in (arrays | {name: [number] for name, number in numbers.items()}).items():
        dtype = np.float64 if name == "x" else np.int32
        group.create_dataset(name, data=np.asarray(value, dtype))


def write(
    path: Path,
    name: str,
    matrices: dict[str, Any],
    d: int = 3,
    kind: str = "columns",
    **vectors: Any,
) -> Path:
    with h5py.File(path, "w") as file:
        group = file.create_group(name)
        group.create_dataset("spacedim", data=[d])
        group.create_group("info")["title"] = "a block"
        for key, matrix in matrices.items():
            write_matrix(group.create_group(key), matrix, kind)
        group.create_group("vectors")
        for key, vector in vectors.items():
            group["vectors"].create_dataset(key, data=np.asarray(vector, float))
    return path


def local(path: Path, W: Any = LOW, q: Any = PUSHED, mu: Any = (0.5,), **rest: Any) -> Path:
    return write(path, "fclib_local", {"W": W}, q=q, mu=mu, **rest)


@pytest.mark.parametrize("kind", ["columns", "rows", "entries", "entries of CSparse"])
def test_a_local_problem_in_space(kind, tmp_path):
    """Each form of a matrix states the same contacts."""
    problem = load_problem(local(tmp_path / "block.h5", kind=kind))
    assert isinstance(problem, FrictionalContact)
    np.testing.assert_array_equal(problem.rows.csr.toarray(), LOW)
    np.testing.assert_array_equal(problem.q, PUSHED)
    np.testing.assert_allclose(
        solve(problem).z, solve(FrictionalContact(LOW, PUSHED, 0.5)).z, atol=1e-12
    )


def test_a_local_problem_in_the_plane(tmp_path):
    """Six rows of spacedim 2 are three contacts, whatever six rows could be besides."""
    q, mu = [-1.0, 0.1, -1.0, 2.0, 1.0, 0.0], [0.5, 0.5, 0.2]
    problem = load_problem(local(tmp_path / "three.hdf5", np.eye(6), q, mu, d=2))
    assert problem.dimension == 2
    result = solve(problem)
    np.testing.assert_allclose(result.z, [1.0, -0.1, 1.0, -0.5, 0.0, 0.0], atol=1e-8)


@pytest.mark.parametrize("kind", ["columns", "rows", "entries", "entries of CSparse"])
def test_a_global_problem(kind, tmp_path):
    """M v = H r + f, u = Hᵀv + w: the impulses are those of the velocities that the contacts then have."""
    rng = np.random.default_rng(3)
    A = rng.normal(size=(2, 4, 4))
    M = block_diag(*[a @ a.T + np.eye(4) for a in A])
    H, f, w = rng.normal(size=(8, 6)), rng.normal(size=8), rng.normal(size=6)
    path = write(
        tmp_path / "g.h5", "fclib_global", {"M": M, "H": H}, kind=kind, f=f, w=w, mu=[0.3, 0.6]
    )
    result = solve(load_problem(path))
    assert result.is_solved
    v = np.linalg.solve(M, H @ result.z + f)
    np.testing.assert_allclose(result.w, H.T @ v + w, atol=1e-10)


def test_the_command_solves_such_a_file(tmp_path):
    """``lcp-plugin solve block.h5``."""
    found = lcp_plugin("solve", str(local(tmp_path / "block.h5")))
    assert found.exit_code == 0, found.output
    assert "SOLVED" in found.output
    assert "1 contact: 0 open, 0 stick, 1 slide" in found.output


def without(name: str) -> Callable[[Path], None]:
    def delete(path: Path) -> None:
        with h5py.File(path, "r+") as file:
            del file[name]

    return delete


def with_(name: str, values: Any) -> Callable[[Path], None]:
    def replace(path: Path) -> None:
        with h5py.File(path, "r+") as file:
            if name in file:
                del file[name]
            file.create_group(name) if values is None else file.create_dataset(name, data=values)

    return replace


def with_mass(matrices: dict[str, Any]) -> Callable[[Path], None]:
    vectors = {"f": np.zeros(2), "w": np.zeros(3), "mu": [0.5]}
    return lambda path: write(path, "fclib_global", matrices | {"H": np.eye(2, 3)}, **vectors)  # type: ignore[func-returns-value]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (without("fclib_local"), "holds nothing; an fclib file holds fclib_local with spacedim, W"),
        (without("fclib_local/W"), "object 'W' doesn't exist"),
        (
            with_("fclib_local/vectors/q", np.zeros(2)),
            "mu has 1 numbers, spacedim is 3 (2 or 3), but velocities are 2",
        ),
        (
            with_("fclib_local/W/m", [10**9]),
            "fclib_local/W is of 1000000000 × 3, its vectors need 3 × 3",
        ),
        (with_("fclib_local/W/x", np.arange(6.0)), "W must be symmetric"),
        (
            with_("fclib_local/vectors/mu", [-1.0]),
            "friction must not be negative, but friction[0] = -1.0",
        ),
        (Path.unlink, "no such file"),
        (lambda path: path.write_text("W = 1"), "damaged or no HDF5 file"),
        (with_mass({"M": -np.eye(2)}), "the mass matrix must be positive definite"),
        (
            with_mass({"M": np.eye(2), "G": np.eye(2)}),
            "equations in addition to its contacts (fclib_global/G)",
        ),
    ],
)
def test_the_error_names_the_fault_of_a_file(change, words, tmp_path):
    """A missing key, an empty group, another dimension: what the file holds, what it should."""
    path = local(tmp_path / "block.h5")
    change(path)
    kind = UnsupportedModel if "equations" in words else UnreadableFile
    with pytest.raises(kind, match=re.escape(words)):
        load_problem(path)


def test_a_file_of_contacts_is_not_taken_for_an_lcp(tmp_path):
    """LCP.load, which has no place for it, names load_problem, and the command ends with 2."""
    path = local(tmp_path / "block.h5")
    with pytest.raises(LCPError, match="load_problem"):
        LCP.load(path)
    without("fclib_local/W")(path)
    found = lcp_plugin("solve", str(path))
    assert found.exit_code == 2, found.output
