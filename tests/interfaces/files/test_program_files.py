"""Programs and least squares problems from files: the names that people save them by, and what is refused in words."""

from __future__ import annotations

import re
from contextlib import nullcontext
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

from lcp_plugin import (
    LCP,
    BoundedLeastSquares,
    FrictionalContact,
    LCPError,
    ModelWarning,
    QuadraticProgram,
    UnreadableFile,
    UnsupportedModel,
    load_problem,
    solve,
)
from lcp_plugin.interfaces.program_files import load_program

P, c = np.array([[2.0, 0.0], [0.0, 2.0]]), np.array([-2.0, -4.0])
G, h = np.array([[1.0, 1.0]]), np.array([2.0])
A, b = np.array([[1.0, -1.0]]), np.array([-0.5])
SYMMETRIC = np.array([[2.0, 1.0], [1.0, 3.0]])


def parts(name: str, matrix: Any) -> dict[str, Any]:
    """The CSC arrays of a matrix."""
    columns = sp.csc_array(matrix)
    return {
        f"{name}_{part}": getattr(columns, part) for part in ("data", "indices", "indptr", "shape")
    }


SAME = {  # the nearest point of x₁ + x₂ ≤ 2, x ≥ 0 to (1, 2), by every convention
    "ranges": dict(P=P, q=c, A=np.vstack([G, np.eye(2)]), l=[-np.inf, 0, 0], u=[2.0, 1e20, np.inf]),
    "ranges and bounds": dict(P=P, q=c, A=G, u=h, lower=0.0),
    "rows of one kind": dict(P=P, c=c, G=G, h=h, lower=[0.0, 0.0]),
    "the names of qpsolvers": dict(P=P, q=c, G=G, h=h, lb=[0.0, 0.0], ub=1e20),
    "limits beyond 1e20": dict(
        P=P, c=c, G=np.vstack([G, G]), h=[2.0, 1e21], lower=0.0, upper=[1e30, 1e20]
    ),
    "a constant": dict(P=P, q=c, A=G, l=-1e20, u=h, lower=0, r=5.0),
}


@pytest.mark.parametrize("content", SAME.values(), ids=SAME)
def test_programs_are_read_by_the_names_people_save(content, tmp_path):
    """Dense arrays, as ``numpy.savez`` writes them, in the names of OSQP, ours and qpsolvers'."""
    np.savez(tmp_path / "p.npz", **content)
    program = load_problem(tmp_path / "p.npz")
    assert isinstance(program, QuadraticProgram)
    assert solve(program).require_solved().x.round(6).tolist() == [0.5, 1.5]
    assert program.constant == content.get("r", 0.0)


@pytest.mark.parametrize(
    "triangle", [sp.triu, sp.tril, sp.csc_array], ids=["upper", "lower", "all"]
)
def test_sparse_matrices_are_their_csc_arrays(triangle, tmp_path):
    """P whole or one triangle of it, A and G sparse too; a dense matrix may stand beside a sparse one."""
    np.savez(
        tmp_path / "p.npz",
        **parts("P", triangle(sp.csc_array(SYMMETRIC))),
        **parts("G", G),
        c=c,
        h=h,
        A=A,
        b=b,
    )
    program = load_program(tmp_path / "p.npz")
    np.testing.assert_array_equal(program.P.toarray(), SYMMETRIC)
    np.testing.assert_array_equal(program.G.toarray(), G)
    assert (program.h.tolist(), program.b.tolist()) == (h.tolist(), b.tolist())


def test_no_p_is_a_linear_program(tmp_path):
    """A cost and rows alone."""
    np.savez(tmp_path / "p.npz", c=[1.0, 2.0], A=[[1.0, 1.0]], b=[1.0], lower=0.0)
    assert solve(load_problem(tmp_path / "p.npz")).require_solved().x == pytest.approx(
        [1.0, 0.0], abs=1e-12
    )


def test_kinds_are_told_by_what_is_in_a_file(tmp_path):
    """M is an LCP's, P or a cost a program's, A and b alone those of least squares, whose bounds are 0 and ∞."""
    np.savez(tmp_path / "lcp.npz", M=P, q=c)
    np.savez(tmp_path / "fit.npz", A=[[1.0, 0.0], [1.0, 1.0], [0.0, 1.0]], b=[2.0, 1.0, -1.0])
    np.savez(
        tmp_path / "sparse.npz",
        **parts("A", np.eye(2)),
        b=[2.0, -1.0],
        lb=-1e20,
        weights=[1.0, 2.0],
        ridge=1.0,
    )
    assert isinstance(load_problem(tmp_path / "lcp.npz"), LCP)
    fits = [load_problem(tmp_path / name) for name in ("fit.npz", "sparse.npz")]
    assert all(isinstance(fit, BoundedLeastSquares) for fit in fits)
    assert [solve(fit).x.round(9).tolist() for fit in fits] == [[1.5, 0.0], [1.0, -0.666666667]]


REFUSED: list[tuple[dict[str, Any], type[LCPError], str]] = [
    (dict(P=P), UnreadableFile, r"lacks the keys \['c'\]; a program holds P, q, A, l, u"),
    (dict(P=P, q=c, c=c), UnreadableFile, "holds c and q, two names for one thing"),
    (dict(P=P, q=c, l=b, u=b), UnreadableFile, "l, u limit A x, and A is missing"),
    (
        dict(P=P, q=[np.nan, 1.0]),
        UnreadableFile,
        r"p\.npz states no \w+: c must be finite, but c\[0\] = nan",
    ),
    (
        dict(P=None, q=c),
        UnreadableFile,
        "pickled objects, which are never read.*arrays that are None are left out",
    ),
    (dict(P_data=[1.0], q=c), UnreadableFile, r"lacks the keys .*a sparse P is P_data, P_indices"),
    (
        dict(A=A, b=[1.0, 2.0]),
        UnreadableFile,
        r"p\.npz states no \w+: b must be a vector of length 1, an entry per row of A",
    ),
]


@pytest.mark.parametrize(
    ("content", "kind", "words"), REFUSED, ids=[words for *_, words in REFUSED]
)
def test_what_states_no_program_is_refused_in_words(content, kind, words, tmp_path):
    """Names that contradict one another, shapes that do not fit, pickled objects: an error that says what is needed."""
    np.savez(tmp_path / "p.npz", **content)
    with pytest.raises(kind, match=words):
        load_problem(tmp_path / "p.npz")


def test_contacts_are_no_program(tmp_path):
    """Neither by W, by M nor by CSR arrays does a contact problem pass for a linear program."""
    contact = FrictionalContact(np.eye(3), [-1.0, 3.0, 4.0], 0.5)
    contact.save(tmp_path / "a.npz")
    for name, matrix in (("b.npz", "W"), ("c.npz", "M")):
        np.savez(tmp_path / name, q=contact.q, mu=contact.friction, **{matrix: np.eye(3)})
    for name in ("a.npz", "b.npz", "c.npz"):
        read = load_problem(tmp_path / name)
        assert isinstance(read, FrictionalContact)
        assert solve(read).z.tobytes() == solve(contact).z.tobytes()
        with pytest.raises(
            UnreadableFile, match=r"holds a FrictionalContact, .*`lcp-plugin solve` takes"
        ):
            load_program(tmp_path / name)
    (tmp_path / "a.h5").touch()
    with pytest.raises(UnreadableFile, match="holds a FrictionalContact, not a QuadraticProgram"):
        load_program(tmp_path / "a.h5")


LP = """minimize
 obj: x + 2 y + [ 2 x ^ 2 ] / 2
subject to
 c1: x + y >= 1
bounds
 x <= 5
{more}end
"""


def test_lp_files_are_programs_and_integers_are_named(tmp_path):
    """HiGHS reads .lp as it reads .mps; an integer variable is refused by its name."""
    pytest.importorskip("highspy")
    (tmp_path / "p.lp").write_text(LP.format(more=""))
    assert solve(load_problem(tmp_path / "p.lp")).require_solved().x.round(6).tolist() == [0.5, 0.5]
    (tmp_path / "i.lp").write_text(LP.format(more="general\n y\n"))
    with pytest.raises(UnsupportedModel, match="has 1 integer variables, the first is y"):
        load_problem(tmp_path / "i.lp")


def test_a_constant_and_a_maximum_are_told(tmp_path):
    """A constant is part of the objective; a ModelWarning reports that the objective is negated."""
    pytest.importorskip("highspy")
    lp = "maximize\n 2 x + 4 y + 3\nsubject to\n x + y <= 2\nend\n"
    (tmp_path / "p.lp").write_text(lp)
    with pytest.warns(ModelWarning, match=r"p\.lp maximizes; the problem returned minimizes"):
        program = load_problem(tmp_path / "p.lp")
    assert solve(program).require_solved().objective == pytest.approx(11.0)


MPS = """NAME T
{sense}ROWS
 N obj
 G c1
COLUMNS
 x obj 1 c1 1
 y obj 2 c1 1
RHS
 RHS c1 {right}{constant}
BOUNDS
{bounds} UP BND y 4
ENDATA
"""


@pytest.mark.parametrize(
    ("bounds", "lower", "objective"),
    [
        (" UP BND x -3\n", -np.inf, -6.0),
        (" UP BND x -3\n MI BND x\n", -np.inf, -6.0),
        (" UP BND x -3\n LO BND x -5\n", -5.0, -5.0),
        (" UP BND x 0\n", 0.0, 0.0),
    ],
)
def test_a_negative_upper_bound_in_mps_leaves_no_lower_bound_of_0(
    bounds, lower, objective, tmp_path
):
    """X + 2 y over x + y ≥ −6, 0 ≤ y ≤ 4 and x ≤ −3: the lower bound of x is −∞ unless the file gives one."""
    text = MPS.format(sense="", right="-6", constant="", bounds=bounds)
    (tmp_path / "p.mps").write_text(text)
    is_told = bounds == " UP BND x -3\n"
    with pytest.warns(ModelWarning, match="x has the upper bound -3") if is_told else nullcontext():
        program = load_problem(tmp_path / "p.mps")
    assert program.lower.tolist() == [lower, 0.0]
    assert solve(program).require_solved().objective == pytest.approx(objective)
    (tmp_path / "q.mps").write_text(text.replace("BOUNDS", "BOUNDS\n LO BND x 0"))
    if "LO" not in bounds and "MI" not in bounds and lower < 0.0:
        with pytest.raises(UnreadableFile, match="lower"):
            load_problem(tmp_path / "q.mps")


@pytest.mark.parametrize(
    "sense",
    [
        "OBJSENSE MAXIMUM\n",
        "OBJSENSE: MAX\n",
        "OBJSENSE MAX $ the profit\n",
        "OBJSENSE\n    MAXIMIZE\n",
        "MAX\n",
    ],
)
def test_a_maximum_in_mps_is_read_on_one_line_and_on_two(sense, tmp_path):
    """The largest x + 2 y + 10 over x + y ≥ 2, x ≤ 3, y ≤ 4 is 21; without the line, the least one is 12."""
    text = MPS.format(sense=sense, right="2", constant="\n RHS obj -10", bounds=" UP BND x 3\n")
    (tmp_path / "p.mps").write_text(text)
    with pytest.warns(ModelWarning, match="maximizes"):
        program = load_problem(tmp_path / "p.mps")
    assert solve(program).require_solved().objective == pytest.approx(21.0)
    (tmp_path / "q.mps").write_text(text.replace(sense, ""))
    assert solve(load_problem(tmp_path / "q.mps")).objective == pytest.approx(12.0)


@pytest.mark.parametrize(
    ("bounds", "lower", "upper"),
    [
        (" FR BND x\n UP BND x -1\n", -np.inf, -1.0),
        (" UP BND x -1\n FR BND x\n", -np.inf, np.inf),
        (" UP BND x 5\n UP BND x 3\n", 0.0, 3.0),
        (" FX BND x 1\n UP BND x 4\n", 1.0, 4.0),
        (" FR x\n LO x -4\n", -4.0, np.inf),
    ],
)
def test_a_later_bound_in_mps_replaces_an_earlier_one(bounds, lower, upper, tmp_path):
    """The bounds of x are read in the order of the lines."""
    text = MPS.format(sense="", right="2", constant="", bounds=bounds)
    (tmp_path / "p.mps").write_text(text)
    program = load_problem(tmp_path / "p.mps")
    assert (program.lower[0], program.upper[0]) == (lower, upper)
    assert (program.lower[1], program.upper[1]) == (0.0, 4.0)


def test_an_mps_file_that_leaves_something_out_is_read_with_a_message(tmp_path):
    """The right-hand side of a second free row is no constant; a repeated entry warns; ENDATA is required."""
    path = tmp_path / "p.mps"
    text = MPS.format(sense="", right="2", constant="\n RHS other 5", bounds="")
    path.write_text(text.replace(" G c1", " N other\n G c1"))
    assert load_problem(path).constant == 0.0
    path.write_text(text.replace(" RHS other 5\n", "").replace("RHS\n", " y c1 7\nRHS\n", 1))
    with pytest.warns(ModelWarning, match="entry of c1 y in COLUMNS; the first holds"):
        assert load_problem(path).G.toarray().tolist() == [[-1.0, -1.0]]
    path.write_text(text.replace("ENDATA\n", ""))
    with pytest.raises(UnreadableFile, match="no line ENDATA"):
        load_problem(path)


QPS = """NAME T
ROWS
 N obj
 G r1
COLUMNS
 x obj 1
 x r1 1
 y obj 1 r1 1
RHS
 RHS r1 4
RANGES
 R r1 2
BOUNDS
 UP BND x 3
QUADOBJ
 x x 2
 x y 1
 y y 2
ENDATA
"""


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ("UP BND x 3", "UP BND z 3", '"UP BND z 3" in BOUNDS'),
        ("UP BND x 3", "FR BND z", '"FR BND z" in BOUNDS'),
        (" x y 1", " x z 1", '"x z 1" in QUADOBJ'),
    ],
)
def test_a_column_of_an_mps_file_without_coefficients_is_told(old, new, line, tmp_path):
    """HiGHS writes a variable without cost and rows only in BOUNDS and QUADOBJ; it may be a wrong name also."""
    path = tmp_path / "p.mps"
    path.write_text(QPS.replace(old, new, 1))
    with pytest.warns(ModelWarning, match=f"z of the line {line} is not in COLUMNS; it is a new"):
        assert load_problem(path).P.shape == (3, 3)


@pytest.mark.parametrize(
    ("old", "new", "expected", "entries"),
    [
        ("r1 4", "r1 4 r1 5", "entry of r1 in RHS; the first", [[2, 1], [1, 2]]),
        (" R r1 2", " R r1 2\n R r1 3", "entry of r1 in RANGES; the first", [[2, 1], [1, 2]]),
        (" x y 1", " x y 1\n y x 1", "entry of x y in QUADOBJ; the sum", [[2, 2], [2, 2]]),
        (" x x 2", " x x 2\n x x 2", "entry of x x in QUADOBJ; the sum", [[4, 1], [1, 2]]),
    ],
)
def test_repeated_entries_of_an_mps_file_are_told_with_the_one_that_holds(
    old, new, expected, entries, tmp_path
):
    """4 ≤ x + y ≤ 6, by the first right-hand side and the first range; quadratic terms are summed."""
    path = tmp_path / "p.mps"
    path.write_text(QPS.replace(old, new, 1))
    with pytest.warns(ModelWarning, match=expected):
        program = load_problem(path)
    assert sorted(program.h.tolist()) == [-4.0, 6.0]
    assert program.P.toarray().tolist() == entries


# text of QPS, the wrong text, a part of the message; / is the end of a line
FAULTS = """
 G r1/         →  G r1/ L r1/             → r1 is stated twice in ROWS
RHS/           →  x r1 7/RHS/             → x is stated twice in COLUMNS
y obj 1 r1 1   → y obj 1 r8 1             → r8 of the line "y obj 1 r8 1" in COLUMNS is not in ROWS
RHS r1 4       → RHS r7 4                 → r7 of the line "RHS r7 4" in RHS is not in ROWS
 x y 1/        →  x y/                    → the line "x y" in QUADOBJ has a name without a number
x obj 1        → x obj 1a                 → 1a of the line "x obj 1a
x obj 1        → x obj 1_0                → 1_0 of the line "x obj 1_0
x obj 1        → x obj \u0661\u0662       → is not a finite number
x obj 1        → x obj nan                → nan of the line
RHS r1 4       → RHS r1 -inf              → -inf of the line "RHS r1 -inf" in RHS is not a finite number
RHS r1 4       → RHS r1 1_0               → 1_0 of the line "RHS r1 1_0" in RHS
R r1 2         → R r1 \u0661              → \u0661 of the line "R r1 \u0661" in RANGES
y y 2          → y y nan                  → nan of the line "y y nan" in QUADOBJ
UP BND x 3     → UP BND x 3_0             → 3_0 of the line "UP BND x 3_0" in BOUNDS
UP BND x 3     → UP BND x nan             → nan of the line "UP BND x nan" in BOUNDS
UP BND x       → XX BND x                 → "XX BND x 3" in BOUNDS begins with none of LO, UP
RANGES         → SOS                      → SOS is not one of the sections NAME, OBJSENSE
ROWS           → OBJSENSE FEW/ROWS        → FEW is not a row N, L, G, E or a sense MIN, MAX
 G r1          →  H r1                    → H is not a row N, L, G, E
QUADOBJ        → QMATRIX                  → P must be symmetric
 y obj          →  M1 'MARKER' 'INTORG'/ y obj → has 1 integer variables, the first is y
UP BND x       → UI BND x                 → has 1 integer variables, the first is x
"""


@pytest.mark.parametrize("row", FAULTS.strip("\n").splitlines())
def test_faults_of_an_mps_file_are_named(row, tmp_path):
    """The message names the line of a name or a number that the format lacks, and integers by the first one."""
    old, new, words = (part.replace("/", "\n") for part in re.split(r" *→ ", row))
    (tmp_path / "p.mps").write_text(QPS.replace(old, new, 1), encoding="utf-8")
    with pytest.raises((UnreadableFile, UnsupportedModel), match=re.escape(words)):
        load_problem(tmp_path / "p.mps")


def test_a_dollar_begins_a_comment_unless_a_name_does(tmp_path):
    """Comments after $ and * change nothing, and $y remains the name of a column."""
    path = tmp_path / "p.mps"
    path.write_text(QPS)
    plain = load_program(path)
    text = QPS.replace("x obj 1", "x obj 1 $ cost").replace("RHS\n", "* data\nRHS $ b\n", 1)
    path.write_text(text.replace("BND x 3", "BND x 3 $ at most").replace(" y", " $y"))
    read = load_program(path)
    assert read.names.unknowns == ["x", "$y"]
    for name in ("c", "h", "lower", "upper"):
        assert getattr(read, name).tolist() == getattr(plain, name).tolist()
    assert (read.P != plain.P).nnz == (read.G != plain.G).nnz == 0


def test_names_with_blanks_have_fixed_places(tmp_path):
    """In fixed format a name has its columns of a line, and may hold blanks."""
    row = "    {:<8}  {:<8}  {:>12}\n".format
    (tmp_path / "p.mps").write_text(
        "NAME\nROWS\n N  the cost\n L  of it\nCOLUMNS\n"
        + row("my x", "the cost", "-1.")
        + row("my x", "of it", "2.")
        + f"RHS\n{row('RHS', 'of it', '8.')}BOUNDS\n UP BND       my x      {'3.':>12}\nENDATA\n"
    )
    program = load_program(tmp_path / "p.mps")
    assert (program.names.unknowns, program.c.tolist(), program.G.toarray().tolist()) == (
        ["my x"],
        [-1.0],
        [[2.0]],
    )
    assert (program.h.tolist(), program.upper.tolist()) == ([8.0], [3.0])


@pytest.mark.parametrize("seed", range(12))
def test_mps_files_of_highs_are_read_as_highs_reads_them(seed, tmp_path):
    """A random program that HiGHS wrote has the arrays that HiGHS holds, with ranges, free rows and all bounds."""
    highspy = pytest.importorskip("highspy")
    rng = np.random.default_rng(seed)
    n, m = rng.integers(1, 9, 2)
    highs = highspy.Highs()
    highs.setOptionValue("log_to_console", False)
    ends = np.round(rng.normal(size=(2, n + m)), 3)
    lower, upper = ends.min(axis=0), ends.max(axis=0)
    kind = np.append(rng.integers(0, 5, n), rng.integers(0, 3, m))
    lower[kind == 0], upper[kind == 1] = -np.inf, np.inf
    lower[kind == 2] = upper[kind == 2]
    lower[kind == 3], upper[kind == 3] = -np.inf, np.inf
    for j in range(n):
        highs.addVar(lower[j], upper[j])
        highs.changeColCost(j, round(rng.normal(), 3))
    A = np.round(rng.normal(size=(m, n)) * (rng.random((m, n)) < 0.6), 3)
    for i in range(m):
        columns = np.flatnonzero(A[i])
        highs.addRow(lower[n + i], upper[n + i], columns.size, columns, A[i, columns])
    highs.changeObjectiveSense(
        highspy.ObjSense.kMaximize if seed % 2 else highspy.ObjSense.kMinimize
    )
    highs.changeObjectiveOffset(float(seed))
    assert highs.writeModel(str(tmp_path / "p.mps")) != highspy.HighsStatus.kError
    program = load_program(tmp_path / "p.mps")
    sign = program.sense
    highs.readModel(str(tmp_path / "p.mps"))  # a range is written by its width, which rounds
    linear = highs.getLp()
    bounds = (linear.row_lower_, linear.row_upper_, linear.col_lower_, linear.col_upper_)
    cost, zero = sign * np.array(linear.col_cost_), np.zeros((n, n))
    expected = QuadraticProgram.from_ranges(zero, cost, A, *bounds, sign * seed)
    assert sign == (-1.0 if seed % 2 else 1.0)
    assert program.constant == expected.constant
    for name in ("c", "G", "h", "A", "b", "lower", "upper"):
        np.testing.assert_array_equal(
            *(
                one.toarray() if sp.issparse(one) else one
                for one in (getattr(program, name), getattr(expected, name))
            )
        )


def test_a_triangle_and_the_whole_of_a_matrix_state_one_program(tmp_path):
    """QUADOBJ has one triangle of P, QMATRIX all of it: P = [[2, 1], [1, 2]], c = (1, 1)."""
    path = tmp_path / "p.mps"
    for text in (QPS, QPS.replace("QUADOBJ", "QMATRIX").replace(" x y 1\n", " x y 1\n y x 1\n")):
        path.write_text(text)
        program = load_problem(path)
        assert program.P.toarray().tolist() == [[2.0, 1.0], [1.0, 2.0]]
        assert program.c.tolist() == [1.0, 1.0]
