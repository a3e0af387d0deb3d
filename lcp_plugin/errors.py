"""What can go wrong, one class a kind; every message says what was given, what is needed, what to do."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

LONG_LIST = 20  # more names than this are not listed beside a guess


class LCPError(Exception):
    """Base of every error this package raises on purpose."""


class InvalidProblem(LCPError, ValueError):
    """The data do not state a linear complementarity problem."""


class InvalidOption(LCPError, TypeError):
    """An option does not exist, or its value cannot be used."""


class UnsuitableMatrix(LCPError, ValueError):
    """The algorithm cannot run on this matrix, whatever q is."""


class UnsuitableProblem(LCPError, ValueError):
    """The algorithm cannot run on this kind of problem, for instance on its bounds."""


class UnsupportedModel(LCPError, ValueError):
    """The model is no complementarity problem or quadratic program that this package can state."""


class UnknownAlgorithm(LCPError, LookupError):
    """No algorithm of that name is registered."""


class UnreadableFile(LCPError, OSError):
    """A file is missing, damaged, or holds something else than a problem."""


class NotConverged(LCPError, RuntimeError):
    """The run ended without a solution and the caller asked for one."""


class ConvergenceWarning(UserWarning):
    """Nothing proves that the chosen algorithm converges on this matrix."""


class ModelWarning(UserWarning):
    """The model can be read, but probably says something else than was meant."""


def did_you_mean(word: object, known: Iterable[str]) -> str:
    """Return ``"; did you mean 'psor'?"`` or nothing, then the known words.

    Examples
    --------
    >>> did_you_mean("psr", ["psor", "npgs"])
    "; did you mean 'psor'? (known: npgs, psor)"
    """
    names = sorted(known)
    close = difflib.get_close_matches(str(word).lower(), names, n=1)
    if len(names) > LONG_LIST:
        known = f"{len(names)} are known, lcp-plugin list shows them"
        return f"; did you mean {close[0]!r}? ({known})" if close else f"; {known}"
    guess = f"; did you mean {close[0]!r}?" if close else ";"
    return f"{guess} (known: {', '.join(names)})" if close else f"{guess} known: {', '.join(names)}"
