"""Options of a run, checked once, and its termination statuses.

Options of `solve` and `solve_batch` for each problem class; editors complete them, and mypy checks them.

:func:`lcp_plugin.solve` describes the options. Options of a named algorithm, for example ``relaxation``, are in
`AlgorithmOptions`. An engine, as ``piqp``, takes its own options in addition.
"""

from __future__ import annotations

import math
from ast import literal_eval
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, fields
from enum import Enum
from functools import partial
from typing import Any, Literal, TypedDict

import numpy as np
from numpy.typing import ArrayLike

from .checks import fill, is_number
from .errors import InvalidOption
from .kernels.threads import usable_threads

CONSTANTS = {"true": "True", "false": "False", "none": "None", "inf": "1e999"}
ZERO_TOLERANCE = 2.0**-200  # a tolerance instead of 0


class Status(Enum):
    """Termination status; its value is a text with the reason and the next step. `advice` of a result has details."""

    SOLVED = "the residual is within the tolerance, rounding included, as proved on your data"
    PRECISION_LIMIT = (
        "the residual is above the tolerance, but no larger than rounding in double precision explains; "
        "next: accept z, or rescale the data"
    )
    MAX_ITERATIONS = "iteration limit reached; next: raise max_iterations"
    MAX_SECONDS = "time limit reached; next: raise max_seconds"
    STALLED = "not solved, and nothing is proved: the residual no longer falls, or too slowly for max_iterations"
    DIVERGED = "the iterates diverged: the residual grew by a factor of 10⁸, or is not finite"
    INFEASIBLE = (
        "infeasible, even if every condition is relaxed by the tolerance; next: print(result.conflict), which "
        "conditions conflict"
    )
    NO_SOLUTION = (
        "no solution exists: the inequalities are feasible, but not with complementarity; every active set is "
        "excluded exactly, by more than the tolerance; next: check the data (proof: result.proof)"
    )
    UNBOUNDED = (
        "the objective is unbounded; next: add bounds for the unknowns of the direction in result.proof, which "
        "proves it"
    )
    INTERRUPTED = "stopped by Ctrl-C or the callback; next: continue from z, the best iterate"


LIMITS = (Status.MAX_ITERATIONS, Status.MAX_SECONDS)
# by a proof whose margin exceeds the tolerance
PROVEN = (Status.INFEASIBLE, Status.NO_SOLUTION, Status.UNBOUNDED)


@dataclass(frozen=True)
class Settings:
    """Tolerance, limits and options of one run.

    Parameters
    ----------
    tolerance : float
        Relative tolerance, in [0, 1).
    max_iterations : int or None
        None means 100 000.
    max_seconds : float or None
        Wall-clock seconds; None or ∞ means unlimited.
    absolute_tolerance : float
        ‖r(z)‖∞, in the unit of z, that is accepted without a reference; ≥ 0 and finite.
    record : bool
        Whether to keep samples.
    threads : int or None
        At least 1; None means all that the process may use.
    verbose : bool
        Whether to print the run.
    prove_infeasibility : bool
        Whether to search for a proof that no solution exists.
    polish : bool
        Whether a final linear solve on the active set may replace the last iterate of an LCP.

    Raises
    ------
    InvalidOption
        If a value is invalid.
    """

    tolerance: Any = 1e-8
    max_iterations: Any = None
    max_seconds: Any = None
    absolute_tolerance: float = 0.0
    record: bool = False
    threads: Any = field(default=None, repr=False, compare=False)
    verbose: bool = False
    prove_infeasibility: bool = True
    polish: bool = True

    def __post_init__(self) -> None:
        for name, check in CHECKS.items():
            value = getattr(self, name)
            if value is None and name in NONE_MEANS:
                fill(self, **{name: NONE_MEANS[name]})
            elif value is not DEFAULTS[name]:
                fill(self, **{name: check(value, name)})

    @property
    def is_watched(self) -> bool:
        """Whether the run is recorded or printed."""
        return bool(self.record or self.verbose)

    @property
    def has_steps(self) -> bool:
        """Whether the limits allow a step."""
        return bool(self.max_iterations and self.max_seconds > 0.0)

    @property
    def goal(self) -> float:
        """Required ratio of residual to reference."""
        return float(self.tolerance or (ZERO_TOLERANCE if self.absolute_tolerance else 0.0))


DEFAULTS = {setting.name: setting.default for setting in fields(Settings)}
BESIDE = ("z0", "callback")  # further options of a run
MOST = 2**53  # limit of steps, nodes and threads
# options of `solve`, not of an algorithm
OF_SOLVE = (*BESIDE, *(setting.name for setting in fields(Settings)))


def _finite_number(value: float, name: str) -> float:
    if not is_number(value):
        raise InvalidOption(f"{name} must be a finite number, got {value!r}")
    if not 0.0 <= value < math.inf:
        raise InvalidOption(f"{name} must be finite and not negative, got {value!r}")
    return float(value)


def _seconds(value: float, name: str) -> float:
    return math.inf if is_number(value) and value == math.inf else _finite_number(value, name)


def checked_tolerance(value: float, name: str = "tolerance", *, may_be_zero: bool = True) -> float:
    """Return a relative tolerance in [0, 1), or in (0, 1).

    Raises
    ------
    InvalidOption
        For other numbers, and for values that are not numbers.
    """
    if not (_finite_number(value, name) or may_be_zero):
        raise InvalidOption(f"{name} must be a number > 0, got {value!r}")
    if value >= 1.0:
        raise InvalidOption(f"{name} must be less than 1, got {value!r}: it is relative; try 1e-8")
    return float(value)


def whole_number(value: object, name: str, least: int, otherwise: str = "") -> int:
    """Return an integer of at least `least`; raise InvalidOption for anything else."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise InvalidOption(f"{name} must be an integer ≥ {least}{otherwise}, got {value!r}")
    return min(int(value), MOST)


def flag(value: object, name: str) -> bool:
    """Return a bool; raise InvalidOption for anything else."""
    if not isinstance(value, (bool, np.bool_)):
        raise InvalidOption(f"{name} must be True or False, got {value!r}")
    return bool(value)


def checked_threads(threads: int | None, name: str = "threads") -> int:
    """Return the number of threads; None means all that the process may use.

    Raises
    ------
    InvalidOption
        If `threads` is not an integer ≥ 1.
    """
    otherwise = ", or None for all that may be used"
    return usable_threads() if threads is None else whole_number(threads, name, 1, otherwise)


CHECKS: dict[str, Callable[[Any, str], Any]] = {
    "tolerance": checked_tolerance,
    "max_iterations": partial(whole_number, least=0),
    "max_seconds": _seconds,
    "absolute_tolerance": _finite_number,
    "record": flag,
    "threads": checked_threads,
    "verbose": flag,
    "prove_infeasibility": flag,
    "polish": flag,
}
NONE_MEANS = {"max_iterations": 100_000, "max_seconds": math.inf}
DEFAULT = Settings()  # of a call without options


def checked_callback(callback: object) -> Callable[..., Any] | None:
    """Return the caller's function, or None."""
    if callback is not None and not callable(callback):
        raise InvalidOption(f"callback must be callable, got {callback!r}")
    return callback


def parse_options(words: Iterable[str]) -> dict[str, Any]:
    """Return options written as name=value; numbers, true, false and none are read as such, others are texts.

    Raises
    ------
    InvalidOption
        If a word has another form, or a name is given twice.

    Examples
    --------
    >>> parse_options(["relaxation=1.5", "sweep=forward", "degenerate=true"])
    {'relaxation': 1.5, 'sweep': 'forward', 'degenerate': True}
    """
    options: dict[str, Any] = {}
    for word in words:
        name, equals, text = (part.strip() for part in word.partition("="))
        if not (name and equals):
            raise InvalidOption(f"an option is name=value, as tolerance=1e-10; got {word!r}")
        if name in options:
            raise InvalidOption(f"the option {name} is given twice; once is enough")
        try:
            options[name] = literal_eval(CONSTANTS.get(text.lower(), text))
        except (ValueError, SyntaxError):
            options[name] = text
    return options


EngineName = Literal["piqp", "daqp", "clarabel", "highs"]


class AlgorithmOptions(TypedDict, total=False):
    """Options of the named algorithms for an LCP."""

    relaxation: float | str
    acceleration: float
    sweep: str
    momentum: str | None
    scaling: str | None
    scaling_factor: float
    splitting: Any
    omega: float | ArrayLike
    max_pivots: int | None
    restarts: int | None
    coarsest: int
    hands_over: bool


class Options(AlgorithmOptions, total=False):
    """Options of `solve`; each problem class takes some of them."""

    tolerance: float
    absolute_tolerance: float
    max_iterations: int | None
    max_seconds: float | None
    max_nodes: int | None
    record: bool
    callback: Callable[..., Any] | None
    threads: int | None
    verbose: bool
    z0: ArrayLike | None
    x0: ArrayLike | None
    prove_infeasibility: bool
    prove: bool
    polish: bool
    check_jacobian: bool
    search: str | None


class BatchOptions(TypedDict, total=False):
    """Options of `solve_batch` for each problem, and of the batch."""

    tolerance: float
    absolute_tolerance: float
    max_iterations: int | None
    max_seconds: float | None
    prove_infeasibility: bool
    threads: int | None
