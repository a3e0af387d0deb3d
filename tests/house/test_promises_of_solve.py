"""The guarantees of solve for every problem class: data stay, bits repeat, watching changes nothing, errors arrive."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from kinds_of_problems import SAMPLES, Sample

from lcp_plugin import (
    LCP,
    BoundedLeastSquares,
    ConeProblem,
    FrictionalContact,
    NonlinearProblem,
    QuadraticProgram,
    Status,
    march,
    solve,
    solve_batch,
)

WATCHED = (
    "LCP", "NonlinearProblem", "QuadraticProgram", "ConeProblem", "FrictionalContact", "BoundedLeastSquares",
)  # fmt: skip


def solved(sample: Sample, **options: Any) -> Any:
    return solve(sample.problem, **sample.start, **options)


def outcome(answer: Any) -> tuple[Any, ...]:
    """Return the status and the bits of x."""
    return answer.status, None if answer.x is None else np.asarray(answer.x).tobytes()


def arrays_of(value: Any, seen: set[int] | None = None) -> Iterator[np.ndarray]:
    """Yield the arrays that an object holds, at any depth."""
    seen = set() if seen is None else seen
    if id(value) in seen:
        return
    seen.add(id(value))
    if isinstance(value, np.ndarray):
        yield value
    elif isinstance(value, (tuple, list)):
        for part in value:
            yield from arrays_of(part, seen)
    elif hasattr(value, "__dict__") and not callable(value):
        yield from arrays_of(list(vars(value).values()), seen)


def keeps_its_data(sample: Sample) -> None:
    start = {name: np.array(value) for name, value in sample.start.items()}
    arrays = [*arrays_of(sample.problem), *start.values()]
    before = [array.tobytes() for array in arrays]
    solve(sample.problem, **start)
    assert [array.tobytes() for array in arrays] == before
    assert all(array.flags.writeable for array in start.values())


def repeats_its_bits(sample: Sample) -> None:
    """“Problems are thread-safe”: eight concurrent solves of one problem have the bits of one."""
    first = outcome(solved(sample))
    assert outcome(solved(sample)) == first
    with ThreadPoolExecutor(4) as pool:
        assert all(one == first for one in pool.map(lambda _: outcome(solved(sample)), range(8)))


def is_not_changed_by_watching(sample: Sample) -> None:
    first = outcome(solved(sample))
    options: list[dict[str, Any]] = [{"max_seconds": 60.0}]
    if sample.kind in WATCHED:
        options += [{"verbose": True}, {"record": True}, {"callback": lambda sample, x: None}]
    if sample.kind == "QuadraticProgram":
        options.append({"z0": np.ones(sample.problem.n)})
    for option in options:
        assert outcome(solved(sample, **option)) == first, option


def passes_errors_on(sample: Sample) -> None:
    mine = ZeroDivisionError("mine")

    def raises(*_: Any) -> None:
        raise mine

    with pytest.raises(ZeroDivisionError) as caught:
        solved(sample, callback=raises)
    assert caught.value is mine


PROMISES: dict[str, Callable[[Sample], None]] = {
    "data stay": keeps_its_data,
    "the same bits": repeats_its_bits,
    "watching changes nothing": is_not_changed_by_watching,
    "errors of a callback arrive": passes_errors_on,
}
CASES = [
    (sample, promise)
    for sample in SAMPLES
    for promise in PROMISES
    if Status.SOLVED in sample.ends
    and (promise != "errors of a callback arrive" or sample.kind in WATCHED)
]


@pytest.mark.quick(1)
@pytest.mark.parametrize(("sample", "promise"), CASES, ids=str)
def test_solve_keeps_the_promise(sample, promise):
    """Each promise of solve holds for each problem class."""
    PROMISES[promise](sample)


EMPTY: dict[str, Callable[[], Any]] = {
    "LCP": lambda: solve(LCP(np.zeros((0, 0)), [])),
    "sparse LCP": lambda: solve(LCP(sp.csr_array((0, 0)), [])),
    "program": lambda: solve(QuadraticProgram(np.zeros((0, 0)), [])),
    "least squares": lambda: solve(BoundedLeastSquares(np.zeros((2, 0)), np.ones(2))),
    "nonlinear": lambda: solve(NonlinearProblem(lambda x: x), x0=[]),
    "cones": lambda: solve(ConeProblem(np.zeros((0, 0)), [], [])),
    "contacts": lambda: solve(FrictionalContact(np.zeros((0, 0)), np.zeros((0, 3)), 0.5)),
    "batch": lambda: solve_batch(LCP(np.zeros((0, 0)), []), np.zeros((3, 0)))[2],
    "march": lambda: march(LCP(np.zeros((0, 0)), []), np.zeros((3, 0)))[2],
}


@pytest.mark.parametrize("name", EMPTY)
def test_an_empty_problem_is_solved(name):
    """A problem without unknowns is SOLVED by an empty x."""
    answer = EMPTY[name]()
    assert answer.status is Status.SOLVED
    assert answer.x.shape == (0,)
