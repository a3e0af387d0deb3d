"""Whether a derivative that was given is that of F: compared with differences, and said in words."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..checks import FloatVector
from ..errors import InvalidProblem
from ..problem.nonlinear import Linearisation

STEP = 2.0**-20
OTHERS = 2.0**-30, 2.0**-40, 2.0**-10  # what is curved is not wrong on shorter ones, nor on a longer one what is rough
WRONG = 1e-2  # of the terms of a row
UNSURE = 10.0  # times what differences of two lengths disagree by


def check_jacobian(point: Linearisation) -> None:
    """Raise where differences of F along a random direction contradict the derivative there; cost: 9 values of F.

    A row that disagrees is looked through for its worst entry, which takes some 2 log₂ n more.

    Parameters
    ----------
    point : Linearisation
        The start. Where F is not defined nearby nothing is said.

    Raises
    ------
    InvalidProblem
        Naming the worst entry.
    """
    direction = _direction(point)
    contradiction = _contradiction(point, direction)
    if not contradiction.size or not contradiction.max() > WRONG:
        return
    i = int(np.argmax(contradiction))
    columns = np.arange(point.x.size)
    while columns.size > 1:  # the half that disagrees more
        halves = np.array_split(columns, 2)
        wrong = [float(np.abs(_difference(point, _only(direction, half))[0])[i]) for half in halves]
        columns = halves[int(np.argmax(np.nan_to_num(wrong)))]
    j = int(columns[0])
    alone = _only(direction, columns)
    own = alone * np.abs(point.x[j] / alone[j])  # where x_j ≪ 1, 1/x_j is curved on every step of the size 1
    if own[j] != 0.0 and not _contradiction(point, own)[i] > WRONG:
        return
    given = float(point.lcp.M[i, j])
    found = given + float(_difference(point, alone)[0][i] / alone[j])
    raise InvalidProblem(
        f"jacobian contradicts F at the start: jacobian(x0)[{i}, {j}] = {given:.6g}, and differences of F give "
        f"{found:.6g}; correct it, leave it out (differences take its place), or pass check_jacobian=False"
    )


def _contradiction(point: Linearisation, direction: FloatVector) -> FloatVector:
    """Return by how much each row disagrees, relative to its terms, where it does so least; 0 where nothing tells."""
    least = np.full(point.x.size, np.inf)
    with np.errstate(all="ignore"):
        size = np.asarray(abs(point.lcp.M) @ np.abs(direction))
        for step in (STEP, *OTHERS):
            wrong, unsure = _difference(point, direction, step)
            terms = size + np.abs(wrong)
            is_told = np.isfinite(terms) & (UNSURE * unsure < np.maximum(np.abs(wrong), WRONG * terms))
            least = np.where(is_told, np.minimum(least, np.abs(wrong) / terms), least)
    contradiction: FloatVector = np.where(np.isinf(least) | point.is_steep, 0.0, least)
    return contradiction


def _difference(
    point: Linearisation, direction: FloatVector, step: float = STEP
) -> tuple[FloatVector, FloatVector]:
    """Return the derivative of F along a direction less F′ times it, and a bound of the former's error, about."""
    x, value, F = point.x, point.value, point.problem.value
    with np.errstate(all="ignore"):
        long = (F(x + 2.0 * step * direction) - value) / (2.0 * step)
        short = (F(x + step * direction) - value) / step
        product = np.asarray(point.lcp.M @ direction)
        rounding = 2.0**-50 * (np.abs(value) + np.abs(short) * step + _added(point)) / step
        return 2.0 * short - long - product, np.abs(short - long) * 0.5 + rounding


def _added(point: Linearisation) -> FloatVector:
    """Return what F adds up, about, shape (n,): where its terms cancel at x they need not at the origin."""
    origin = np.clip(0.0, point.problem.lower, point.problem.upper)
    return np.nan_to_num(np.abs(point.problem.value(origin)), posinf=0.0)


def _direction(point: Linearisation) -> FloatVector:
    """Return a direction of the size of x, or 1, that leads into the bounds where x is at one."""
    x, lower, upper = point.x, point.problem.lower, point.problem.upper
    random = np.random.default_rng(0)
    sign = np.where(random.random(x.size) < 0.5, -1.0, 1.0)
    size = np.maximum(np.abs(x), 1.0) * random.uniform(0.5, 1.0, x.size)
    with np.errstate(all="ignore"):
        sign = np.where(x - lower < 4.0 * STEP * size, 1.0, np.where(upper - x < 4.0 * STEP * size, -1.0, sign))
    direction: FloatVector = sign * size
    return direction


def _only(direction: FloatVector, columns: NDArray[np.intp]) -> FloatVector:
    kept = np.zeros(direction.size)
    kept[columns] = direction[columns]
    return kept
