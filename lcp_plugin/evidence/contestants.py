"""Who takes part in a race: algorithms with a label and a family, at the paper's settings and at ours.

Of somebody else a study runs problems as functions, and says where a mistake in them or in a method lies.
"""

from __future__ import annotations

import contextlib
import hashlib
import inspect
import sys
import sysconfig
import traceback
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from ..algorithms import REGISTRY, create, module_of
from ..api import solve
from ..auto import policy_for
from ..core.algorithm import Algorithm
from ..core.checks import FloatVector
from ..core.errors import InvalidOption, LCPError
from ..core.kind import refusal
from ..core.lcp import LCP
from ..core.settings import Status
from ..core.solving.result import Result, Sample
from ..gallery.scene import Scene

FAMILIES = {
    "projected_type": "projected-type (NP)",
    "npsplitting": "projected-type (NP)",
    "projected_relaxation": "projected relaxation (P)",
    "modulus": "modulus (M)",
    "multigrid": "multigrid",
    "auto": "auto",
}
OTHER = "factorising and pivoting"
PAPER_RELAXATION, PAPER_MSOR = 1.7, 0.85


@dataclass(frozen=True)
class Contestant:
    """A label, the algorithm behind it ("auto" or an object), its family, and how its options came about."""

    label: str
    algorithm: str | Algorithm
    family: str
    note: str = ""


def family_of(algorithm: str | Algorithm) -> str:
    """Return the family that colours a curve.

    Examples
    --------
    >>> family_of("npsor"), family_of("psor"), family_of("newton")
    ('projected-type (NP)', 'projected relaxation (P)', 'factorising and pivoting')
    """
    name = algorithm if isinstance(algorithm, str) else algorithm.name
    if name == "gfp":
        return "general fixed point (GFP)"
    if name not in REGISTRY and name != "auto":
        return "other"
    return FAMILIES.get(module_of(name), OTHER)


def contestants(algorithms: Any) -> list[Contestant]:
    """Return who takes part.

    Parameters
    ----------
    algorithms : None, a sequence, or a mapping of labels to its items
        Of names, Algorithm objects and pairs of a name and a dictionary of its options. None: the comparison that the
        paper promises.

    Raises
    ------
    UnknownAlgorithm
        With the closest name.
    InvalidOption
        Where `algorithms` is none of these, or two different ones have one label.
    """
    if algorithms is None:
        return [*paper_settings(), *own_settings()]
    if isinstance(algorithms, str | Algorithm | Contestant) or _is_with_options(algorithms):
        algorithms = [algorithms]
    try:
        named = (
            [*algorithms.items()]
            if isinstance(algorithms, Mapping)
            else [(None, one) for one in algorithms]
        )
    except TypeError:  # a sparse array only seems to be a sequence
        raise InvalidOption(
            f'algorithms must be names or Algorithm objects, got {algorithms!r}; write ["psor"]'
        ) from None
    every = [
        one if isinstance(one, Contestant) else _contestant(label, one) for label, one in named
    ]
    found: dict[str, Contestant] = {}
    for one in every:
        other = found.setdefault(one.label, one)
        if other.algorithm is not one.algorithm and other.algorithm != one.algorithm:
            raise InvalidOption(
                f"two methods are called {one.label!r}, {other.algorithm!r} and {one.algorithm!r}; give them labels, "
                'as in {"mine": …, "theirs": …}, or another name to your own'
            )
    return list(found.values())


def checked_names(names: Any, option: str) -> list[str]:
    """Return the names as a list.

    Raises
    ------
    InvalidOption
        Where they are a single word, or something else than words.
    """
    given = f"the word {names!r}; write [{names!r}]" if isinstance(names, str) else repr(names)
    with contextlib.suppress(TypeError):
        listed = list(names)
        if not isinstance(names, str) and all(isinstance(name, str) for name in listed):
            return listed
    raise InvalidOption(f"{option} must be a list of names, got {given}")


def _is_with_options(one: Any) -> bool:
    return (
        isinstance(one, tuple)
        and len(one) == 2
        and isinstance(one[0], str)
        and isinstance(one[1], Mapping)
    )


def _contestant(label: Any, one: Any) -> Contestant:
    """Return who takes part: an algorithm, made of its name or of a pair of its name and its options, or "auto"."""
    made = one
    if not isinstance(one, Algorithm):
        if isinstance(one, type):
            name = one.__name__
            raise InvalidOption(
                f"an algorithm is a name or an object, got the class {name}; write {name}()"
            )
        if not (isinstance(one, str) or _is_with_options(one)):
            raise InvalidOption(
                'an algorithm is a name, an Algorithm object or a pair as in ("npsor", {"relaxation": 1.5}), '
                f"got {one!r}"
            )
        name, options = (one, {}) if isinstance(one, str) else one
        made = (
            policy_for(name, dict(options)).name if name == "auto" else create(name, dict(options))
        )
    return Contestant(str(label) if label else _label(made), made, family_of(made))


def _label(algorithm: str | Algorithm) -> str:
    """Return the name with the options that differ from the defaults."""
    if isinstance(algorithm, str):
        return algorithm
    changed = [
        f"{field.name}={getattr(algorithm, field.name)}"
        for field in fields(algorithm)
        if repr(getattr(algorithm, field.name)) != repr(field.default)
    ]
    return " ".join([algorithm.name, *changed])


def paper_options(name: str, relaxation: float | None) -> dict[str, Any]:
    """Return the options that the paper's tables were computed with."""
    if name.startswith("np"):
        return {"scaling": None} | ({"relaxation": relaxation} if relaxation else {})
    if name == "msor" and relaxation:
        return {"relaxation": relaxation, "omega": 1.0 / (2.0 * relaxation**2)}
    return {"omega": 0.5}


def paper_settings() -> Iterable[Contestant]:
    """Yield the paper's methods with its own settings: no row scaling, the Ω behind its tables."""
    unscaled, tables = "as in the paper: no row scaling", "as behind the paper's tables"
    for name, relaxation, note in (
        ("npgs", None, unscaled),
        ("npsor", PAPER_RELAXATION, unscaled),
        ("mgs", None, f"Ω = D/2, {tables}"),
        ("msor", PAPER_MSOR, f"Ω = D/(2α²), α = {PAPER_MSOR}, {tables}"),
    ):
        yield _made(f"{name.upper()} paper", name, note, **paper_options(name, relaxation))


def own_settings() -> Iterable[Contestant]:
    """Yield the methods with the package's defaults."""
    scaled = "row scaling found automatically"
    yield _made("NPGS", "npgs", scaled)
    yield _made("NPSOR", "npsor", f"{scaled}, α = 1.7")
    yield _made("NPAOR", "npaor", f"{scaled}, α = 1.7, β = 1")
    yield _made("GFP", "gfp", "Ω = D⁻¹")
    yield _made("PGS", "pgs", "")
    yield _made("PSOR", "psor", "relaxation found during the run")
    yield _made("multigrid", "multigrid", "")
    yield Contestant("auto", "auto", family_of("auto"), "the default of solve")


def _made(label: str, name: str, note: str, **options: Any) -> Contestant:
    return Contestant(label, create(name, options), family_of(name), note)


def fresh(problem: LCP) -> LCP:
    """Return the same problem with nothing computed about it yet; the arrays are shared."""
    return LCP(problem.M, problem.q, lower=problem.lower, upper=problem.upper)


class WorkLimit:
    """A callback that ends a run after so many passes over M: the same end on every machine."""

    def __init__(self, max_work: float) -> None:
        self.max_work = max_work
        self.is_over = False

    def __call__(self, sample: Sample, z: FloatVector) -> bool:
        """Return whether the limit is reached."""
        self.is_over = sample.work >= self.max_work
        return self.is_over


def measured_run(
    problem: LCP, algorithm: str | Algorithm, limit: WorkLimit, **settings: Any
) -> Result:
    """Return what `solve` returns; Ctrl-C, after which `solve` keeps the best iterate, ends a measurement."""
    result = solve(problem, algorithm, callback=limit, **settings)
    if result.status is Status.INTERRUPTED and not limit.is_over:
        raise KeyboardInterrupt
    return result


OURS = (
    str(Path(__file__).parents[1]),
    *(sysconfig.get_paths()[name] for name in ("stdlib", "purelib", "platlib")),
)


def error_line(error: BaseException) -> str:
    """Return an error in one line, with the last line of somebody else's code that it passed."""
    words = " ".join(str(error).split())
    if isinstance(error, LCPError):
        return words
    if isinstance(error, SyntaxError) and error.filename:
        return f"{Path(error.filename).name}, line {error.lineno}: {error.msg}: {(error.text or '').strip()}"
    said = f"{type(error).__name__}: {words}" if words else type(error).__name__
    last = own_frame(error)
    if last is None:
        return said
    return f"{Path(last.filename).name}, line {last.lineno}, in {last.name}: {said}: {last.line}"


def own_frame(error: BaseException) -> traceback.FrameSummary | None:
    """Return the last frame of an error that is neither ours nor a library's, None where there is none."""
    frames = traceback.extract_tb(error.__traceback__)
    return next((one for one in reversed(frames) if not _is_installed(one.filename)), None)


def _is_installed(path: str) -> bool:
    """Return whether a file is ours, of a library, wherever that is installed, or none at all."""
    return path.startswith((*OURS, "<")) or not {"site-packages", "dist-packages"}.isdisjoint(
        Path(path).parts
    )


def own_source(thing: Any) -> str:
    """Return a hash of the file that an object's class comes from, where that is neither ours nor a library's."""
    if isinstance(thing, str):
        return ""
    path = getattr(sys.modules.get(type(thing).__module__), "__file__", None)
    if path is None or _is_installed(path) or not Path(path).is_file():
        return ""
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


def as_scene_of(given: Any, name: str, size: int | None, way: str = "study") -> Scene:
    """Return the scene that a problem, or a function of the size, or (M, q) means.

    Raises
    ------
    InvalidOption
        Where it is nothing of that, or a size is given to what has one.
    """
    if isinstance(given, LCP | Scene | tuple) and size is not None:
        raise InvalidOption(
            f"{name} is one problem and has its size; leave sizes out, or give a function of the size"
        )
    if callable(given) and not isinstance(given, type):
        arguments = () if size is None else (size,)
        try:
            inspect.signature(given).bind(*arguments)
        except TypeError as error:
            needs = (
                "needs a size (sizes=[100], --size 100)"
                if size is None
                else f"does not take the size {size}"
            )
            raise InvalidOption(
                f"{name} {needs}, or its parameters, {name}:key=value: {error}"
            ) from None
        given = given(*arguments)
    if isinstance(given, tuple) and 2 <= len(given) <= 4:
        given = LCP(given[0], given[1], **dict(zip(("lower", "upper"), given[2:], strict=False)))
    if isinstance(given, LCP):
        return Scene(problem=given, name=name, is_declared=False)
    if isinstance(given, Scene):
        return given
    raise InvalidOption(
        f"{refusal(way, given)}; {name} may also be a scene, (M, q), or a function of the size"
    )
