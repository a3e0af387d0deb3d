"""An objective beside the complementarities of an ``.nl`` file: the best of all solutions."""

from __future__ import annotations

from typing import Any

import numpy as np

from ... import __version__
from ...checks import FloatVector
from ...conversions.equilibrium_program import EquilibriumProgram
from ...errors import InvalidOption, did_you_mean
from ...solving.equilibria.branch_and_bound import OPTIONS, minimize_over_solutions
from .answers import CODES, NLAnswer, NLModel
from .content import Indices, NLContent


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
            Of :func:`lcp_plugin.minimize_over_solutions`.

        Raises
        ------
        InvalidOption
            For any other.
        """
        wishes = {name: wish for name, wish in options.items() if wish is not None and wish is not False}
        for name in [*wishes, *(["algorithm"] if algorithm != "auto" else [])]:
            if name not in OPTIONS:
                raise InvalidOption(
                    f"the search for the best of all solutions has no option {name!r}{did_you_mean(name, OPTIONS)}; it "
                    f"has {', '.join(OPTIONS)}"
                )
        result = minimize_over_solutions(self.program, **wishes)
        n = self.unknowns.size
        x, duals, objective = self._known.copy(), np.zeros(self.content.row_lower.size), None
        if result.x is not None:
            x[self.unknowns], duals[self.pairs] = result.x[:n], result.x[n:]
            objective = self.sign * result.value + 0.0
        words = "optimal" if result.is_solved else result.status.name.lower()
        of = "" if self.sign > 0.0 else " (of minus the objective)"
        message = f"lcp_plugin {__version__}: {words}; {result.reached()}{of}, {result.nodes} nodes"
        return NLAnswer(x, duals, result.status, message, result, objective, CODES[result.status])
