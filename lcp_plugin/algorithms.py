"""The table of algorithms by name, and the functions that create them.

An algorithm is a class below :class:`Algorithm` with ``name``, its options as fields, ``needs``, ``solves``, ``cost``
and ``reference``, which ``lcp-plugin list`` prints. Ours is a class in ``methods/`` (sweeps: ``core/splittings.py``)
and a line of `REGISTRY`; your own works as an object, ``solve(problem, Mine())``: ``examples/add_an_algorithm.py``.
Convex programs also have engines, external solvers, in a separate table (:mod:`lcp_plugin.engines`).

An instance holds its options, and raises InvalidOption if one is wrong:

>>> from lcp_plugin import LCP, solve
>>> from lcp_plugin.algorithms import NPSOR
>>> problem = LCP([[4, -1], [-1, 4]], [-3, 5])
>>> solve(problem, NPSOR(relaxation=1.5)).iterations == solve(problem, "npsor", relaxation=1.5).iterations
True
"""

from __future__ import annotations

from dataclasses import MISSING, fields
from functools import cache
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any

from .core.algorithm import Algorithm, Step, check_flag, check_positive
from .core.errors import InvalidOption, UnknownAlgorithm, did_you_mean
from .core.settings import OF_SOLVE
from .engines import ENGINES, engine_class

if TYPE_CHECKING:  # for editors and mypy: __getattr__ has each class of the registry by its name
    from .core.splittings import GFP, NPAOR, NPGS, NPJ, NPSOR, PAOR, PGS, PJ, PSOR
    from .methods.banded import Banded
    from .methods.interior_point import InteriorPoint
    from .methods.lemke import Lemke
    from .methods.modulus import MAOR, MGS, MJ, MSOR
    from .methods.multigrid import Multigrid
    from .methods.newton import Newton
    from .methods.npsplitting import NPSplitting

# Each name's module, from this package on, and class: a solve imports only the module of its algorithm.
REGISTRY = {
    "psor": "core.splittings:PSOR",
    "pgs": "core.splittings:PGS",
    "paor": "core.splittings:PAOR",
    "pj": "core.splittings:PJ",
    "gfp": "core.splittings:GFP",
    "npaor": "core.splittings:NPAOR",
    "npsor": "core.splittings:NPSOR",
    "npgs": "core.splittings:NPGS",
    "npj": "core.splittings:NPJ",
    "banded": "methods.banded:Banded",
    "interior_point": "methods.interior_point:InteriorPoint",
    "lemke": "methods.lemke:Lemke",
    "maor": "methods.modulus:MAOR",
    "msor": "methods.modulus:MSOR",
    "mgs": "methods.modulus:MGS",
    "mj": "methods.modulus:MJ",
    "multigrid": "methods.multigrid:Multigrid",
    "newton": "methods.newton:Newton",
    "npsplitting": "methods.npsplitting:NPSplitting",
}

__all__ = [
    "REGISTRY",
    "Algorithm",
    "Step",
    "algorithm_class",
    "check_flag",
    "check_positive",
    "create",
    "paper_options",
]


def __getattr__(name: str) -> Any:
    classes = {place.partition(":")[2]: key for key, place in REGISTRY.items()}
    if name in classes:
        return algorithm_class(classes[name])
    hint = "" if name.startswith("_") else did_you_mean(name, classes)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}{hint}")


def algorithm_class(name: str) -> type[Algorithm]:
    """Return the class registered under the name.

    Parameters
    ----------
    name : str
        A name that ``lcp-plugin list`` shows.

    Raises
    ------
    UnknownAlgorithm
        With the closest known name, or with the problem that an engine solves.

    Examples
    --------
    >>> algorithm_class("psor").__name__
    'PSOR'
    """
    if name in ENGINES:
        refused = refusal_of_engine(name)
        raise refused
    if name not in REGISTRY:
        hint = did_you_mean(name, {"auto", *REGISTRY, *ENGINES}, is_listed=True)
        if ".py" in name:
            hint += "; pass a class of your own as an object, in Python: solve(problem, Mine())"
        raise UnknownAlgorithm(f"unknown algorithm {name!r}{hint}")
    return resolve_name(f"{__package__}.{REGISTRY[name]}")


def create(name: str, options: dict[str, Any]) -> Algorithm:
    """Return the named algorithm with these options.

    Parameters
    ----------
    name : str
        A name that ``lcp-plugin list`` shows.
    options : dict
        Values of the options by name; the others take their defaults.

    Raises
    ------
    UnknownAlgorithm, InvalidOption
        With the right names and a guess, or the names of options that have no default.
    """
    return made(algorithm_class(name), name, options) if options else _by_default(name)


@cache
def _by_default(name: str) -> Any:
    """Return the named algorithm with its default options: one object, which is frozen."""
    return made(algorithm_class(name), name, {})


def paper_options(name: str, relaxation: float | None = None) -> dict[str, Any]:
    """Return the options of the paper's tables: no momentum and no row scaling for np methods, Ω = D/2 or D/(2α²) else.

    Parameters
    ----------
    name : str
        An np method, "mgs" or "msor".
    relaxation : float, optional
        α of "npsor" (1.7 in the tables) and "msor" (0.85 and 0.88).

    Raises
    ------
    InvalidOption
        If the paper does not have the method.

    References
    ----------
    Kumar, Deepmala, Das, *More on projected type iteration method and linear complementarity problem*, §5.

    Examples
    --------
    >>> paper_options("npsor", 1.7), paper_options("mgs")
    ({'momentum': None, 'scaling': None, 'relaxation': 1.7}, {'omega': 0.5})
    """
    if name.startswith("np"):
        weights = {"relaxation": relaxation} if relaxation else {}
        return {"momentum": None, "scaling": None} | weights
    if name == "msor" and relaxation:
        return {"relaxation": relaxation, "omega": 1.0 / (2.0 * relaxation**2)}
    if name not in ("mgs", "msor"):
        raise InvalidOption(f"the paper has np methods, mgs and msor, got {name!r}")
    return {"omega": 0.5}


def made(kind: Any, name: str, options: dict[str, Any]) -> Any:
    """Return an instance of the class with these options; raise InvalidOption as `create` does."""
    try:
        return kind(**options)
    except InvalidOption:
        raise
    except TypeError:
        known = {field.name: field for field in fields(kind)}
        for option in options:
            if option not in known:
                hint = did_you_mean(option, known, OF_SOLVE)
                raise InvalidOption(f"{name} has no option {option!r}{hint}") from None
        absent = (field for option, field in known.items() if option not in options)
        missing = [f.name for f in absent if f.default is f.default_factory is MISSING]
        if not missing:
            raise
        raise InvalidOption(
            f"{name} needs a value for {' and '.join(missing)}, which has no default; give one"
        ) from None


def refusal_of_engine(name: str) -> UnknownAlgorithm:
    """Return the error that names the problem classes of the engine, and the remedy for an LCP."""
    return UnknownAlgorithm(
        f"{name} is an engine for {engine_class(name).solves}, not for this problem; the convex program of an LCP "
        f"whose M is positive semidefinite is problem.to_qp(): solve(problem.to_qp(), {name!r})"
    )
