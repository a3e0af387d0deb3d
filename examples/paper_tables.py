"""The paper's Tables 1 and 2 computed again, each printed figure next to the computed one.

Every run stops at ‖min(z, Mz + q)‖₂ < 1e-5 from z = (1, 0, 1, 0, …), without row scaling. Ω is D/2 for MGS and D/(2α²)
for MSOR, the values behind the printed figures, which are in `paper_tables.json` (n = 100 … 10 000 in both tables, the
misprint 254 read as 24). The check at the end counts the cells whose number of iterations differs from the paper's.

Source: Kumar, Deepmala, Das, More on projected type iteration method and linear complementarity problem, §5.
"""

import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import typer

from lcp_plugin import gallery
from lcp_plugin.algorithms import create, paper_options

TOLERANCE, DELTA, MAX_ITERATIONS = 1e-5, 4.0, 1000


class Cell(NamedTuple):
    """One column of one row: the paper's IT, Res and CPU, and ours."""

    example: int
    algorithm: str
    n: int
    paper_iterations: int
    iterations: int
    paper_residual: float
    residual: float
    paper_seconds: float
    seconds: float


def published() -> Any:
    """Return the paper's figures."""
    return json.loads(Path(__file__).with_name("paper_tables.json").read_text(encoding="utf-8"))


def iterated(problem: Any, start: Any, algorithm: Any) -> tuple[Any, int, float, float]:
    """Return z, the iterations until Res is below the paper's ε, their seconds, and Res."""
    begin, z, count, residual = time.perf_counter(), np.array(start), 0, np.inf
    for count, step in enumerate(algorithm.iterates(problem, z)):
        z = step.z
        residual = float(np.linalg.norm(np.minimum(z, problem.slack(z))))
        if residual < TOLERANCE or count >= MAX_ITERATIONS:
            break
    return z, count, time.perf_counter() - begin, residual


def cells() -> Iterator[Cell]:
    """Yield every cell of both tables, computed now."""
    tables = published()
    for example in (1, 2):
        for name, row in tables[f"example_{example}"].items():
            relaxation = row.get("relaxation")
            for k, n in enumerate(tables["n"]):
                algorithm = create(name, paper_options(name, relaxation))
                for _ in range(2):  # the first run may compile
                    scene = gallery.build(f"paper_example_{example}", n=n, delta=DELTA)
                    _, count, seconds, residual = iterated(scene.problem, scene.start, algorithm)
                printed = (row[column][k] for column in ("iterations", "residual", "seconds"))
                computed = (count, float(f"{residual:.2g}"), float(f"{seconds:.2g}"))
                pairs = [value for pair in zip(printed, computed, strict=True) for value in pair]
                yield Cell(example, f"{name} {relaxation or ''}".strip(), n, *pairs)


def main(out: Path = Path()) -> None:
    """Print both tables, and save a figure of the iterations into the folder OUT."""
    import matplotlib.pyplot as plt

    computed = list(cells())
    heads = ("algorithm", "n", "paper IT", "IT", "paper Res", "Res", "paper CPU", "CPU")
    for example in (1, 2):
        rows = [cell[1:] for cell in computed if cell.example == example]
        print(f"The paper's Table {example}, δ = {DELTA:g}\n", *(f"{head:>11}" for head in heads))
        for row in rows:
            print(*(f"{cell:>11}" for cell in row))

    plt.style.use(Path(__file__).with_name("plots.mplstyle"))
    figure, every = plt.subplots(1, 2, figsize=(8, 3.6), layout="constrained", sharey=True)
    for example, axes in zip((1, 2), every, strict=True):
        own = [cell for cell in computed if cell.example == example]
        for name in dict.fromkeys(cell.algorithm for cell in own):
            points = [(cell.n, cell.iterations) for cell in own if cell.algorithm == name]
            axes.semilogx(*zip(*points, strict=True), label=name)
        axes.plot(*zip(*((cell.n, cell.paper_iterations) for cell in own), strict=True), "k.")
        axes.set(title=f"Example {example}: dots are the paper's", xlabel="n", ylabel="iterations")
        axes.legend()
    figure.savefig(out / "paper_tables.png", dpi=150)
    differ = sum(cell.iterations != cell.paper_iterations for cell in computed)
    print(f"check: the number of iterations differs in {differ} of {len(computed)} cells")


if __name__ == "__main__":
    typer.run(main)
