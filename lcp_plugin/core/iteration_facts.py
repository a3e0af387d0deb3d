"""The data of an iteration that convergence theorems require."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from .checks import Vector

PROJECTED_TYPE = "projected type"
PROJECTED_SPLITTING = "projected splitting"
PROJECTED_RELAXATION = "projected relaxation"
MODULUS = "modulus"


@dataclass(frozen=True, eq=False, kw_only=True)
class IterationFacts:
    """The family and the parameters of an iteration, for convergence theorems.

    Attributes
    ----------
    family : str
        "projected type", "projected splitting", "projected relaxation" or "modulus".
    relaxation : float or None
        α (ω of a projected relaxation); None if it is found during the run.
    acceleration : float or None
        β.
    sweep : {"forward", "backward", "symmetric"}
    scaling : array, shape (n,), or None
        The diagonal of S of the projected-type families.
    omega : array, shape (n,), or None
        The diagonal of Ω of the modulus family.
    splitting : sparse array, shape (n, n), or None
        𝓜 of a projected splitting; `is_part_of_matrix` if each entry is 0 or the entry of M, with the full diagonal.
    has_momentum : bool
        Whether the iterates are extrapolated.
    """

    family: str
    relaxation: float | None = 1.0
    acceleration: float | None = 1.0
    sweep: str = "forward"
    scaling: Vector | None = field(default=None, repr=False)
    omega: Vector | None = field(default=None, repr=False)
    splitting: Any = field(default=None, repr=False)
    is_part_of_matrix: bool = False
    has_momentum: bool = False
