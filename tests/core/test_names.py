"""Names of rows and unknowns: messages and proofs of every way in use the user's words."""

import cvxpy as cp
import numpy as np
import pytest

from lcp_plugin import (
    LCP,
    BoundedLeastSquares,
    InvalidProblem,
    NonlinearProblem,
    QuadraticProgram,
    certify,
    complements,
    load_problem,
    prepare,
    solve,
    solve_batch,
    trace,
)

MPS = """NAME p
ROWS
 N obj
 L cap
 G steel
COLUMNS
 a obj 1 cap 1
 a steel 1
RHS
 RHS cap 1 steel 4
ENDATA
"""


def test_an_infeasible_lcp_names_its_row():
    """The proof of an LCP names the row that it was given, and q may change."""
    problem = LCP([[-1, 0], [0, 1]], [-1, 2], names=["market", "budget"])
    assert "market contradicts its bounds" in str(solve(problem.with_q([-2, 2])).proof)
    with pytest.raises(InvalidProblem, match="3 names of rows, and the problem has 2"):
        LCP(np.eye(2), [0, 0], names=["a", "b", "c"])


CONSTRUCTORS = {
    "LCP": lambda names: LCP(np.eye(2), [1, 1], names=names),
    "QuadraticProgram": lambda names: QuadraticProgram(None, [1, 1], names=names),
    "from_ranges": lambda names: QuadraticProgram.from_ranges(
        np.eye(2), [1, 1], np.eye(2), [0, 0], [1, 1], names=names
    ),
    "NonlinearProblem": lambda names: NonlinearProblem(lambda x: x - 1, names=names),
    "NonlinearProblem with bounds": lambda names: NonlinearProblem(
        lambda x: x - 1, lower=[0, 0], names=names
    ),
}
NO_NAMES = {
    "number": 5,
    "function": lambda i: str(i),
    "generator": (name for name in "ab"),
    "set": {"a", "b"},
    "dict": {0: "a", 1: "b"},
    "word": "ab",
    "numbers": [1, 2],
    "tuples": [("a", 1), ("b", 2)],
    "half": ["a", None],
}


@pytest.mark.parametrize("wrong", NO_NAMES)
def test_names_are_lists_of_strings_in_every_constructor(wrong):
    """Anything but a sequence of strings or a pair of sequences is an InvalidProblem of the constructor."""
    for build in CONSTRUCTORS.values():
        with pytest.raises(InvalidProblem, match="names must be a sequence of strings, or a pair"):
            build(NO_NAMES[wrong])
        array = np.array(["a", "b"])
        for names in (["a", "b"], ("a", "b"), array, [None, ("a", "b")], (None, array), None):
            build(names)


def test_programs_name_rows_and_bounds(tmp_path):
    """Rows of arrays and of an MPS file keep their names; a bound is written with the name of its unknown."""
    named = [["cap"], ["ship", "store"]]
    program = QuadraticProgram(None, [1, 1], [[1, 1]], [1], lower=[4, 0], names=named)
    assert "cap, ship ≥ 4" in str(solve(program).proof)
    assert "row 0 of G, lower[0]" in str(
        solve(QuadraticProgram(None, [1, 1], [[1, 1]], [1], lower=[4, 0])).proof
    )
    (tmp_path / "p.mps").write_text(MPS)
    assert "2 of its constraints are inconsistent, cap, steel" in str(
        solve(load_problem(tmp_path / "p.mps")).proof
    )


def test_cvxpy_models_speak_in_the_users_words():
    """A program and a complementarity problem name constraints as written, labels where there are some."""
    ship = cp.Variable(3, name="ship", nonneg=True)
    cap = cp.sum(ship) <= 10
    stated = [cap, ship >= 4, cp.norm1(ship[1:] - ship[:2]) <= 1]
    problem = cp.Problem(cp.Minimize(cp.sum(ship)), stated)
    problem.solve(method="LCP")
    said = problem.solver_stats.extra_stats.explain()
    assert "sum(ship) <= 10.0, 4.0 <= ship, entry 0" in said
    assert "norm1" not in said
    price = cp.Variable(2, name="price", nonneg=True)
    pair = complements(price, cp.hstack([-1 - price[0], 2 + price[1]]))
    model = cp.Problem(cp.Minimize(0), [pair])
    if hasattr(pair, "set_label"):  # cvxpy 1.9
        pair.set_label("market")
    model.solve(method="LCP")
    name = "market[0]" if hasattr(pair, "set_label") else "entry 0"
    assert f"{name} contradicts its bounds" in model.solver_stats.extra_stats.explain()


def test_rows_of_arrays_of_numbers_have_the_number_and_the_variables_of_their_constraint():
    """Instead of a dump of M, for pairs and programs; a label or a short text takes its place."""
    ship, price = cp.Variable(3, name="ship"), cp.Variable(3, name="price")
    M = -np.array([[2.0, 1.0, 0.0], [1.0, 2.0, 1.0], [0.0, 1.0, 2.0]])
    pair = complements(price >= 0, M @ price + ship - 7.25 * np.arange(3.0) >= 0)
    program = cp.Problem(cp.Minimize(cp.sum(ship)), [ship >= 0, price >= 0, M @ ship - price >= 1])
    square = cp.Problem(cp.Minimize(0), [ship == 0.5 * price, pair])
    square.solve(method="LCP")
    told = square.solver_stats.extra_stats.explain()
    assert "constraint 1 (price, ship), entry" in told
    assert "2.00" not in told
    assert told.count("set_label('market')") == 1
    program.solve(method="LCP")
    told = program.solver_stats.extra_stats.explain()
    assert "constraint 2 (ship, price), entry" in told
    assert "0.0 <= ship" in told
    assert told.count("set_label('market')") == 1
    if hasattr(pair, "set_label"):
        pair.set_label("market")
        square.solve(method="LCP")
        told = square.solver_stats.extra_stats.explain()
        assert "market[" in told
        assert "set_label" not in told


def test_a_list_names_the_unknowns_of_a_program_also_if_it_has_as_many_rows():
    """A row without a name is called by its number, of the rows that the user gave; a pair names rows."""
    G, h = [[-1.0, -1, 0], [0, -1, -1], [1, 0, 1]], [-3.0, 0, 5]
    fuels = ["coal", "gas", "oil"]
    made = [QuadraticProgram(None, np.ones(3), G, h, lower=0, upper=1, names=fuels)]
    made.append(
        QuadraticProgram.from_ranges(
            None, np.ones(3), -np.array(G), -np.array(h), np.inf, 0, 1, names=fuels
        )
    )
    for program, row in zip(made, ("row 0 of G", "row 0 of A"), strict=True):
        assert solve(program).conflict.names == [row, "coal ≤ 1", "gas ≤ 1"]
    named = QuadraticProgram(
        None, np.ones(3), G, h, lower=0, upper=1, names=[["a", "b", "c"], fuels]
    )
    assert solve(named).conflict.names == ["a", "coal ≤ 1", "gas ≤ 1"]


def test_the_objective_of_a_cvxpy_program_is_the_users():
    """With its constant and its sense: in results, texts, along a path, and for the best of all solutions."""
    x, top = cp.Variable(2), cp.Parameter(value=5.0)
    goal = cp.Maximize(top - cp.abs(x[0] - 3) - x[1] ** 2)
    problem = cp.Problem(goal, [x[0] <= 1])
    assert problem.solve(method="LCP") == pytest.approx(3.0)
    result = problem.solver_stats.extra_stats
    assert result.objective == pytest.approx(3.0)
    assert "objective 3;" in result.explain()
    path = trace(problem, top, 1, 4)
    assert [path.at(theta).objective for theta in (1, 4)] == pytest.approx([-1.0, 2.0])
    z = cp.Variable(nonneg=True)
    best = cp.Problem(cp.Maximize(7 - z), [complements(z, z - 1)])
    assert best.solve(method="LCP") == pytest.approx(6.0)
    assert "objective 6, none above 6" in best.solver_stats.extra_stats.explain()


def test_a_conflict_of_many_bounds_names_each_array_once():
    """60 bounds of one variable are one name with their number, of arrays and of cvxpy."""
    program = QuadraticProgram(None, np.zeros(60), G=np.ones((1, 60)), h=[-1.0], lower=0)
    result = solve(program)
    for text in (str(result.conflict), result.explain()):
        assert "row 0 of G" in text
        assert "lower (60 entries)" in text
    ship = cp.Variable(60, name="ship")
    problem = cp.Problem(cp.Minimize(0), [ship >= 0, cp.sum(ship) <= -1])
    problem.solve(method="LCP")
    assert "0.0 <= ship (60 entries)" in str(problem.solver_stats.extra_stats.conflict)


def test_two_unknowns_with_one_name_are_refused():
    """`result.named` would lose a value; rows may share a name. Programs and least squares count x."""
    for problem in (LCP, QuadraticProgram):
        with pytest.raises(InvalidProblem, match="must differ, but 'a' is there twice"):
            problem(np.eye(2), [1, 1], names=["a", "a"])
    assert LCP(np.eye(2), [1, 1], names=[["a", "a"], ["b", "c"]]).names.row(1) == "a"
    for problem in (QuadraticProgram(np.eye(1), [1.0]), BoundedLeastSquares(np.eye(1), [1.0])):
        assert [*solve(problem).named] == ["x[0]"]


def test_labels_of_pandas_are_names_and_must_be_in_one_order():
    """A permuted matrix, vector or bound is an error that shows its labels; default labels name nothing."""
    pandas = pytest.importorskip("pandas")
    labels, turned, q = ["a", "b"], ["b", "a"], pandas.Series([-5.0, 1.0], ["a", "b"])
    M = pandas.DataFrame([[2.0, 1.0], [1.0, 2.0]], labels, labels)
    assert solve(LCP(M, q)).named == {"a": 2.5, "b": 0.0}
    rows = pandas.DataFrame([[1.0, 1.0]], ["cap"], labels)
    assert QuadraticProgram(M, q, rows, [1.0]).names == (["cap"], labels)
    assert LCP(M, q.reset_index(drop=True), names=["c", "d"]).names.row(0) == "c"
    assert LCP(M.to_numpy(), pandas.Series([1.0, 2.0])).names == (None, None)
    problem, program = LCP(M, q), QuadraticProgram(M, q, M, q + 9)
    assert prepare(problem).solve(q=q[turned][labels]).named == {"a": 2.5, "b": 0.0}
    for wrong in (
        lambda: LCP(M, q[turned]),
        lambda: LCP(M[turned], q),
        lambda: LCP(M.to_numpy(), q, upper=q[turned] + 9),
        lambda: LCP(pandas.DataFrame(M.to_numpy()), pandas.Series([1.0, 2.0], [1, 0])),
        lambda: QuadraticProgram(M, q, rows[turned], [1.0]),
        lambda: BoundedLeastSquares(M, [1.0, 2.0], lower=q[turned]),
        lambda: LCP(M.reset_index(drop=True), q[turned]),
        lambda: problem.with_q(q[turned]),
        lambda: prepare(problem).solve(q=q[turned]),
        lambda: prepare(problem).solve(M=M.loc[turned]),
        lambda: solve(problem, z0=q[turned]),
        lambda: certify(problem, q[turned]),
        lambda: solve_batch(problem, M[turned]),
        lambda: prepare(program).solve(c=q[turned]),
        lambda: prepare(program).solve(h=pandas.Series([1.0, 2.0], turned)),
        lambda: solve_batch(program, M[turned]),
    ):
        with pytest.raises(InvalidProblem, match=r"in one order, but label 0 is '[a0]' and '[b1]'"):
            wrong()
