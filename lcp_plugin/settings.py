"""What a caller may ask of a run, checked once."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .algorithms.base import is_number
from .certificates.residuals import MEASURES
from .checks import FloatVector, real_vector
from .errors import InvalidOption, InvalidProblem, did_you_mean
from .problem import LCP

DEFAULT_MAX_ITERATIONS = 100_000
TARGETS = ("residual", "error")


@dataclass(frozen=True)
class Settings:
    """Tolerance, limits and wishes of one run.

    Parameters
    ----------
    tolerance : float
        ≥ 0 and finite.
    tolerance_on : {"residual", "error"}
        What the tolerance speaks of.
    measure : {"relative", "euclidean"}
        The residual that is followed.
    max_iterations : int or None
        None means 100 000.
    max_seconds : float or None
        In seconds; None means no limit.
    record, error_bound : bool
        Whether to keep samples, and whether to bound the error.

    Raises
    ------
    InvalidOption
        Where one of them is none of these.
    """

    tolerance: Any
    tolerance_on: Any
    measure: Any
    max_iterations: Any
    max_seconds: Any
    record: Any
    error_bound: Any

    def __post_init__(self) -> None:
        checked = {
            "tolerance": _number(self.tolerance, "tolerance"),
            "tolerance_on": _choice(self.tolerance_on, "tolerance_on", TARGETS),
            "measure": _choice(self.measure, "measure", MEASURES),
            "max_iterations": _count(self.max_iterations),
            "max_seconds": math.inf if self.max_seconds is None else _number(self.max_seconds, "max_seconds"),
            "record": _flag(self.record, "record"),
            "error_bound": _flag(self.error_bound, "error_bound"),
        }
        for name, value in checked.items():
            object.__setattr__(self, name, value)

    @property
    def is_on_error(self) -> bool:
        """True where SOLVED asks for a proven bound of the error."""
        return bool(self.tolerance_on == "error")


def checked_start(problem: LCP, z0: ArrayLike | None) -> FloatVector:
    """Return the start within the bounds, shape (n,).

    Raises
    ------
    InvalidOption
        Where z0 is no finite real vector of length n.
    """
    if z0 is None:
        return problem.nearest_to_zero
    try:
        start = real_vector(z0, "z0", problem.n)
    except InvalidProblem as error:
        raise InvalidOption(str(error)) from error
    if not np.isfinite(start).all():
        raise InvalidOption(f"z0 must be a finite vector of length {problem.n}, got NaN or infinite entries")
    return np.clip(start, problem.lower, problem.upper)


def _number(value: Any, name: str) -> float:
    if not is_number(value):
        raise InvalidOption(f"{name} must be a finite number, got {value!r}")
    if not 0.0 <= value < math.inf:
        raise InvalidOption(f"{name} must be finite and not negative, got {value!r}")
    return float(value)


def _count(value: Any) -> int:
    if value is None:
        return DEFAULT_MAX_ITERATIONS
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < 0:
        raise InvalidOption(f"max_iterations must be a whole number ≥ 0, got {value!r}")
    return int(value)


def _choice(value: Any, name: str, choices: tuple[str, ...]) -> str:
    if not isinstance(value, str) or value not in choices:
        raise InvalidOption(f"{name}={value!r} is not offered{did_you_mean(value, choices)}")
    return value


def _flag(value: Any, name: str) -> bool:
    if not isinstance(value, (bool, np.bool_)):
        raise InvalidOption(f"{name} must be True or False, got {value!r}")
    return bool(value)


class CallersOwn:
    """The caller's function, which remembers what it raised: that is no refusal of ours.

    Parameters
    ----------
    function : callable
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function
        self.raised: BaseException | None = None

    def __call__(self, *arguments: Any) -> bool:
        """Return the truth of what the function returns."""
        try:
            return bool(self._function(*arguments))
        except BaseException as error:
            self.raised = error
            raise
