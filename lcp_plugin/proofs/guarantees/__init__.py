"""convergence_guarantee(): what is proven about an algorithm on a matrix."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ...core.algorithm import Algorithm
from ...core.errors import InvalidOption, UnsuitableMatrix, UnsuitableProblem
from ...core.lcp import LCP
from ...core.matrix.iteration_facts import (
    MODULUS,
    PROJECTED_RELAXATION,
    PROJECTED_SPLITTING,
    PROJECTED_TYPE,
    IterationFacts,
)
from ...core.matrix.row_sums import inverse_residual_scale, unit_triangle_sums
from ...core.problem_classes import refusal
from ...systems.comparison import jacobi_radius
from ..verdicts import analyze, comparison_certificate, h_verdict
from .convergence import Contraction, contraction
from .theorems import (
    GUARANTEED,
    NOT_COVERED,
    PAPER,
    Guarantee,
    positive_definite_theorem,
    theorem_4_1,
    theorem_4_2,
    theorem_of,
)

DENSE_SPLITTING = 500


@np.errstate(all="ignore")
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
        ``verdict`` "guaranteed" or "not covered", with theorem, rate, weights v and a remedy; `spectral_radius` and
        `jacobi_radius` on first access.

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
    >>> guarantee = convergence_guarantee(LCP([[4, -1], [-1, 4]], [-3, 5]), "npsor")
    >>> guarantee.verdict, round(guarantee.rate, 3)
    ('guaranteed', 0.648)
    >>> round(guarantee.spectral_radius, 3), round(guarantee.jacobi_radius, 3)
    (0.662, 0.25)
    """
    if not isinstance(problem, LCP):
        raise InvalidOption(refusal("convergence_guarantee", problem))
    from ...auto import method_of
    from ...methods.direct import last_resort

    method = method_of(algorithm, options)
    if method is not None:
        return _of_one(problem, method)
    return _of_auto(problem, last_resort(problem))


def _of_one(problem: LCP, algorithm: Algorithm) -> Guarantee:
    if problem.n == 0:
        return Guarantee(GUARANTEED, "the problem has no rows")
    try:
        facts = algorithm.facts(problem)
        theorem = algorithm.theorem(problem, analyze(problem)) if facts is None else None
    except (UnsuitableMatrix, UnsuitableProblem) as error:
        return Guarantee(NOT_COVERED, "it cannot run on this problem", remedy=str(error))
    if facts is not None:
        return replace(_full(problem, facts), facts=facts, problem=problem)
    if theorem is not None:
        return Guarantee(GUARANTEED, theorem)
    return Guarantee(NOT_COVERED, f"no theorem here is about {algorithm.name} on such a problem")


def _of_auto(problem: LCP, method: Algorithm) -> Guarantee:
    """Return the guarantee of the last method of auto, which runs to its end if the methods before it fail."""
    last = _of_one(problem, method)
    if not last.is_guaranteed:
        return Guarantee(NOT_COVERED, last.theorem)
    return Guarantee(GUARANTEED, f"after any other methods it runs {method.name}: {last.theorem}")


def _full(problem: LCP, facts: IterationFacts) -> Guarantee:
    paper = _paper_says(problem, facts)
    proof = _row_proof(problem, facts)
    if proof is not None:
        is_automatic = facts.relaxation is None and facts.family == PROJECTED_RELAXATION
        rate, v = (None, None) if is_automatic else proof
        speaks_of = "x" if facts.family == MODULUS else "z"
        return Guarantee(GUARANTEED, theorem_of(facts), rate, v, paper=paper, speaks_of=speaks_of)
    if facts.family == PROJECTED_SPLITTING and problem.n <= DENSE_SPLITTING:
        found = _by_theorem_4_1(problem, facts)
        if found is not None:
            return found
    theorem = _positive_definite(problem, facts)
    if theorem is not None:
        return Guarantee(GUARANTEED, theorem)
    remedy = _remedy(problem, facts)
    return Guarantee(NOT_COVERED, _nothing_known(problem, facts), remedy=remedy, paper=paper)


def _row_proof(problem: LCP, facts: IterationFacts) -> Contraction | None:
    """Return a contraction with the weights v of the H₊ certificate, or with 1 + v/(2‖v‖∞), or None.

    Every row bound implies ⟨M⟩v > 0 and a positive diagonal. Nearly equal weights help a row at its bound (τ = 0),
    whose sweep needs no margin of ⟨M⟩v but a small |L|v.
    """
    if not bool(np.all(problem.diagonal > 0.0)) or h_verdict(problem.matrix).is_h is False:
        return None
    certificate = comparison_certificate(problem.matrix)
    v = np.ones(problem.n) if certificate is None else certificate.v
    return contraction(facts, problem, v) or contraction(
        facts, problem, 1.0 + 0.5 * v / v.max(initial=0.0)
    )


def _by_theorem_4_1(problem: LCP, facts: IterationFacts) -> Guarantee | None:
    scaling = np.ones(problem.n) if facts.scaling is None else facts.scaling
    splitting: Any = facts.splitting
    found = theorem_4_1(
        scaling[:, None] * problem.csr.toarray(), scaling[:, None] * splitting.toarray()
    )
    if found is None:
        return None
    return Guarantee(
        GUARANTEED, f"ρ(T) < 1, certified by a vector (Theorem 4.1 of {PAPER})", *found
    )


def _is_h_plus(problem: LCP) -> bool:
    return bool(np.all(problem.diagonal > 0.0)) and h_verdict(problem.matrix).is_h is True


def _positive_definite(problem: LCP, facts: IterationFacts) -> str | None:
    """Return the theorem on positive definite matrices that covers it; M is factorized only if one could apply."""
    sums = np.add(*unit_triangle_sums(problem.matrix)) / (
        problem.diagonal * inverse_residual_scale(problem.matrix)
    )
    largest_sum = float(np.max(sums, initial=0.0)) * (1.0 + 1e-12)
    theorem = positive_definite_theorem(facts, largest_sum)
    if theorem is None:
        return None
    report = analyze(problem)
    return theorem if report.is_symmetric and report.is_positive_definite else None


def _paper_says(problem: LCP, facts: IterationFacts) -> str:
    if facts.family != PROJECTED_TYPE or facts.is_scaled:
        return ""
    return theorem_4_2(facts, problem, jacobi_radius(problem.matrix), _is_h_plus(problem))


def _nothing_known(problem: LCP, facts: IterationFacts) -> str:
    if facts.family == PROJECTED_SPLITTING and problem.n > DENSE_SPLITTING:
        return f"Theorem 4.1's ρ(T) is not computed for n > {DENSE_SPLITTING}"
    if _is_h_plus(problem):
        return "M is an H₊-matrix, but with these options no theorem here applies beyond rounding"
    if facts.family == PROJECTED_RELAXATION:
        return "M is proven neither to be an H₊-matrix nor to be symmetric positive definite"
    return "M is not proven to be an H₊-matrix"


def _remedy(problem: LCP, facts: IterationFacts) -> str:
    """Return the remedy: the change that gives a guarantee."""
    if _is_h_plus(problem):
        if facts.family in (PROJECTED_RELAXATION, MODULUS):
            return (
                "relaxation ≤ 1 (and 0 ≤ acceleration ≤ relaxation, omega=1.0 if these are options)"
            )
        return 'scaling="auto" and 0 ≤ acceleration ≤ relaxation'
    report = analyze(problem)
    if report.is_symmetric and report.is_positive_definite:
        return 'algorithm="psor": M is symmetric positive definite'
    return 'no theorem covers this M; algorithm="auto" tries several methods'
