"""The steps that make programs smaller, in their order: a new one is a class and its entry here."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .definitions import Substitution
from .reductions import FoldedRows, Purpose, Reduction, Step

if TYPE_CHECKING:
    from .program import QuadraticProgram

STEPS: tuple[type[Step], ...] = (Substitution, FoldedRows)


def reduction_for(program: QuadraticProgram, purpose: Purpose) -> Reduction:
    """Return what the steps that serve this purpose leave of a program.

    Examples
    --------
    min t² with t = x − 1 and 2 x ≥ 4: t is put in, the row is a bound.

    >>> from lcp_plugin import QuadraticProgram
    >>> program = QuadraticProgram([[0, 0], [0, 2]], [0, 0], [[-2, 0]], [-4], A=[[1, -1]], b=[1])
    >>> for purpose in (Purpose.AS_IT_STANDS, Purpose.LEAST_WORK):
    ...     [type(step).__name__ for step in reduction_for(program, purpose).steps]
    ['FoldedRows']
    ['Substitution', 'FoldedRows']
    """
    reduction = Reduction(program)
    for step in STEPS:
        reduction = reduction.then(step.for_purpose, purpose)
    return reduction
