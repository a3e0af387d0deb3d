"""The kinds of problems: what solves each, and which ways in and out take it.

A kind is a row of a table, which its room offers, a way a column. Who is given a kind that it does not take says so in
the words of its cell. README shows the table in small, ``lcp-plugin list`` prints it, and a test walks all cells with
problems of each kind.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any

from .errors import InvalidOption, did_you_mean
from .registry import ask, at, offered

FUNCTIONS = (
    "solve", "solve_batch", "solve_many", "prepare", "march", "march_many", "derivative", "certify", "Certificate.of",
    "error_bound", "analyze", "all_solutions", "convergence_guarantee", "cross_validate", "error_against_time",
    "study", "presolve",
)
STORES = ("save", "pickle")
LANGUAGES = ("cvxpy", "Pyomo", "AMPL", "qpsolvers")
COMMANDS = tuple(f"lcp-plugin {name}" for name in ("solve", "check", "certify", "analyze", "study", "report"))
WAYS = (*FUNCTIONS, *STORES, *LANGUAGES, *COMMANDS)


@dataclass(frozen=True)
class Kind:
    """A kind of problem.

    Attributes
    ----------
    name : str
        What it is called in a sentence.
    home, solver, result : str
        Where its class lies, what solves it, what that returns: places, as in "core.lcp:LCP".
    ways : tuple of str
        Those of `WAYS` that take it, or its result.
    otherwise : str
        What to write for any other.
    instead : mapping from str to str
        What to write for some of these; an option of `solve` that its solver does not have is called as in ``z0=``.
    """

    name: str
    home: str
    solver: str
    result: str
    ways: tuple[str, ...]
    otherwise: str
    instead: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def type(self) -> Any:
        """Its class."""
        return at(self.home)

    @property
    def word(self) -> str:
        """The name of its class."""
        return self.home.partition(":")[2]

    def words(self, way: str) -> str:
        """Return what to write for a way that does not take this kind, '' for one that does."""
        return "" if way in self.ways else self.instead.get(way, self.otherwise)

    @cached_property
    def options(self) -> Mapping[str, Any] | None:
        """The options that its solver has, with their defaults; None where it takes those of an algorithm as well."""
        parameters = list(inspect.signature(at(self.solver)).parameters.values())[1:]
        if any(one.kind is one.VAR_KEYWORD for one in parameters):
            return None
        return {one.name: one.default for one in parameters}

    def refuse(self, wishes: Mapping[str, Any]) -> None:
        """Raise InvalidOption where the table says what to write instead of one of these options."""
        for name in wishes:
            if f"{name}=" in self.instead:
                instead = self.instead[f"{name}="]
                raise InvalidOption(f"solve takes no {name} for {_with_article(self.word)}; {instead}")

    def solve(self, problem: Any, algorithm: Any, wishes: Mapping[str, Any]) -> Any:
        """Return the answer to a problem of this kind.

        Raises
        ------
        InvalidOption
            Where it is asked for what this kind does not take, or where what it needs is not given.
        """
        if self.options is None or "algorithm" in self.options or algorithm != "auto":
            wishes = {"algorithm": algorithm, **wishes}
        self.refuse(wishes)
        article = _with_article(self.word)
        for name in wishes:
            if self.options is not None and name not in self.options:
                raise InvalidOption(f"solve takes no {name} for {article}{did_you_mean(name, self.options)}")
        for name, default in (self.options or {}).items():
            if default is inspect.Parameter.empty and name not in wishes:
                raise InvalidOption(f"solve needs {name} for {article}: write solve(problem, {name}=…)")
        return at(self.solver)(problem, **wishes)


def changes_by_name(origin: Any, named: Mapping[str, Any], known: Sequence[str], elsewhere: str = "") -> dict[str, Any]:
    """Return what changes of the data that a problem was made from are in its M and q, as ``{"dM": …, "dq": …}``.

    Parameters
    ----------
    origin : object
        That of the problem: it may list `names`, and have `changes`.
    named : mapping
        The changes.
    known : sequence of str
        What else a derivative takes; for the message.
    elsewhere : str
        What to say of names of contacts that this derivative does not take.

    Raises
    ------
    InvalidOption
        Where a name is none of these.
    """
    names = getattr(origin, "names", ())
    for name in named:
        if name not in names:
            raise InvalidOption(f"a derivative takes no {name} here{did_you_mean(name, [*known, *names])}{elsewhere}")
    return dict(origin.changes(**named)) if named else {}


LINEAR_COMPLEMENTARITY_PROBLEM = Kind(
    "linear complementarity problem", "core.lcp:LCP", "core.solving.driver:solve", "core.solving.result:Result",
    tuple(way for way in WAYS if way not in ("certify", "qpsolvers", "lcp-plugin certify")), "",
    {
        "x0=": "a start is called z0 here",
        "certify": "Certificate.of(problem, z) has the residuals of a z, error_bound(problem, z) bounds its "
                   "distance from the solution",
        "qpsolvers": "problem.to_qp() makes a program of a symmetric M",
        "lcp-plugin certify": "lcp-plugin solve judges an LCP, --error-bound bounds the error",
    },
)


def kinds() -> tuple[Kind, ...]:
    """Return the kinds that are here, in the order of README's table."""
    return tuple(ask("kind", name) for name in offered("kind"))


def kind_of(problem: Any) -> Kind | None:
    """Return the kind of a problem, None where it is none."""
    return _kind_of_type(type(problem))  # type: ignore[arg-type]  # typeshed takes types for unhashable


@lru_cache(maxsize=64)  # kinds are those that the rooms here offer, and many problems are asked for theirs
def _kind_of_type(given: type) -> Kind | None:
    names = {base.__name__ for base in given.__mro__}
    return next((kind for kind in kinds() if kind.word in names and issubclass(given, kind.type)), None)


def solve_any(problem: Any, algorithm: Any, wishes: Mapping[str, Any]) -> Any:
    """Return the answer to a problem of another kind than an LCP; raise InvalidOption where it is none."""
    kind = kind_of(problem)
    if kind is None:
        raise InvalidOption(refusal("solve", problem))
    return kind.solve(problem, algorithm, wishes)


def refusal(way: str, given: Any) -> str:
    """Return what to say where a way does not take what it was given, with what to write instead."""
    takes = [kind.word for kind in kinds() if way in kind.ways]
    needs = " or ".join(filter(None, [", ".join(takes[:-1]), takes[-1]]))
    needs = f"the answer to {_with_article(needs)}" if way == "derivative" else _with_article(needs)
    kind = kind_of(given)
    if way in ("derivative", "certify") and kind is None:  # an answer
        kind = next((one for one in kinds()[2:] if one.result.endswith(f":{type(given).__name__}")), None)
    instead = _remedy(way, given) if kind is None else kind.words(way) or f"write {way}(solve(problem))"
    return f"{way} needs {needs}, got {type(given).__name__}; {instead}"


def _remedy(way: str, given: Any) -> str:
    """Return what to write for what is no problem of any kind, but near one."""
    if way == "derivative" and hasattr(given, "all_solved"):
        return "write derivative(answers[k]) for one that is the answer to an LCP"
    if way == "derivative":
        return "write derivative(solve(problem))"
    if way == "certify" and hasattr(given, "is_stationary"):
        return "give the program as well: certify(program, solution)"
    if way == "certify" and hasattr(given, "certificate"):
        return "result.certificate has its residuals, error_bound(problem, result.z) bounds its distance"
    if hasattr(given, "require_solved"):
        return "that is an answer: give the problem"
    if kind_of(getattr(given, "problem", None)) is not None:
        return f"write {way}(scene.problem)" if hasattr(given, "grid") else "give its problem"
    if isinstance(given, (str, bytes)) or hasattr(given, "__fspath__"):
        return "read a file first: load_problem(path), or lcp_plugin.doors.nl.read_nl(path) for a model of AMPL"
    if type(given).__module__.startswith("cvxpy."):
        return 'write problem.solve(method="LCP"), or LCP.from_cvxpy(problem)'
    is_list = isinstance(given, (list, tuple)) and bool(given) and kind_of(given[0]) is not None
    if is_list or type(given).__name__ == "QuadraticProgramBatch":
        return "solve_batch takes many"
    if isinstance(given, type) or callable(given):
        return "give an object: LCP(M, q), or NonlinearProblem(F) of a function F"
    takes_programs = any(way in kind.ways for kind in kinds() if kind.word == "QuadraticProgram")
    return f"write {way}(LCP(M, q))" + (f", or {way}(QuadraticProgram(P, c, …))" if takes_programs else "")


def _with_article(word: str) -> str:
    return f"an {word}" if word[0] in "AEIOU" or word.startswith("LCP") else f"a {word}"
