"""Checks that test_problem.py runs under MPI."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp
from checks import check, run_checks
from petsc4py import PETSc

from lcp_plugin import LCP, solve
from lcp_plugin.core.errors import InvalidOption, InvalidProblem, UnreadableFile
from lcp_plugin.ranks.petsc.collective import Ranks
from lcp_plugin.ranks.petsc.halo import numbered_over_all

N = 7


def problem(n: int = N, seed: int = 0) -> LCP:
    """A problem with coupling over all rows, boxes, free rows and one-sided ones."""
    rng = np.random.default_rng(seed)
    M = sp.random_array((n, n), density=0.4, rng=rng, format="csr") + 5.0 * sp.eye_array(
        n, format="csr"
    )
    lower = np.where(rng.random(n) < 0.3, -np.inf, rng.normal(size=n) - 1.0)
    upper = np.where(rng.random(n) < 0.4, np.inf, np.where(np.isfinite(lower), lower + 1.5, 1.0))
    return LCP(sp.csr_array(M), rng.normal(size=n), lower=lower, upper=upper)


def raised_by(attempt: Callable[[], object]) -> BaseException:
    """What the attempt raises."""
    try:
        attempt()
    except Exception as error:
        return error
    raise AssertionError("nothing was raised")


def require_refused(
    comm: Any, attempt: Callable[[], object], kind: type[Exception], *words: str
) -> None:
    """Every rank raises that kind of error, with one message that has the words."""
    error = raised_by(attempt)
    assert type(error) is kind, repr(error)
    assert all(word in str(error) for word in words), str(error)
    assert len(set(comm.allgather(str(error)))) == 1, str(error)


def part(comm: Any, whole: LCP, **changes: Any) -> dict[str, Any]:
    """The arguments of from_rows for an equal share, some of them changed."""
    first, last = whole.n * comm.rank // comm.size, whole.n * (comm.rank + 1) // comm.size
    own = slice(first, last)
    given = {
        "rows": whole.csr[first:last],
        "q": whole.q[own],
        "lower": whole.lower[own],
        "upper": whole.upper[own],
    }
    return given | {"first_row": first} | changes


def require_equal(parts: LCP, whole: LCP) -> None:
    """The parts are the rows of the whole, bit for bit."""
    own = slice(parts.first, parts.last)
    assert (parts.n, parts.nonzeros) == (whole.n, whole.nonzeros)
    for name in ("q", "lower", "upper", "diagonal", "residual_scale", "nearest_to_zero"):
        assert np.array_equal(getattr(parts, name), getattr(whole, name)[own]), name
    z = np.random.default_rng(1).normal(size=whole.n)
    assert np.allclose(parts.slack(z[own]), whole.slack(z)[own], rtol=1e-14, atol=1e-14)
    global_rows = numbered_over_all(parts.matrix.csr_rows, parts.matrix.communicator)
    assert np.array_equal(global_rows.toarray(), whole.csr[own].toarray())


@check(1, 2, 3, 4)
def equal_shares_and_any_other_shares_hold_the_problem(comm: Any) -> None:
    """from_problem and from_rows keep every row, scale and bound; shares may have any length."""
    whole = problem()
    require_equal(LCP.from_problem(whole, comm), whole)
    cuts = sorted(
        [0, *([3] * (comm.size - 1)), N]
    )  # ranks between the first and the last have no row
    own = slice(cuts[comm.rank], cuts[comm.rank + 1])
    parts = LCP.from_rows(
        comm,
        whole.csr[own].tocoo(),
        whole.q[own],
        whole.lower[own],
        whole.upper[own],
        first_row=own.start,
    )
    require_equal(parts, whole)
    z = parts.gathered(whole.q[own])
    assert (z is None) == (comm.rank > 0)
    assert z is None or np.array_equal(z, whole.q)
    petsc = PETSc.Comm(comm)
    require_equal(LCP.from_problem(whole, petsc), whole)


@check(2, 3)
def what_is_given_is_only_read(comm: Any) -> None:
    """The caller's rows, canonical as they are, keep their order and values."""
    given = part(comm, problem())
    before = [
        array.copy() for array in (given["rows"].indptr, given["rows"].indices, given["rows"].data)
    ]
    require_equal(LCP.from_rows(comm, **given), problem())
    for array, old in zip(
        (given["rows"].indptr, given["rows"].indices, given["rows"].data), before, strict=True
    ):
        assert np.array_equal(array, old)


@check(1, 2, 3, 4)
def fewer_rows_than_ranks_and_no_row_at_all_work(comm: Any) -> None:
    """Any number of ranks takes n = 0, 1 and 2."""
    for n in range(3):
        whole = LCP(sp.diags_array(np.full(n, 2.0), format="csr"), -np.arange(1.0, n + 1.0))
        parts = LCP.from_problem(whole, comm)
        require_equal(parts, whole)
        result = solve(parts)
        assert result.is_solved
        assert np.allclose(result.z, 0.5 * np.arange(1.0, n + 1.0)[parts.first : parts.last])


@check(2, 3)
def missing_and_doubled_rows_are_refused(comm: Any) -> None:
    """The sum of the parts must have as many rows as M has columns, and each rank those it says."""
    whole = problem()
    last = comm.rank == comm.size - 1
    given = part(comm, whole)
    for own, word in (
        (slice(None, -1), "1 are missing"),
        ([0, *range(given["q"].size)], "1 are too many"),
    ):
        changed = (
            {name: given[name][own] for name in ("rows", "q", "lower", "upper")} if last else given
        )
        require_refused(
            comm, lambda changed=changed: LCP.from_rows(comm, **changed), InvalidProblem, word
        )
    for shift in (1, -1):
        off = given | {"first_row": given["first_row"] + shift * last}
        require_refused(
            comm, lambda off=off: LCP.from_rows(comm, **off), InvalidProblem, "first_row is"
        )


def damaged(rows: Any, kind: str) -> Any:
    """The rows with one damage."""
    rows = rows.copy()
    n = rows.shape[1]
    if kind == "out of range":
        rows.indices[-1] = n
    elif kind == "negative":
        rows.indices[0] = -1
    elif kind == "NaN":
        rows.data[0] = np.nan
    elif kind == "descending":
        rows.indptr[1] = rows.indptr[-1] + 1
    elif kind == "complex":
        return rows.astype(complex)
    elif kind == "width":
        return sp.csr_array((rows.data, rows.indices, rows.indptr), shape=(rows.shape[0], n + 1))
    return rows.toarray() if kind == "dense" else rows


@check(2, 3)
def damage_on_one_rank_is_refused_on_all(comm: Any) -> None:
    """Wrong indices, lengths, kinds, NaN and bounds on one rank raise one message on every rank."""
    whole, worst = problem(), comm.size - 1
    is_here = comm.rank == worst
    given = part(comm, whole)
    name = f"rank {worst}"
    for kind, words in (
        ("out of range", (name, "damaged")),
        ("negative", (name, "damaged")),
        ("descending", (name, "damaged")),
        ("NaN", (name, "nan")),
        ("complex", (name, "complex")),
        ("dense", (name, "ndarray")),
        ("width", ("columns differs", str(N + 1))),
    ):
        changed = given | ({"rows": damaged(given["rows"], kind)} if is_here else {})
        require_refused(
            comm, lambda changed=changed: LCP.from_rows(comm, **changed), InvalidProblem, *words
        )
    q = given["q"]
    for changes, words in (
        ({"q": q[:-1]}, (name, "q must be")),
        ({"q": np.full(q.size, np.inf)}, (name, "inf")),
        ({"q": "7"}, (name,)),
        ({"q": None}, (name, "None")),
        ({"lower": np.full(q.size, np.nan)}, (name, "NaN")),
        ({"upper": np.full(q.size, -9.0), "lower": np.full(q.size, -8.0)}, (name, "lower ≤ upper")),
        ({"lower": [[1.0], [2.0, 3.0]]}, (name,)),
        ({"lower": -10.0}, ("lower differs", "an array")),
    ):
        changed = given | (changes if is_here else {})
        require_refused(
            comm, lambda changed=changed: LCP.from_rows(comm, **changed), InvalidProblem, *words
        )


@check(2, 3)
def numbers_for_all_rows_must_agree(comm: Any) -> None:
    """A bound that is a number must be the same on every rank, whatever its type."""
    whole = problem()
    given = part(comm, whole)
    given |= {"lower": [0, 0.0, np.array(0)][comm.rank % 3], "upper": np.inf}
    assert not LCP.from_rows(comm, **given).lower.any()
    given["upper"] = 1.0 + (comm.rank == 1)
    require_refused(
        comm, lambda: LCP.from_rows(comm, **given), InvalidProblem, "upper differs", "rank 1"
    )


@check(2, 3)
def different_whole_problems_are_refused(comm: Any) -> None:
    """from_problem wants the same problem on every rank, to the last bit."""
    whole = problem()
    q = whole.q.copy()
    q[0] = np.nextafter(q[0], 9.0) if comm.rank == 1 else q[0]
    other = whole.with_q(q)
    require_refused(
        comm, lambda: LCP.from_problem(other, comm), InvalidProblem, "the problem", "rank 1"
    )
    given = whole if comm.rank else "M"
    require_refused(comm, lambda: LCP.from_problem(given, comm), InvalidProblem, "rank 0", "str")


@check(1, 2, 3)
def a_failure_on_one_rank_is_known_on_all(comm: Any) -> None:
    """`together` raises our errors everywhere and passes on what is not ours, which the other ranks name."""

    def fail(error: Exception) -> None:
        if comm.rank == comm.size - 1:
            raise error

    require_refused(
        comm, lambda: Ranks(comm).together(lambda: fail(InvalidOption("no"))), InvalidOption, "no"
    )
    require_refused(
        comm, lambda: Ranks(comm).together(lambda: fail(OSError("disk"))), UnreadableFile, "disk"
    )
    error = raised_by(lambda: Ranks(comm).together(lambda: fail(ZeroDivisionError("own"))))
    if comm.rank == comm.size - 1:
        assert repr(error) == "ZeroDivisionError('own')"
    else:
        assert repr(error) == f"LCPError('rank {comm.size - 1}: ZeroDivisionError: own')"
    assert Ranks(comm).from_first(lambda: comm.rank) == 0
    assert (
        Ranks(comm).all_largest(1.0 * comm.rank, np.nan if comm.rank == 0 else 0.0)[0]
        == comm.size - 1
    )
    assert np.isnan(Ranks(comm).all_largest(np.nan if comm.rank == 0 else 0.0)[0])
    assert Ranks(comm).total(0.1) == sum([0.1] * comm.size)
    assert Ranks(comm).table(comm.rank, 1.0).tolist() == [[rank, 1.0] for rank in range(comm.size)]


# --- files ----------------------------------------------------------------------------------------------


def shared_folder(comm: Any) -> Path:
    """A new folder that all ranks know."""
    return Path(comm.bcast(tempfile.mkdtemp() if comm.rank == 0 else None, root=0))


def removed(comm: Any, folder: Path) -> None:
    """Remove it when all ranks are done."""
    comm.Barrier()
    if comm.rank == 0:
        shutil.rmtree(folder)


@check(4)
def chunks_written_on_any_number_of_ranks_are_read_on_any(comm: Any) -> None:
    """Saving on 1–4 ranks and loading on 1–4 ranks give the problem bit for bit; a new save replaces the old one."""
    folder = shared_folder(comm)
    parts = {size: comm.Split(int(comm.rank >= size)) for size in range(1, 5)}
    for writers, writing in parts.items():
        whole = problem(seed=writers)
        if comm.rank < writers:
            LCP.from_problem(whole, writing).save(folder / "problem")
        comm.Barrier()
        assert sorted(one.name for one in folder.iterdir()) == ["problem"]
        names = sorted(one.name for one in (folder / "problem").iterdir())
        assert names == [f"rows-{k:05d}-of-{writers:05d}.npz" for k in range(writers)]
        for readers, reading in parts.items():
            if comm.rank < readers:
                require_equal(LCP.load(str(folder / "problem"), reading), whole)
        comm.Barrier()
    removed(comm, folder)


@check(2)
def a_folder_with_something_else_is_left_alone(comm: Any) -> None:
    """Saving refuses to replace what is no save, and leaves nothing behind where one rank cannot write."""
    folder, parts = shared_folder(comm), LCP.from_problem(problem(), comm)
    if comm.rank == 0:
        (folder / "notes.txt").write_text("keep")
        (folder / "file").write_text("keep")
    comm.Barrier()
    for place in (folder, folder / "file", folder / "file" / "below"):
        require_refused(comm, lambda place=place: parts.save(place), UnreadableFile)
    require_refused(comm, lambda: parts.save(7), InvalidOption, "path must be")
    comm.Barrier()
    assert sorted(one.name for one in folder.iterdir()) == ["file", "notes.txt"]
    removed(comm, folder)


def rewritten(path: Path, **changes: Any) -> None:
    """Write a chunk again with some arrays changed; None leaves one out."""
    with np.load(path) as archive:
        content = {**archive, **changes}
    np.savez(path, **{name: array for name, array in content.items() if array is not None})


def damages(chunk: Path, other: Path) -> dict[str, Callable[[], object]]:
    """What may happen to a folder of three chunks; each with what it does."""
    with np.load(chunk) as archive:
        content = {**archive}
    return {
        "lacks 1 of 3": chunk.unlink,
        "several saves": lambda: chunk.rename(chunk.with_name("rows-00001-of-00004.npz")),
        "not of one save": lambda: shutil.copy(other, chunk),
        "damaged": lambda: chunk.write_bytes(chunk.read_bytes()[:-200]),
        "cannot read": lambda: chunk.write_bytes(b"no archive"),
        "lacks the keys ['shape']": lambda: rewritten(chunk, shape=None),
        "lacks the keys ['q']": lambda: rewritten(chunk, q=None),
        "q has shape": lambda: rewritten(chunk, q=content["q"][1:]),
        "no valid CSR matrix": lambda: rewritten(chunk, indices=content["indices"] + N),
        "whole numbers": lambda: rewritten(chunk, indptr=content["indptr"] + 0.5),
        "begins with row": lambda: rewritten(chunk, first_row=content["first_row"] + 1),
        "nan": lambda: rewritten(chunk, q=content["q"] * np.nan),
        "holds 7 rows": lambda: [
            rewritten(one, shape=np.array([len(np.load(one)["q"]), N + 1]))
            for one in chunk.parent.iterdir()
        ],
        "holds no chunk": lambda: [one.unlink() for one in chunk.parent.iterdir()],
        "no such file": lambda: shutil.rmtree(chunk.parent),
    }


@check(3)
def damaged_folders_are_refused_on_all_ranks(comm: Any) -> None:
    """Missing, mixed, cut, misstated chunks: one message on every rank, which names the place."""
    folder = shared_folder(comm)
    parts = LCP.from_problem(problem(), comm)
    parts.save(folder / "other")
    names = comm.bcast(
        list(damages(*[folder / "other" / "rows-00001-of-00003.npz"] * 2))
        if comm.rank == 0
        else None
    )
    for name in names:
        parts.save(folder / "problem")
        if comm.rank == 0:
            chunks = [folder / one / "rows-00001-of-00003.npz" for one in ("problem", "other")]
            damages(*chunks)[name]()
        comm.Barrier()
        kind = InvalidProblem if name == "nan" else UnreadableFile
        require_refused(comm, lambda: LCP.load(folder / "problem", comm), kind, name)
        comm.Barrier()
        if comm.rank == 0:
            shutil.rmtree(folder / "problem", ignore_errors=True)
        comm.Barrier()
    removed(comm, folder)


if __name__ == "__main__":
    run_checks()
