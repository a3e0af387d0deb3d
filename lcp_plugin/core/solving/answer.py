"""What every kind of problem is answered by."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from ..errors import NotConverged
from ..representation import in_words, within
from ..settings import PROVEN, Status

NEXT = "; next: "  # between what happened and what to do


class Answer:
    """The answer to a problem of any kind: all results have these attributes, and further ones of their own.

    Attributes
    ----------
    status : Status
        SOLVED, or why not; what it rests on stands in the class of the result.
    x : ndarray, shape (n,), or None
        The values of the unknowns; z of a complementarity problem. None where there are none to show.
    objective : float or None
        What was minimised, at x; None where nothing is.
    seconds : float
        Wall-clock seconds of the run.
    algorithm : str
        What ran.
    iterations : int
    begun : str
        Where the run began, in words, where another than the caller chose that; else empty.
    """

    begun: str = ""

    if TYPE_CHECKING:  # fields of the dataclasses that answers are

        @property
        def status(self) -> Status:
            """SOLVED, or why not."""

        @property
        def x(self) -> Any:
            """The values of the unknowns."""

        @property
        def seconds(self) -> float:
            """Wall-clock seconds of the run."""

        @property
        def algorithm(self) -> str:
            """What ran."""

        @property
        def iterations(self) -> int:
            """How many steps."""

    @property
    def objective(self) -> float | None:
        """What was minimised, at x; None where nothing is."""
        return None

    @property
    def is_solved(self) -> bool:
        """True where the status is SOLVED."""
        return self.status is Status.SOLVED

    @property
    def has_no_solution(self) -> bool:
        """True where a proof says that there is no answer: INFEASIBLE, NO_SOLUTION or UNBOUNDED."""
        return self.status in PROVEN

    @property
    def proof(self) -> Any:
        """What proves the status, an object with ``verify()``; None where nothing beside the residuals does."""
        return None

    @property
    def advice(self) -> str:
        """What the status means for this run, and behind ``next:`` what to do."""
        return self.status.value

    def _of_which(self, what: str) -> list[str]:
        """Return of which points a proof speaks that there is no answer, where it is not of all."""
        words = (
            within(getattr(self.proof, "radius", math.inf), what) if self.has_no_solution else ""
        )
        return [f"{words[2:]}: a larger one is not excluded"] if words else []

    def reached(self) -> str:
        """Return what was reached beside what was asked for."""
        raise NotImplementedError

    @np.errstate(under="ignore")
    def explain(self) -> str:
        """Return what happened, how sure that is and what to do next, a line each; then why, and what ran."""
        return "\n".join([*self._verdict(), *self._course()])

    def _verdict(self) -> list[str]:
        """Return what happened, how sure that is, what to do next, and what else is known, a line each."""
        happened, _, to_do = self.advice.partition(NEXT)
        what, *why = happened.split("; ")
        sure, *more = self.reached().splitlines()
        return [
            f"{self.status.name}: {what}",
            sure,
            *([f"next: {to_do}"] if to_do else []),
            *why,
            *more,
        ]

    def _course(self) -> list[str]:
        """Return what ran, what it took, and where it began if somebody else chose that."""
        return [self._effort(), *([self.begun] if self.begun else [])]

    def _effort(self) -> str:
        """Return what ran, and what it took."""
        return f"{self.algorithm}: {in_words(self.iterations, 'iteration')}, {self.seconds:.3g} s"

    def require_solved(self) -> Self:
        """Return this result, or raise where it is not solved.

        Raises
        ------
        NotConverged
            With the status, what was reached and the advice.
        """
        if not self.is_solved:
            raise NotConverged(
                f"{self.status.name} after {self.iterations} iterations of {self.algorithm}: "
                f"{'; '.join([*self.reached().splitlines(), self.advice])}"
            )
        return self

    def to_json(self) -> str:
        """Return status, residuals and counts (no vectors) as JSON text; non-finite numbers become null."""
        return json.dumps(self.to_content(), indent=2)

    def to_content(self) -> dict[str, Any]:
        """Return what :meth:`to_json` writes, as a dictionary."""
        numbers = self._numbers() | {"seconds": self.seconds}
        return {
            "status": self.status.name,
            "advice": self.advice,
            "algorithm": self.algorithm,
            "n": None if self.x is None else len(self.x),
            "iterations": self.iterations,
            **{name: value if math.isfinite(value) else None for name, value in numbers.items()},
        }

    def _numbers(self) -> dict[str, float]:
        """Return the answer's other numbers."""
        return {} if self.objective is None else {"objective": self.objective}

    def plot(self, **how: Any) -> Any:
        """Return matplotlib's axes with a picture of the answer; needs ``pip install 'lcp_plugin[report]'``.

        Parameters
        ----------
        **how
            Of :func:`lcp_plugin.evidence.pictures.plot_answer`: ``axes`` to draw into, ``shape`` of the unknowns'
            grid.
        """
        from ...evidence.pictures import plot_answer

        return plot_answer(self, **how)

    def __repr__(self) -> str:
        size = "" if self.x is None else f"n={len(self.x)}, "
        value = "" if self.objective is None else f"objective {self.objective:.9g}, "
        return f"{type(self).__name__}({self.status.name}, {size}{value}{Answer._effort(self)})"

    def __str__(self) -> str:
        return self.explain()
