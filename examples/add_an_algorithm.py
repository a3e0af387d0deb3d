"""Your own algorithm in thirty lines, tested on problems whose answers are known exactly.

Korpelevich's extragradient method takes each step twice: a predictor step, then a corrector step with the slack at the
predicted point,

    y = mid(lower, upper, z − τ w(z)),   z⁺ = mid(lower, upper, z − τ w(y)),   w(z) = M z + q.

For τ < 1/‖M‖ it converges on every monotone problem, M symmetric or not. Without the predictor the iterates of the
game below circle indefinitely; with it they spiral into the equilibrium.

An algorithm is a frozen dataclass with `iterates`. It has no clock, no tolerance and no status: `solve` adds these. A
copy of the class in a file of `lcp_plugin/methods/`, with a line in `REGISTRY`, is an algorithm of this package.
From a package of your own it is used as an object: solve(problem, Extragradient()).

Source: Korpelevich, The extragradient method for finding saddle points and other problems, Ekonomika i
Matematicheskie Metody 12, 1976; in English in Matecon 13, 1977.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import matplotlib.pyplot as plt
import numpy as np
import scipy.sparse.linalg
import typer

from lcp_plugin import LCP, solve
from lcp_plugin.algorithms import Algorithm, Step, check_flag, check_positive


@dataclass(frozen=True, kw_only=True)
class Extragradient(Algorithm):
    """Each step twice: a predictor and a corrector.

    Parameters
    ----------
    step : float
        Step length τ in units of 1/‖M‖.
    looks_ahead : bool
        False leaves out the first of the two, for comparison.
    """

    name: ClassVar[str] = "extragradient"
    needs: ClassVar[str] = "monotone M"
    solves: ClassVar[str] = "PSD, symmetric or not, for step < 1"
    cost: ClassVar[str] = "2 products with M"
    reference: ClassVar[str] = (
        "Korpelevich 1976; Facchinei, Pang 2003, chapter 12, doi:10.1007/b97544"
    )
    is_monotone: ClassVar[bool] = False  # its residual may rise on the way

    step: float = 0.9
    looks_ahead: bool = True

    def __post_init__(self) -> None:
        """Check the options."""
        check_positive(self, "step")
        check_flag(self, "looks_ahead")

    def iterates(self, problem: LCP, z0: np.ndarray) -> Iterator[Step]:
        """Yield z0, then one step per iteration."""
        # the Frobenius norm is ≥ ‖M‖
        z, length = (z0.copy(), self.step / scipy.sparse.linalg.norm(problem.csr))
        while True:
            yield Step(z, work=2.0)
            ahead = (
                np.clip(z - length * problem.slack(z), problem.lower, problem.upper)
                if self.looks_ahead
                else z
            )
            z = np.clip(z - length * problem.slack(ahead), problem.lower, problem.upper)


def worst_of_random_problems() -> float:
    """Return the largest error on random problems with bounds, drawn by hypothesis together with exact answers."""
    from hypothesis import given, settings

    from lcp_plugin.strategies import positive_definite_matrices, solved_lcps

    errors = []

    @settings(max_examples=40, deadline=None, database=None, derandomize=True)
    @given(solved_lcps(positive_definite_matrices(3, density=0.5), bounds=True))
    def compare(drawn: tuple) -> None:
        problem, exact = drawn
        result = solve(problem, Extragradient(), tolerance=1e-10)
        errors.append(max(abs(result.z - [float(value) for value in exact])))
        assert result.is_solved

    compare()
    return max(errors)


def way_through(game: LCP, algorithm: Extragradient) -> np.ndarray:
    """Return the iterates of a run, one per row, and print how it ended."""
    way: list[np.ndarray] = []
    result = solve(
        game,
        algorithm,
        z0=[0.65, 0.5],
        max_iterations=150,
        callback=lambda _, z: way.append(z.copy()),
    )
    how = "with" if algorithm.looks_ahead else "without"
    print(
        f"{how} the look ahead: {result.status.name}, {result.iterations} iterations, z = {result.z.round(6)}"
    )
    return np.array(way)


def main(out: Path = Path()) -> None:
    """Test the algorithm, and draw its path through a game into the folder OUT."""
    # matching pennies: each tosses a coin
    game = LCP([[0.0, 1.0], [-1.0, 0.0]], [-0.5, 0.5], upper=1.0)
    plt.style.use(Path(__file__).with_name("plots.mplstyle"))
    figure, axes = plt.subplots(figsize=(5.4, 5.0), layout="constrained")
    for looks_ahead, color, label in (
        (False, "#D55E00", "without the look ahead"),
        (True, "#0072B2", "with it"),
    ):
        way = way_through(game, Extragradient(looks_ahead=looks_ahead))
        axes.plot(*way[:40].T, ".-", color=color, markersize=4, linewidth=0.8, label=label)
    print(
        f"check: the largest error on random problems with exact answers is {worst_of_random_problems():.1e}"
    )

    axes.plot(0.5, 0.5, "k*", markersize=12, label="equilibrium")
    axes.set(xlim=(-0.02, 1.02), ylim=(-0.02, 1.25), xticks=[0, 0.5, 1], yticks=[0, 0.5, 1])
    axes.set(xlabel="first player: chance of heads", ylabel="second player: chance of heads")
    axes.legend(loc="upper left", fontsize=8.5)
    axes.set_title("Matching pennies: the first 40 steps")
    figure.savefig(out / "add_an_algorithm.png", dpi=150)


if __name__ == "__main__":
    typer.run(main)
