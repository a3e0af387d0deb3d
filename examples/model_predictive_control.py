"""A crane carries a load 4 m without swinging: model predictive control, one program solved again and again.

A trolley with a load on a rope of length l is moved by its acceleration u, which the motor limits: |u| ≤ 0.5 m/s². The
state x holds the trolley's place and speed and the rope's angle θ and its rate, where small angles obey

    l θ″ = −g θ − u.

Every 0.15 s the controller measures x and plans N accelerations ahead that bring the load to rest at 0:

    min Σ x_kᵀQ x_k + r u_k² + x_NᵀP x_N,   x_{k+1} = A x_k + B u_k,   −0.5 ≤ u_k ≤ 0.5.

It applies the first and plans anew. With the states eliminated, this is an LCP with two bounds: M = BᵀQB + r I is the
same in every step, and q = F x. So M is prepared once, and each step starts from the plan of the step before. The map
shows the first acceleration for 6561 states at rest of the rope, solved as one batch.

P is the cost that remains without limits, from Riccati's equation. Hence, where no limit acts, the controller must be
the linear one, u = −K x. That is one check; a conic solver, which gets states and inputs as they are, is another.

Sources: Borrelli, Bemporad, Morari, Predictive Control for Linear and Hybrid Systems, Cambridge 2017,
doi:10.1017/9781139061759; Bemporad, Morari, Dua, Pistikopoulos, Automatica 38, 2002, doi:10.1016/S0005-1098(01)00174-1.
"""

from pathlib import Path
from time import perf_counter

import cvxpy as cp
import matplotlib.pyplot as plt
import numpy as np
import typer
from scipy.linalg import block_diag, expm, solve_discrete_are

from lcp_plugin import LCP, prepare, solve, solve_batch

ROPE, GRAVITY, LIMIT = 3.0, 9.81, 0.5  # m, m/s², m/s²
STEP, AHEAD, SECONDS = 0.15, 40, 12.0  # s, steps of a plan, s
START = np.array([-4.0, 0.0, 0.0, 0.0])  # m, m/s, rad, rad/s
COSTS, EFFORT = np.diag([1.0, 0.2, 20.0, 5.0]), 0.5  # Q and r
BLUE, ORANGE, GREEN = "#0072B2", "#D55E00", "#009E73"


def crane() -> tuple[np.ndarray, np.ndarray]:
    """Return A and B of one step, exactly for a constant acceleration."""
    rates = np.zeros((5, 5))
    rates[0, 1] = rates[1, 4] = rates[2, 3] = 1.0
    rates[3, 2], rates[3, 4] = -GRAVITY / ROPE, -1.0 / ROPE
    step = expm(STEP * rates)
    return step[:4, :4], step[:4, 4:]


def condensed(A: np.ndarray, B: np.ndarray, P: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return M and F of the plan: the cost is ½ uᵀM u + (F x)ᵀu and what does not depend on u."""
    powers = [np.linalg.matrix_power(A, k) for k in range(AHEAD + 1)]
    free = np.vstack(powers[1:])
    forced = np.block(
        [[powers[k - j] @ B if j <= k else 0.0 * B for j in range(AHEAD)] for k in range(AHEAD)]
    )
    weights = block_diag(*[COSTS] * (AHEAD - 1), P)
    return forced.T @ weights @ forced + EFFORT * np.eye(AHEAD), forced.T @ weights @ free


def planned_by_a_conic_solver(
    A: np.ndarray, B: np.ndarray, P: np.ndarray, x0: np.ndarray
) -> np.ndarray:
    """Return the plan from one state, with states and inputs as unknowns."""
    x, u = cp.Variable((AHEAD + 1, 4)), cp.Variable((AHEAD, 1))
    states = cp.sum([cp.quad_form(x[k], COSTS) for k in range(1, AHEAD)]) + cp.quad_form(
        x[AHEAD], cp.psd_wrap(P)
    )
    motion = [x[0] == x0, x[1:] == x[:-1] @ A.T + u @ B.T, cp.abs(u) <= LIMIT]
    cp.Problem(cp.Minimize(states + EFFORT * cp.sum_squares(u)), motion).solve(solver="CLARABEL")
    return u.value[:, 0]


def main(out: Path = Path()) -> None:
    """Steer the crane, compare with two other ways, and save a figure into the folder OUT."""
    A, B = crane()
    P = solve_discrete_are(A, B, COSTS, EFFORT * np.eye(1))
    K = np.linalg.solve(EFFORT + B.T @ P @ B, B.T @ P @ A)
    M, F = condensed(A, B, P)
    step = prepare(LCP(M, F @ START, lower=-LIMIT, upper=LIMIT))

    states, inputs, plan, iterations = [START], [], np.zeros(AHEAD), []
    for _ in range(round(SECONDS / STEP)):
        result = step.solve(q=F @ states[-1], z0=plan).require_solved()
        plan = np.append(result.z[1:], 0.0)  # one step later, the start of the next
        inputs.append(result.z[0])
        iterations.append(result.iterations)
        states.append(A @ states[-1] + B @ result.z[:1])
    x, u = np.array(states), np.array(inputs)
    print(
        f"{len(u)} plans of {AHEAD} steps, each from the one before; {max(iterations)} iterations at most"
    )

    places, speeds = np.linspace(-5, 5, 81), np.linspace(-2, 2, 81)
    grid = np.stack([*np.meshgrid(places, speeds), *np.zeros((2, 81, 81))], axis=-1).reshape(-1, 4)
    start = perf_counter()
    answers = solve_batch(step, grid @ F.T)
    law = np.array([answer.require_solved().z[0] for answer in answers])
    print(f"{len(grid)} states as one batch: {perf_counter() - start:.1f} s")

    conic = max(
        abs(
            solve(LCP(M, F @ x[k], lower=-LIMIT, upper=LIMIT), tolerance=1e-12).z
            - planned_by_a_conic_solver(A, B, P, x[k])
        ).max()
        for k in (0, 10, 20)
    )
    near = 0.002 * np.random.default_rng(0).standard_normal((50, 4))
    linear = max(
        abs(answer.z[0] + (K @ state)[0])
        for answer, state in zip(solve_batch(step, near @ F.T, tolerance=1e-12), near, strict=True)
    )
    print(f"check: plans differ from a conic solver's by {conic:.1e} m/s²")
    print(f"check: where no limit acts, inputs differ from −K x by {linear:.1e} m/s²")

    cut = [START]
    for _ in u:
        cut.append(A @ cut[-1] + B @ np.clip(-K @ cut[-1], -LIMIT, LIMIT))
    plt.style.use(Path(__file__).with_name("plots.mplstyle"))
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(9.6, 4.0), layout="constrained", width_ratios=[1.15, 1]
    )
    time = STEP * np.arange(len(x))
    left.plot(time, x[:, 0], color=BLUE, label="trolley (m)")
    left.plot(time, x[:, 0] + ROPE * x[:, 2], color=ORANGE, label="load (m)")
    left.plot(
        time,
        np.array(cut)[:, 0],
        ":",
        color=BLUE,
        linewidth=1.2,
        label="trolley, linear law cut off (m)",
    )
    left.step(time[:-1], u, where="post", color=GREEN, linewidth=1.2, label="acceleration (m/s²)")
    left.axhspan(-LIMIT, LIMIT, color=GREEN, alpha=0.08, linewidth=0)
    left.set(xlabel="time (s)", title="The load arrives and hangs still", xlim=(0, SECONDS))
    left.legend(fontsize=8, loc="lower right")
    law = law.reshape(81, 81)
    drawn = right.contourf(
        places, speeds, law, levels=1.001 * np.linspace(-LIMIT, LIMIT, 22), cmap="PuOr"
    )
    edges = [-0.999 * LIMIT, 0.999 * LIMIT]
    right.contour(
        places, speeds, law, levels=edges, colors="#333333", linewidths=1.0, linestyles="-"
    )
    right.text(-4.7, -1.7, "limit reached", fontsize=8, color="white")
    right.text(2.5, 1.6, "limit reached", fontsize=8, color="white")
    right.set(
        xlabel="place (m)", ylabel="speed (m/s)", title="First acceleration of a plan, rope at rest"
    )
    right.grid(visible=False)
    figure.colorbar(drawn, ax=right, label="m/s²", ticks=[-LIMIT, 0.0, LIMIT])
    figure.savefig(out / "model_predictive_control.png", dpi=150)


if __name__ == "__main__":
    typer.run(main)
