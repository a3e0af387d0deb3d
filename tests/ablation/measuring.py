"""Measure a mechanism: the same inputs with everything on and without it, in one process, in turn."""

from __future__ import annotations

import contextlib
import io
import math
import signal
import time
import warnings
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from lcp_plugin import LCPError

from .inputs import FALSE, OPEN, RIGHT, Input, inputs
from .mechanisms import NAMES
from .switching import Patch, forget, replaced

PAGE = Path(__file__).with_name("ablation.md")
SLOWER = 1.5  # times as long in the mean of a source of inputs: a loss
LONGEST = 20  # seconds of one solve
QUICK, TIMES = 0.02, 3  # a solve that takes less is timed again so often
SHORTEST = 1e-6


class Ran(NamedTuple):
    """The verdict and seconds of an input."""

    verdict: str
    seconds: float
    has_raised: bool = False


@dataclass
class Tally:
    """Inputs of a source that meet a mechanism: pairs of runs, everything on and without it."""

    source: str
    runs: list[tuple[Ran, Ran]] = field(default_factory=list)
    left: int = 0  # inputs for which there was no time

    def counts(self, verdict: str) -> tuple[int, int]:
        """Return how many runs end so, on and off."""
        on, off = (sum(pair[k].verdict == verdict for pair in self.runs) for k in (0, 1))
        return on, off

    def ratio(self) -> float:
        """Return the geometric mean of the seconds, off ÷ on."""
        return mean([off.seconds / on.seconds for on, off in self.runs])

    def losses(self) -> list[str]:
        """Return the losses without the mechanism, in words."""
        found = []
        for verdict, sign in ((RIGHT, 1), (FALSE, -1)):
            on, off = self.counts(verdict)
            if sign * (on - off) > 0:
                found.append(f"{abs(on - off)} {verdict}")
        if raised := sum(off.has_raised for _, off in self.runs):
            found.append(f"{raised} raised")
        return found + [f"time: {self.source}"] * (self.ratio() >= SLOWER)


def mean(ratios: Sequence[float]) -> float:
    """Return the geometric mean, 1 of none."""
    return math.exp(math.fsum(map(math.log, ratios)) / len(ratios)) if ratios else 1.0


def meetings(names: Sequence[str]) -> dict[str, list[Input]]:
    """Return the inputs that meet these mechanisms: those for which the package would do something else."""
    watched = {name: NAMES[name].patches for name in names}
    found: dict[str, list[Input]] = {name: [] for name in names}
    signal.signal(signal.SIGALRM, _give_up)
    with replaced([patch for patches in watched.values() for patch in patches], watched=True):
        for one in inputs():
            before = {name: sum(p.times for p in patches) for name, patches in watched.items()}
            forget()
            if run(one).has_raised:
                raise AssertionError(f"{one.source}, {one.name}: raises while it is watched")
            for name, patches in watched.items():
                if sum(p.times for p in patches) > before[name]:
                    found[name].append(one)
    return found


def measured(name: str, met: Sequence[Input], seconds: float) -> list[Tally]:
    """Return a tally per source, within about so many seconds of the processor."""
    tallies: dict[str, Tally] = {}
    groups: dict[str, list[Input]] = defaultdict(list)
    for one in met:
        groups[one.source].append(one)
    end = time.process_time() + seconds
    for k, (source, group) in enumerate(groups.items()):
        tally, now = Tally(source), time.process_time()
        share_ends = now + (end - now) / (len(groups) - k)
        for one in group:
            if tally.runs and time.process_time() > share_ends:
                tally.left += 1
            else:
                tally.runs.append(measure(one, NAMES[name].patches))
        tallies[source] = tally
    return [*tallies.values()]


def measure(one: Input, patches: list[Patch]) -> tuple[Ran, Ran]:
    """Solve an input with everything on and without these, in turn."""
    runs = []
    for chosen in ([], patches):
        with replaced(chosen):
            runs.append(run(one))
    for _ in range(TIMES if max(ran.seconds for ran in runs) <= QUICK else 1):
        for k, chosen in enumerate(([], patches)):
            with replaced(chosen):
                seconds = min(runs[k].seconds, run(one).seconds)
                runs[k] = runs[k]._replace(seconds=seconds)
    return runs[0], runs[1]


def row_of(name: str, tallies: Sequence[Tally]) -> str:
    """Return a mechanism's line of the page."""
    mechanism, whole = NAMES[name], Tally("all")
    for tally in tallies:
        whole.runs += tally.runs
        whole.left += tally.left
    met = len(whole.runs)
    losses = [loss for tally in tallies for loss in tally.losses()]
    claim = [f"`{mechanism.claim.partition('::')[2]}`"] if mechanism.claim else []
    worst = max(tallies, key=Tally.ratio, default=whole)
    counts = [f"{on} → {off}" for on, off in map(whole.counts, (RIGHT, FALSE))]
    cells = [
        name,
        mechanism.purpose,
        f"{met} of {met + whole.left}" if whole.left else str(met),
        *counts,
        f"{whole.ratio():.2f}",
        f"{worst.ratio():.2f} {worst.source}",
        "; ".join(losses or claim) or ("nothing" if met else "never met"),
    ]
    return f"| {' | '.join(cells)} |"


def rows_of_page() -> dict[str, str]:
    """Return the lines of the page by the names of their mechanisms."""
    lines = PAGE.read_text(encoding="utf-8").splitlines()
    return {line.split(" | ")[0].removeprefix("| "): line for line in lines if line[:2] == "| "}


def write(new: dict[str, str]) -> None:
    """Put lines into the page, in the order of the list."""
    head = PAGE.read_text(encoding="utf-8").partition("| banded")[0]
    rows = rows_of_page() | new
    lines = [rows[name] for name in NAMES if name in rows]
    PAGE.write_text(head + "\n".join(lines) + "\n", encoding="utf-8")


def run(one: Input) -> Ran:
    """Solve an input and judge the result."""
    with _quiet():
        result, verdict, has_raised = None, OPEN, False
        signal.alarm(LONGEST)
        begin = time.process_time()
        try:
            result = one.solve()
        except (LCPError, TimeoutError):
            pass
        except Exception:  # an exception without the mechanism counts against leaving it out
            has_raised = True
        finally:
            signal.alarm(0)
        seconds = max(time.process_time() - begin, SHORTEST)
        if result is not None:
            verdict = one.judge(result)
        return Ran(verdict, seconds, has_raised)


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    with warnings.catch_warnings(action="ignore"), contextlib.redirect_stdout(io.StringIO()):
        yield


def _give_up(*_: Any) -> None:
    raise TimeoutError
