"""The algorithm and the settings of a call."""

from __future__ import annotations

from typing import Any

from ..algorithms import create, refusal_of_engine
from ..core.algorithm import Algorithm
from ..core.errors import InvalidOption, UnknownAlgorithm, did_you_mean
from ..core.lcp import LCP
from ..core.settings import BESIDE, DEFAULT, OF_SOLVE, Settings
from ..engines.engine import Engine
from ..methods.banded import banded_passes
from ..methods.small import is_small

GUESSED = "small: a few sweeps guess the active set"


def parse_call(
    algorithm: str | Algorithm, wishes: dict[str, Any]
) -> tuple[Algorithm | None, Settings]:
    """Return the method (None for auto) and the settings of a call; `wishes` may contain z0 and callback."""
    if not wishes:
        return method_of(algorithm, wishes), DEFAULT
    settings = Settings(
        **{name: wish for name, wish in wishes.items() if name in OF_SOLVE and name not in BESIDE}
    )
    options = {name: wish for name, wish in wishes.items() if name not in OF_SOLVE}
    return method_of(algorithm, options), settings


def method_of(algorithm: Any, options: dict[str, Any]) -> Algorithm | None:
    """Return the algorithm object for the `algorithm` and the options of a call; None for "auto".

    Raises
    ------
    UnknownAlgorithm, InvalidOption
        If the name or an option does not exist.
    """
    if isinstance(algorithm, str):
        if algorithm != "auto":
            return create(algorithm, options)
        if options:
            hint = did_you_mean(next(iter(options)), (), OF_SOLVE)
            name_one = "" if "did you mean" in hint else "; name an algorithm as well"
            raise InvalidOption(
                f'algorithm="auto" has no options, got {sorted(options)}{name_one}{hint}'
            )
        return None
    if isinstance(algorithm, Algorithm):
        if options:
            raise InvalidOption(
                f"options {sorted(options)} were given with an algorithm object; "
                f"set them in {type(algorithm).__name__}(…){did_you_mean(next(iter(options)), (), OF_SOLVE)}"
            )
        if not getattr(algorithm, "name", ""):
            raise InvalidOption(
                f'{type(algorithm).__name__} has no name; write name = "…" in the class'
            )
        return algorithm
    if isinstance(algorithm, Engine):
        raise refusal_of_engine(algorithm.name)
    got = repr(algorithm)
    if isinstance(algorithm, type):
        got = f"the class {algorithm.__name__}"
        got += f"; write {algorithm.__name__}()" if issubclass(algorithm, Algorithm) else ""
    raise UnknownAlgorithm(
        f"algorithm must be a name or an object such as PSOR(relaxation=1.5), got {got}"
    )


def takes_rounds(problem: LCP) -> bool:
    """Return whether auto begins with rounds on a dense M: a small problem, no tridiagonal M-matrix kept sparse."""
    if not is_small(problem):
        return False
    if problem.matrix.is_dense:
        return True
    return banded_passes(problem.matrix) > 10
