"""Algorithms: one family a file, one line of the registry each."""

from __future__ import annotations

from dataclasses import fields
from importlib import import_module
from typing import Any

from ..errors import InvalidOption, UnknownAlgorithm, did_you_mean
from .base import Algorithm, Step

__all__ = ["REGISTRY", "Algorithm", "Step", "algorithm_class", "create"]

REGISTRY = {
    "npj": "projected_type:NPJ",
    "npgs": "projected_type:NPGS",
    "npsor": "projected_type:NPSOR",
    "npaor": "projected_type:NPAOR",
    "npsplitting": "projected_splitting:NPSplitting",
    "pj": "projected_relaxation:PJ",
    "pgs": "projected_relaxation:PGS",
    "psor": "projected_relaxation:PSOR",
    "paor": "projected_relaxation:PAOR",
    "mj": "modulus:MJ",
    "mgs": "modulus:MGS",
    "msor": "modulus:MSOR",
    "maor": "modulus:MAOR",
    "gfp": "projected_relaxation:GFP",
    "newton": "semismooth_newton:Newton",
    "interior_point": "interior_point:InteriorPoint",
    "lemke": "lemke:Lemke",
    "multigrid": "multigrid:Multigrid",
}


def algorithm_class(name: str) -> type[Algorithm]:
    """Return the class registered under the name.

    Raises
    ------
    UnknownAlgorithm
        With the closest registered name.
    """
    if name not in REGISTRY:
        raise UnknownAlgorithm(f"unknown algorithm {name!r}{did_you_mean(name, ['auto', *REGISTRY])}")
    module, _, class_name = REGISTRY[name].partition(":")
    found: type[Algorithm] = getattr(import_module(f"{__name__}.{module}"), class_name)
    return found


def create(name: str, options: dict[str, Any]) -> Algorithm:
    """Return the named algorithm with these options.

    Raises
    ------
    UnknownAlgorithm, InvalidOption
        With the right names and a guess.
    """
    kind = algorithm_class(name)
    known = [field.name for field in fields(kind)]
    for option in options:
        if option not in known:
            raise InvalidOption(f"{name} has no option {option!r}{did_you_mean(option, known)}")
    return kind(**options)
