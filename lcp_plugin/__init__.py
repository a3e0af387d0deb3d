"""Linear complementarity problems: model, solve, certify.

Find z with lower ≤ z ≤ upper and w = M z + q complementary. The names below load on first use, so that
``import lcp_plugin`` costs no more than numpy and scipy.sparse. Each has its help; these are pages on a whole subject:

- ``help("lcp_plugin.core")``: what every solve needs, and in which order to read it
- ``help("lcp_plugin.modeling")``: what may be stated in cvxpy, and how its status is judged
- ``help("lcp_plugin.problems.programs")``: quadratic and linear programs, games
- ``help("lcp_plugin.auto")``: what algorithm="auto" does
- ``help("lcp_plugin.methods.direct")``: how it goes on without sweeps
- ``help("lcp_plugin.core.splittings")``: what to expect of sweeps
- ``help("lcp_plugin.proofs")``: what is proved of a matrix, a method, an error, a problem without solution
- ``help("lcp_plugin.core.certificates.criterion")``: what SOLVED means, in which scaling
- ``help("lcp_plugin.problems.programs.criterion")``: the same of a quadratic program
- ``help("lcp_plugin.interfaces.learn")``: layers for PyTorch and JAX
- ``help("lcp_plugin.interfaces")``: Pyomo, AMPL, JuMP, qpsolvers, files, finite elements
- ``help("lcp_plugin.evidence")``: error against time, studies, cross-validation; other packages
- ``help("lcp_plugin.ranks")``: several machines
- ``help("lcp_plugin.strategies")``: hypothesis strategies, and a test of any solver
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

__version__ = "0.1.0"


def _homes() -> dict[str, str]:
    """Return the module of each public name, as ``__init__.pyi`` says, which editors and mypy read."""
    lines = Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8").splitlines()
    said = [
        line.split() for line in lines if line.startswith("from ")
    ]  # from .home import name as name
    return {name: home[1:] or name for _, home, _, name, *_ in said}


_HOME = _homes()
_FOR_TESTS = {"strategies"}  # needs hypothesis, so that "import *" does without
__all__ = ["__version__", *sorted(_HOME.keys() - _FOR_TESTS)]  # noqa: PLE0604 - the names are strings, from the table


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'lcp_plugin' has no attribute {name!r}")
    home = _HOME[name]
    module = import_module(f"{__name__}.{home}")
    globals()[name] = value = module if home == name else getattr(module, name)
    return value


def __dir__() -> list[str]:
    return sorted([*__all__, *_FOR_TESTS])
