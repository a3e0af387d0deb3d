"""The base class of all results."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from ..errors import NotConverged
from ..representation import describe_radius, format_count
from ..settings import PROVEN, Status

NEXT = "; next: "  # between what happened and what to do


class Outcome:
    """Properties that follow from the status."""

    if TYPE_CHECKING:

        @property
        def status(self) -> Status:
            """SOLVED, or the reason for termination."""

    @property
    def is_solved(self) -> bool:
        """True if the status is SOLVED."""
        return self.status is Status.SOLVED

    @property
    def has_no_solution(self) -> bool:
        """True if a proof shows that no solution exists: INFEASIBLE, NO_SOLUTION or UNBOUNDED."""
        return self.status in PROVEN


class BaseResult(Outcome):
    """Base class of all results; the result of each problem class has further attributes.

    Attributes
    ----------
    status : Status
        SOLVED, or the reason for termination; the class of the result documents the stopping criterion.
    x : ndarray, shape (n,), or None
        The solution (z of a complementarity problem), or the best iterate; None if there is no point.
    objective : float or None
        Objective value at x; None if the problem has no objective.
    seconds : float
        Wall-clock seconds of the run.
    algorithm : str
        Name of the algorithm; for "auto" the chain of methods that ran.
    iterations : int
        Number of iterations.
    begun : str
        Description of the starting point, if the caller did not choose it; otherwise empty.
    agents : tuple of Optimal
        Agents of a cvxpy model; ``explain()`` prints the possible gain of each.
    """

    begun: str = ""
    agents: tuple[Any, ...] = ()

    if TYPE_CHECKING:  # fields of the dataclasses that answers are

        @property
        def x(self) -> Any:
            """The values of the unknowns."""

        @property
        def seconds(self) -> float:
            """Wall-clock seconds of the run."""

        @property
        def algorithm(self) -> str:
            """Name of the algorithm, or chain of methods."""

        @property
        def iterations(self) -> int:
            """Number of iterations."""

    @property
    def objective(self) -> float | None:
        """Objective value at x; None if the problem has no objective."""
        return None

    @property
    def proof(self) -> Any:
        """Proof of the status, an object with ``verify()``; None if the status rests only on residuals."""
        return None

    @property
    def advice(self) -> str:
        """Meaning of the status for this run, and the recommended next step after ``next:``."""
        return self.status.value

    def _describe_scope(self, what: str) -> list[str]:
        """Return the restriction of a proof of infeasibility to points of bounded norm, if it has one."""
        words = (
            describe_radius(getattr(self.proof, "radius", math.inf), what)
            if self.has_no_solution
            else ""
        )
        return [f"of {words}: a larger one is not excluded"] if words else []

    def describe_accuracy(self) -> str:
        """Return the achieved accuracy next to the required one."""
        raise NotImplementedError

    @np.errstate(all="ignore")
    def explain(self) -> str:
        """Return the event, its certainty and the next step, one line each; then the reasons and the methods."""
        return "\n".join([*self._verdict(), *self._course()])

    def _verdict(self) -> list[str]:
        """Return lines with the event, its certainty, the next step, and further facts."""
        happened, _, to_do = self.advice.partition(NEXT)
        what, *why = happened.split("; ")
        sure, *more = self.describe_accuracy().splitlines()
        return [
            f"{self.status.name}: {what}",
            sure,
            *([f"next: {to_do}"] if to_do else []),
            *why,
            *more,
        ]

    def _course(self) -> list[str]:
        """Return lines with the methods, their effort, and the starting point if the caller did not choose it."""
        gains = [agent.describe_gap() for agent in self.agents]
        return [self._effort(), *([self.begun] if self.begun else []), *gains]

    def _effort(self) -> str:
        """Return the name of the algorithm, its iterations and seconds."""
        return (
            f"{self.algorithm}: {format_count(self.iterations, 'iteration')}, {self.seconds:.3g} s"
        )

    def require_solved(self) -> Self:
        """Return this result, or raise NotConverged if the status is not SOLVED.

        Raises
        ------
        NotConverged
            The message has the status, the achieved accuracy and the advice.
        """
        if not self.is_solved:
            raise NotConverged(
                f"{self.status.name} after {self.iterations} iterations of {self.algorithm}: "
                f"{'; '.join([*self.describe_accuracy().splitlines(), self.advice])}"
            )
        return self

    def to_json(self) -> str:
        """Return status, residuals and counts (no vectors) as JSON text; non-finite numbers become null."""
        return json.dumps(self.to_content(), indent=2)

    def to_content(self) -> dict[str, Any]:
        """Return the content of :meth:`to_json` as a dictionary."""
        numbers = self._numbers() | {"seconds": self.seconds}
        return {
            "status": self.status.name,
            "advice": self.advice,
            "algorithm": self.algorithm,
            "n": self._size(),
            "iterations": self.iterations,
            **{name: value if math.isfinite(value) else None for name, value in numbers.items()},
        }

    def _size(self) -> int | None:
        """Return the number of unknowns; None without a point."""
        return None if self.x is None else len(self.x)

    def _numbers(self) -> dict[str, float]:
        """Return the other numbers of the result."""
        return {} if self.objective is None else {"objective": self.objective}

    def plot(self, **how: Any) -> Any:
        """Return matplotlib's axes with a plot of the result; needs ``pip install '.[report]'``.

        Parameters
        ----------
        **how
            Options of :func:`lcp_plugin.evidence.drawing.plot_answer`: ``axes`` to draw into, ``shape`` of the
            unknowns' grid.
        """
        from ...evidence.drawing import plot_answer

        return plot_answer(self, **how)

    def __repr__(self) -> str:
        size = "" if self.x is None else f"n={self._size()}, "
        value = "" if self.objective is None else f"objective {self.objective:.9g}, "
        return f"{type(self).__name__}({self.status.name}, {size}{value}{BaseResult._effort(self)})"

    def __str__(self) -> str:
        return self.explain()
