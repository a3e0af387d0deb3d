"""Which algorithm solves what: status and true error on stiff, badly scaled, nearly singular and extreme problems.

The solution z* of each problem is known in fractions. A run counts as SOLVED, unsolved, refused or failed; within a run
every warning of numpy is an error, so that no overflow is silent. A small residual can hide a large error if M is
ill-conditioned: the printed table lists these runs.

    python examples/stability_atlas.py                            # a minute: auto, npsor, newton
    python examples/stability_atlas.py mgs psor lemke --families scaling --families sizes
"""

import math
import sys
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property, partial
from itertools import product
from pathlib import Path
from typing import Annotated, Any

import matplotlib.pyplot as plt
import numpy as np
import scipy.linalg
import scipy.sparse as sp
import typer
from numpy.typing import NDArray

from lcp_plugin import LCP, UnsuitableMatrix, UnsuitableProblem, solve
from lcp_plugin.algorithms import REGISTRY
from lcp_plugin.core.checks import Array, Vector
from lcp_plugin.core.entries import scale_by
from lcp_plugin.proofs.exact import exact_slack, is_exact_solution, rational_rows, solved_nearby

Field = NDArray[np.float64]
Coefficient = float | Field
Legs = tuple[list[Coefficient], list[Coefficient]]  # below and above, one coefficient per axis
ExactPoint = tuple[Fraction, ...]


@dataclass(frozen=True, eq=False, kw_only=True)
class StressCase:
    """A problem under one stress.

    Parameters
    ----------
    stress : str
        Extreme property, with its number.
    problem : LCP
    near : sequence of float, shape (n,), optional
        A point on the right bounds, from which the exact answer is found; None if there is none, or a line of them.
    start : ndarray, shape (n,), optional
        z0 of the runs.
    unit : number or ndarray, shape (n,)
        Unit of each component of z.
    """

    stress: str
    problem: LCP = field(repr=False)
    near: Sequence[float] | Vector | None = field(default=None, repr=False)
    start: Vector | None = field(default=None, repr=False)
    unit: Any = field(default=1.0, repr=False)

    @cached_property
    def exact(self) -> ExactPoint | None:
        """z* in fractions, verified exactly; None without `near`."""
        return None if self.near is None else exact_answer(self.problem, self.near)


def stencil_matrix(
    shape: tuple[int, ...], centre: Coefficient, below: Sequence[Any], above: Sequence[Any]
) -> sp.csr_array:
    """Return the matrix of (centre u)_i + Σ_axis (below[axis] u_{i − e} + above[axis] u_{i + e}) on a grid.

    Neighbors outside the grid are left out: their known values belong into q.

    Parameters
    ----------
    shape
        Number of nodes along each axis; unknowns are numbered in C order.
    centre, below, above
        Coefficients: numbers, or arrays that broadcast to `shape`; `below` and `above` hold one per axis.

    Returns
    -------
    csr_array, shape (n, n)
        Canonical, with 32-bit indices if they suffice.

    Examples
    --------
    >>> stencil_matrix((3,), 2.0, [-1.0], [-1.0]).toarray()
    array([[ 2., -1.,  0.],
           [-1.,  2., -1.],
           [ 0., -1.,  2.]])
    """
    n = math.prod(shape)
    strides = [math.prod(shape[axis + 1 :]) for axis in range(len(shape))]
    # The far neighbor below comes first, the far neighbor above last: each row is born sorted.
    offsets = [*(-stride for stride in strides), 0, *reversed(strides)]
    entries = np.empty((*shape, len(offsets)))
    for axis in range(len(shape)):
        entries[..., axis] = below[axis]
        entries[..., -1 - axis] = above[axis]
        np.moveaxis(entries, axis, 0)[0, ..., axis] = 0.0
        np.moveaxis(entries, axis, 0)[-1, ..., -1 - axis] = 0.0
    entries[..., len(shape)] = centre

    entries = entries.reshape(n, len(offsets))
    rows, legs = np.nonzero(entries)
    columns = rows + np.array(offsets)[legs]
    return sp.csr_array((entries[rows, legs], (rows, columns)), shape=(n, n))


def balanced_matrix(shape: tuple[int, ...], legs: Legs) -> sp.csr_array:
    """Return the stencil whose centre balances its legs exactly: −∇·(k∇u) + b·∇u."""
    below, above = legs
    return stencil_matrix(shape, -sum(below) - sum(above), below, above)


def stiff_cells(cells: Field) -> Legs:
    """Return the legs of −∇·(k∇u), k on each cell of the mesh; an edge takes the mean of its two cells."""
    # edges along the first axis have the shape (size + 1, size)
    across = (cells[:, :-1] + cells[:, 1:]) / 2.0
    along = (cells[:-1, :] + cells[1:, :]) / 2.0
    return [-across[:-1], -along[:, :-1]], [-across[1:], -along[:, 1:]]


def upwind(diffusion: float, wind: Sequence[Coefficient]) -> Legs:
    """Return the legs of −diffusion Δu + wind·∇u by first-order upwind differences, on a mesh of width 1."""
    below = [-(diffusion + np.maximum(b, 0.0)) for b in wind]
    return below, [-(diffusion + np.maximum(-b, 0.0)) for b in wind]


def grid(
    size: int, centre: Any = 4.0, below: Any = (-1.0, -1.0), above: Any = (-1.0, -1.0)
) -> sp.csr_array:
    """Return a five-point matrix on size × size nodes, −Δ by default."""
    return stencil_matrix((size, size), centre, below, above)


def pattern(
    n: int, *, active: float = 0.5, degenerate: float = 0.0, is_scattered: bool = True
) -> tuple[Vector, Vector]:
    """Return complementary integer vectors z, w with these shares of active and, among them, degenerate rows.

    The active rows are here and there, or the first ones.
    """
    generator = np.random.default_rng(0)
    z, w = generator.integers(1, 10, size=(2, n)).astype(np.float64)
    order, count = generator.permutation(n) if is_scattered else np.arange(n), int(active * n)
    z[order[:count]] = 0.0
    w[order[count:]] = 0.0
    w[order[: round(degenerate * count)]] = 0.0
    return z, w


def planted(stress: str, M: Array, z: Vector, w: Vector, **facts: Any) -> StressCase:
    """Return the case with q = w − M z, each entry rounded once; the exact answer then belongs to the rounded q."""
    unrounded = exact_slack(LCP(M, np.zeros(z.size)), z)
    q = [
        float(Fraction(value) - product)
        for value, product in zip(w.tolist(), unrounded, strict=True)
    ]
    return StressCase(stress=stress, problem=LCP(M, q), near=z, **facts)


def half_active(stress: str, M: Array, *, start: Vector | None = None, **shares: Any) -> StressCase:
    """Return a case with this matrix and an answer of small integers with these shares of active rows, as in `pattern`.

    On the active rows w is a small integer times the diagonal.
    """
    z, w = pattern(M.shape[0], **shares)
    return planted(stress, M, z, w * np.abs(M.diagonal()), start=start)


#: The first fifth is active: the coupling of distant rows matters, because the free rows are consecutive.
mostly_free = partial(half_active, active=0.2, is_scattered=False)


def rescaled(stress: str, case: StressCase, row: object, column: object) -> StressCase:
    """Return the case with rows multiplied by `row` and z measured in units of 1/`column`."""
    problem = case.problem
    row, column = (
        np.broadcast_to(np.asarray(factor, dtype=np.float64), problem.n) for factor in (row, column)
    )
    # One multiplication after another: the product of the two factors may overflow although the entry does not.
    scaled = LCP(scale_by(problem.csr, row, column), problem.q * row)
    unit = 1.0 / column
    near = np.asarray(case.near) * unit
    return replace(case, stress=stress, problem=scaled, near=near, unit=unit)


SIDE = 10  # unknowns in each direction of the grids


def stiffness() -> Iterator[StressCase]:
    """Yield δ → 0, anisotropy, contrast, Péclet number and time scales, each towards its extreme."""
    for delta in (1e-4, 1e-12, 0.0):
        yield mostly_free(f"delta={delta:g}", grid(SIDE, 4.0 + delta))
    for ratio in (1e-3, 1e-6, 1e-12):
        yield mostly_free(
            f"anisotropy={ratio:g}", grid(SIDE, 2.0 + 2.0 * ratio, (-1.0, -ratio), (-1.0, -ratio))
        )
    for contrast in (1e4, 1e12):
        yield mostly_free(f"contrast={contrast:g}", _island(contrast))
        yield mostly_free(f"contrast={1 / contrast:g}", _island(1.0 / contrast))
    winds = [(peclet, 0.6, "") for peclet in (1e2, 1e6, 1e12)]
    winds.append((1e12, 0.6 + np.pi, ", against the sweep"))
    for peclet, angle, words in winds:
        # upwind convection by a unit wind with diffusion 1/peclet a mesh width
        M = balanced_matrix((SIDE, SIDE), upwind(1.0 / peclet, (np.cos(angle), np.sin(angle))))
        yield mostly_free(f"peclet={peclet:g}{words}", M)
    for span in (1e4, 1e8, 1e12):
        # an implicit Euler step of reactions with rates from 1 to `span` that feed one another in a chain
        rates = np.geomspace(1.0, span, SIDE * SIDE)
        M = sp.csr_array(sp.diags_array([1.0 + rates, -rates[:-1]], offsets=[0, -1]))
        yield mostly_free(f"time scales={span:g}", M)


def _island(contrast: float) -> sp.csr_array:
    """Return −∇·(k∇u) with k = contrast on a square in the middle and 1 around it."""
    cells = np.ones((SIDE + 1, SIDE + 1))
    cells[3:-3, 3:-3] = contrast
    return balanced_matrix((SIDE, SIDE), stiff_cells(cells))


def scaling() -> Iterator[StressCase]:
    """Yield M and q in units of 1e±150, and rows and columns from 1e±8 to 1e±100."""
    base = half_active("", grid(4, 5.0))
    for of_M, of_q in product((1e-150, 1.0, 1e150), repeat=2):
        if of_M != 1.0 or of_q != 1.0:
            yield rescaled(f"M × {of_M:g}, q × {of_q:g}", base, of_q, of_M / of_q)
    n = base.problem.n
    for power in (8, 30, 100):
        up_and_down = 10.0 ** np.resize([power, -power, 0, power / 2], n)
        yield rescaled(f"rows × 1e±{power}", base, up_and_down, 1.0)
        yield rescaled(f"columns × 1e±{power}", base, 1.0, np.roll(up_and_down, 1))
        yield rescaled(f"rows and columns × 1e±{power}", base, up_and_down, np.roll(up_and_down, 1))
    for k in (-900, -300, 300, 900):
        yield rescaled(f"M, q × 2^{k}", base, np.ldexp(1.0, k), 1.0)


def singularity() -> Iterator[StressCase]:
    """Yield nearly singular and singular matrices, with one solution, with many, with none."""
    for bits in (10, 20, 30, 40):
        rho = 1.0 - 2.0**-bits
        M, z = np.array([[1.0, -rho], [-rho, 1.0]]), np.array([1.0, 2.0])
        yield planted(f"H+ with 1 - rho = 2^-{bits}", M, z, np.zeros(2))
    for n in (3, 5, 8):
        yield mostly_free(f"Hilbert matrix, n={n}", scipy.linalg.hilbert(n))
    ring = _ring(12)
    yield mostly_free("singular M, one solution", ring)
    z = pattern(12, active=0.0)[0]
    yield StressCase(stress="singular M, a line of solutions", problem=LCP(ring, -(ring @ z)))
    yield StressCase(stress="singular M, no solution", problem=LCP(ring, np.full(12, -1.0)))
    for tiny in (1e-8, 1e-14):
        yield mostly_free(f"singular M + {tiny:g}", sp.csr_array(ring + tiny * sp.eye_array(12)))


def _ring(n: int) -> sp.csr_array:
    """Return −u'' on a circle: singular, M 1 = 0."""
    eye = np.eye(n)
    return sp.csr_array(2.0 * eye - np.roll(eye, 1, axis=1) - np.roll(eye, -1, axis=1))


def degeneracy() -> Iterator[StressCase]:
    """Yield answers with z = w = 0 in some rows, in all active ones, in all."""
    M = grid(SIDE)
    yield half_active("half of the active rows degenerate", M, degenerate=0.5)
    yield half_active("all active rows degenerate", M, degenerate=1.0)
    z, w = pattern(M.shape[0])
    none, start = np.zeros(z.size), np.arange(float(z.size))
    yield planted("every row degenerate", M, none, none, start=start)
    yield planted("nearly degenerate, w = 1e-14", M, z, 1e-14 * w)
    small = np.where(np.arange(z.size) % 5 == 0, 1e-14 * z, z)
    yield planted("nearly degenerate, z = 1e-14", M, small, w)
    square = LCP(M, half_active("", M, degenerate=1.0).problem.q, upper=z.max())
    yield StressCase(stress="degenerate at both bounds of a box", problem=square, near=z)


def far_starts() -> Iterator[StressCase]:
    """Yield starts far beyond the answer."""
    for power in (10, 100, 300):
        M = grid(SIDE)
        yield half_active(f"z0 = 1e{power}", M, start=np.full(SIDE * SIDE, 10.0**power))


def sizes() -> Iterator[StressCase]:
    """Yield n = 1 and 2, and a large n."""
    yield planted("n = 1", np.array([[3.0]]), np.array([1.0]), np.zeros(1))
    yield planted("n = 1, active", np.array([[3.0]]), np.zeros(1), np.ones(1))
    M = np.array([[2.0, 1.0], [1.0, 2.0]])
    yield planted("n = 2", M, np.array([5.0, 0.0]), np.array([0.0, 3.0]))
    yield half_active("n = 2500", grid(50, 8.0))
    yield half_active("n = 10000", grid(100, 8.0))


def number_range() -> Iterator[StressCase]:
    """Yield subnormal data, data next to the largest double, and answers beyond it."""
    base = half_active("", grid(3, 5.0))
    M, q, z = base.problem.csr, base.problem.q, np.asarray(base.near)
    tiny, huge = 1e-310, 1e306
    for stress, of_M, of_q, near in (
        ("q and z subnormal, 1e-310", 1.0, tiny, z * tiny),
        ("q a few times 5e-324", 1.0, 5e-324, np.ceil(z) * 5e-324),
        ("M subnormal, 1e-310", tiny, 1e-300, z * 1e10),
        ("M and q subnormal, 1e-310", tiny, tiny, z),
        ("q and z huge, 1e306", 1.0, huge, z * huge),
        ("M huge, 1e306", huge, 1.0, z / huge),
        ("M and q huge, 1e306", huge, huge, z),
        ("the answer overflows", 1e-200, 1e200, None),
    ):
        yield StressCase(stress=stress, problem=LCP(M * of_M, q * of_q), near=near)
    start = np.full(M.shape[0], 1e200)
    problem = LCP(M * 1e200, q * 1e200)
    yield StressCase(stress="w overflows at the start", problem=problem, near=z, start=start)


def cancellation() -> Iterator[StressCase]:
    """Yield problems with a q from cancellation, or with components of very different size."""
    M = grid(SIDE)
    z, w = pattern(SIDE * SIDE)
    for power in (6, 12):
        yield planted(f"z = 1e{power} + digits", M, z + 10.0**power, np.zeros(z.size))
        mixed = np.where(np.arange(z.size) % 7 == 0, 10.0**power * z, z)
        yield planted(f"some z 1e{power} times the others", M, mixed, w)
        mixed = np.where(np.arange(z.size) % 2, 10.0**power * w, w)
        yield planted(f"some w 1e{power} times the others", M, z, mixed)
    nearly_singular = sp.csr_array(_ring(12) + 2.0**-40 * sp.eye_array(12))
    z = 2.0**40 + pattern(12, active=0.0)[0]
    yield planted("q is 1e-12 of its terms", nearly_singular, z, np.zeros(12))
    for power in (4, 12):
        large = 10.0**power
        cyclic = np.array([[1.0, large, -large], [0.0, 1.0, large], [0.0, 0.0, 1.0]])
        z = np.array([1.0, 2.0, 2.0])
        yield planted(f"terms of 1e{power} cancel in M z", cyclic, z, np.zeros(3))


CASES = stiffness, scaling, singularity, degeneracy, far_starts, sizes, number_range, cancellation
FAMILIES: dict[str, Callable[[], Iterator[StressCase]]] = {
    family.__name__.replace("_", " "): family for family in CASES
}


# --- Exact answers ----------------------------------------------------------------------------------------------


def exact_answer(problem: LCP, guess: Any) -> ExactPoint:
    """Return z* in fractions, verified without rounding, from the active set of a guess.

    Parameters
    ----------
    problem : LCP
    guess : array_like, shape (n,)
        A point on the right bounds; unknowns strictly between their bounds are taken as free.

    Raises
    ------
    UnsuitableProblem
        If its free block is singular, or gives no solution.

    Examples
    --------
    >>> exact_answer(LCP([[3, 0], [0, 1]], [-1, 1]), [0.33, 0])
    (Fraction(1, 3), Fraction(0, 1))
    """
    z = [Fraction(value) for value in guess]
    if is_exact_solution(problem, z):
        return tuple(z)
    lower, upper = (np.asarray(bound) for bound in (problem.lower, problem.upper))
    at_lower, at_upper = guess <= lower, guess >= upper
    is_free = ~(at_lower | at_upper)
    ends = np.where(at_lower, lower, np.where(at_upper, upper, 0.0))
    z = [Fraction(end) for end in ends.tolist()]
    rows = [row for row, free in zip(rational_rows(problem.csr), is_free, strict=True) if free]
    right = [-Fraction(value) for value in problem.q[is_free].tolist()]
    exact = solved_nearby(rows, right, z, is_free.tolist())
    if exact is None or not is_exact_solution(problem, exact):
        raise UnsuitableProblem(
            f"no exact answer of {problem!r} found near the guess; give one on the right bounds"
        )
    return tuple(exact)


def relative_error(z: Vector, exact: ExactPoint, unit: float | Vector) -> float:
    """Return max_i |z_i − z*_i|/unit_i over max_i |z*_i|/unit_i, exact up to the last rounding; ∞ for x/0.

    Parameters
    ----------
    z : ndarray, shape (n,)
        Finite.
    exact : sequence of Fraction, shape (n,)
    unit : number or ndarray, shape (n,)

    Examples
    --------
    >>> relative_error(np.array([1.0, 0.5]), (Fraction(1), Fraction(0)), np.ones(2))
    0.5
    """
    units = [Fraction(value) for value in np.broadcast_to(unit, z.shape).tolist()]
    rows = [*zip(z.tolist(), exact, units, strict=True)]
    error = max((abs(Fraction(value) - right) / scale for value, right, scale in rows), default=0)
    largest = max((abs(right) / scale for _, right, scale in rows), default=0)
    if error >= largest * Fraction(sys.float_info.max):
        return np.inf if error else 0.0
    return float(error / largest)


# --- The atlas --------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Cell:
    """Result of one algorithm on one difficult problem.

    Attributes
    ----------
    algorithm : str
    stress, family : str
        Extreme property, with its number; the family of stresses.
    status : str
        A status of `solve`. REFUSED if the algorithm does not take this problem. ERROR if the run raised anything
        else, including a warning of overflow.
    residual : float
        Relative residual of z; NaN if z does not exist.
    true_error : float
        ‖z − z*‖∞ / ‖z*‖∞ in the units of the problem, z* exact; NaN if z or a unique z* does not exist.
    note : str
        Message of the error.
    """

    algorithm: str
    stress: str
    family: str
    status: str
    residual: float = math.nan
    true_error: float = math.nan
    note: str = ""

    def __str__(self) -> str:
        note = f"; {self.note}" if self.note else ""
        return (
            f"{self.status:<16} {self.algorithm:<15} {self.stress:<38} "
            f"residual {self.residual:.0e}, error {self.true_error:.0e}{note}"
        )


def cell_of(family: str, case: StressCase, algorithm: str, most: int) -> Cell:
    """Return the cell of one run of at most so many iterations."""
    head = (algorithm, case.stress, family)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            result = solve(case.problem, algorithm, z0=case.start, max_iterations=most)
    except (UnsuitableMatrix, UnsuitableProblem) as refusal:
        return Cell(*head, "REFUSED", note=str(refusal))
    except Exception as failure:  # the atlas shows every exception of a run
        return Cell(*head, "ERROR", note=f"{type(failure).__name__}: {failure}")
    error = math.nan
    if case.exact is not None and np.isfinite(result.z).all():
        error = relative_error(result.z, case.exact, case.unit)
    return Cell(*head, result.status.name, result.certificate.relative_residual, error)


def stability_atlas(
    algorithms: Iterable[str], families: Iterable[str] = tuple(FAMILIES), most: int = 5_000
) -> list[Cell]:
    """Return status, residual and true error of each algorithm on each problem of at most 2500 unknowns."""
    cases = [(family, case) for family in families for case in FAMILIES[family]()]
    return [
        cell_of(family, case, algorithm, most)
        for family, case in cases
        if case.problem.n <= 2500
        for algorithm in algorithms
    ]


def is_misleading(cell: Cell) -> bool:
    """Return whether a run is SOLVED with an error of more than a thousandth, because M is ill-conditioned."""
    return cell.status == "SOLVED" and cell.true_error > 1e-3


def explain(cells: list[Cell]) -> str:
    """Return the counts, then a line for each run that is not SOLVED, and for each run with a hidden error."""
    counts = Counter(cell.status for cell in cells).most_common()
    lines = [f"{len(cells)} runs: " + ", ".join(f"{count} {status}" for status, count in counts)]
    lines += [str(cell) for cell in cells if cell.status != "SOLVED"]
    lines += [f"a small residual hides the error: {cell}" for cell in cells if is_misleading(cell)]
    return "\n".join(lines)


def draw(cells: list[Cell], path: Path) -> None:
    """Save a picture: the solved share of each family of problems, an algorithm a column."""
    algorithms = list(dict.fromkeys(cell.algorithm for cell in cells))
    families = list(dict.fromkeys(cell.family for cell in cells))
    figure, axes = plt.subplots(figsize=(6.4, 4.2), layout="constrained")
    for i, j in product(range(len(families)), range(len(algorithms))):
        runs = [c for c in cells if (c.family, c.algorithm) == (families[i], algorithms[j])]
        solved = sum(cell.status == "SOLVED" for cell in runs)
        axes.text(j, i, f"{solved} of {len(runs)}", ha="center", va="center")
        share = solved / len(runs)
        axes.add_patch(plt.Rectangle((j - 0.5, i - 0.5), 1, 1, color="#0072B2", alpha=0.6 * share))
    axes.set(xlim=(-0.5, len(algorithms) - 0.5), ylim=(len(families) - 0.5, -0.5))
    axes.set_xticks(range(len(algorithms)), algorithms)
    axes.set_yticks(range(len(families)), families)
    axes.grid(visible=False)
    axes.set_title("Difficult problems that end SOLVED")
    figure.savefig(path, dpi=150)


def main(
    algorithms: Annotated[list[str], typer.Argument()] = ["auto", "npsor", "newton"],  # noqa: B006
    families: Annotated[list[str], typer.Option()] = [*FAMILIES],  # noqa: B006
    out: Path = Path(),
) -> None:
    """Print the runs that are not SOLVED, or whose small residual hides a large error; save the picture."""
    if unknown := (set(algorithms) - {"auto", *REGISTRY}) | (set(families) - set(FAMILIES)):
        known = ", ".join(["auto", *REGISTRY, *FAMILIES])
        raise typer.BadParameter(f"{', '.join(unknown)} is unknown; known are {known}")
    cells = stability_atlas(algorithms, families)
    print(explain(cells))
    failed = sum(cell.status == "ERROR" for cell in cells)
    print(f"check: an exception or a warning of numpy ended {failed} of {len(cells)} runs")
    draw(cells, out / "stability_atlas.png")


if __name__ == "__main__":
    typer.run(main)
