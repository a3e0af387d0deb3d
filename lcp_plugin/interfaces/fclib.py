"""Contacts with friction from the files of fclib, the field's own collection: HDF5, read by h5py.

Its local problems are u = W r + q; its global ones M v = H r + f, u = Hᵀv + w become these: W = Hᵀ M⁻¹ H and
q = Hᵀ M⁻¹ f + w. A matrix is m, n, nz and the arrays p, i, x: entries with their rows p and columns i where nz ≥ 0,
compressed columns where it is −1, compressed rows where it is −2. Guesses and solutions are not read.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

from ..core.errors import InvalidProblem, UnreadableFile, UnsupportedModel
from ..problems.cones.files import problem_of
from ..problems.cones.frictional_contact import FrictionalContact
from ..problems.contact import inverse_by_components
from .files.matrix_market import opened

SUFFIXES = (".h5", ".hdf5")
LAYOUT = (
    "an fclib file holds fclib_local with spacedim, W, vectors/q and vectors/mu, or fclib_global with spacedim, M, H, "
    "vectors/f, vectors/w and vectors/mu; a matrix is m, n, nz, p, i, x"
)


def load_fclib(source: Path) -> FrictionalContact:
    """Return the contact problem of an fclib file, local or global, in the plane or in space.

    Raises
    ------
    UnreadableFile
        Where the file is missing, damaged or of another layout, or h5py is not installed.
    UnsupportedModel
        Where equations stand beside its contacts.
    """
    try:
        import h5py
    except ImportError as error:
        raise UnreadableFile(
            f"{source} is read by h5py; install it with: pip install h5py"
        ) from error
    with opened(source, "HDF5 file") as file, h5py.File(file, "r") as content:
        found = [name for name in ("fclib_local", "fclib_global") if name in content]
        if not found:
            raise UnreadableFile(f"{source} holds {', '.join(content) or 'nothing'}; {LAYOUT}")
        return _contacts(_Group(source, found[0], content[found[0]]))


class _Group:
    """A group of a file; what it lacks is an UnreadableFile."""

    def __init__(self, source: Path, name: str, content: Mapping[str, Any]) -> None:
        self.source, self.name, self._content = source, name, content

    def refuse(self, why: str) -> UnreadableFile:
        return UnreadableFile(f"{self.source}: {why}; {LAYOUT}")

    def holds(self, name: str) -> bool:
        return name in self._content

    def array(self, name: str, kind: type = float) -> Any:
        """Return an array of numbers as a vector."""
        if name not in self._content:
            raise self.refuse(
                f"{self.name} lacks {name}, it holds {', '.join(self._content) or 'nothing'}"
            )
        found = self._content[name]
        if not hasattr(found, "dtype") or found.dtype.kind not in ("iu" if kind is int else "iuf"):
            what = f"numbers of dtype {found.dtype}" if hasattr(found, "dtype") else "a group"
            raise self.refuse(
                f"{self.name}/{name} must hold {'whole ' * (kind is int)}numbers, got {what}"
            )
        return np.ravel(found[()]).astype(np.int64 if kind is int else np.float64)

    def number(self, name: str) -> int:
        """Return a whole number."""
        array = self.array(name, int)
        if array.size != 1:
            raise self.refuse(f"{self.name}/{name} must be one whole number, got {array.size}")
        return int(array[0])

    def matrix(self, name: str, rows: int, columns: int) -> sp.csr_array:
        """Return a matrix, whose shape follows from the vectors."""
        if not self.holds(name):
            raise self.refuse(
                f"{self.name} lacks {name}, it holds {', '.join(self._content) or 'nothing'}"
            )
        own = _Group(self.source, f"{self.name}/{name}", self._content[name])
        shape, nz = (own.number("m"), own.number("n")), own.number("nz")
        if shape != (rows, columns):
            raise self.refuse(
                f"{own.name} is of {shape[0]} × {shape[1]}, but its vectors need {rows} × {columns}"
            )
        p, i, x = own.array("p", int), own.array("i", int), own.array("x")
        try:
            if nz >= 0:
                p, i, x = p[:nz], i[:nz], x[:nz]
                if p.max(initial=0) >= rows or i.max(initial=0) >= columns:
                    p, i = i, p  # as CSparse, and what copies its arrays, has them
                return sp.csr_array((x, (p, i)), shape=shape)
            kind, count = (sp.csc_array if nz == -1 else sp.csr_array), int(p[-1]) if p.size else 0
            matrix = kind((x[:count], i[:count], p), shape=shape)
            matrix.check_format(full_check=True)
            return sp.csr_array(matrix)
        except (ValueError, IndexError) as error:
            raise self.refuse(f"{own.name} is no matrix: {error}") from error


def _contacts(group: _Group) -> FrictionalContact:
    is_local, d = group.name == "fclib_local", group.number("spacedim")
    for equations in ("V", "R", "G"):
        if group.holds(equations):
            raise UnsupportedModel(
                f"{group.source} has equations beside its contacts ({group.name}/{equations}), which are not read; "
                "eliminate their unknowns, and give FrictionalContact(W, b, friction)"
            )
    if not group.holds("vectors"):
        raise group.refuse(f"{group.name} lacks vectors")
    vectors = _Group(group.source, f"{group.name}/vectors", group._content["vectors"])
    offset, friction = vectors.array("q" if is_local else "w"), vectors.array("mu")
    if d not in (2, 3) or offset.size != d * friction.size:
        raise group.refuse(
            f"mu has {friction.size} numbers, spacedim is {d} (2 or 3), but velocities are {offset.size}, not d each"
        )
    if is_local:
        W = group.matrix("W", offset.size, offset.size)
    else:
        f = vectors.array("f")
        M, H = group.matrix("M", f.size, f.size), group.matrix("H", f.size, offset.size)
        try:
            by_impulse = inverse_by_components(M) @ H
        except InvalidProblem as error:
            raise group.refuse(str(error)) from error
        W, offset = H.T @ by_impulse, by_impulse.T @ f + offset
    problem: FrictionalContact = problem_of(
        {"W": W, "q": offset.reshape(-1, d), "mu": friction}, group.source
    )
    return problem
