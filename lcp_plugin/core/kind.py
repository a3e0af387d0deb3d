"""A kind of problem: which ways in and out take it, and what to write for the others.

A kind is a row of a table, a way a column. The class of a problem carries its row as ``problem_kind``, that of an
answer as ``answered_kind``; :mod:`lcp_plugin.kinds` is the table, with what solves each. Who is given a kind that it
does not take says so in the words of its cell. README shows the table in small, ``lcp-plugin list`` prints it, and a
test walks all cells with problems of each kind.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from .errors import InvalidOption, did_you_mean

FUNCTIONS = (
    "solve",
    "solve_batch",
    "prepare",
    "march",
    "trace",
    "derivative",
    "certify",
    "Certificate.of",
    "error_bound",
    "analyze",
    "all_solutions",
    "convergence_guarantee",
    "cross_validate",
    "error_against_time",
    "study",
)
STORES = ("save", "pickle")
LANGUAGES = ("cvxpy", "Pyomo", "AMPL", "qpsolvers")
COMMANDS = tuple(f"lcp-plugin {name}" for name in ("solve", "check", "analyze", "compare"))
WAYS = (*FUNCTIONS, *STORES, *LANGUAGES, *COMMANDS)


@dataclass(frozen=True, eq=False)
class Kind:
    """A kind of problem.

    Attributes
    ----------
    name : str
        What it is called in a sentence.
    word : str
        The name of its class.
    ways : tuple of str
        Those of `WAYS` that take it, or its result.
    otherwise : str
        What to write for any other.
    instead : mapping from str to str
        What to write for some of these; an option of `solve` that its solver does not have is called as in ``z0=``.
    """

    name: str
    word: str
    ways: tuple[str, ...]
    otherwise: str
    instead: Mapping[str, str] = field(default_factory=dict)

    def words(self, way: str) -> str:
        """Return what to write for a way that does not take this kind, '' for one that does."""
        return "" if way in self.ways else self.instead.get(way, self.otherwise)

    def refuse(self, wishes: Iterable[str]) -> None:
        """Raise InvalidOption where the table says what to write instead of one of these options."""
        for name in wishes:
            if f"{name}=" in self.instead:
                instead = self.instead[f"{name}="]
                raise InvalidOption(
                    f"solve takes no {name} for {with_article(self.word)}; {instead}"
                )


def changes_by_name(
    origin: Any, named: Mapping[str, Any], known: Sequence[str], elsewhere: str = ""
) -> dict[str, Any]:
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
            raise InvalidOption(
                f"a derivative takes no {name} here{did_you_mean(name, [*known, *names])}{elsewhere}"
            )
    return dict(origin.changes(**named)) if named else {}


LINEAR_COMPLEMENTARITY_PROBLEM = Kind(
    "linear complementarity problem",
    "LCP",
    tuple(way for way in WAYS if way not in ("certify", "qpsolvers")),
    "",
    {
        "x0=": "a start is called z0 here",
        "certify": "Certificate.of(problem, z) has the residuals of a z, error_bound(problem, z) bounds its "
        "distance from the solution",
        "qpsolvers": "problem.to_qp() makes a program of a symmetric M",
    },
)


def kind_of(problem: Any) -> Kind | None:
    """Return the kind of a problem, None where it is none."""
    return getattr(type(problem), "problem_kind", None)


def states_many(given: Any) -> bool:
    """Return whether these are the arrays of many problems."""
    return type(given).__name__ in ("QuadraticProgramBatch", "FrictionalContactBatch")


def refusal(way: str, given: Any) -> str:
    """Return what to say where a way does not take what it was given, with what to write instead."""
    from ..kinds import KINDS

    takes = [kind.word for kind in KINDS if way in kind.ways]
    needs = " or ".join(filter(None, [", ".join(takes[:-1]), takes[-1]]))
    needs = f"the answer to {with_article(needs)}" if way == "derivative" else with_article(needs)
    kind = kind_of(given)
    if way in ("derivative", "certify") and kind is None:  # an answer
        kind = getattr(type(given), "answered_kind", None)
    takes_programs = "QuadraticProgram" in takes
    instead = (
        _remedy(way, given, takes_programs)
        if kind is None
        else kind.words(way) or f"write {way}(solve(problem))"
    )
    return f"{way} needs {needs}, got {type(given).__name__}; {instead}"


def _remedy(way: str, given: Any, takes_programs: bool) -> str:
    """Return what to write for what is no problem of any kind, but near one."""
    is_list = isinstance(given, (list, tuple)) and bool(given) and kind_of(given[0]) is not None
    if is_list or states_many(given):
        return "solve_batch takes many"
    if way == "derivative" and hasattr(given, "all_solved"):
        return "write derivative(answers[k]) for the answer to one problem"
    if way == "derivative" and hasattr(given, "breakpoints"):
        return "write path.derivative(theta)"
    if way == "derivative":
        return "write derivative(solve(problem))"
    if way == "certify" and hasattr(given, "is_optimal"):
        return "give the program as well: certify(program, solution)"
    if way == "certify" and hasattr(given, "certificate"):
        return "result.certificate has its residuals, error_bound(problem, result.z) bounds its distance"
    if hasattr(given, "require_solved"):
        return "that is an answer: give the problem"
    if kind_of(getattr(given, "problem", None)) is not None:
        return f"write {way}(scene.problem)" if hasattr(given, "grid") else "give its problem"
    if isinstance(given, (str, bytes)) or hasattr(given, "__fspath__"):
        return "read a file first: load_problem(path), or lcp_plugin.interfaces.nl.read_nl(path) for a model of AMPL"
    if type(given).__module__.startswith("cvxpy."):
        return 'write problem.solve(method="LCP"), or LCP.from_cvxpy(problem)'
    if isinstance(given, type) or callable(given):
        return "give an object: LCP(M, q), or NonlinearProblem(F) of a function F"
    return f"write {way}(LCP(M, q))" + (
        f", or {way}(QuadraticProgram(P, c, …))" if takes_programs else ""
    )


def with_article(word: str) -> str:
    """Return a word with its article."""
    return f"an {word}" if word[0] in "AEIOU" or word.startswith("LCP") else f"a {word}"
