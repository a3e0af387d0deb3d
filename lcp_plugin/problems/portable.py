"""Proofs and exact solutions as files, which a program of 80 lines checks without this package.

``proof.save("p.json")`` writes the proof of a linear complementarity problem or of a program, `exact` computes a
solution in fractions, and `check_proof` checks such a file by :mod:`lcp_plugin.proofs.checker`.

>>> from lcp_plugin import LCP, exact, solve
>>> solution = exact(solve(LCP([[3, 1], [1, 3]], [-1, 5])))
>>> print(*solution.z, solution.verify())
1/3 0 True
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from fractions import Fraction
from os import PathLike
from typing import Any

import numpy as np
import scipy.sparse as sp

from ..core.errors import InvalidOption, UnsuitableProblem
from ..core.files import checked_path, opened, write_whole
from ..core.lcp import LCP
from ..core.problem_classes import Door
from ..judges.lcp import RowData
from ..proofs import exact as arithmetic
from ..proofs.checker import checksum, is_proved
from ..proofs.farkas import FarkasCertificate
from ..proofs.no_solution import FIXED, LOWER, UPPER, Case, NoSolution, certificate_of
from .programs.conversion import conditions
from .programs.no_minimum import QPUnboundedness, stationarity
from .programs.program import QuadraticProgram

PARTS_OF_PROOFS = {"y", "radius", "tree", "z", "point", "direction", "checksum"}
RELATIONS = {(True, False): ">=", (True, True): "=", (False, True): "<=", (False, False): ""}


@dataclass(frozen=True)
class ExactSolution:
    """Exact solution of a linear complementarity problem or of a program.

    Attributes
    ----------
    z : tuple of Fraction, or None
        The solution for the stored double-precision data; of a program x, then the multipliers of G and of A.
    reason : str
        Why z is None; otherwise empty.
    """

    problem: LCP = field(repr=False)
    z: tuple[Fraction, ...] | None
    reason: str = ""
    save = Door()

    def verify(self) -> bool:
        """Return whether z solves the problem, in exact arithmetic."""
        return self.z is not None and arithmetic.is_exact_solution(self.problem, self.z)


def exact(result: Any) -> ExactSolution:
    """Return the solution of a result in fractions, if the linear system of its active set is regular and small.

    Parameters
    ----------
    result : Result of an LCP, or QuadraticProgramResult

    Returns
    -------
    ExactSolution
        ``z``, exact for the stored double-precision data; None with a ``reason`` if the result is not SOLVED, if the
        system is singular (at least modulo a prime), has long numbers or more than 60 unknowns, or if no active set
        near the result has all signs exactly.

    Raises
    ------
    UnsuitableProblem
        If the argument is another object.
    """
    program = getattr(result, "program", None)
    certificate: Any = getattr(result, "certificate", None)
    if isinstance(program, QuadraticProgram) and hasattr(result, "solution"):
        problem, y = conditions(program), result.solution
        start = np.concatenate([result.x, y.inequality, y.equality])
    elif type(getattr(certificate, "criterion", None)) is RowData:
        problem, start = certificate.problem, result.z
    else:
        raise UnsuitableProblem(
            f"exact needs the result of an LCP or of a QuadraticProgram, got {type(result).__name__}; "
            "write exact(solve(problem))"
        )
    if not result.is_solved:
        return ExactSolution(problem, None, f"the status is {result.status.name}")
    x, step = arithmetic.rational(start), problem.slack(start) / problem.residual_scale
    for _ in range(20):  # active sets, until the signs are right
        moved = np.array(x, dtype=object) - step
        low, high = moved <= problem.lower, moved >= problem.upper
        free = ~(low | high)
        if np.count_nonzero(free) > 60:  # the digits of a solution grow with its size
            return ExactSolution(problem, None, "more than 60 unknowns are free")
        ends = np.where(low, problem.lower, problem.upper).tolist()
        x = [v if f else Fraction(end) for v, f, end in zip(x, free, ends, strict=True)]
        rows, right = problem.csr[free], arithmetic.rational(-problem.q[free])
        found = arithmetic.solved_nearby(arithmetic.rational_rows(rows), right, x, free.tolist())
        if found is None:
            because = (
                f"singular (perhaps only modulo {arithmetic.PRIME}), or its numbers are too long"
            )
            return ExactSolution(problem, None, f"the linear system of the active set is {because}")
        x = found
        if arithmetic.is_exact_solution(problem, x):
            return ExactSolution(problem, tuple(x))
        step = np.array(arithmetic.exact_slack(problem, x), dtype=object)
    return ExactSolution(problem, None, "no active set near the result has all signs exactly")


def check_proof(path: str | PathLike[str], problem: LCP | QuadraticProgram | None = None) -> bool:
    """Return whether a file by ``proof.save`` proves its statement, in exact arithmetic.

    ``python examples/check_proof.py < p.json`` prints the same without this package. If the file has a radius, the
    statement is limited to |x_j| ≤ radius for the x_j without bounds.

    Parameters
    ----------
    path : str or PathLike
    problem : LCP or QuadraticProgram, optional
        The problem that the statement should be about: False if the data in the file are others.

    Raises
    ------
    UnreadableFile
        If the file does not exist, or does not have the format of a proof.
    InvalidOption
        If the problem is of another class.
    """
    if not isinstance(problem, LCP | QuadraticProgram | None):
        raise InvalidOption(
            f"problem must be an LCP or a QuadraticProgram, got {type(problem).__name__}"
        )
    with (
        opened(checked_path(path), "proof file of lcp_plugin") as file,
        suppress(TypeError, AttributeError),
    ):
        text = file.read().decode()
        if is_proved(text):
            content = json.loads(text)
            if problem is None:
                return True
            if "M" in content and isinstance(problem, QuadraticProgram):  # of an exact solution
                problem = conditions(problem)
            ours = _data_of(problem, content.get("kind", ""))
            # other data next to ours could be the data of the proof
            return {key: content[key] for key in content.keys() - PARTS_OF_PROOFS} == ours
    return False


def save_proof(proof: Any, path: str | PathLike[str]) -> None:
    """Write the proof and the data of its problem as a file for `check_proof` and ``examples/check_proof.py``.

    Parameters
    ----------
    proof : ``result.proof`` of an LCP or a QuadraticProgram, or an exact solution
    path : str or PathLike
        Replaced if it exists.

    Raises
    ------
    UnsuitableProblem
        If the exact solution is None.
    UnreadableFile
        If the file cannot be written.
    """
    kind, problem = "", getattr(proof, "problem", None) or proof.program
    if isinstance(proof, ExactSolution):
        if proof.z is None:
            raise UnsuitableProblem(f"there is no exact solution to save: {proof.reason}")
        found: dict[str, Any] = {"z": _numbers(proof.z)}
    elif isinstance(proof, NoSolution):
        found = {"tree": _tree(problem, proof.tree, {})}
    elif isinstance(proof, QPUnboundedness) and not proof._certificate.left:
        kind = "ray"
        found = {"point": _numbers(proof.point), "direction": _numbers(proof.direction)}
    else:  # a direction up to rounding: no minimizer within a radius
        kind = "stationarity" if isinstance(proof, QPUnboundedness) else "rows"
        certificate = proof._certificate
        found = {"y": _multipliers(certificate, {}), "radius": _number(certificate.radius)}
    head = json.dumps(_data_of(problem, kind) | found)[:-1]
    text = f'{head}, "checksum": {checksum(head)}}}\n'.encode()
    write_whole({checked_path(path): lambda file: file.write(text)})


def _data_of(problem: LCP | QuadraticProgram, kind: str) -> dict[str, Any]:
    """Return the data of a problem as the file states them."""
    if isinstance(problem, LCP):
        vectors = {name: _numbers(getattr(problem, name)) for name in ("q", "lower", "upper")}
        return {"M": _terms_by_row(problem.csr), **vectors}
    P = sp.csr_array(problem.P)
    stated = stationarity(problem, P) if kind == "stationarity" else problem.constraints.as_rows
    needs = zip(stated.needs_rise.tolist(), stated.needs_fall.tolist(), strict=True)
    signs = [RELATIONS[pair] for pair in needs]
    terms, constants = _terms_by_row(stated.matrix), _numbers(stated.q)
    if kind == "stationarity":  # the multipliers of inequalities are not negative
        signs += np.where(np.isfinite(stated.lower), ">=", "").tolist()
        terms += _terms_by_row(sp.eye_array(stated.lower.size, format="csr"))
        constants += _numbers(-stated.lower)
    rows = [[*row] for row in zip(terms, constants, strict=True)]
    objective = {"P": _terms_by_row(P), "c": _numbers(problem.c)} if kind == "ray" else {}
    return {"kind": kind, "rows": rows, "signs": signs, **objective}


def _tree(problem: LCP, case: Case, path: Mapping[int, str]) -> dict[str, Any]:
    """Return a node of a tree of complementarity pieces; a fixed unknown has one piece only, without a split."""
    if case.row < 0:
        certificate = certificate_of(problem, path, dict(enumerate(case.y or ())))
        return {"y": _multipliers(certificate, path)}
    below = {
        name: _tree(problem, child, {**path, case.row: name})
        for name, child in case.branches.items()
    }
    return below.get(FIXED) or {"row": case.row, "branches": below}


def _multipliers(certificate: FarkasCertificate, path: Mapping[int, str]) -> list[Any]:
    """Return the multipliers of the rows, then of x − lower and of upper − x, each with its number."""
    y, (m, n) = dict(certificate.y), certificate.sides.matrix.shape
    for j in certificate.product.keys() - certificate.left:
        value = certificate.product[j]
        is_upper = path.get(j, UPPER if value > 0 else LOWER) == UPPER
        y[m + n * is_upper + j] = value if is_upper else -value
    return [[i, _number(value)] for i, value in y.items()]


def _terms_by_row(matrix: sp.csr_array) -> list[Any]:
    """Return the columns and coefficients of each row."""
    return [[[j, _number(a)] for j, a in row.items()] for row in arithmetic.rational_rows(matrix)]


def _numbers(values: Iterable[Any]) -> list[Any]:
    return [_number(value) for value in values]


def _number(value: Any) -> dict[str, str] | None:
    """Return a number exactly, in hexadecimal; None if it is infinite."""
    if math.isinf(value):
        return None
    above, below = Fraction(value).as_integer_ratio()
    return {"0x": f"{above:x}" + f"/{below:x}" * (below > 1)}
