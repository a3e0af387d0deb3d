"""Tables of the manual agree with the code: defaults, statuses in every language, formulas of the methods."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lcp_plugin
from lcp_plugin import LCP, Status
from lcp_plugin.algorithms import create
from lcp_plugin.core.problem_classes import CLASSES
from lcp_plugin.problems.statement import STATUS_ELSEWHERE
from lcp_plugin.solving.dispatch import options_of, solver_of

MANUAL = Path(__file__).parents[2] / "examples" / "manual"


def rows(page: str, head: str) -> list[list[str]]:
    """Return the cells of a table of a page, by the beginning of its first line."""
    text = MANUAL.joinpath(f"{page}.md").read_text(encoding="utf-8")
    table = text[text.index(f"| {head} |") :].split("\n\n")[0].splitlines()
    return [[cell.strip() for cell in line.strip("| ").split(" | ")] for line in table[2:]]


def default_tolerance(name: str) -> float:
    """Return the default tolerance of the solver of a class."""
    default = inspect.signature(solver_of(name)).parameters.get("tolerance")
    return 1e-8 if default is None else float(default.default)  # an LCP has that of Settings


def test_cheat_sheet_has_the_defaults_of_the_classes():
    """Bounds, tolerances and the name of the start are those of the signatures."""
    found = rows("cheat_sheet", "class")
    assert {row[0].strip("`").partition("(")[0] for row in found} == {*CLASSES}
    for row in found:
        name, _, arguments = row[0].strip("`)").partition("(")
        parameters = inspect.signature(getattr(lcp_plugin, name)).parameters
        for argument in arguments.split(", "):
            word, _, value = argument.partition("=")
            assert word in parameters, name
            assert not value or float(value) == float(parameters[word].default), (name, word)
        assert float(row[3]) == default_tolerance(name), name
        known = options_of(name)
        assert row[4].strip("`") in known or "options" in known, name


def test_cheat_sheet_has_the_statuses_of_every_language():
    """Each status has the word of cvxpy, Pyomo and AMPL that the interfaces return."""
    words = {
        status: (of_cvxpy, str(of_pyomo), of_ampl)
        for names, of_cvxpy, of_pyomo, of_ampl, _ in rows("cheat_sheet", "`result.status`")
        for status in names.split(", ")
    }
    assert {*words} == {status.name for status in Status}
    for status in Status:
        of_cvxpy, of_pyomo, of_ampl = words[status.name]
        shown = of_cvxpy.replace("raises SolverError", "solver_error")
        assert (int(of_ampl), shown, of_pyomo) == STATUS_ELSEWHERE[status], status


def test_solved_has_the_tolerance_of_every_class():
    """Each class has a row with its default tolerance."""
    found = {
        name: float(default.replace("10⁻⁸", "1e-8").replace("10⁻⁶", "1e-6"))
        for classes, default, *_ in rows("solved", "class")
        for name in re.findall(r"\w+", classes)
    }
    assert found == {name: default_tolerance(name) for name in CLASSES}


M = np.array([[4.0, -1.0, 0.5], [-2.0, 5.0, 1.0], [0.25, -1.5, 3.0]])
Q, START = np.array([-3.0, 2.0, -1.0]), np.array([0.5, 0.25, 1.0])
D, L, U = np.diag(np.diag(M)), -np.tril(M, -1), -np.triu(M, 1)
UNIT = np.eye(3)


def np_step(left: Any) -> Callable[[Any], Any]:
    """Return the step of (left)(z⁺ − z) = −2 min(z, w), with each component projected at once."""

    def step(z: Any) -> Any:
        right, new = -2.0 * np.minimum(z, M @ z + Q), z.copy()
        for i in range(3):
            change = (right[i] - left[i, :i] @ (new - z)[:i]) / left[i, i]
            new[i] = max(0.0, z[i] + change)
        return new

    return step


def sor_step(omega: float) -> Callable[[Any], Any]:
    """Return the step z_i ← max(0, z_i − ω w_i/d_i) with the current w."""

    def step(z: Any) -> Any:
        z = z.copy()
        for i in range(3):
            z[i] = max(0.0, z[i] - omega * (M[i] @ z + Q[i]) / M[i, i])
        return z

    return step


def aor_step(omega: float, beta: float) -> Callable[[Any], Any]:
    """Return the step z⁺ = max(0, z − D⁻¹(ω w − β L (z⁺ − z)))."""

    def step(z: Any) -> Any:
        w, new = M @ z + Q, z.copy()
        for i in range(3):
            new[i] = max(0.0, z[i] - (omega * w[i] - beta * L[i] @ (new - z)) / M[i, i])
        return new

    return step


def modulus_step(omega: float, alpha: float, beta: float) -> Callable[[Any], Any]:
    """Return the step (αΩ + D − βL)(x⁺ − x) = −2α(w − Ω max(0, −x)), z = max(0, x)."""

    def step(x: Any) -> Any:
        w = M @ np.maximum(0.0, x) + Q
        right = -2.0 * alpha * (w - omega * D @ np.maximum(0.0, -x))
        return x + np.linalg.solve(alpha * omega * D + D - beta * L, right)

    return step


PLAIN: dict[str, Any] = {"scaling": None, "momentum": None}
FORMULAS: dict[str, tuple[str, dict[str, Any], Callable[[Any], Any]]] = {
    "npj": ("(2D + 2I)(z⁺ − z) = −2 min(z, w)", PLAIN, np_step(2 * D + 2 * UNIT)),
    "npgs": ("(2D + 2I − L)(z⁺ − z) = −2 min(z, w)", PLAIN, np_step(2 * D + 2 * UNIT - L)),
    "npsor": (
        "(D/α + D + 2I − L)(z⁺ − z) = −2 min(z, w)",
        {**PLAIN, "relaxation": 1.25},
        np_step(D / 1.25 + D + 2 * UNIT - L),
    ),
    "npaor": (
        "(D/α + D + 2I − (β/α) L)(z⁺ − z) = −2 min(z, w)",
        {**PLAIN, "relaxation": 1.25, "acceleration": 0.75},
        np_step(D / 1.25 + D + 2 * UNIT - 0.6 * L),
    ),
    "pj": ("z⁺ = max(0, z − D⁻¹ w)", {}, aor_step(1.0, 0.0)),
    "pgs": ("z_i ← max(0, z_i − w_i/d_i), w current", {}, sor_step(1.0)),
    "psor": ("z_i ← max(0, z_i − ω w_i/d_i), w current", {"relaxation": 1.25}, sor_step(1.25)),
    "paor": (
        "z⁺ = max(0, z − D⁻¹(ω w − β L (z⁺ − z)))",
        {"relaxation": 1.25, "acceleration": 0.75},
        aor_step(1.25, 0.75),
    ),
    "gfp": ("z⁺ = max(0, z − ω D⁻¹ w)", {"relaxation": 1.25}, aor_step(1.25, 0.0)),
    "mj": ("(Ω + D)(x⁺ − x) = −2(w − Ω max(0, −x))", {"omega": 1.5}, modulus_step(1.5, 1.0, 0.0)),
    "mgs": (
        "(Ω + D − L)(x⁺ − x) = −2(w − Ω max(0, −x))",
        {"omega": 1.5},
        modulus_step(1.5, 1.0, 1.0),
    ),
    "msor": (
        "(αΩ + D − αL)(x⁺ − x) = −2α(w − Ω max(0, −x))",
        {"omega": 1.5, "relaxation": 0.75},
        modulus_step(1.5, 0.75, 0.75),
    ),
    "maor": (
        "(αΩ + D − βL)(x⁺ − x) = −2α(w − Ω max(0, −x))",
        {"omega": 1.5, "relaxation": 0.75, "acceleration": 0.5},
        modulus_step(1.5, 0.75, 0.5),
    ),
}


@pytest.mark.parametrize("name", FORMULAS)
def test_formula_of_the_table_is_the_method(name):
    """Five steps of the formula on the page are those of the method, to rounding error."""
    formula, options, step = FORMULAS[name]
    written = {row[0].strip("`"): row[2] for row in rows("algorithms", "name")}
    assert written[name] == formula
    iterates = create(name, options).iterates(LCP(M, Q), START.copy())
    x = START
    for _ in range(6):
        np.testing.assert_allclose(next(iterates).z, np.maximum(0.0, x), rtol=1e-12, atol=1e-14)
        x = step(x)
