"""The convergence theorem that covers a choice of algorithm on a matrix."""

from __future__ import annotations

from typing import Any

from ..core.algorithm import Algorithm
from ..core.errors import InvalidOption
from ..core.lcp import LCP
from ..core.problem_classes import refusal
from ..core.splittings import PSOR
from ..core.tuning import PIVOTED_UP_TO
from ..methods.lemke import Lemke
from ..proofs.guarantees import GUARANTEED, NOT_COVERED, Guarantee, guarantee_of
from .choice import method_of


def convergence_guarantee(
    problem: LCP, algorithm: str | Algorithm = "auto", **options: Any
) -> Guarantee:
    """Return the convergence guarantee of an algorithm on this matrix, for all q and all starts.

    Parameters
    ----------
    problem : LCP
    algorithm : str or Algorithm
        A registered name, "auto", or an object such as ``NPSOR(relaxation=1.5)``.
    **options
        Options of the named algorithm.

    Returns
    -------
    Guarantee
        ``verdict`` "guaranteed" or "not covered", with theorem, rate, weights v and a remedy; `spectral_radius` on
        first access.

    Raises
    ------
    UnknownAlgorithm, InvalidOption
        If the name or an option does not exist, or `problem` is not an LCP.

    Notes
    -----
    Cost: some passes over M, a loose solve with its comparison matrix if dominance does not decide, and a
    factorization if M is symmetric. Iterates are assumed exact, step sizes rounded as in a run. It holds for any q,
    boxes and free rows included.

    Examples
    --------
    >>> from lcp_plugin import LCP
    >>> problem = LCP([[4, -1], [-1, 4]], [-3, 5])
    >>> guarantee = convergence_guarantee(problem, "npsor", momentum=None)
    >>> guarantee.verdict, round(guarantee.rate, 3)
    ('guaranteed', 0.648)
    >>> round(guarantee.spectral_radius, 3)
    0.599
    """
    if not isinstance(problem, LCP):
        raise InvalidOption(refusal("convergence_guarantee", problem))
    return guarantee_of_choice(problem, method_of(algorithm, options))


def guarantee_of_choice(problem: LCP, method: Algorithm | None) -> Guarantee:
    """Return the guarantee of a method, or of "auto" for None."""
    if method is not None:
        return guarantee_of(problem, method)
    # auto ends with this method, which runs to its end if the methods before it fail
    last = guarantee_of(problem, method := last_resort(problem))
    if not last.is_guaranteed:
        return Guarantee(NOT_COVERED, last.theorem)
    return Guarantee(GUARANTEED, f"after any other methods it runs {method.name}: {last.theorem}")


def last_resort(problem: LCP) -> Algorithm:
    """Return the method that auto follows to its end if no earlier method converges."""
    return Lemke() if problem.n <= PIVOTED_UP_TO else PSOR()
