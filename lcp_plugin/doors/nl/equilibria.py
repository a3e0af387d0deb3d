"""An objective beside the complementarities of an ``.nl`` file: the best of all solutions."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np

from ... import __version__
from ...core.checks import FloatVector
from ...core.errors import InvalidOption
from ...core.settings import Settings
from ...problems.equilibria.branch_and_bound import OPTIONS, minimize_over_solutions
from ...problems.equilibria.equilibrium_program import EquilibriumProgram
from .answers import CODES, NLAnswer, NLModel
from .content import Indices, NLContent

#: What a caller of any model may ask for that a search has no use for, or a name of its own.
PLAIN = {one.name: one.default for one in fields(Settings)} | {"algorithm": "auto"}
TAKEN = ("tolerance", "max_iterations", "max_seconds", "callback", "verbose", "threads")


class EquilibriumModel(NLModel):
    """A convex program with complementarity constraints.

    Parameters
    ----------
    content : NLContent
    problem : EquilibriumProgram
        In the unknowns, then the values of the complementarity rows; to be minimised.
    unknowns : ndarray of int
        The variable that each of its first variables is.
    known : ndarray, shape (n,)
        The values of the variables that are none of them.
    sign : float
        −1 where the objective of the file is to be maximised.
    pairs : ndarray of int
        The complementarity rows.
    """

    def __init__(
        self, content: NLContent, problem: EquilibriumProgram, unknowns: Indices, known: FloatVector, sign: float,
        pairs: Indices,
    ) -> None:
        self.content, self.unknowns, self.pairs = content, unknowns, pairs
        self.problem = self.program = problem
        self._known, self.sign = known, sign

    @property
    def start(self) -> FloatVector:
        """The start in the unknowns of the problem; a search begins elsewhere."""
        start: FloatVector = self.content.start[self.unknowns]
        return start

    def solve(self, algorithm: Any = "auto", **options: Any) -> NLAnswer:
        """Return the answer, optimal only with a proved gap.

        Parameters
        ----------
        algorithm : str
            "auto": branch and bound.
        **options
            Of :func:`lcp_plugin.minimize_over_solutions`; ``max_iterations`` is its ``max_nodes``, ``threads`` is taken
            and changes nothing.

        Raises
        ------
        InvalidOption
            For any other.
        """
        wishes = {name: wish for name, wish in options.items() if name in (*OPTIONS, *TAKEN) and wish is not None}
        for name, wish in {**options, "algorithm": algorithm}.items():
            if name not in wishes and wish is not None and wish != PLAIN.get(name):
                raise InvalidOption(
                    f"an objective beside complementarities is minimised by branch and bound, which takes no {name}, "
                    f"got {wish!r}; leave it out; taken are {', '.join(TAKEN)}"
                )
        wishes.pop("threads", None)
        if "max_iterations" in wishes:
            wishes["max_nodes"] = wishes.pop("max_iterations")
        result = minimize_over_solutions(self.program, **wishes)
        x, duals, objective = None, None, None
        if result.x is not None:
            n = self.unknowns.size
            x, duals = self._known.copy(), np.zeros(self.content.row_lower.size)
            x[self.unknowns], duals[self.pairs] = result.x[:n], result.x[n:]
            objective = self.sign * result.value + 0.0
        words = "optimal" if result.is_solved else result.status.name.lower()
        of = "" if self.sign > 0.0 else " (of minus the objective)"
        reached = "" if result.is_refuted else f"{result.reached()}{of}, "
        nodes = f"{result.nodes} node{'s' * (result.nodes != 1)}"
        message = f"lcp_plugin {__version__}: {words}; {reached}{nodes}"
        return NLAnswer(x, duals, result.status, message, result, objective, CODES[result.status])
