"""Contacts with friction from the files of fclib, the field's own collection: HDF5, read by h5py.

The local problems are u = W r + q. Global problems M v = H r + f, u = Hᵀv + w are reduced: W = Hᵀ M⁻¹ H and
q = Hᵀ M⁻¹ f + w. A matrix is m, n, nz and the arrays p, i, x: entries with their rows p and columns i if nz ≥ 0,
compressed columns if it is −1, compressed rows if it is −2. Guesses and solutions are not read.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

from ..core.errors import UnreadableFile, UnsupportedModel
from ..core.files import opened
from ..problems.cones.frictional_contact import FrictionalContact
from ..problems.contact import inverse_by_components

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
        If the file is missing, corrupt or of another layout, or h5py is not installed.
    UnsupportedModel
        If the file has equations in addition to its contacts.
    """
    try:
        import h5py
    except ImportError as error:
        raise UnreadableFile(
            f"{source} is read by h5py; install it with: pip install h5py (or lcp_plugin[fclib])"
        ) from error
    with opened(source, "HDF5 file") as file, h5py.File(file, "r") as content:
        try:
            for name in ("fclib_local", "fclib_global"):
                if name in content:
                    return _contacts(source, name, content[name])
            raise ValueError(f"it holds {', '.join(content) or 'nothing'}")
        except UnsupportedModel:
            raise
        except (KeyError, ValueError, IndexError, TypeError) as error:
            raise UnreadableFile(f"{source}: {error}; {LAYOUT}") from error


def _vector(group: Any, name: str, kind: type = float) -> Any:
    """Return an array of numbers as a vector."""
    found = np.ravel(group[name][()])
    if found.dtype.kind not in ("iu" if kind is int else "iuf"):
        raise TypeError(f"{group.name}/{name} holds {found.dtype} in place of {kind.__name__}")
    return found.astype(np.int64 if kind is int else np.float64)


def _matrix(group: Any, rows: int, columns: int) -> sp.csr_array:
    """Return a matrix, whose shape follows from the vectors."""
    m, n, nz = (int(_vector(group, name, int)[0]) for name in ("m", "n", "nz"))
    if (m, n) != (rows, columns):
        raise ValueError(f"{group.name} is of {m} × {n}, its vectors need {rows} × {columns}")
    p, i, x = _vector(group, "p", int), _vector(group, "i", int), _vector(group, "x")
    if nz >= 0:
        p, i, x = p[:nz], i[:nz], x[:nz]
        if p.max(initial=0) >= rows or i.max(initial=0) >= columns:
            p, i = i, p  # CSparse stores triplets in this order
        return sp.csr_array((x, (p, i)), shape=(rows, columns))
    form, count = (sp.csc_array if nz == -1 else sp.csr_array), int(p[-1]) if p.size else 0
    matrix = form((x[:count], i[:count], p), shape=(rows, columns))
    matrix.check_format(full_check=True)
    return sp.csr_array(matrix)


def _contacts(source: Path, name: str, group: Any) -> FrictionalContact:
    d = int(_vector(group, "spacedim", int)[0])
    if equations := {"V", "R", "G"} & group.keys():
        raise UnsupportedModel(
            f"{source} has equations in addition to its contacts ({name}/{min(equations)}), which are not read; "
            "eliminate their unknowns, and give FrictionalContact(W, b, friction)"
        )
    vectors, is_local = group["vectors"], name == "fclib_local"
    offset, friction = _vector(vectors, "q" if is_local else "w"), _vector(vectors, "mu")
    if d not in (2, 3) or offset.size != d * friction.size:
        raise ValueError(
            f"mu has {friction.size} numbers, spacedim is {d} (2 or 3), but velocities are {offset.size}, not d each"
        )
    if is_local:
        W = _matrix(group["W"], offset.size, offset.size)
    else:
        f = _vector(vectors, "f")
        H = _matrix(group["H"], f.size, offset.size)
        by_impulse = inverse_by_components(_matrix(group["M"], f.size, f.size)) @ H
        W, offset = H.T @ by_impulse, by_impulse.T @ f + offset
    return FrictionalContact(W, offset.reshape(-1, d), friction)
