"""Linear complementarity problems: model, solve, certify.

Find z with lower ≤ z ≤ upper and w = M z + q complementary. The names below load on first use, so that
``import lcp_plugin`` costs no more than numpy and scipy.sparse.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from .certificates.residuals import Certificate as Certificate
    from .driver import solve as solve
    from .problem import LCP as LCP
    from .result import Result as Result
    from .result import Sample as Sample
    from .result import Status as Status

_HOME = {
    "LCP": "problem",
    "Certificate": "certificates.residuals",
    "Result": "result",
    "Sample": "result",
    "Status": "result",
    "solve": "driver",
    "gallery": "evidence.gallery",
    "strategies": "strategies",
    **{
        error: "errors"
        for error in (
            "InvalidOption", "InvalidProblem", "LCPError", "NotConverged", "UnknownAlgorithm",
            "UnreadableFile", "UnsuitableMatrix", "UnsuitableProblem",
        )
    },
}

__all__ = ["__version__", *sorted(_HOME)]  # noqa: PLE0604 - the names are strings, built from the table


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'lcp_plugin' has no attribute {name!r}")
    module = import_module(f"{__name__}.{_HOME[name]}")
    # A room of that name is the thing itself; otherwise the thing lives in the room.
    value = module if _HOME[name].split(".")[-1] == name and not hasattr(module, name) else getattr(module, name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
