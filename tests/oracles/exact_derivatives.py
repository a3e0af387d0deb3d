"""Derivatives of solutions in rational arithmetic, by the active set; shared by tests and campaigns."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np

from lcp_plugin import LCP

from .exact import FREE, LOWER, UPPER, States, exact_rows, solve_fractions

Vector = list[Fraction]


@dataclass(frozen=True)
class Change:
    """A direction in the data: dM an array, the others vectors, all of doubles."""

    dM: np.ndarray  # noqa: N815 - the argument's name
    dq: np.ndarray
    dlower: np.ndarray
    dupper: np.ndarray

    @classmethod
    def drawn(cls, n: int, rng: np.random.Generator) -> Change:
        """Return one of normal entries; bounds that are equal move together only by chance."""
        return cls(rng.normal(size=(n, n)), *rng.normal(size=(3, n)))

    @property
    def arguments(self) -> dict[str, np.ndarray]:
        """What `jvp` takes."""
        return {"dM": self.dM, "dq": self.dq, "dlower": self.dlower, "dupper": self.dupper}


@dataclass(frozen=True)
class ExactGradient:
    """By q, lower and upper, and by each entry of M, in fractions."""

    q: Vector
    lower: Vector
    upper: Vector
    M: list[Vector]


@dataclass(frozen=True)
class Piece:
    """z as a function of the data where each row keeps its state: at the lower bound, free, at the upper bound."""

    problem: LCP
    states: States

    @cached_property
    def M(self) -> list[Vector]:
        return exact_rows(self.problem.M)

    @cached_property
    def free(self) -> list[int]:
        return [i for i, state in enumerate(self.states) if state == FREE]

    @cached_property
    def z(self) -> Vector | None:
        """The point whose free rows have w = 0; None where they do not determine it."""
        ends = {LOWER: self.problem.lower, UPPER: self.problem.upper}
        q, z = exact(self.problem.q), [Fraction(0)] * self.problem.n
        for i, state in enumerate(self.states):
            if state != FREE:
                z[i] = Fraction(float(ends[state][i]))
        return self._with_free_rows(z, q)

    @cached_property
    def w(self) -> Vector:
        return [a + b for a, b in zip(product(self.M, self.z), exact(self.problem.q), strict=True)]

    @cached_property
    def is_solution(self) -> bool:
        """Whether z solves the problem."""
        return self.z is not None and all(min(distances) >= 0 for distances in self._distances())

    @cached_property
    def is_strict(self) -> bool:
        """Whether z solves the problem and no row is degenerate."""
        return self.is_solution and not self.degenerate

    @cached_property
    def degenerate(self) -> list[int]:
        """The rows of a solution at one of two different bounds with w = 0."""
        lower, upper = self.problem.lower, self.problem.upper
        return [
            i
            for i, (z, w) in enumerate(zip(self.z, self.w, strict=True))
            if w == 0 and lower[i] != upper[i] and z in (lower[i], upper[i])
        ]

    def _distances(self) -> Iterator[tuple[Any, ...]]:
        """What must not be negative, row by row."""
        for i, state in enumerate(self.states):
            if self.problem.lower[i] == self.problem.upper[i]:
                yield (0,)
            elif state == FREE:
                yield self.z[i] - self.problem.lower[i], self.problem.upper[i] - self.z[i]
            else:
                yield (self.w[i] if state == LOWER else -self.w[i],)

    def _with_free_rows(self, d: Vector, h: Sequence[Fraction]) -> Vector | None:
        """Return d with its free entries such that (M d + h)_F = 0."""
        right = [-h[i] - sum(self.M[i][j] * d[j] for j in range(len(d)) if d[j]) for i in self.free]
        inner = solve_fractions([[self.M[i][j] for j in self.free] for i in self.free], right)
        if inner is None:
            return None
        for i, value in zip(self.free, inner, strict=True):
            d[i] = value
        return d

    def held_change(self, change: Change) -> Vector:
        """The change of the bound that holds, 0 on free rows."""
        ends = {LOWER: change.dlower, UPPER: change.dupper}
        return [
            Fraction(0) if state == FREE else Fraction(float(ends[state][i]))
            for i, state in enumerate(self.states)
        ]

    def data_change(self, change: Change) -> Vector:
        """Return dM z + dq."""
        return [
            a + b
            for a, b in zip(product(exact_rows(change.dM), self.z), exact(change.dq), strict=True)
        ]

    def jvp(self, change: Change) -> Vector:
        """Return dz on this piece."""
        return self._with_free_rows(self.held_change(change), self.data_change(change))

    def vjp(self, g: np.ndarray, gw: np.ndarray) -> ExactGradient:
        """Return the gradients of gᵀz + gwᵀw on this piece."""
        n, transposed = len(self.states), [list(column) for column in zip(*self.M, strict=True)]
        total = [a + b for a, b in zip(exact(g), product(transposed, exact(gw)), strict=True)]
        inner = solve_fractions(
            [[transposed[i][j] for j in self.free] for i in self.free],
            [total[i] for i in self.free],
        )
        by_q = exact(gw)
        for i, value in zip(self.free, inner, strict=True):
            by_q[i] -= value
        shift = product(transposed, [a - b for a, b in zip(by_q, exact(gw), strict=True)])
        bounds = [
            [total[i] + shift[i] if self.states[i] == side else Fraction(0) for i in range(n)]
            for side in (LOWER, UPPER)
        ]
        return ExactGradient(by_q, *bounds, [[a * b for b in self.z] for a in by_q])

    def one_sided(self, change: Change) -> Vector | None:
        """Return the one-sided derivative of a solution: that of the neighboring piece the change leads into."""
        d = [
            self._towards(change, choice)
            for choice in itertools.product((False, True), repeat=len(self.degenerate))
        ]
        return next((one for one in d if one is not None), None)

    def _towards(self, change: Change, is_freed: Sequence[bool]) -> Vector | None:
        """Return the derivative of the piece with some degenerate rows freed, where their inequalities allow it."""
        freed = dict(zip(self.degenerate, is_freed, strict=True))
        is_upper = {i: self.z[i] == self.problem.upper[i] for i in freed}
        states = tuple(
            state if i not in freed else FREE if freed[i] else UPPER if is_upper[i] else LOWER
            for i, state in enumerate(self.states)
        )
        piece = Piece(self.problem, states)
        d = piece._with_free_rows(piece.held_change(change), self.data_change(change))
        if d is None:
            return None
        slack = [a + b for a, b in zip(product(self.M, d), self.data_change(change), strict=True)]
        for i, is_free in freed.items():
            sign = -1 if is_upper[i] else 1
            bound = Fraction(float((change.dupper if is_upper[i] else change.dlower)[i]))
            if sign * (d[i] - bound if is_free else slack[i]) < 0:
                return None
        return d


def exact(values: Any) -> Vector:
    """Return doubles as fractions."""
    return [Fraction(value) for value in np.asarray(values, dtype=float).tolist()]


def product(M: Sequence[Sequence[Fraction]], x: Sequence[Fraction]) -> Vector:
    """Return M x."""
    return [sum((a * b for a, b in zip(row, x, strict=True) if a and b), Fraction(0)) for row in M]


def piece_at(problem: LCP, z: Any, free: Any) -> Piece:
    """Return the piece on which these rows are free, the others at the bound nearer to z, fixed ones as w asks for."""
    with np.errstate(invalid="ignore"):
        is_upper = problem.upper - z < z - problem.lower
    states = np.where(free, FREE, np.where(is_upper, UPPER, LOWER))
    piece = Piece(problem, tuple(states.tolist()))
    if piece.z is not None:
        is_negative = np.array([w < 0 for w in piece.w], dtype=bool)
        states = np.where((problem.lower == problem.upper) & is_negative, UPPER, states)
    return Piece(problem, tuple(states.tolist()))


def distance(found: Any, true: Any) -> float:
    """Return ‖found − true‖∞/‖true‖∞, of doubles and fractions; 0 for 0/0."""
    true = np.array(true, dtype=object).ravel()
    found = np.asarray(found, dtype=float).ravel()
    error = max(
        (abs(Fraction(a) - b) for a, b in zip(found.tolist(), true, strict=True)),
        default=Fraction(0),
    )
    size = max((abs(b) for b in true), default=Fraction(0))
    return 0.0 if not error else float(error / size) if size else float("inf")
