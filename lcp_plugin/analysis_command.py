"""What `lcp-plugin analyze` tells: the matrix report, and what is proven about every algorithm on that matrix."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from .algorithms import REGISTRY
from .certificates.convergence import Guarantee
from .guarantees import convergence_guarantee
from .matrix_classes import analyze
from .problem import LCP

PAPER_VARIANTS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("npj", {"scaling": None}),
    ("npgs", {"scaling": None}),
    ("npsor", {"scaling": None}),
    ("npaor", {"scaling": None}),
    ("npsplitting", {"scaling": None}),
    ("mgs", {"omega": 0.5}),
    ("msor", {"omega": 0.5 / 0.85**2}),
)


def guarantees(problem: LCP) -> Iterator[tuple[str, Guarantee]]:
    """Yield (title, guarantee) of auto, of every registered algorithm at its defaults, and of the paper's variants."""
    for name in ("auto", *REGISTRY):
        yield name, convergence_guarantee(problem, name)
    for name, options in PAPER_VARIANTS:
        shown = ", ".join(f"{option}={_short(value)}" for option, value in options.items())
        yield f"{name}, {shown}", convergence_guarantee(problem, name, **options)


def story(problem: LCP) -> str:
    """Return both tables as text for a terminal.

    Examples
    --------
    >>> print(story(LCP([[4, -1], [-1, 4]], [-3, 5])).splitlines()[0])
    matrix of size 2, 4 nonzeros
    """
    lines = [str(analyze(problem)), "", f"{'algorithm':<29} {'verdict':<12} {'rate':<8} because"]
    said: dict[str, list[str]] = {}
    for title, guarantee in guarantees(problem):
        rate = "" if guarantee.rate is None else _rate(guarantee.rate)
        remedy = f"  →  {guarantee.remedy}" if guarantee.remedy else ""
        lines.append(f"{title:<29} {guarantee.verdict:<12} {rate:<8} {guarantee.theorem}{remedy}")
        if guarantee.paper:
            said.setdefault(guarantee.paper, []).append(title.partition(",")[0])
    if said:
        lines += ["", "The paper's Theorem 4.2, for its methods without row scaling:"]
        lines += [f"{', '.join(names)}: {text}" for text, names in said.items()]
    return "\n".join(lines)


def content(problem: LCP) -> dict[str, Any]:
    """Return both tables as a dictionary that JSON can hold; numbers that are not finite become None."""
    rows = [
        {
            "algorithm": title, "verdict": found.verdict, "theorem": found.theorem, "rate": found.rate,
            "rate_of": found.speaks_of if found.rate is not None else None, "remedy": found.remedy,
            "theorem_4_2": found.paper,
        }
        for title, found in guarantees(problem)
    ]
    told: dict[str, Any] = _finite({"matrix": analyze(problem).to_content(), "convergence": rows})
    return told


def _rate(rate: float) -> str:
    """Return the rate rounded up, or its distance to 1 where that is what counts."""
    return f"{math.ceil(1000.0 * rate) / 1000.0:.3f}" if rate <= 0.99 else f"1-{1.0 - rate:.0e}"


def _short(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value).lower()


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_finite(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
