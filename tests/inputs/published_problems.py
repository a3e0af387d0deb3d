"""Published problems with published answers, and what an answer is wrong by, in plain numpy from the arrays of a file.

The files are in ``published/data``, or in the folder that LCP_PLUGIN_PUBLISHED names. Nothing here calls the package. A
row is measured relative to its terms, the largest of |limit| and |a_ij x_j|; a violation below 1e-12 of the largest
coefficient times the largest unknown is rounding.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

FOLDER = Path(
    os.environ.get("LCP_PLUGIN_PUBLISHED", Path(__file__).parents[1] / "published" / "data")
)
INFINITE, ROUNDING = 0.99e20, 1e-12

# Maros and Mészáros, A repository of convex quadratic programming problems, 1999, and the number of unknowns.
PROGRAMS = {
    "AUG3DC": 3873, "CONT-050": 2597, "CONT-101": 10197, "CVXQP1_S": 100, "CVXQP3_M": 1000, "DUAL4": 75, "DUALC1": 9,
    "GOULDQP2": 699, "HS21": 2, "KSIP": 20, "LASER": 1002, "LISWET10": 10002, "LISWET7": 10002, "POWELL20": 10000,
    "PRIMALC1": 230, "QAFIRO": 32, "QBORE3D": 315, "QCAPRI": 353, "QETAMACR": 688, "QFFFFF80": 854, "QISRAEL": 142,
    "QPCBOEI1": 384, "QPCBOEI2": 143, "QSC205": 203, "QSHELL": 1775, "QSHIP08S": 2387, "STCQP2": 4097, "UBH1": 18009,
    "YAO": 2002,
}  # fmt: skip
# Clarabel's values at a tolerance of 1e-11: the eight digits of KSIP agree; those of GOULDQP2 were of a loose solve.
MORE_DIGITS = {"KSIP": 0.57579794124, "GOULDQP2": 0.000184274503}
# Acary, Brémond, Huber, On solving contact problems with Coulomb friction, 2018: the collection of Siconos.
CONTACTS = sorted(file.stem.removeprefix("fc3d_") for file in FOLDER.glob("fc3d_*.npz"))
COMPLEMENTARITY = (
    "Capsules-i100-889",
    "FrictionContactProblem00071",
    "RLCD_mlcp",
    "Rover1039",
    "diodeBridge_mlcp",
    "relay_4x4",
)


def read(name: str) -> dict[str, Any]:
    """The arrays of a file, its matrices in CSC or CSR as they lie there."""
    with np.load(FOLDER / f"{name}.npz") as file:
        arrays: dict[str, Any] = {key: file[key] for key in file.files}
    for letter, kind in (("P_", sp.csc_array), ("A_", sp.csc_array), ("", sp.csr_array)):
        keys = [f"{letter}{part}" for part in ("data", "indices", "indptr", "shape")]
        if keys[0] in arrays:
            *parts, shape = (arrays.pop(key) for key in keys)
            arrays[letter.rstrip("_") or "M"] = kind(
                tuple(parts), shape=tuple(int(size) for size in shape)
            )
    return arrays


def beside(wrong: np.ndarray, size: np.ndarray) -> float:
    """The largest wrong ÷ size; 0 where nothing is wrong, ∞ where something is beside 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(np.where(wrong > 0.0, wrong / size, 0.0).max(initial=0.0))


@dataclass(frozen=True)
class PublishedProgram:
    """Minimize ½ xᵀP x + qᵀx + r over l ≤ A x ≤ u, with its published least value, right to `digits` of it."""

    P: Any
    q: np.ndarray
    r: float
    A: Any
    l: np.ndarray
    u: np.ndarray
    value: float
    digits: float

    @classmethod
    def read(cls, name: str) -> PublishedProgram:
        """The program of a file."""
        of = read(f"qp_{name}")
        low = np.where(of["l"] <= -INFINITE, -np.inf, of["l"])
        high = np.where(of["u"] >= INFINITE, np.inf, of["u"])
        value = MORE_DIGITS.get(name, float(of["optimal_value"]))
        digits = 1e-9 if name == "KSIP" else 1e-6
        return cls(of["P"], of["q"], float(of["r"]), of["A"], low, high, value, digits)

    def split(self) -> tuple[Any, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """The rows but for those of one 1, their limits, and the bounds that those are."""
        rows, n = sp.csr_array(self.A), self.q.size
        counts = np.diff(rows.indptr)
        single = np.flatnonzero(counts == 1)
        single = single[rows.data[rows.indptr[single]] == 1.0]
        lower, upper = np.full(n, -np.inf), np.full(n, np.inf)
        of = rows.indices[rows.indptr[single]]
        np.maximum.at(lower, of, self.l[single])
        np.minimum.at(upper, of, self.u[single])
        others = np.setdiff1d(np.arange(counts.size), single)
        return rows[others], self.l[others], self.u[others], lower, upper

    def errors(self, x: np.ndarray) -> tuple[float, float]:
        """|f(x) − f*| beside |f*|, and the largest violation beside a row's own terms."""
        value = 0.5 * x @ (self.P @ x) + self.q @ x + self.r
        A, row = abs(self.A), self.A @ x
        terms = (A @ sp.diags_array(abs(x))).max(axis=1).toarray().ravel()
        largest = A.max(axis=1).toarray().ravel() * abs(x).max(initial=0.0)
        violated = 0.0
        for wrong, limit in ((self.l - row, self.l), (row - self.u, self.u)):
            size = np.maximum(terms, np.where(np.isfinite(limit), abs(limit), 0.0))
            violated = max(violated, beside(np.where(wrong > ROUNDING * largest, wrong, 0.0), size))
        return abs(value - self.value) / abs(self.value), violated


def errors_of_lcp(of: dict[str, Any], z: np.ndarray) -> float:
    """The largest part of z outside its bounds beside ‖z‖∞, or wrong part of w = M z + q beside its own terms.

    What is smaller than 1e-6 of the largest is measured beside that; a z_i within 1e-9 ‖z‖∞ of a bound is at it.
    """
    M, q, lower, upper, size = of["M"], of["q"], of["lower"], of["upper"], abs(z).max(initial=0.0)
    w, terms = M @ z + q, abs(q) + abs(M) @ abs(z)
    is_low, is_high = z - lower <= 1e-9 * size, upper - z <= 1e-9 * size
    wrong = np.where(is_low, np.where(is_high, 0.0, -w), np.where(is_high, w, abs(w)))
    outside = beside(np.maximum(lower - z, z - upper), np.full(z.size, size))
    return max(outside, beside(wrong, np.maximum(terms, 1e-6 * terms.max())))


def errors_of_contact(of: dict[str, Any], r: np.ndarray) -> float:
    """The largest wrong part of the laws of contact and friction, beside the impulse and the velocity's own terms.

    Impulses in the cone ‖r_T‖ ≤ μ r_N, velocities with u_N ≥ 0, and r·(u + μ‖u_T‖ e_N) = 0: open, sticking, sliding.
    Smaller impulses and terms than a hundredth of the largest are measured beside that.
    """
    W, q, mu = of["M"], of["q"], of["mu"]
    r, u = r.reshape(-1, 3), (W @ r + q).reshape(-1, 3)
    terms = np.linalg.norm((abs(q) + abs(W) @ abs(r.ravel())).reshape(-1, 3), axis=1)
    impulse, tangent, slip = (np.linalg.norm(part, axis=1) for part in (r, r[:, 1:], u[:, 1:]))
    terms, impulse = (np.maximum(sizes, 1e-2 * sizes.max()) for sizes in (terms, impulse))
    power = (r * u).sum(axis=1) + mu * slip * r[:, 0]
    outside = beside(np.maximum(tangent - mu * r[:, 0], -r[:, 0]), impulse)
    return max(outside, beside(-u[:, 0], terms), beside(abs(power), impulse * terms))
