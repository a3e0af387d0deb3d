"""Tolls that earn the most, when every driver takes the cheapest road: the best of many equilibria, with proof.

The owner of some roads of a network sets their tolls t; drivers between several pairs of places take cheapest paths.
With flows v of a pair of places, prices π of its nodes, costs c and the incidence matrix N, each is an equilibrium:

    v ≥ 0,   c + t − Nᵀπ ≥ 0,   and on every road at least one holds with equality;   N v = demand.

The owner's income Σ t v has products in it. If drivers are in equilibrium, the income is what they pay less what the
roads cost, Σ demandᵀπ − cᵀv, which is linear: a linear program with linear complementarity constraints. Of several
cheapest paths the drivers take the one that pays the owner most.

The same income is found by an integer program with bounds on all prices and flows. And for these tolls, a trifle lower,
cheapest paths by Dijkstra's method earn it.

Source: Labbé, Marcotte, Savard, Management Science 44 (1998), doi:10.1287/mnsc.44.12.1608.
"""

from itertools import pairwise
from pathlib import Path

import cvxpy as cp
import matplotlib.pyplot as plt
import numpy as np
import scipy.sparse as sp
import typer
from scipy.optimize import LinearConstraint, milp
from scipy.sparse.csgraph import shortest_path

from lcp_plugin import complements

SIDE = 3  # nodes along each side of the town
TOWN = [(i, i + 1) for i in range(SIDE**2) if (i + 1) % SIDE] + [
    (i, i + SIDE) for i in range(SIDE * (SIDE - 1))
]
ROADS = np.array(TOWN + [(j, i) for i, j in TOWN])
PLACES = np.array([(i % SIDE, i // SIDE) for i in range(SIDE**2)])
HIGHWAY = [(0, 1), (1, 2), (3, 4), (4, 5), (1, 4), (4, 7)]  # the owner's
TRIPS = {(0, 5): 3.0, (3, 2): 2.0, (1, 7): 4.0}  # from, to: how many drive
MOST = 20.0  # above every price that matters


def main(out: Path = Path()) -> None:
    """Find the tolls, prove them best, compare with an integer program, and save a figure into the folder OUT."""
    rng = np.random.default_rng(3)
    is_highway = np.array([tuple(road) in HIGHWAY for road in ROADS.tolist()])
    costs = np.where(is_highway, 1.0, rng.integers(2, 7, len(ROADS)).astype(float))
    arcs = np.arange(len(ROADS))
    incidence = sp.csr_array((np.ones(arcs.size), (ROADS[:, 0], arcs))) - sp.csr_array(
        (np.ones(arcs.size), (ROADS[:, 1], arcs)), shape=(SIDE**2, arcs.size)
    )

    tolls = cp.Variable(arcs.size, bounds=[0, MOST])
    constraints, income = [tolls[~is_highway] == 0], 0
    for (start, end), number in TRIPS.items():
        demand = np.zeros(SIDE**2)
        demand[start], demand[end] = number, -number
        flow, price = (
            cp.Variable(arcs.size, bounds=[0, number]),
            cp.Variable(SIDE**2, bounds=[-MOST, MOST]),
        )
        constraints += [incidence @ flow == demand, price[end] == 0]
        constraints.append(complements(flow >= 0, costs + tolls - incidence.T @ price >= 0))
        income += demand @ price - costs @ flow
    problem = cp.Problem(cp.Maximize(income), constraints)
    history: list[tuple[float, float]] = []
    problem.solve(
        method="LCP", callback=lambda search: history.append((-search.value, -search.lower_bound))
    )
    result = problem.solver_stats.extra_stats
    history.append((-result.value, -result.lower_bound))
    print(f"income {problem.value:.6f}, {problem.status}: {result!r}")
    print(
        "tolls:",
        {
            tuple(road): round(float(toll), 3)
            for road, toll in zip(ROADS.tolist(), tolls.value, strict=True)
            if toll > 1e-6
        },
    )
    print("all bounds checked again:", result.verify())
    by_integers = _by_integers(costs, is_highway, incidence)
    earned = _earned(costs, tolls.value * (1 - 1e-6))
    print(
        f"check: the income of an integer program differs by {abs(problem.value - by_integers):.1e}; cheapest paths "
        f"at tolls lower by a millionth earn less by {(problem.value - earned) / problem.value:.1e}, relatively"
    )
    _draw(tolls.value, is_highway, history, out)


def _by_integers(costs: np.ndarray, is_highway: np.ndarray, incidence: sp.csr_array) -> float:
    """Return the income that a mixed-integer program finds; no slack exceeds a cost, a toll and two prices."""
    m, n, k = len(ROADS), SIDE**2, len(TRIPS)
    identity, whole, slack = np.eye(m), incidence.toarray(), costs.max() + 3 * MOST
    size = m + k * (2 * m + n)  # tolls; for each trip: flow, choice, price
    objective, rows, low, high = np.zeros(size), [], [], []
    lower, upper, is_whole = np.zeros(size), np.full(size, MOST), np.zeros(size)
    upper[:m][~is_highway] = 0.0
    for trip, ((start, end), number) in enumerate(TRIPS.items()):
        first = m + trip * (2 * m + n)
        flow, choice, price = np.split(np.arange(first, first + 2 * m + n), [m, 2 * m])
        upper[flow], upper[choice], is_whole[choice] = number, 1.0, 1
        lower[price] = -MOST
        lower[price[end]] = upper[price[end]] = 0.0
        demand = np.zeros(n)
        demand[start], demand[end] = number, -number
        objective[price], objective[flow] = -demand, costs
        for parts, least, most in (
            ({"flow": whole}, demand, demand),
            ({"toll": identity, "price": -whole.T}, -costs, np.full(m, np.inf)),
            ({"flow": identity, "choice": -number * identity}, np.full(m, -np.inf), np.zeros(m)),
            (
                {"toll": identity, "price": -whole.T, "choice": slack * identity},
                np.full(m, -np.inf),
                slack - costs,
            ),
        ):
            block = np.zeros((least.size, size))
            for name, part in parts.items():
                block[
                    :, {"flow": flow, "choice": choice, "price": price, "toll": np.arange(m)}[name]
                ] = part
            rows.append(block), low.append(least), high.append(most)
    found = milp(
        objective,
        integrality=is_whole,
        bounds=(lower, upper),
        options={"mip_rel_gap": 1e-9},
        constraints=LinearConstraint(np.vstack(rows), np.concatenate(low), np.concatenate(high)),
    )
    return -found.fun


def _earned(costs: np.ndarray, tolls: np.ndarray) -> float:
    """Return the payments of drivers on cheapest paths."""
    graph = sp.csr_array((costs + tolls, (ROADS[:, 0], ROADS[:, 1])))
    _, before = shortest_path(graph, return_predecessors=True)
    toll_of, earned = (
        {tuple(road): toll for road, toll in zip(ROADS.tolist(), tolls, strict=True)},
        0.0,
    )
    for (start, end), number in TRIPS.items():
        path = [end]
        while path[-1] != start:
            path.append(int(before[start, path[-1]]))
        earned += number * sum(toll_of[j, i] for i, j in pairwise(path))
    return earned


def _draw(
    tolls: np.ndarray, is_highway: np.ndarray, history: list[tuple[float, float]], out: Path
) -> None:
    plt.style.use(Path(__file__).with_name("plots.mplstyle"))
    figure, (town, search) = plt.subplots(1, 2, figsize=(10.4, 4.4), layout="constrained")
    for road, toll, is_owned in zip(ROADS, tolls, is_highway, strict=True):
        (x, y), (dx, dy) = PLACES[road[0]], PLACES[road[1]] - PLACES[road[0]]
        color = "#D55E00" if is_owned else "#BBBBBB"
        town.annotate(
            "",
            (x + 0.9 * dx, y + 0.9 * dy),
            (x + 0.1 * dx, y + 0.1 * dy),
            zorder=3 if is_owned else 2,
            arrowprops={"arrowstyle": "->", "color": color, "linewidth": 2.5 if is_owned else 1.2},
        )
        if is_owned:
            town.text(
                x + 0.5 * dx,
                y + 0.5 * dy,
                f"{toll:.1f}",
                ha="center",
                va="center",
                zorder=5,
                bbox={"boxstyle": "round", "facecolor": "white", "edgecolor": color},
            )
    town.plot(*PLACES.T, "o", color="#0072B2", markersize=9)
    for place, (x, y) in enumerate(PLACES):
        town.text(x - 0.07, y + 0.07, str(place), ha="right")
    town.set(xlim=(-0.4, SIDE - 0.6), ylim=(-0.4, SIDE - 0.6), aspect="equal", xticks=[], yticks=[])
    town.set_title("The owner's roads and their tolls")
    town.set_xlabel(
        ", ".join(f"{number:g} drive {start} → {end}" for (start, end), number in TRIPS.items())
    )
    incomes, bounds = zip(*history, strict=True)
    search.step(
        range(len(history)), bounds, where="post", color="#777777", label="no tolls earn more"
    )
    search.step(
        range(len(history)),
        incomes,
        where="post",
        color="#0072B2",
        linewidth=2,
        label="best tolls so far",
    )
    search.set(xlabel="nodes of the search", ylabel="income", title="The gap closes")
    search.legend()
    figure.savefig(out / "network_tolls.png", dpi=150)


if __name__ == "__main__":
    typer.run(main)
