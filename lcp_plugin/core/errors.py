"""Exceptions; every message has the invalid value, the requirement, and a remedy."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection, Iterable
from difflib import get_close_matches
from functools import wraps
from typing import Any, TypeVar

Function = TypeVar("Function", bound=Callable[..., Any])

LONG_LIST = 20  # names or values: of a longer list only some are printed, or none next to a guess


class LCPError(Exception):
    """Base of every error this package raises on purpose."""


class InvalidProblem(LCPError, ValueError):
    """The data do not define a problem, for example if shapes differ or a lower bound exceeds the upper bound."""


class InvalidOption(LCPError, TypeError):
    """An option does not exist, or its value cannot be used."""


def public(function: Function) -> Function:
    """Decorate a function: a call with other arguments raises InvalidOption, with the call that is possible."""

    @wraps(function)
    def called(*args: Any, **named: Any) -> Any:
        try:
            return function(*args, **named)
        except TypeError as error:
            if error.__traceback__ is None or error.__traceback__.tb_next is not None:
                raise  # not by this call itself
        raise InvalidOption(_wrong_call(function, args, named))

    return called  # type: ignore[return-value]


def _wrong_call(function: Callable[..., Any], args: Any, named: Any) -> str:
    """Return the message for arguments that a function does not take."""
    signature, wrong = inspect.signature(function), ""
    try:
        signature.bind(*args, **named)
    except TypeError as error:
        wrong = str(error)
    forms = {"KEYWORD_ONLY": "{}=…", "VAR_POSITIONAL": "*{}", "VAR_KEYWORD": "**{}"}
    known = {
        name: forms.get(one.kind.name, "{}").format(name)
        for name, one in signature.parameters.items()
        if name != "self"
    }
    name = function.__qualname__.removesuffix(".__init__")
    hints = (
        did_you_mean(k, known)
        for k in named
        if k not in known and "did you" in did_you_mean(k, known)
    )
    return f"{name}: {wrong}{next(hints, '')}; write {name}({', '.join(known.values())})"


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
    word: object,
    known: Iterable[str | None],
    of_solve: Collection[str] = (),
    *,
    is_listed: bool = False,
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
    written |= {name: repr(name) for name in of_solve}
    hints += [f"solve itself takes {', '.join(sorted(of_solve))}"] if of_solve else []
    close = [name for name in sorted(written) if len(str(word)) > 2 and name.startswith(str(word))]
    close = close or get_close_matches(str(word).lower(), sorted(written), 1, 0.6)
    if not close:
        return f"; {'; '.join(hints)}"
    return f"; did you mean {written[close[0]]}? ({'; '.join(hints)})"
