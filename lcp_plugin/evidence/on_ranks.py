"""Scenes with their rows over ranks: some are built by each rank for its own rows, every other one whole, then cut."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

from ..core.lcp import LCP
from ..gallery.obstacle import sphere_layers
from ..gallery.scene import Scene, checked_values
from ..gallery.scene import build as build_whole
from ..ranks.petsc.collective import Ranks

BY_ROWS = {"obstacle_2d": partial(sphere_layers, 2), "obstacle_3d": partial(sphere_layers, 3)}


def build(name: str, comm: Any, parameters: Mapping[str, Any]) -> Scene:
    """Return the scene with its problem's rows spread over the ranks, its vectors the own parts; all ranks call.

    Raises
    ------
    LCPError
        On every rank, as :func:`lcp_plugin.gallery.build`.
    """
    ranks = Ranks(comm)
    if name not in BY_ROWS:
        scene = ranks.together(lambda: build_whole(name, **parameters))
        problem = LCP.from_problem(scene.problem, comm)
        vectors = {"exact": scene.exact, "continuum": scene.continuum, "start": scene.start}
        own = slice(problem.first, problem.last)
        parts: dict[str, Any] = {fact: None if vector is None else vector[own] for fact, vector in vectors.items()}
        return replace(scene, problem=problem, **parts)
    values = ranks.together(lambda: checked_values(name, parameters))
    size = values["size"]
    begin, end = size * ranks.rank // ranks.size, size * (ranks.rank + 1) // ranks.size
    own_part = ranks.together(lambda: BY_ROWS[name](begin=begin, end=end, **values))
    problem = LCP.from_rows(comm, own_part.rows, own_part.q, own_part.lower)
    return Scene(problem=problem, name=name, parameters=values, continuum=own_part.continuum)
