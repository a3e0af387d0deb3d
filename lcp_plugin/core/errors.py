"""Exceptions; every message has the invalid value, the requirement, and a remedy."""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable, Collection, Iterable
from difflib import get_close_matches
from functools import wraps
from importlib import import_module
from typing import Any, TypeVar

Decorated = TypeVar("Decorated", bound=Callable[..., Any])

LONG_LIST = 20  # names or values: of a longer list only some are printed, or none next to a guess


class LCPError(Exception):
    """Base of every error this package raises on purpose."""


class InvalidProblem(LCPError, ValueError):
    """The data do not define a problem, for example if shapes differ or a lower bound exceeds the upper bound."""


class InvalidOption(LCPError, TypeError):
    """An option does not exist, or its value cannot be used."""


def public(function: Decorated, name: str = "") -> Decorated:
    """Decorate a function: a call with other arguments raises InvalidOption, with the call that is possible."""
    name = name or function.__qualname__.removesuffix(".__init__")

    @wraps(function)
    def called(*args: Any, **named: Any) -> Any:
        try:
            return function(*args, **named)
        except TypeError:
            signature = inspect.signature(function)
            try:
                signature.bind(*args, **named)
            except TypeError as wrong:
                raise InvalidOption(_wrong_call(name, signature, named, wrong)) from None
            raise  # by the function itself

    return called  # type: ignore[return-value]


def _wrong_call(
    name: str, signature: inspect.Signature, named: Iterable[str], wrong: object
) -> str:
    """Return the message for arguments that a function does not take: Python's words, and the possible call."""
    forms = {"KEYWORD_ONLY": "{}=…", "VAR_POSITIONAL": "*{}", "VAR_KEYWORD": "name=…"}
    taken = [one for one in signature.parameters.values() if one.name != "self"]
    known = {one.name: forms.get(one.kind.name, "{}").format(one.name) for one in taken}
    hints = (did_you_mean(key, known) for key in named if key not in known)
    hint = next((hint for hint in hints if "did you" in hint), "")
    return f"{name}: {wrong}{hint}; write {name}({', '.join(known.values())})"


class UnsuitableMatrix(LCPError, ValueError):
    """The algorithm cannot run on this matrix, for any q."""


class UnsuitableProblem(LCPError, ValueError):
    """The algorithm cannot run on a problem of this class, or with such bounds."""


class UnsupportedModel(LCPError, ValueError):
    """The model cannot be written as a complementarity problem or a quadratic program."""


class NotSquare(UnsupportedModel):
    """The model has constraints without a complementary unknown; a search over its solutions may accept it."""


class UnknownAlgorithm(LCPError, LookupError):
    """No algorithm of that name is registered."""


class UnreadableFile(LCPError, OSError):
    """A file is missing, corrupt, or does not contain a problem."""


class NotConverged(LCPError, RuntimeError):
    """The run ended without a solution, and the caller required a solution."""


class ModelWarning(UserWarning):
    """The model is valid, but its meaning is probably not the intended meaning."""


def did_you_mean(
    word: object, known: Iterable[object], more: Collection[str] = (), *, is_listed: bool = False
) -> str:
    """Return ``"; did you mean 'psor'?"`` or nothing, then the known words, and the words that `solve` itself takes.

    Among equally close words the first in the alphabet is chosen. Long lists of algorithms and test problems, which
    ``lcp-plugin list`` shows (`is_listed`), are left out.

    Examples
    --------
    >>> did_you_mean("psr", ["psor", "npgs"])
    "; did you mean 'psor'? (known: npgs, psor)"
    """
    written = {str(name): repr(name) for name in known}
    hints = [f"known: {', '.join(sorted(written))}"] if written else []
    if is_listed and len(written) > LONG_LIST:
        hints = [f"{len(written)} are known, lcp-plugin list shows them"]
    written |= {name: repr(name) for name in more}
    hints += [f"solve itself takes {', '.join(sorted(more))}"] if more else []
    close = [name for name in sorted(written) if len(str(word)) > 2 and name.startswith(str(word))]
    close = close or get_close_matches(str(word).lower(), sorted(written), 1, 0.6)
    if not close:
        return f"; {'; '.join(hints)}"
    return f"; did you mean {written[close[0]]}? ({'; '.join(hints)})"


def imported(
    package: str, needs: str, extra: str, error_class: type[Exception] = ImportError
) -> Any:
    """Return an optional package; if it is missing, raise an error with the command that installs it."""
    try:
        return import_module(package)
    except ImportError as error:
        advice = (
            f"install it with: pip install {package.partition('.')[0]} (or lcp_plugin[{extra}])"
        )
        raise error_class(f"{needs}; {advice}") from error


def warn(remark: str, category: type[Warning] = ModelWarning) -> None:
    """Issue a warning at the user's call of this package, or of cvxpy."""
    packages = {__name__.partition(".")[0], "cvxpy", "numpy"}  # np.errstate wraps functions
    frame, level = inspect.currentframe(), 1
    while frame is not None and frame.f_globals.get("__name__", "").partition(".")[0] in packages:
        frame, level = frame.f_back, level + 1
    warnings.warn(remark, category, stacklevel=level)
