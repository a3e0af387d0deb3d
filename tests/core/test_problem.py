"""The problem's data: canonical, read-only, shared where nothing forces a copy, and never the caller's to lose."""

from __future__ import annotations

import copy
import tracemalloc
import warnings
from inspect import signature
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given
from hypothesis import strategies as st
from tools.refusals import assert_refused, refusals

from lcp_plugin import (
    LCP,
    BoundedLeastSquares,
    Certificate,
    NonlinearProblem,
    QuadraticProgram,
    solve,
)

A = np.array(
    [[4.0, -1.0, 0.0, 0.0], [0.0, 5.0, -2.0, 0.0], [0.0, 0.0, 6.0, 0.0], [-3.0, 0.0, 0.0, 0.5]]
)
Q = np.array([-1.0, 2.0, -3.0, 4.0])
TRIDIAGONAL = sp.csr_array(
    sp.diags_array([-np.ones(9), np.full(10, 4.0), -np.ones(9)], offsets=[-1, 0, 1])
)
FORMATS = [f"{name}_array" for name in ("csr", "csc", "coo", "bsr", "dia", "lil", "dok")]
FORMATS += [name.replace("array", "matrix") for name in FORMATS]


def assert_canonical(p: LCP, expected: np.ndarray) -> None:
    """The CSR arrays one by one: sorted, no duplicate, no stored zero, doubles, narrow indices, read-only."""
    M = p.csr
    assert isinstance(M, sp.csr_array)
    assert (M.data.dtype, M.indices.dtype, M.indptr.dtype) == (np.float64, np.int32, np.int32)
    assert M.indptr[0] == 0
    assert M.indptr[-1] == M.indices.size == M.data.size == p.nonzeros == np.count_nonzero(expected)
    for i in range(p.n):
        columns = M.indices[M.indptr[i] : M.indptr[i + 1]]
        assert (np.diff(columns) > 0).all()
        np.testing.assert_array_equal(M.data[M.indptr[i] : M.indptr[i + 1]], expected[i, columns])
    assert M.data.all()
    assert M.has_canonical_format
    np.testing.assert_array_equal(p.M.toarray() if sp.issparse(p.M) else p.M, expected)
    assert_read_only(M.data, M.indices, M.indptr)


def assert_read_only(*arrays: np.ndarray) -> None:
    for array in arrays:
        assert not array.flags.writeable
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0


# --- what is accepted ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", FORMATS)
def test_every_sparse_format_means_the_same(form):
    """Each scipy format, as array and as matrix, gives the same CSR and is not modified."""
    M = getattr(sp, form)(A)
    p = LCP(M, Q)
    assert_canonical(p, A)
    assert sp.issparse(p.M)
    assert M.format == form[:3]
    np.testing.assert_array_equal(M.toarray(), A)


@pytest.mark.parametrize(
    "dtype", ["float64", "float32", "float16", "longdouble", "int8", "bool", ">i4"]
)
@pytest.mark.parametrize(
    "layout", ["C", "F", "strided", "read-only", "sparse", "list", "np.matrix"]
)
def test_every_kind_of_number_becomes_a_double(dtype, layout):
    """Integers, booleans, halves, singles and foreign byte orders, in any memory layout, are stored as doubles."""
    numbers = np.abs(A).astype(dtype)
    expected = numbers.astype(np.float64)
    forms = {
        "C": lambda: np.ascontiguousarray(numbers),
        "F": lambda: np.asfortranarray(numbers),
        "strided": lambda: np.repeat(np.repeat(numbers, 2, axis=0), 2, axis=1)[::2, ::2],
        "read-only": lambda: np.frombuffer(numbers.tobytes(), dtype=numbers.dtype).reshape(
            numbers.shape
        ),
        "sparse": lambda: with_data(sp.csr_array(expected), numbers[numbers != 0]),
        "list": lambda: numbers.tolist(),
        "np.matrix": lambda: older_matrix(numbers),
    }
    p = LCP(forms[layout](), Q.astype("int8"))
    assert_canonical(p, expected)
    assert p.M.dtype == np.float64
    np.testing.assert_array_equal(p.slack(np.ones(4)), expected.sum(axis=1) + Q)
    assert numbers.dtype == np.dtype(dtype)


def older_matrix(values: np.ndarray) -> np.matrix:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PendingDeprecationWarning)
        return np.matrix(values)


def with_data(M: sp.csr_array, data: np.ndarray) -> sp.csr_array:
    """The same pattern with values of a dtype that scipy itself would not build."""
    M.data = data
    return M


@given(
    n=st.integers(1, 6),
    triplets=st.lists(
        st.tuples(st.integers(0, 5), st.integers(0, 5), st.integers(-4, 4)), max_size=40
    ),
    form=st.sampled_from(
        ["coo", "csr", "csc", "csr stale", "csc stale", "coo stale", "bsr", "lil"]
    ),
)
def test_duplicates_are_summed_and_zeros_dropped(n, triplets, form):
    """Repeated, cancelling or zero triplets in any order are summed, in spite of wrong flags."""
    expected = np.zeros((n, n))
    rows, columns, values = [], [], []
    for i, j, value in triplets:
        if i < n and j < n:
            expected[i, j] += value
            rows.append(i), columns.append(j), values.append(float(value))
    name, _, flags = form.partition(" ")
    M = uncompressed(name, n, rows, columns, values)
    if flags == "stale":
        M.has_canonical_format = True
    if name in ("csr", "csc"):
        before = (M.data.copy(), M.indices.copy(), M.indptr.copy())
        p = LCP(M, np.zeros(n))
        for now, then in zip((M.data, M.indices, M.indptr), before, strict=True):
            np.testing.assert_array_equal(now, then)
    else:
        p = LCP(M, np.zeros(n))
    assert_canonical(p, expected)


def uncompressed(
    form: str, n: int, rows: list[int], columns: list[int], values: list[float]
) -> Any:
    """A sparse array that keeps the triplets as they come: duplicates, unsorted, zeros."""
    triplets = sp.coo_array((values, (rows, columns)), shape=(n, n))
    if form not in ("csr", "csc"):
        return triplets if form == "coo" else getattr(sp, f"{form}_array")(triplets)
    major, minor = (rows, columns) if form == "csr" else (columns, rows)
    order = np.argsort(np.array(major, dtype=int), kind="stable")
    indptr = np.searchsorted(np.array(major, dtype=int)[order], np.arange(n + 1))
    M = getattr(sp, f"{form}_array")((n, n))
    M.data = np.array(values, dtype=float)[order]
    M.indices, M.indptr = np.array(minor, np.int32)[order], indptr.astype(np.int32)
    return M


# --- no copy, nothing modified ---------------------------------------------------------------------------------


def test_canonical_csr_is_not_copied():
    """A canonical CSR array is used in place through read-only views; the caller's stay writable and as they were."""
    M = TRIDIAGONAL.copy()
    before = (M.data.copy(), M.indices.copy(), M.indptr.copy())
    p = LCP(M, np.ones(10))
    solve(p, "npsor")
    for own, given_array, then in zip(
        (p.csr.data, p.csr.indices, p.csr.indptr),
        (M.data, M.indices, M.indptr),
        before,
        strict=True,
    ):
        assert np.shares_memory(own, given_array)
        assert given_array.flags.writeable
        np.testing.assert_array_equal(given_array, then)
    assert_read_only(p.csr.data, p.csr.indices, p.csr.indptr)


def test_dense_matrices_are_copies_of_their_own():
    """Later changes of a dense M affect neither the problem nor its proved properties."""
    M = np.array([[4.0, -1.0], [-1.0, 4.0]])
    p = LCP(M, [-3.0, 5.0])
    result = solve(p)
    M[0, 1] = M[1, 0] = 40.0
    assert not np.shares_memory(p.M, M)
    assert p.M[0, 1] == p.csr[0, 1] == -1.0
    assert_read_only(p.M)
    again = solve(p)
    assert again.z.tobytes() == result.z.tobytes()
    assert M.flags.writeable
    assert M[0, 1] == 40.0


@pytest.mark.parametrize("form", ["csr", "csc", "coo", "bsr"])
@pytest.mark.parametrize("kind", [np.int8, np.uint8, bool, np.int16, np.float32, np.float64])
def test_duplicates_are_summed_as_doubles(form, kind):
    """Entries given twice add up in double precision, however narrow the type they come in: 100 + 100 is 200."""
    value, once = (1, 1.0) if kind is bool else (100, 100.0)
    M = sp.coo_array(
        (np.array([value, value, value], dtype=kind), ([0, 0, 1], [0, 0, 1])), shape=(2, 2)
    )
    if form != "coo":  # scipy would add them up on the way
        data = np.array([value] * 3, dtype=kind)
        indices = np.array([0, 0, 1])
        pointer = np.array([0, 2, 3])
        kinds = {"csr": sp.csr_array, "csc": sp.csc_array, "bsr": sp.bsr_array}
        M = kinds[form](
            (data.reshape(3, 1, 1) if form == "bsr" else data, indices, pointer), shape=(2, 2)
        )
    assert LCP(M, [0.0, 0.0]).csr.toarray().tolist() == [[2 * once, 0.0], [0.0, once]]
    assert QuadraticProgram(M, [0.0, 0.0]).P.toarray().tolist() == [[2 * once, 0.0], [0.0, once]]


def test_vectors_are_copies_of_their_own():
    """The vectors are copies: writing into the caller's arrays later changes no problem."""
    q, lower, upper = Q.copy(), np.zeros(4), np.full(4, 9.0)
    p = LCP(A, q, lower=lower, upper=upper)
    q[:], lower[:], upper[:] = 77.0, -77.0, 77.0
    np.testing.assert_array_equal(p.q, Q)
    np.testing.assert_array_equal(p.lower, np.zeros(4))
    np.testing.assert_array_equal(p.upper, np.full(4, 9.0))


def test_large_sparse_problem_is_never_dense():
    """Building, describing and measuring a problem with n = 100 000 takes a few times its nonzeros in memory."""
    n = 100_000
    M = sp.csr_array(sp.diags_array([np.full(n, 4.0), -np.ones(n - 1)], offsets=[0, -1]))
    tracemalloc.start()
    p = LCP(M, np.ones(n))
    assert Certificate.of(p, np.ones(n)).relative_residual > 0.0
    assert "n=100000" in repr(p)
    mixed = LCP(np.eye(4), np.ones(4), lower=[0, 0, 0, -np.inf], upper=[np.inf, np.inf, 1, np.inf])
    assert repr(mixed) == "LCP(n=4, nonzeros=4, bounds 2 one-sided, 1 boxed, 1 free)"
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 40 * p.nonzeros * 8


# --- dense or sparse -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["npsor", "psor", "mgs", "npsplitting"])
def test_dense_and_sparse_give_the_same_answer(name):
    """A matrix is solved in the same steps to the same bits, dense and sparse."""
    dense = solve(LCP(A, Q), name)
    sparse = solve(LCP(sp.csr_array(A), Q), name)
    assert dense.z.tobytes() == sparse.z.tobytes()
    assert (dense.status, dense.iterations, dense.work) == (
        sparse.status,
        sparse.iterations,
        sparse.work,
    )


# --- sharing ---------------------------------------------------------------------------------------------------


def test_with_q_changes_q_and_the_bounds_given():
    """Given bounds are replaced, others kept, z° follows, and the first problem is unchanged."""
    p = LCP(A, Q, lower=1.0, upper=3.0)
    assert p.nearest_to_zero.tolist() == [1.0] * 4
    other = p.with_q(-Q, lower=[-2.0, -2.0, 2.0, 0.0])
    assert other.q.tolist() == (-Q).tolist()
    assert other.lower.tolist() == [-2.0, -2.0, 2.0, 0.0]
    assert other.upper.tolist() == [3.0] * 4
    assert other.nearest_to_zero.tolist() == [0.0, 0.0, 2.0, 0.0]
    assert p.with_q(Q, upper=9.0).lower.tolist() == [1.0] * 4
    assert (p.q.tolist(), p.lower.tolist(), p.upper.tolist()) == (Q.tolist(), [1.0] * 4, [3.0] * 4)
    assert_read_only(other.q, other.lower, other.upper, other.nearest_to_zero)


# --- copies and attributes -------------------------------------------------------------------------------------


@refusals(r"""
solve(LCP(np.eye(2), np.ones(2)), np.zeros(2)) → a start is z0=…
solve(BoundedLeastSquares(np.eye(2), np.ones(2)), np.zeros(2)) → a start is z0=…
solve(ConeProblem(np.eye(2), np.ones(2), [('second_order', 2)]), [0.0, 0.0]) → a start is z0=…
""")
def test_a_start_in_the_wrong_place_is_told_what_to_write(call, words):
    """Common mistakes in the first call of every problem class raise errors with the remedy."""
    assert_refused(call, words, {})


@pytest.mark.parametrize("name", ["q", "lower", "upper", "matrix", "n", "other"])
def test_a_problem_is_immutable(name):
    """An attribute cannot be set, before and after a solve, because facts about the problem are cached."""
    problem = LCP([[2.0, 1.0], [1.0, 2.0]], [-5.0, 1.0])
    for one in (problem, problem.with_q([-1.0, -1.0]), copy.copy(problem)):
        solve(one)
        with pytest.raises(AttributeError, match="with_q"):
            setattr(one, name, np.zeros(2))
    assert Certificate.of(problem, solve(problem).z).relative_residual < 1e-12


def test_equal_bounds_of_a_problem_cannot_be_changed():
    """Short equal bounds are shared by problems: nobody can make those of all problems writable."""
    with pytest.raises(ValueError, match="WRITEABLE"):
        LCP([[2.0, 1.0], [1.0, 2.0]], [-5.0, 1.0]).lower.flags.writeable = True


# --- the table of data --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "problem",
    [
        LCP([[2.0]], [1.0]),
        QuadraticProgram([[2.0]], [1.0], [[1.0]], [3.0], [[1.0]], [0.5]),
        BoundedLeastSquares([[1.0]], [1.0], weights=[2.0], ridge=0.5, l1=[0.1]),
        NonlinearProblem(lambda x: x, lower=np.zeros(1)),
    ],
    ids=lambda problem: type(problem).__name__,
)
def test_the_named_data_are_arguments_attributes_and_changes(problem):
    """Each name is an argument of the class and an attribute; with_vectors takes the vectors, the bounds last."""
    arguments = signature(type(problem)).parameters
    names = (*problem.matrix_names, *problem.vector_names)
    assert {*names} - {*arguments} <= ({"q"} if isinstance(problem, NonlinearProblem) else set())
    assert problem.vector_names[-2:] == ("lower", "upper")
    for name in problem.vector_names:
        moved = problem.with_vectors(**{name: getattr(problem, name) + 1.0})
        assert type(moved) is type(problem)
        if name != "q":
            assert getattr(moved, name).tolist() == [getattr(problem, name)[0] + 1.0]
    same = problem.with_vectors(lower=problem.lower)
    assert solve(same).x.tolist() == solve(problem).x.tolist()
