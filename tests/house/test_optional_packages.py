"""Every package except numpy and scipy may be missing: a hidden module stands for one that is not installed."""

import pytest
from tools.processes import printed_by

PACKAGES = (
    *("cvxpy", "piqp", "daqp", "clarabel", "qdldl", "pyamg", "typer", "rich", "numba"),
    *("threadpoolctl", "osqp"),
)
SOLVES = """
import warnings
import numpy as np
import scipy.sparse as sp
warnings.simplefilter("ignore", RuntimeWarning)
from lcp_plugin import *
rng = np.random.default_rng(0)
A = rng.standard_normal((30, 30))
P, q = A @ A.T + np.eye(30), rng.standard_normal(30)
ends = [solve(LCP(P, q), name) for name in ("auto", "psor", "lemke", "newton")]
grid = gallery.obstacle_2d(size=40).problem
ends += [solve(grid, "multigrid"), solve(gallery.half_active(n=225).problem)]
rows = sp.random_array((60, 400), density=0.05, rng=rng)
ends.append(solve(QuadraticProgram(sp.eye_array(400), rng.standard_normal(400), G=rows, h=np.ones(60))))
program = solve(QuadraticProgram(np.eye(2), [-2.0, -4.0], G=[[1.0, 1.0]], h=[2.0]))
linear = solve(QuadraticProgram(np.zeros((2, 2)), [1.0, 2.0], A=[[1.0, 1.0]], b=[1.0], lower=0.0))
ends += [solve(BoundedLeastSquares(A, q, lower=-np.inf, l1=1.0)), program, linear]
ends += [solve(FrictionalContact(np.eye(3), [-1.0, 0.5, 0.0], 0.5))]
ends += [*solve_batch([LCP(P, q + k) for k in range(20)]), *march(LCP(P, q), np.zeros((2, 30)), -1.0)]
print({one.status.name for one in ends}, program.x.round(6) + 0.0, linear.x.round(6) + 0.0)
proofs = [solve(LCP([[0.0]], [-1.0])), solve(QuadraticProgram([[1.0]], [0.0], G=[[1.0], [-1.0]], h=[-1.0, -1.0]))]
print([(one.status.name, one.proof.verify()) for one in proofs])
"""


@pytest.mark.parametrize(
    "hidden",
    [
        pytest.param(PACKAGES, id="all"),
        *(pytest.param((name,), id=name, marks=pytest.mark.full) for name in PACKAGES),
    ],
)
def test_problems_are_solved_without_optional_packages(hidden):
    """Each class is solved, with known answers, and a proof verifies; cvxpy is imported if it is installed."""
    code = f"import sys\nsys.modules |= dict.fromkeys({hidden!r})\n" + SOLVES
    if not {"cvxpy", "qdldl"}.isdisjoint(hidden):  # cvxpy imports qdldl
        names = "LCP, BoundedLeastSquares, FrictionalContact, QuadraticProgram, gallery, march, solve, solve_batch"
        code = code.replace("import *", f"import {names}")
    assert printed_by(code).splitlines() == [
        "{'SOLVED'} [0. 2.] [1. 0.]",
        "[('INFEASIBLE', True), ('INFEASIBLE', True)]",
    ]


def test_an_engine_without_its_package_says_what_to_install_and_auto_goes_through_the_lcp():
    """Without external solvers auto solves a program by its LCP; an engine by name raises; both name the package."""
    code = (
        "import sys\nsys.modules |= dict.fromkeys(('piqp', 'daqp', 'clarabel'))\n"
        "import warnings, numpy as np\nfrom lcp_plugin import LCP, QuadraticProgram, solve\n"
        "program = QuadraticProgram(np.eye(400), -np.ones(400), G=np.ones((1, 400)), h=[40.0])\n"
        "with warnings.catch_warnings(record=True) as caught:\n    result = solve(program)\n"
        "print(result.status.name, result.x[0].round(6), caught[0].message)\n"
        "for problem in (program, LCP(np.eye(2), [-1.0, 1.0])):\n"
        "    try:\n        solve(problem, 'interior_point')\n    except ValueError as error:\n        print(error)"
    )
    solved, *refused = printed_by(code).splitlines()
    assert solved.startswith("SOLVED 0.1 piqp is not installed")
    assert [message.count("pip install piqp") for message in refused] == [1, 1]


H5 = """
import pathlib, tempfile
file = pathlib.Path(tempfile.mkdtemp(), "b.h5")
file.write_bytes(b"HDF")
lcp_plugin.load_problem(file)
"""
LEARN, STRATEGIES = "lcp_plugin.interfaces.learn", "lcp_plugin.strategies"
NONLINEAR = "lcp_plugin.NonlinearProblem"
QPSOLVERS = "from lcp_plugin.interfaces import qpsolvers as q\nq.register_with_qpsolvers()"
USES = [  # the hidden package, a use of it, a part of the message, the extra that it names
    ("hypothesis", STRATEGIES, f"{STRATEGIES} needs hypothesis", "test"),
    ("hypothesis", f"import pydoc\npydoc.locate('{STRATEGIES}')", f"{STRATEGIES} needs hypothesis", "test"),
    ("torch", f"import {LEARN}\nimport {LEARN}.torch", f"{LEARN}.torch needs PyTorch", "torch"),
    ("jax", f"import {LEARN}\nimport {LEARN}.jax", f"{LEARN}.jax needs JAX", "jax"),
    ("pyomo", "import lcp_plugin.pyomo", "lcp_plugin.pyomo needs pyomo", "pyomo"),
    ("qpsolvers", QPSOLVERS, "register_with_qpsolvers needs qpsolvers", "qpsolvers"),
    ("jax", f"{NONLINEAR}.from_jax(abs)", "NonlinearProblem.from_jax needs JAX", "jax"),
    ("casadi", f"{NONLINEAR}.from_casadi(0, 0)", "NonlinearProblem.from_casadi needs CasADi", "casadi"),
    ("h5py", H5, "is read by h5py", "fclib"),
    ("hypothesis", f"from lcp_plugin import *\nimport {STRATEGIES}", f"{STRATEGIES} needs hypothesis", "test"),
]  # fmt: skip


@pytest.mark.quick(1)
@pytest.mark.parametrize(("name", "use", "words", "extra"), USES)
def test_a_use_without_its_package_says_what_to_install(name, use, words, extra):
    """The message has the package and its extra; ``from lcp_plugin import *`` needs no hypothesis."""
    code = (
        f"import sys\nsys.modules[{name!r}] = None\nimport lcp_plugin\n"
        f"try:\n    exec({use!r})\nexcept Exception as error:\n    print(error)"
    )
    advice = f"{words}; install it with: pip install {name} (or lcp_plugin[{extra}])"
    assert advice in printed_by(code)
