"""The typed options of `solve` are those that the solvers take."""

from dataclasses import fields
from inspect import signature
from typing import get_args

import pytest
from mypy import api as mypy

from lcp_plugin.algorithms import REGISTRY, algorithm_class
from lcp_plugin.core import settings
from lcp_plugin.core.problem_classes import CLASSES
from lcp_plugin.core.settings import DEFAULTS, OF_SOLVE
from lcp_plugin.engines import ENGINES
from lcp_plugin.solving.dispatch import options_of, solver_of


@pytest.mark.parametrize("kind", [name for name, row in CLASSES.items() if row.options])
def test_the_options_of_a_class_are_those_of_its_solver(kind):
    """Those of the table are fields of Settings, and the solver does not name them."""
    own = set(CLASSES[kind].options.split())
    assert own <= set(DEFAULTS) - set(signature(solver_of(kind)).parameters)


def test_the_typed_options_are_those_of_all_solvers_and_algorithms():
    """An option of a new algorithm or solver is added to the table."""
    of_algorithms = {field.name for name in REGISTRY for field in fields(algorithm_class(name))}
    of_solvers = {name for kind in CLASSES for name in options_of(kind)} - {"algorithm", "options"}
    assert set(settings.AlgorithmOptions.__annotations__) == of_algorithms
    assert set(settings.Options.__annotations__) == of_algorithms | of_solvers | set(OF_SOLVE)
    assert set(get_args(settings.EngineName)) == set(ENGINES)


@pytest.mark.full
def test_a_type_checker_finds_a_misspelled_option(tmp_path):
    """`tolerence=` is an error for each class, options of a named algorithm and of an engine are none."""
    file = tmp_path / "call.py"
    file.write_text(
        "import numpy as np\n"
        "from lcp_plugin import LCP, BoundedLeastSquares, QuadraticProgram, solve\n"
        "p, P = LCP(np.eye(2), [1, 2]), QuadraticProgram(np.eye(2), [1, 2])\n"
        "solve(p, 'npsor', relaxation=1.5, tolerance=1e-9)\n"
        "solve(P, 'piqp', eps_abs=1e-9)\n"
        "solve(p, tolerence=1e-9)\n"
        "solve(P, tolerence=1e-9)\n"
        "solve(BoundedLeastSquares(np.eye(2), [1, 2]), tolerence=1e-9)\n"
    )
    found, *_ = mypy.run(
        [str(file), "--config-file=", "--no-error-summary", f"--cache-dir={tmp_path}"]
    )
    lines = {
        line.split(":")[1] for line in found.splitlines() if "error" in line and "call.py" in line
    }
    assert lines == {"6", "7", "8"}
