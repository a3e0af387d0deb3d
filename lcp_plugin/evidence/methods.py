"""The methods of a study, each with a label and the family that colors its curve; the paper's settings and ours."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from typing import Any

from ..algorithms import REGISTRY, create, paper_options
from ..auto import method_of
from ..core.algorithm import Algorithm
from ..core.errors import InvalidOption

FAMILIES = {
    **dict.fromkeys(("npj", "npgs", "npsor", "npaor", "npsplitting"), "projected-type (NP)"),
    **dict.fromkeys(("pj", "pgs", "psor", "paor"), "projected relaxation (P)"),
    **dict.fromkeys(("mj", "mgs", "msor", "maor"), "modulus (M)"),
    "gfp": "general fixed point (GFP)",
    "multigrid": "multigrid",
    "auto": "auto",
}
PAPER_RELAXATION, PAPER_MSOR = 1.7, 0.85


@dataclass(frozen=True)
class Method:
    """A label, the algorithm ("auto" or an object), its family, and the choice of its options."""

    label: str
    algorithm: str | Algorithm
    family: str
    note: str = ""


def family_of(algorithm: str | Algorithm) -> str:
    """Return the family of an algorithm.

    Examples
    --------
    >>> family_of("npsor"), family_of("psor"), family_of("newton")
    ('projected-type (NP)', 'projected relaxation (P)', 'factorizing and pivoting')
    """
    name = algorithm if isinstance(algorithm, str) else algorithm.name
    return FAMILIES.get(name, "factorizing and pivoting" if name in REGISTRY else "other")


def methods_of(given: Any) -> list[Method]:
    """Return the methods of a study.

    Parameters
    ----------
    given : None, an algorithm, a sequence of them, or a mapping of labels to them
        An algorithm is a name, an Algorithm object, or a pair of a name and a dictionary of options. If it is None,
        the paper's methods with its settings and with ours, next to their relatives.

    Raises
    ------
    UnknownAlgorithm
        With the closest name.
    InvalidOption
        If `given` is none of these, or if two different algorithms have one label.
    """
    if given is None:
        return [*_paper_settings(), *_own_settings()]
    if isinstance(given, str | Algorithm) or _is_pair(given):
        given = [given]
    try:
        named = (
            [*given.items()] if isinstance(given, Mapping) else [(None, one) for one in [*given]]
        )
    except TypeError:  # a sparse array only looks like a sequence
        raise InvalidOption(
            f'methods must be names or Algorithm objects, got {given!r}; write ["psor"]'
        ) from None
    found: dict[str, Method] = {}
    for label, one in named:
        method = _method(label, one)
        other = found.setdefault(method.label, method)
        if other.algorithm != method.algorithm:
            raise InvalidOption(
                f"two methods are called {method.label!r}; give them labels, as in "
                '{"mine": …, "theirs": …}'
            )
    return [*found.values()]


def _is_pair(one: Any) -> bool:
    return isinstance(one, tuple) and len(one) == 2 and isinstance(one[1], Mapping)


def _method(label: Any, one: Any) -> Method:
    if isinstance(one, str) or _is_pair(one):
        name, options = (one, {}) if isinstance(one, str) else one
        one = method_of(name, dict(options)) or "auto"
    elif not isinstance(one, Algorithm):
        raise InvalidOption(
            'a method is a name, an Algorithm object or a pair as ("npsor", {"relaxation": 1.5}), '
            f"got {one!r}"
        )
    return Method(str(label) if label else _label(one), one, family_of(one))


def _label(algorithm: str | Algorithm) -> str:
    """Return the name with the options that differ from the defaults."""
    if isinstance(algorithm, str):
        return algorithm
    values = [(field, getattr(algorithm, field.name)) for field in fields(algorithm)]
    changed = [
        f"{field.name}={value}" for field, value in values if repr(value) != repr(field.default)
    ]
    return " ".join([algorithm.name, *changed])


def _paper_settings() -> Iterator[Method]:
    for name, relaxation in (
        ("npgs", None),
        ("npsor", PAPER_RELAXATION),
        ("mgs", None),
        ("msor", PAPER_MSOR),
    ):
        algorithm = create(name, paper_options(name, relaxation))
        yield Method(f"{name.upper()} paper", algorithm, family_of(name), "the paper's settings")


def _own_settings() -> Iterator[Method]:
    for name in ("npgs", "npsor", "npaor", "gfp", "pgs", "psor", "multigrid"):
        label = name if name == "multigrid" else name.upper()
        yield Method(label, create(name, {}), family_of(name))
    yield Method("auto", "auto", family_of("auto"))
