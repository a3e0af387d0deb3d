"""Measures a mechanism beside everything on: the same inputs, in one process, in turn."""

from __future__ import annotations

import contextlib
import io
import math
import signal
import time
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields
from itertools import groupby
from typing import Any, NamedTuple

from lcp_plugin import LCPError

from .inputs import FALSE, OPEN, PROVED, SOLVED, Input, inputs, work_of
from .mechanisms import NAMES
from .switching import Patch, forget, replaced

LONGEST = 20  # seconds of one solve
QUICK, TIMES = 0.02, 3  # a solve that takes less is timed again so often
COMPILED = 20.0  # one that takes longer is not timed again; a shorter one may have compiled
LEAST_WORK, SHORTEST = 1e-12, 1e-6


class Ran(NamedTuple):
    """What became of an input."""

    verdict: str
    work: float
    seconds: float
    has_raised: bool = False


@dataclass
class Tally:
    """A mechanism's row of a source of inputs: counts of those that meet it, with everything on and without it.

    Attributes
    ----------
    work, time : float
        Without ÷ with, the geometric mean over those inputs that meet the mechanism.
    left : int
        Inputs for which there was no time.
    """

    mechanism: str
    source: str
    met: int = 0
    left: int = 0
    solved: int = 0
    solved_off: int = 0
    proved: int = 0
    proved_off: int = 0
    false: int = 0
    false_off: int = 0
    raised_off: int = 0
    work: float = 1.0
    time: float = 1.0
    seconds: float = 0.0
    seconds_off: float = 0.0
    _works: list[float] = field(default_factory=list, repr=False)
    _times: list[float] = field(default_factory=list, repr=False)

    def add(self, on: Ran, off: Ran) -> None:
        self.met += 1
        for verdict, name in ((SOLVED, "solved"), (PROVED, "proved"), (FALSE, "false")):
            setattr(self, name, getattr(self, name) + (on.verdict == verdict))
            setattr(self, f"{name}_off", getattr(self, f"{name}_off") + (off.verdict == verdict))
        self.raised_off += off.has_raised
        self.seconds, self.seconds_off = self.seconds + on.seconds, self.seconds_off + off.seconds
        self._times.append(off.seconds / on.seconds)
        if min(on.work, off.work) > LEAST_WORK:
            self._works.append(off.work / on.work)
        self.work, self.time = mean(self._works), mean(self._times)

    @classmethod
    def columns(cls) -> list[str]:
        return [one.name for one in fields(cls) if not one.name.startswith("_")]

    def cells(self) -> list[str]:
        values = [getattr(self, name) for name in self.columns()]
        return [f"{value:.4g}" if isinstance(value, float) else str(value) for value in values]


def mean(ratios: Sequence[float]) -> float:
    """Return the geometric mean, 1 of none."""
    return math.exp(math.fsum(map(math.log, ratios)) / len(ratios)) if ratios else 1.0


def meetings(names: Sequence[str]) -> dict[str, list[list[str]]]:
    """Return the inputs, by source and name, that meet these mechanisms: where the package would do something else."""
    watched = {name: NAMES[name].patches for name in names}
    found: dict[str, list[list[str]]] = {name: [] for name in names}
    signal.signal(signal.SIGALRM, _give_up)
    with replaced([patch for patches in watched.values() for patch in patches], watched=True):
        for one in inputs():
            before = {
                name: sum(patch.times for patch in patches) for name, patches in watched.items()
            }
            forget()
            ran = _run(one)
            _judged(one, *ran)  # some answers are computed when asked for
            if ran[2].has_raised:
                raise AssertionError(f"{one.source}, {one.name}: raises where it is watched")
            for name, patches in watched.items():
                if sum(patch.times for patch in patches) > before[name]:
                    found[name].append([one.source, one.name])
    return found


def measured(name: str, met: Sequence[Sequence[str]], seconds: float) -> Iterator[Tally]:
    """Yield a mechanism's rows, or those of several, "one + other", within about so many seconds of the processor."""
    patches = [patch for part in name.split(" + ") for patch in NAMES[part].patches]
    chosen = {tuple(one) for one in met}
    signal.signal(signal.SIGALRM, _give_up)
    sources, end = {source for source, _ in chosen}, time.process_time() + seconds
    if not chosen:
        yield Tally(name, "all")
    for k, (source, group) in enumerate(groupby(inputs(sources), key=lambda one: one.source)):
        tally, now = Tally(name, source), time.process_time()
        share_ends = now + (end - now) / (len(sources) - k)
        for one in group:
            if (source, one.name) in chosen:
                if tally.met and time.process_time() > share_ends:
                    tally.left += 1
                else:
                    measure(one, patches, tally)
        yield tally


def measure(one: Input, patches: list[Patch], tally: Tally) -> None:
    """Solve an input with everything on and without these, in turn."""
    with replaced([]):
        on = _judged(one, *_run(one))
    with replaced(patches):
        off = _judged(one, *_run(one))
    for _ in range(
        TIMES if max(on.seconds, off.seconds) <= QUICK else max(on.seconds, off.seconds) <= COMPILED
    ):
        with replaced([]):
            on = on._replace(seconds=min(on.seconds, _run(one)[2].seconds))
        with replaced(patches):
            off = off._replace(seconds=min(off.seconds, _run(one)[2].seconds))
    tally.add(on, off)


def _run(one: Input) -> tuple[Any, Any, Ran]:
    """State an input and solve it; return the problem, the result or None, and what that took."""
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        problem, result, has_raised = one.state(), None, False
        signal.alarm(LONGEST)
        begin = time.process_time()
        try:
            result = one.solve(problem)
        except (LCPError, TimeoutError):
            pass
        except Exception:  # whatever is raised without the mechanism counts against leaving it out
            has_raised = True
        finally:
            signal.alarm(0)
        return (
            problem,
            result,
            Ran(OPEN, 0.0, max(time.process_time() - begin, SHORTEST), has_raised),
        )


def _judged(one: Input, problem: Any, result: Any, ran: Ran) -> Ran:
    """Return the same with what a judge says of the result."""
    if result is None:
        return ran
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        return ran._replace(verdict=one.judge(problem, result), work=work_of(result))


def _give_up(*_: Any) -> None:
    raise TimeoutError
