"""Every public name: what lcp_plugin offers, its scenes, strategies and algorithms, and what lives in a subpackage."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import lcp_plugin
from lcp_plugin import gallery, strategies
from lcp_plugin.algorithms import REGISTRY, algorithm_class

ELSEWHERE = {
    "algorithms": "Algorithm Step algorithm_class create",
    "problems.reformulations": "Equilibrium lcp_from_bimatrix_game",
    "problems.contact": "ContactMotion Contacts contact_data",
    "problems.programs.solution": "QPSolution",
    "problems.programs.conversion": "lcp_from_qp qp_from_lcp",
    "evidence.measurement": "Measurement",
    "evidence.drawing": "draw",
    "evidence.study": "Table",
    "modeling.constraint": "Complements Side",
    "modeling.registration": "solve_model",
    "methods.search": "Solution",
}
PUBLIC: dict[str, Any] = {
    **{name: getattr(lcp_plugin, name) for name in lcp_plugin.__all__},
    **{
        f"LCP.{name}": getattr(lcp_plugin.LCP, name)
        for name in vars(lcp_plugin.LCP)
        if name[0] != "_"
    },
    **{
        f"Result.{name}": getattr(lcp_plugin.Result, name)
        for name in vars(lcp_plugin.Result)
        if name[0] != "_"
    },
    **{f"gallery.{name}": getattr(gallery, name) for name in gallery.__all__},
    **{f"strategies.{name}": getattr(strategies, name) for name in strategies.__all__},
    **{name: algorithm_class(name) for name in REGISTRY},
    **{
        name: getattr(import_module(f"lcp_plugin.{home}"), name)
        for home, names in ELSEWHERE.items()
        for name in names.split()
    },
}
