"""Rejected arguments: the right error class, one sentence with the value, and no side effects."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from inputs.families import MODULUS
from tools.refusals import BUILTIN_BASE, assert_refused, refusals

from lcp_plugin import (
    LCP,
    BoundedLeastSquares,
    InvalidOption,
    InvalidProblem,
    LCPError,
    NonlinearProblem,
    QuadraticProgram,
    UnsuitableMatrix,
    UnsuitableProblem,
    algorithms,
    convergence_guarantee,
    cross_validate,
    error_against_time,
    error_bound,
    gallery,
    solve,
    solve_batch,
)
from lcp_plugin.algorithms import REGISTRY, algorithm_class
from lcp_plugin.evidence.study import Study

NAN, INF = float("nan"), float("inf")
KINDS = {name: algorithm_class(name) for name in REGISTRY}
OPTIONS = {name: [field.name for field in fields(kind)] for name, kind in KINDS.items()}
NEEDS_POSITIVE_DIAGONAL = [
    name for name, kind in KINDS.items() if kind.needs.startswith("positive diagonal")
]


def given() -> dict[str, Any]:
    """Return fresh data for one rejected call, which the call must not change."""
    M = np.array([[4.0, -1.0, 0.0], [-1.0, 4.0, -1.0], [0.0, -1.0, 4.0]])
    csr, q = sp.csr_array(M), np.array([-1.0, 2.0, -3.0])
    problem = LCP(csr, q, upper=[INF, 5.0, INF])
    return {
        **globals(),
        "algorithms": algorithms,
        "M": M,
        "q": q,
        "problem": problem,
        "plain": LCP(csr, q),
    }


def with_entry(i: int, j: int, value: Any, dtype: Any = float) -> np.ndarray:
    M = np.eye(3, dtype=dtype)
    M[i, j] = value
    return M


def damaged_csr(
    data: Any = (1.0, 1.0, 1.0), indices: Any = (0, 1, 2), indptr: Any = (0, 1, 2, 3)
) -> sp.csr_array:
    """A 3 × 3 CSR array whose own arrays were overwritten behind scipy's back."""
    M = sp.csr_array((3, 3))
    M.data = np.array(data)
    M.indices = np.array(indices, np.int32)
    M.indptr = np.array(indptr, np.int32)
    return M


class TensorWithGradient:
    """Array that raises the error of a torch.Tensor with requires_grad."""

    def __array__(self, *_: Any, **__: Any) -> Any:
        raise RuntimeError(
            "Can't call numpy() on Tensor that requires grad. Use tensor.detach().numpy() instead."
        )


@refusals(r"""
LCP(np.ones((2, 3)), q) → InvalidProblem: square matrix.*got shape \(2, 3\)
LCP(with_entry(1, 2, NAN), q) → InvalidProblem: M must be finite.*M\[1, 2\] = nan.*repair
LCP(damaged_csr([1e308, 1e308, 1.0], [0, 0, 2], [0, 2, 2, 3]), q) → InvalidProblem: M\[0, 0\] = inf
LCP([[np.longdouble("1e4000")]], q) → InvalidProblem: M must be finite.*M\[0, 0\] =
LCP(with_entry(0, 1, 1j, complex), q) → InvalidProblem: M must hold real numbers.*complex.*convert
LCP(None, q) → InvalidProblem: M must hold real numbers
LCP("4 1; 1 4", q) → InvalidProblem: M must hold real numbers.*text
LCP([[1.0, 2.0], [3.0]], q) → InvalidProblem: M .*rectangular array.*check its rows
LCP(np.ma.array(np.eye(3), mask=np.eye(3)), q) → InvalidProblem: M .*masked array.*fill
LCP(TensorWithGradient(), q) → InvalidProblem: M must hold real numbers: .*Use tensor.detach
LCP(damaged_csr(indices=[0, 5, 2]), q) → InvalidProblem: damaged sparse.*< 3.*rebuild it
LCP(damaged_csr(indptr=[0, 2, 1, 3]), q) → InvalidProblem: damaged sparse.*decreasing
LCP(damaged_csr(indptr=[0, 1, 3]), q) → InvalidProblem: damaged sparse.*4
LCP(M, [1.0, 2.0]) → InvalidProblem: q must be a finite vector of length 3.*\(2,\)
LCP(M, np.zeros((4, 1))) → InvalidProblem: got shape \(4, 1\): 1 too many
LCP(M, [1.0, NAN, 3.0]) → InvalidProblem: q must be finite, but q\[1\] = nan; repair
LCP(M, None) → InvalidProblem: q must .*got None
LCP(M, sp.csr_array([[1.0, 2.0, 3.0]]))
    → InvalidProblem: q must be .*vector of length 3.*sparse.*toarray\(\), and for a vector also .ravel
problem.with_q([1.0, 2.0]) → InvalidProblem: q must be a finite vector of length 3.*\(2,\): 1 too few
problem.with_q(q, lower=6.0) → InvalidProblem: lower\[1\] = 6.0 and upper\[1\] = 5.0
LCP(M, q, lower=[0.0, 0.0]) → InvalidProblem: lower must be a number or a vector of length 3.*\(2,\): 1 too few
LCP(M, q, lower=NAN) → InvalidProblem: lower must not hold NaN.*lower\[0\] = nan.*-inf
LCP(M, q, upper=[1.0, NAN, 1.0]) → InvalidProblem: upper must not hold NaN.*upper\[1\] = nan.*inf
LCP(M, q, lower=[0.0, 2.0, 0.0], upper=1.0)
    → InvalidProblem: lower ≤ upper.*lower\[1\] = 2.0 and upper\[1\] = 1.0; swap
LCP(M, q, lower=-INF, upper=-INF) → InvalidProblem: lower ≤ upper.*upper\[0\] = -inf
LCP(M, q, 0.0, 1.0) → InvalidOption: LCP\(M, q, lower=…, upper=…
solve(plain, "psr") → UnknownAlgorithm: unknown algorithm 'psr'; did you mean 'psor'\?
solve(plain, "gurobi") → UnknownAlgorithm: unknown algorithm 'gurobi'.*known
solve(plain, "piqp") → UnknownAlgorithm: piqp is an engine.*solve\(problem\.to_qp\(\), 'piqp'
solve(plain, "clarable") → UnknownAlgorithm: did you mean 'clarabel'\?
solve(plain, algorithms.PSOR) → UnknownAlgorithm: algorithm must be a name or an object.*PSOR\(
solve(plain, LCP) → UnknownAlgorithm: such as PSOR\(relaxation=1.5\), got the class LCP$
solve(plain, "psor", relaxtion=1.0) → InvalidOption: psor has no option 'relaxtion'; did you mean 'relaxation'\?.*sweep
solve(plain, "npgs", relaxation=1.5) → InvalidOption: npgs has no option 'relaxation'.*scaling
solve(plain, verbose=1) → InvalidOption: verbose must be True or False, got 1
solve(plain, "pj", max_iter=5) → InvalidOption: 'max_iter'; did you mean 'max_iterations'\?.*known: sweep
solve(plain, max_iter=5) → InvalidOption: auto.*\['max_iter'\].*did you mean 'max_iterations'\?
solve(plain, "npsor", scaling="None")
    → InvalidOption: scaling='None' is not offered; did you mean None\? \(known: None, auto
solve(plain, algorithms.NPSOR(), relaxation=1.5) → InvalidOption: 'relaxation'.*with an algorithm object.*NPSOR\(
march(plain, np.zeros((1, 3)), tol=1e-5)
    → InvalidOption: march has no option 'tol'; did you mean 'tolerance'\? \(known
solve(plain, relaxation=1.5) → InvalidOption: auto.*\['relaxation'\].*name an algorithm
solve(plain, x0=[0.0, 0.0, 0.0]) → InvalidOption: solve takes no x0 for an LCP; the start is called z0
solve(plain, prove_infeasibility="no") → InvalidOption: prove_infeasibility must be True or False
solve_batch([[[1.0]]], [[1.0]], prove_infeasibility=1) → InvalidOption: prove_infeasibility must be True or False
solve(QuadraticProgram([[1, -2], [-2, 1]], [0, 0])) → UnsupportedModel: give x\[0\], x\[1\] finite bounds, then solve
solve(QuadraticProgram([[1, -2], [-2, 1]], [0, 0], lower=0, upper=1)) → UnsupportedModel: minimum; solve Equ
solve(plain, tolerance=-1e-8) → InvalidOption: tolerance must be finite and not negative, got -1e-08
solve(plain, tolerance="1e-8") → InvalidOption: tolerance must be .*number, got '1e-8'
solve(plain, max_iterations=-1) → InvalidOption: max_iterations must be an integer ≥ 0, got -1
solve(plain, max_seconds=-1) → InvalidOption: max_seconds must be finite and not negative, got -1
solve(plain, callback=3) → InvalidOption: callback must be .*got 3
solve(plain, z0=[1.0, 2.0]) → InvalidOption: z0 must be a finite vector of length 3.*\(2,\)
solve(plain, z0=[1.0, NAN, 1.0]) → InvalidOption: z0 must be finite, but z0\[1\] = nan; repair
solve(plain, "mgs", omega=1j) → InvalidOption: ^mgs: omega must be
solve(plain, "mgs", omega=[1.0, 2.0]) → InvalidOption: ^mgs: omega must be
solve(plain, "mgs", omega=[1.0, -1.0, 1.0]) → InvalidOption: ^mgs: omega must be
solve(plain, "npsplitting", splitting=None) → InvalidOption: ^npsplitting: .*\bsplitting\b.*None
solve(plain, "npsplitting", splitting=with_entry(1, 2, NAN))
    → InvalidOption: splitting\b.*finite.*\[1, 2\] = nan
solve(M, q) → InvalidOption: solve needs an LCP.* got ndarray; .*LCP\(M, q\)
solve(None) → InvalidOption: solve needs an LCP.* got NoneType
Certificate.of(problem, [1.0, 2.0]) → InvalidProblem: z must be a.* vector of length 3.*\(2,\)
Certificate.of(problem, None) → InvalidProblem: z must be a.* vector of length 3
""")
def test_refused(call, words):
    """“Invalid input raises an `LCPError`”: the error names the argument, and the call has no side effects."""
    assert_refused(call, words, given())


# --- options of every algorithm ----------------------------------------------------------------------------

NO_NUMBER = ["x", "1.5", True, None, 1j, [1.0], np.array([1.0, 1.0])]
NO_POSITIVE_NUMBER = [0, -1, -0.5, NAN, INF, -INF, *NO_NUMBER]
BAD_VALUES: dict[str, list[Any]] = {
    "relaxation": NO_POSITIVE_NUMBER,
    "acceleration": [NAN, INF, -INF, *NO_NUMBER],
    "scaling": ["diag", "Auto", "none", "Diagonal", 2.0, True, ["diagonal"]],
    "scaling_factor": NO_POSITIVE_NUMBER,
    "momentum": ["none", "Auto", 0.9, True],
    "sweep": ["up", "Forward", "", None, True, 1, ["forward"]],
    "omega": [0, -1, NAN, INF, "x", True, None],
    "splitting": ["diag", ""],
    "hands_over": [None, 1, "yes"],
    "coarsest": [0, -1, 2.5, True, "x"],
    "max_pivots": [-1, 2.5, NAN, True, "x", [1]],
    "restarts": [-1, 2.5, NAN, True, "x", [1]],
}
MORE_BAD_VALUES = {
    ("psor", "relaxation"): [2, 2.0, 2.5, "Auto"],
    ("pgs", "relaxation"): [2.5, "auto"],
}
OPTION_ROWS = [
    pytest.param(name, option, value, id=f"{name} {option}={value!r}")
    for name, options in OPTIONS.items()
    for option in options
    for value in [*BAD_VALUES.get(option, []), *MORE_BAD_VALUES.get((name, option), [])]
]


def test_every_option_has_bad_values():
    """Every option in the manual's table of algorithms has a list of invalid values here."""
    text = (Path(__file__).parents[2] / "examples" / "manual" / "algorithms.md").read_text(
        encoding="utf-8"
    )
    shown = [options for name, options in OPTIONS.items() if f"| `{name}` |" in text]
    assert set(BAD_VALUES) == {option for options in shown for option in options}


@pytest.mark.quick(19)
@pytest.mark.parametrize(("name", "option", "value"), OPTION_ROWS)
def test_option_out_of_range(name, option, value):
    """An invalid option value raises an error with algorithm, option and value."""
    pattern = rf"^{name}\b.*\b{option}\b.*{re.escape(repr(value))}"
    names = {**given(), "option": {option: value}}
    assert_refused(f"solve(plain, {name!r}, **option)", pattern, names, InvalidOption)
    assert_refused(f"KINDS[{name!r}](**option)", pattern, names, InvalidOption)


def test_numpy_numbers_are_numbers():
    """NumPy integers and floats, zero limits and a zero tolerance are accepted."""
    names = given()
    limits = {"max_iterations": np.int64(500), "max_seconds": np.float32(60.0)}
    start = {"z0": np.array([1, 2, 3], dtype=np.int8), "tolerance": np.float64(1e-6)}
    assert solve(names["problem"], "psor", relaxation=np.float32(1.5), **limits, **start).is_solved
    assert solve(names["problem"], "npsor", relaxation=np.int32(1)).is_solved
    assert solve(names["plain"], "mgs", omega=np.float64(0.5)).is_solved
    assert (
        solve(names["problem"], "pgs", max_iterations=0, max_seconds=0, tolerance=0).iterations == 0
    )
    # in a compiled loop
    assert solve(LCP([[2.0, 1.0], [1.0, 2.0]], [-5.0, 1.0]), max_iterations=10**30).is_solved


# --- matrices that an algorithm does not support ------------------------------------------------------------


def with_diagonal(value: float | None) -> LCP:
    """A problem with a diagonal 4, 4, value, 4; None leaves the entry out."""
    M = sp.lil_array(4.0 * np.eye(4) - np.eye(4, k=1))
    M[2, 2] = 0.0 if value is None else value
    return LCP(M, -np.ones(4))


@pytest.mark.parametrize("value", [0.0, None, -1.0, -1e-300, 5e-324, 1e-310])
@pytest.mark.parametrize("name", NEEDS_POSITIVE_DIAGONAL)
def test_diagonal_must_be_positive(name, value):
    """Zero, missing, negative or too small to invert: a method that divides by the diagonal names the entry."""
    pattern = rf"^{name} needs a positive diagonal.*M\[2, 2\] = {re.escape(str(value or 0.0))}; try algorithm=\"auto"
    names = {"problem": with_diagonal(value)}
    assert_refused(f"solve(problem, {name!r})", pattern, names, UnsuitableMatrix)


@pytest.mark.parametrize(
    ("name", "value", "options"),
    [
        ("npj", -1.0, {}),  # d/1 + d + 2 = 0 exactly
        ("npgs", -1.0, {}),
        ("npsor", -1.5, {"relaxation": 0.5}),
        ("npaor", -1.0, {"relaxation": 0.5, "acceleration": 0.0}),
    ],
)
def test_pivot_must_be_positive(name, value, options):
    """If d/α + d + 2 ≤ 0 in a row, NP* raises an error with the row, the diagonal and the pivot."""
    pattern = rf"^{name} needs d/α \+ d \+ 2 > 0.*M\[2, 2\] = {re.escape(str(value))} gives (-|0)"
    names = {"problem": with_diagonal(value), "options": options}
    assert_refused(f"solve(problem, {name!r}, **options)", pattern, names, UnsuitableMatrix)


@pytest.mark.parametrize(
    "options", [{}, {"scaling": None}, {"scaling": "diagonal"}], ids=["auto", "unscaled", "scaled"]
)
@pytest.mark.parametrize(
    "name", [name for name, options in OPTIONS.items() if "scaling" in options]
)
def test_diagonal_near_the_largest_double_is_no_obstacle(name, options):
    """A diagonal of 1e308 or 1e-307 does not overflow: the solution is right, without warning."""
    result = solve(LCP([[1e308, 0.0], [0.0, 4.0]], [1e307, -1.0]), name, **options)
    assert result.is_solved
    assert solve(LCP([[1e-307, 0.0], [0.0, 4.0]], [1e-307, -1.0]), name, **options).is_solved


@pytest.mark.parametrize(
    ("M", "options"),
    [
        ([[-1.0, 0.0], [0.0, 4.0]], {"splitting": "diagonal"}),
        (
            [[4.0, 1.0], [0.0, 4.0]],
            {"splitting": sp.csr_array([[-5.0, 1.0], [1.0, -5.0]]), "scaling": None},
        ),
    ],
)
def test_singular_splitting_is_refused(M, options):
    """If the matrix of npsplitting is singular, the error recommends another splitting."""
    words = r"^npsplitting: .*is singular.*choose another splitting"
    names = {"problem": LCP(M, [1.0, -1.0]), "options": options}
    assert_refused("solve(problem, 'npsplitting', **options)", words, names, UnsuitableMatrix)


@pytest.mark.parametrize("name", MODULUS)
@pytest.mark.parametrize(
    ("lower", "upper", "interval"),
    [
        (0.0, [INF, 3.0, INF], r"row 1 has bounds \[0\.0, 3\.0\]"),
        ([-INF, 0.0, 0.0], 1.0, r"row 0 has bounds \[-inf, 1\.0\]"),
    ],
    ids=["box", "upper only"],
)
def test_modulus_methods_need_lower_bounds_only(name, lower, upper, interval):
    """Modulus methods reject free rows and upper bounds with row, bounds and alternative."""
    words = (
        rf"^{name} needs a finite lower and no upper bound.*{interval}.*; try algorithm=\"auto\"$"
    )
    names = {**given(), "lower": lower, "upper": upper}
    call = f"solve(LCP(M, q, lower=lower, upper=upper), {name!r})"
    assert_refused(call, words, names, UnsuitableProblem)


# --- error handling ------------------------------------------------------------------------------------------


def test_nothing_runs_before_a_refusal():
    """A rejected solve raises its error before the first iterate, without a callback."""
    seen = []
    refusals = [
        {"algorithm": "psor", "relaxation": 0.0},
        {"algorithm": "psor", "tolerance": -1.0},
        {"algorithm": "psor", "z0": [1.0]},
        {"algorithm": "mgs", "omega": [1.0]},
        {"algorithm": "nobody"},
    ]
    for settings in refusals:
        with pytest.raises(LCPError):
            solve(given()["plain"], callback=lambda sample, z: seen.append(sample), **settings)
    with pytest.raises(UnsuitableMatrix):
        solve(with_diagonal(0.0), "psor", callback=lambda sample, z: seen.append(sample))
    assert seen == []


def test_every_error_is_its_builtin_too():
    """Each error is an LCPError and the builtin exception that a caller would expect; none is left out."""
    assert set(BUILTIN_BASE) == set(LCPError.__subclasses__())
    for error, builtin in BUILTIN_BASE.items():
        assert issubclass(error, builtin)


DAMAGES = {
    "CSC row beyond n": "M = sp.csc_array(E); M.indices = np.array([0, 2_000_000_000, 2], np.int32)",
    "COO row beyond n": "M = sp.coo_array(E); M.row[1] = 500_000_000",
}
DAMAGE_SCRIPT = """
import numpy as np, scipy.sparse as sp
from lcp_plugin import LCP
from lcp_plugin.core.errors import LCPError
E = np.diag([1.0, 2.0, 3.0])
{damage}
try:
    print("accepted as", LCP(M, [1.0, 2.0, 3.0]).csr.toarray().tolist())
except LCPError as error:
    print(type(error).__name__, error)
"""


@pytest.mark.quick(1)
@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES.keys())
def test_damaged_sparse_array_of_any_format_is_refused(damage):
    """A sparse array with inconsistent index arrays raises InvalidProblem, without a crash.

    The test runs in a separate process, because scipy's conversions access memory beyond the arrays of such a
    matrix.
    """
    script = DAMAGE_SCRIPT.format(damage=damage)
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, encoding="utf-8", check=False
    )
    assert done.returncode == 0, f"the process died with {done.returncode}: {done.stderr[-500:]}"
    assert re.match(r"InvalidProblem M is a damaged sparse array", done.stdout), done.stdout


# --- Arguments of a wrong kind ------------------------------------------------------------------------------------

WRONG: dict[str, Any] = {
    "number": 3.5,  "object": object(), "array": np.zeros((3, 3)), "sparse": sp.eye_array(3),
    "complex": 1j, "list": [[1]], "slice": slice(None),  "set": {1, 2},
}  # fmt: skip
TAKE: dict[str, Callable[[LCP, Any], object]] = {
    "solve algorithm": lambda p, wrong: solve(p, wrong),
    "convergence_guarantee algorithm": lambda p, wrong: convergence_guarantee(p, wrong),
    "error_bound sharp": lambda p, wrong: error_bound(p, p.q, sharp=wrong),
    "error_against_time target": lambda p, wrong: error_against_time(wrong),
    "error_against_time algorithms": lambda p, wrong: error_against_time(p, wrong),
    "error_against_time one algorithm": lambda p, wrong: error_against_time(p, [wrong]),
    "error_against_time its options": lambda p, wrong: error_against_time(p, [("psor", wrong)]),
    "error_against_time references": lambda p, wrong: error_against_time(p, ["psor"], wrong),
    "cross_validate reference": lambda p, wrong: cross_validate(p, reference=wrong),
    "cross_validate algorithm": lambda p, wrong: cross_validate(p, algorithm=wrong),
    "gallery parse": lambda p, wrong: gallery.parse(wrong),
    "gallery build": lambda p, wrong: gallery.build(wrong),
    "study against": lambda p, wrong: Study(()).plot(against=wrong),
    "study save": lambda p, wrong: Study(()).save(wrong),
}


@pytest.mark.quick(29)
@pytest.mark.parametrize("what", TAKE)
@pytest.mark.parametrize("kind", WRONG)
def test_an_argument_of_a_wrong_kind_is_refused_in_words(what, kind):
    """An argument of a wrong type ends in an LCPError, not in a TypeError of another package."""
    with pytest.raises(LCPError):
        TAKE[what](given()["plain"], WRONG[kind])


def test_rows_on_ranks_without_mpi4py(monkeypatch):
    """Names of LCP that need mpi4py are there without it, as help(LCP) shows; a call says what to install."""
    monkeypatch.setitem(sys.modules, "mpi4py", None)
    assert LCP.from_petsc.__doc__ is not None
    with pytest.raises(InvalidOption, match="pip install mpi4py mpich"):
        LCP.from_rows(None, sp.eye_array(2), np.zeros(2))


BUILDERS = {
    "LCP": lambda **bounds: LCP(np.eye(2), [1.0, 1.0], **bounds),
    "QuadraticProgram": lambda **bounds: QuadraticProgram(np.eye(2), [1.0, 1.0], **bounds),
    "BoundedLeastSquares": lambda **bounds: BoundedLeastSquares(np.eye(2), [1.0, 1.0], **bounds),
    "NonlinearProblem": lambda **bounds: NonlinearProblem(
        lambda x: x, lambda x: np.eye(2), **bounds
    ),
    "batch": lambda **bounds: (
        solve_batch(np.eye(2), [[1.0, 1.0]] * 2, **bounds)[0].certificate.problem
    ),
}


def test_bounds_that_cross_by_rounding_are_one_value_and_none_is_no_bound():
    """0.1 · 3 and 0.3 are one value in every class; 1e-9 above is refused; None means what scipy means by it."""
    for build in BUILDERS.values():
        crossed = build(lower=0.1 * 3, upper=[0.3, 1.0])
        assert crossed.upper.tolist() == [crossed.lower[0], 1.0]
        opened = build(lower=[0.0, None], upper=[None, 3.0])
        assert (opened.lower.tolist(), opened.upper.tolist()) == ([0.0, -np.inf], [np.inf, 3.0])
    for build in [*BUILDERS.values()][:3]:
        with pytest.raises(InvalidProblem, match="lower ≤ upper"):
            build(lower=0.3 + 1e-9, upper=0.3)
