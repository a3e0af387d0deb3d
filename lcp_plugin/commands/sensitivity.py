"""What `lcp-plugin solve --sensitivity` asks: how z moves with q, or how a number made of z changes with the data."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ..checks import FloatVector
from ..errors import InvalidOption, UnsuitableProblem, did_you_mean
from ..solving.derivative import Derivative, derivative
from ..solving.result import Result

WORDS = ("q", "sum", "mean", "max", "min")


class Found(NamedTuple):
    """What is saved, by name; what --json prints; and the line that a person reads."""

    arrays: dict[str, FloatVector]
    content: dict[str, Any]
    line: str


@dataclass(frozen=True)
class Sensitivity:
    """What was asked for, read from the command line.

    Parameters
    ----------
    word : {"q", "sum", "mean", "max", "min", "z"}
    index : int
        Of the entry, where the word is z.
    """

    word: str
    index: int = 0

    @classmethod
    def read(cls, text: str) -> Sensitivity:
        """Return what a text asks for, or say what could be asked for."""
        entry = re.fullmatch(r"z\[\s*(\d+)\s*\]", text.strip())
        if entry:
            return cls("z", int(entry[1]))
        word = text.strip().lower()
        if word not in WORDS:
            raise InvalidOption(f"--sensitivity {text!r} is not offered{did_you_mean(word, (*WORDS, 'z[0]'))}")
        return cls(word)

    def check(self, n: int) -> None:
        """Refuse an entry that z does not have, and any where z has none."""
        if n == 0:
            raise InvalidOption("--sensitivity needs a problem with unknowns, and this one has none; leave it out")
        if self.index >= n:
            raise InvalidOption(f"--sensitivity z[{self.index}]: z has {n} entries, z[0] to z[{n - 1}]")

    def of(self, result: Result) -> Found:
        """Return what was asked for; where there is no derivative, only the reason."""
        if not result.is_solved:
            return _nothing("only a solution has a derivative")
        try:
            at = derivative(result)
            return self._moved(at) if self.word == "q" else self._gradient(at)
        except UnsuitableProblem as reason:
            return _nothing(str(reason))

    def _moved(self, at: Derivative) -> Found:
        dz = at.jvp(dq=np.ones(at.z.size))
        line = f"dz for dq = 1 lies between {dz.min():.3e} and {dz.max():.3e}; {_claim(at, 'on one side')}"
        content = {"is_unique": at.is_unique, "least": float(dz.min()), "largest": float(dz.max())}
        return Found({"dz": dz}, content, line)

    def _gradient(self, at: Derivative) -> Found:
        name, weights = self._functional(at.z)
        ties = int(np.count_nonzero(at.z == at.z[weights.argmax()])) if self.word in ("max", "min") else 1
        gradient = at.vjp(weights)
        arrays = {"by_q": gradient.q, "by_lower": gradient.lower, "by_upper": gradient.upper}
        value, largest = float(weights @ at.z), int(np.abs(gradient.q).argmax())
        slope = float(gradient.q[largest])
        change = f"changes most with q[{largest}], by {slope:.3e} a unit" if slope else "does not change with q"
        claim = f"that of one of {ties} entries that are equal" if ties > 1 else _claim(at, "on one of the pieces")
        line = f"{name} = {value:.6g} {change}; {claim}"
        is_unique = at.is_unique if ties == 1 else False
        content = {"is_unique": is_unique, "functional": name, "value": value, "entry": largest, "by_q": slope}
        return Found(arrays, content, line)

    def _functional(self, z: FloatVector) -> tuple[str, FloatVector]:
        """Return what is differentiated in words, and its gradient by z."""
        weights = np.zeros(z.size)
        if self.word in ("sum", "mean"):
            weights[:] = 1.0 if self.word == "sum" else 1.0 / z.size
            return f"the {self.word} of z", weights
        places = {"max": int(z.argmax()), "min": int(z.argmin()), "z": self.index}
        entry = places[self.word]
        weights[entry] = 1.0
        return f"z[{entry}]" if self.word == "z" else f"the {self.word} of z = z[{entry}]", weights


def _nothing(reason: str) -> Found:
    return Found({}, {"reason": reason}, f"none: {reason}")


def _claim(at: Derivative, otherwise: str) -> str:
    """Return what is known of the derivative."""
    count = at.degenerate.size
    if count:
        return f"{otherwise}, as {count} {'row is' if count == 1 else 'rows are'} degenerate"
    return "proved to exist" if at.is_unique else "not proved to exist"
