"""Steps that solve on faces: block pivots, interior points, active sets; each with factors of AᵀA on the free columns.

Block pivots solve on the free columns and exchange all that have the wrong sign, until none has. A few rounds lead to
the face from anywhere, however many columns change, where AᵀA is well-conditioned. Proximal terms ½ δ ‖x − x_k‖² make
it so: x_k+1 is the minimum with the term, and with the next, smaller δ few columns change.

Interior points find the face where A is too ill-conditioned for that. The gradient on the columns that may move is
M x + q with M = AᵀA + ridge, and the predictor–corrector takes that as it takes any monotone M. A point is shown with
the columns at their bounds whose multipliers exceed their distances.

Active sets solve on the free columns, go there as far as the bounds allow, let go of what pulls inwards. From a point
near the answer it is a few rounds. The cost falls with each, so that no set comes twice but for rounding: columns let
go that want to cross their bound stay, and one let go alone does not want to (Lawson and Hanson).

Projected gradients take the step lengths of Barzilai and Borwein until the face settles, conjugate gradients solve on
it: a product with A and one with Aᵀ an iteration; AᵀA is never formed. Measured beside it on random
sparse, dense, ill-conditioned, blurring, difference and wide matrices: accelerated gradients with restarts need
1.3 – 8 times as many products, MPRGP .7 – 3 times, the projected steps alone 1 – 15 times, rounds of active sets
1 – 3 times, and those end without an answer where A is ill-conditioned.

References
----------
L. F. Portugal, J. J. Júdice, L. N. Vicente, *A comparison of block pivoting and interior-point algorithms for linear
least squares problems with nonnegative variables*, Math. Comp. 63 (1994), doi:10.1090/S0025-5718-1994-1250776-4.
P. B. Stark, R. L. Parker, *Bounded-variable least-squares: an algorithm and applications*, Comput. Stat. 10 (1995).
E. G. Birgin, J. M. Martínez, M. Raydan, *Nonmonotone spectral projected gradient methods on convex sets*,
SIAM J. Optim. 10 (2000), doi:10.1137/S1052623497330963. W. W. Hager, H. Zhang, *A new active set algorithm for box
constrained optimization*, SIAM J. Optim. 17 (2006), doi:10.1137/050635225.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterator
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...core.checks import BoolVector, FloatVector
from ...core.deadline import is_over
from ...core.kernels.floats import EPSILON
from ...methods.interior.newton_matrix import NewtonMatrix
from ...methods.interior.predictor_corrector import PredictorCorrector
from .faces import FacePoint, Faces, Solve, clipped

PROXIMITY = (1e-4, 1e-8)  # δ, of columns of unit length; the first where A is wide, so that AᵀA is singular
NOISE = 1e3  # times rounding: less is no pull on a column at its bound, by a gradient with AᵀA
PATIENCE = 5  # rounds that do not lessen the columns with a wrong sign
ROUNDS = 20  # of active sets, which let A have the last word
CORRECTIONS = 2  # a solve is cheap beside a factor of AᵀA
SMALLEST_STEP = 1e-8  # a shorter one leads nowhere
PRECISION = EPSILON**2  # complementarity, ÷ that of the start, from which on rounding decides
STEPS = 100
REFINED = 0.5  # what a correction on the same face has to leave at the most to be followed by another
REMEMBERED = 10  # costs, the largest of which a projected step has to undercut
SUFFICIENT = 1e-4  # share of the fall that the gradient promises
LEFT_BEHIND = 0.1  # of the pull out of an orthant: a smaller residual in it is not worth a step
SETTLED = 2  # steps in a row that leave the face as it is
Steps = Generator[FacePoint, None, FacePoint]


def through_orthants(take: Callable[[FacePoint], Iterator[FacePoint]]) -> Callable[[FacePoint], Iterator[FacePoint]]:
    """Return the steps that take those in an orthant, then in that where columns at 0 are pulled to, until none is.

    In an orthant Σ l1 |x| is linear. Cost falls from one to the next: none comes back once it is solved.
    """

    def steps(start: FacePoint) -> Iterator[FacePoint]:
        point = start
        while True:
            orthant = start.problem.whole.orthant(point.x, point.slope)
            for point in take(FacePoint(orthant, point.x, point.residual)):  # noqa: B020 - each begins where one ended
                yield point
                if point.pull_across > point.noise and LEFT_BEHIND * point.pull_across > _largest(point):
                    break
            if not point.pull_across > max(point.noise, _largest(point)):
                return

    return steps


def _largest(point: FacePoint) -> float:
    return float(np.abs(point.natural_residual).max(initial=0.0))


def block_pivot_steps(start: FacePoint, faces: Faces) -> Iterator[FacePoint]:
    """Yield points from the start on: active sets from where the rounds converge, nothing else where they do not."""
    yield start
    point = start
    for proximity in PROXIMITY[0 if faces.is_wide else 1 :]:
        x = _proximal_point(point, faces, proximity)
        if x is None:
            return
        point = FacePoint(point.problem, x)
    yield from islice(active_set_steps(point, faces), 1, ROUNDS)


def _proximal_point(centre: FacePoint, faces: Faces, proximity: float) -> FloatVector | None:
    """Return the minimum of the cost + ½ δ ‖x − centre‖² within the bounds; None where the rounds do not converge."""
    problem, side = centre.problem, _sides(centre)
    fewest, patience = side.size + 1, PATIENCE
    noise = NOISE * centre.noise
    while patience > 0 and not is_over():
        bound = np.where(side < 0, problem.lower, np.where(side > 0, problem.upper, centre.x))
        d, free = bound - centre.x, np.flatnonzero(side == 0)
        solve = faces.factor(free, np.full(free.size, proximity))
        if solve is None:
            return None
        d[free] = solve(-(centre.gradient + faces.product(d))[free])
        slope = centre.gradient + faces.product(d) + proximity * d
        x = np.where(side == 0, centre.x + d, bound)
        after = np.where(x < problem.lower, -1, np.where(x > problem.upper, 1, side))
        after[(side * slope > noise) & (problem.lower < problem.upper)] = 0
        wrong = int(np.count_nonzero(after != side))
        if wrong == 0:
            return x
        fewest, patience = min(wrong, fewest), PATIENCE if wrong < fewest else patience - 1
        side = after
    return None


def _sides(point: FacePoint) -> NDArray[np.int_]:
    """Return −1 for columns at their lower bound, 1 at the upper one, 0 for those between and those pulled inwards."""
    held = ~point.is_free & (point.pull == 0.0)
    return np.where(held, np.where(point.x <= point.problem.lower, -1, 1), 0)


class NormalMatrix(NewtonMatrix):
    """AᵀA + ridge + diag on some columns: products by A, factors by AᵀA, whose errors active sets mend at the end."""

    def __init__(self, faces: Faces, columns: Any) -> None:
        super().__init__(columns.size)
        self._faces, self._columns = faces, columns
        self._solve: Solve = np.copy
        self.state[:2] = 0.0  # the faces find the shift that a singular AᵀA needs

    def product(self, d: FloatVector) -> FloatVector:
        """Return (AᵀA + ridge) d."""
        problem = self._faces.problem
        direction = np.zeros(problem.lower.size)
        direction[self._columns] = d
        bent = problem.transposed(problem.product(direction)) + problem.ridge * direction
        return np.asarray(bent[self._columns])

    def _try(self, shifted: FloatVector, right: FloatVector) -> FloatVector | None:
        solve = self._faces.factor(self._columns, shifted)
        self._solve = solve or self._solve
        return None if solve is None else solve(right)

    def _refined(self, right: FloatVector, diagonal: FloatVector, enough: float) -> tuple[FloatVector, float, float]:
        return self._solve(right), 0.0, 1.0


def interior_steps(start: FacePoint, faces: Faces) -> Iterator[FacePoint]:
    """Yield points from the start on: interior ones until rounding decides which columns are free, then active sets."""
    yield start
    problem, x, reached = start.problem, start.x, start
    columns = np.flatnonzero(problem.lower < problem.upper)
    matrix, lower, upper = NormalMatrix(faces, columns), problem.lower[columns], problem.upper[columns]
    fixed = np.where(problem.lower < problem.upper, 0.0, problem.lower)
    point = PredictorCorrector(matrix, FacePoint(problem, fixed).gradient[columns], lower, upper, CORRECTIONS)
    point.start_near(x[columns], start.gradient[columns])
    first = point.gap
    for _ in range(STEPS):
        if not point.advance(1):
            break
        active, at = point.active(1.0)
        x = fixed.copy()
        x[columns] = np.clip(np.where(active, at, point.z), lower, upper)
        reached = FacePoint(problem, x)
        yield reached
        if point.length <= SMALLEST_STEP or not point.gap > PRECISION * first:
            break
    yield from islice(active_set_steps(reached, faces), 1, None)


def active_set_steps(start: FacePoint, faces: Faces) -> Iterator[FacePoint]:
    """Yield points from the start on; ends at the answer up to rounding, or where no set gains any more."""
    yield start
    point, free, size = start, start.is_free, np.inf
    while (correction := faces.correction(point, free)) is not None:
        length = point.farthest(correction)
        after = _moved(point, correction, length)
        if length == 0.0 and np.array_equal(after.x, point.x):
            fewer = _without(point, free, correction)
            if fewer is None:
                return
            free = fewer
            continue
        point = after
        yield point
        free = point.is_free
        if length >= 1.0:  # the face is solved
            noise, before, size = point.noise, size, _largest(point)
            pulled = np.abs(point.pull) > noise
            if not pulled.any() and not 0.0 < size <= REFINED * before:
                return
            free = free | pulled


def _moved(point: FacePoint, correction: FloatVector, length: float) -> FacePoint:
    """Return the minimum over the free columns, or what the bounds allow on the way there."""
    if length >= 1.0:
        return FacePoint(point.problem, np.clip(point.x + correction, point.problem.lower, point.problem.upper))
    return point.projected(correction, point.problem.product(correction))


def _without(point: FacePoint, free: BoolVector, correction: FloatVector) -> BoolVector | None:
    """Return the free columns without those that were let go and want to cross the bound they are at, if that helps.

    Where all want to, the one that pulls hardest is let go alone: but for rounding it moves inwards.
    """
    let_go = free & ~point.is_free
    stay = let_go & (correction * point.gradient < 0.0)
    if stay.any():
        return point.is_free | stay
    if np.count_nonzero(let_go) <= 1:
        return None
    hardest = point.is_free.copy()
    hardest[np.argmax(np.abs(np.where(let_go, point.pull, 0.0)))] = True
    return hardest


def projected_steps(start: FacePoint) -> Iterator[FacePoint]:
    """Yield points from the start on; ends where no step leads anywhere."""
    yield start
    point, length = start, _cauchy_length(start)
    while length > 0.0 and point.natural_residual.any():
        point, length = yield from _spectral_steps(point, length)
        point = yield from _conjugate_steps(point)


def _cauchy_length(point: FacePoint) -> float:
    """Return the length that minimises along the projected gradient, 0 where there is none."""
    direction = point.free_gradient + point.pull
    curvature = point.curvature(direction, point.problem.product(direction))
    return float(direction @ direction) / curvature if curvature > 0.0 else 0.0


def _spectral_steps(point: FacePoint, length: float) -> Generator[FacePoint, None, tuple[FacePoint, float]]:
    """Take projected gradient steps until they leave the face alone; return the last point and step length."""
    costs, settled = deque([point.cost], maxlen=REMEMBERED), 0
    while settled < SETTLED:
        problem = point.problem
        direction = clipped(point.x - length * point.gradient, problem.lower, problem.upper) - point.x
        product = problem.product(direction)
        slope, curvature = float(point.gradient @ direction), point.curvature(direction, product)
        if not (slope < 0.0 < curvature):  # nothing but rounding is left to gain
            return point, 0.0
        share = 1.0
        if point.cost + slope + 0.5 * curvature > max(costs) + SUFFICIENT * slope:
            share = min(1.0, -slope / curvature)
        after = point.moved(direction, product, share)
        length = float(direction @ direction) / curvature
        settled = settled + 1 if np.array_equal(after.is_free, point.is_free) else 0
        point = after
        costs.append(point.cost)
        yield point
    return point, length


def _conjugate_steps(point: FacePoint) -> Steps:
    """Take conjugate gradient steps on the face until a bound stops them or columns at a bound pull harder."""
    direction = -point.free_gradient
    size = float(direction @ direction)
    while size > 0.0 and float(point.pull @ point.pull) <= size:
        product = point.problem.product(direction)
        curvature = point.curvature(direction, product)
        if not curvature > 0.0:
            return point
        length = size / curvature
        if length > point.farthest(direction):
            point = point.projected(length * direction, length * product)
            yield point
            return point
        point = point.moved(direction, product, length)
        yield point
        before, size = size, float(point.free_gradient @ point.free_gradient)
        direction = (size / before) * direction - point.free_gradient
    return point
