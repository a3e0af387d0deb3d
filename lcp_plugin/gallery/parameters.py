"""What a scene's parameter may be: the kind and the range stand once, in the builder's signature."""

from __future__ import annotations

import contextlib
import inspect
import math
import numbers
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, NamedTuple, get_args, get_origin, get_type_hints

import numpy as np

from ..core.errors import InvalidOption


class Rule(NamedTuple):
    """A condition on a value, and how to say it: "n must be ``needs``"."""

    needs: str
    holds: Callable[[Any], bool]


def at_least(low: float) -> Rule:
    """Return the rule value ≥ low."""
    return Rule(f"≥ {low}", lambda value: bool(value >= low))


def more_than(low: float) -> Rule:
    """Return the rule value > low."""
    return Rule(f"> {low}", lambda value: bool(value > low))


def between(low: float, high: float) -> Rule:
    """Return the rule low ≤ value ≤ high."""
    return Rule(f"between {low} and {high}", lambda value: bool(low <= value <= high))


def one_of(*choices: str) -> Rule:
    """Return the rule that the value is one of these words."""
    return Rule(" or ".join(map(repr, choices)), lambda value: value in choices)


Count = Annotated[int, at_least(1)]
Square = Annotated[int, Rule("a perfect square ≥ 1", lambda n: n >= 1 and math.isqrt(n) ** 2 == n)]
Seed = Annotated[int, at_least(0)]
Positive = Annotated[float, more_than(0)]
NonNegative = Annotated[float, at_least(0)]
Share = Annotated[float, between(0, 1)]


class _Kind(NamedTuple):
    noun: str
    accepted: tuple[type, ...]
    from_text: Callable[[str], Any]


_TRUTH = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}

_KINDS: dict[type, _Kind] = {
    bool: _Kind("True or False", (bool, np.bool_), lambda text: _TRUTH[text.lower()]),
    int: _Kind("an integer", (numbers.Integral,), int),
    float: _Kind("a finite number", (numbers.Real,), float),
    str: _Kind("a word", (str,), str),
}


@dataclass(frozen=True)
class Parameter:
    """One parameter of one scene."""

    scene: str
    name: str
    default: Any
    kind: type
    rules: tuple[Rule, ...] = ()

    def check(self, value: Any) -> Any:
        """Return the value as a plain Python object.

        Raises
        ------
        InvalidOption
            Where it has the wrong type or lies out of range.
        """
        is_bool = isinstance(value, bool | np.bool_)
        if isinstance(value, _KINDS[self.kind].accepted) and is_bool == (self.kind is bool):
            with contextlib.suppress(OverflowError):
                plain = self.kind(value)
                if (self.kind is not float or math.isfinite(plain)) and all(
                    rule.holds(plain) for rule in self.rules
                ):
                    return plain
        raise self._refusal(value)

    def read(self, text: str) -> Any:
        """Return the value written as text, unchecked as to its range.

        Raises
        ------
        InvalidOption
            Where the text does not denote a value of this kind.
        """
        try:
            return _KINDS[self.kind].from_text(text)
        except (ValueError, KeyError):
            raise self._refusal(text) from None

    def _refusal(self, value: Any) -> InvalidOption:
        needs = ", ".join([_KINDS[self.kind].noun, *(rule.needs for rule in self.rules)])
        return InvalidOption(
            f"scene {self.scene!r}: {self.name} must be {needs}, got {value!r} (the default is {self.default!r})"
        )


@cache
def parameters_of(builder: Callable[..., Any]) -> dict[str, Parameter]:
    """Return the parameters that a builder's signature declares, by name and in order."""
    hints = get_type_hints(builder, include_extras=True)
    parameters = {}
    for name, declared in inspect.signature(builder).parameters.items():
        hint = hints[name]
        kind, *rules = get_args(hint) if get_origin(hint) is Annotated else (hint,)
        parameters[name] = Parameter(builder.__name__, name, declared.default, kind, tuple(rules))
    return parameters
