"""Friction coefficients learned from a film: sledges that stick and slip.

Three sledges hang together by springs, and another spring pulls the first of them at a constant speed. Each sticks
until the springs overcome its friction, then it slips. In a step of length Δt friction gives a sledge the impulse z, at
most μ m g Δt: at less the sledge sticks, and at the limit it slides against it. With v = A⁻¹(z + b) the speeds,

    −μ m g Δt ≤ z ≤ μ m g Δt;   v = 0 where z is between,  v ≥ 0 where it is at the lower limit,  v ≤ 0 at the upper,

and A = m I + Δt² K by the implicit step of the springs K. This is an LCP with bounds: M = A⁻¹, q = A⁻¹ b, and its
derivative by μ comes in through the bounds, goes through the speeds into the next step, and so through the whole film.
Gauss–Newton steps then find the coefficients from noisy positions. The check: the coefficients behind the film.

Source: Burridge, Knopoff, Bull. Seismol. Soc. Am. 57, 1967 (sledges and springs, as a model of earthquakes).
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import typer
from scipy.optimize import least_squares

from lcp_plugin import LCP, derivative, solve

PLANTED, GUESS = np.array([0.30, 0.50, 0.20]), np.array([0.45, 0.30, 0.40])
MASS, GRAVITY, PULL = 1.0, 9.81, 0.25  # kg, m/s², m/s
STEP, STEPS, NOISE = 0.02, 300, 0.01  # s, –, m: standard deviation of a measured position
STIFF = 40.0  # N/m, of every spring
SPRINGS = STIFF * np.array([[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])
M = np.linalg.inv(MASS * np.eye(3) + STEP**2 * SPRINGS)
SLEDGES = LCP(M, np.zeros(3))  # with_q shares the facts about M


def film(friction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the positions after each step, (steps, 3), and their derivative by the coefficients, (steps, 3, 3)."""
    place, speed = np.zeros(3), np.zeros(3)
    by_friction = np.zeros((2, 3, 3))  # of place and speed
    limit = MASS * GRAVITY * STEP
    places, derivatives = [], []
    for k in range(STEPS):
        pull = np.array([STIFF * PULL * STEP * (k + 1), 0.0, 0.0])
        q = M @ (MASS * speed + STEP * (pull - SPRINGS @ place))
        step = SLEDGES.with_q(q, lower=-friction * limit, upper=friction * limit)
        at = derivative(solve(step))
        speed = M @ at.z + q
        place = place + STEP * speed
        dq = M @ (MASS * by_friction[1] - STEP * SPRINGS @ by_friction[0])
        for j, unit in enumerate(np.eye(3)):
            dz = at.jvp(dq=dq[:, j], dlower=-limit * unit, dupper=limit * unit)
            by_friction[1, :, j] = at.dw(dz, dq=dq[:, j])
        by_friction[0] += STEP * by_friction[1]
        places.append(place)
        derivatives.append(by_friction[0].copy())
    return np.array(places), np.array(derivatives)


class Fit:
    """Residuals for least squares: distance from the measured film, derivative, coefficients tried."""

    def __init__(self, measured: np.ndarray) -> None:
        self.measured, self.tried, self.last = measured, [], None

    def distances(self, friction: np.ndarray) -> np.ndarray:
        """Return places less measured ones, (3 · steps,)."""
        self.tried.append(friction.copy())
        places, self.last = film(friction)
        return (places - self.measured).ravel()

    def derivative(self, friction: np.ndarray) -> np.ndarray:
        """Return the derivative of the distances of the last evaluation, (3 · steps, 3)."""
        if not np.array_equal(self.tried[-1], friction):
            self.distances(friction)
        return self.last.reshape(-1, 3)

    def learn(self) -> np.ndarray:
        """Return the coefficients of least squares."""
        return least_squares(
            self.distances, GUESS, self.derivative, xtol=1e-12, ftol=1e-14, gtol=1e-14
        ).x


def main(out: Path = Path()) -> None:
    """Learn the coefficients from a noisy film, compare with the known ones, save a figure into the folder OUT."""
    true, _ = film(PLANTED)
    noisy = Fit(true + NOISE * np.random.default_rng(1).standard_normal(true.shape))
    learned, exact = noisy.learn(), Fit(true).learn()
    by_friction = noisy.derivative(learned)
    spread = NOISE * np.sqrt(np.diag(np.linalg.inv(by_friction.T @ by_friction)))
    for k in range(3):
        print(
            f"sledge {k + 1}: known {PLANTED[k]:.4f}, guessed {GUESS[k]:.4f}, "
            f"learned {learned[k]:.4f} ± {spread[k]:.4f}"
        )
    print(f"{len(noisy.tried)} films of {STEPS} steps")
    print(
        f"check: from a film without noise the coefficients differ from the known ones by "
        f"{abs(exact - PLANTED).max():.1e}, from one with {1000 * NOISE:g} mm of noise by "
        f"{abs(learned - PLANTED).max():.1e}"
    )

    plt.style.use(Path(__file__).with_name("plots.mplstyle"))
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(10.4, 4.4), width_ratios=[1.5, 1], layout="constrained"
    )
    seconds, places, guessed = STEP * np.arange(1, STEPS + 1), film(learned)[0], film(GUESS)[0]
    for k, color in enumerate(("#0072B2", "#D55E00", "#009E73")):
        behind = -0.6 * k
        left.plot(
            seconds[::6],
            behind + noisy.measured[::6, k],
            ".",
            color=color,
            markersize=4,
            alpha=0.55,
        )
        left.plot(seconds, behind + places[:, k], color=color, linewidth=1.6)
        left.plot(seconds, behind + guessed[:, k], color=color, linewidth=1, linestyle=(0, (4, 3)))
        left.text(
            seconds[-1] + 0.1, behind + places[-1, k], f"sledge {k + 1}", color=color, va="center"
        )
        right.plot([one[k] for one in noisy.tried], "o-", color=color, linewidth=1.6, markersize=4)
        right.axhline(PLANTED[k], color=color, linewidth=1, linestyle=":")
        right.text(
            len(noisy.tried) - 1,
            PLANTED[k] + 0.007,
            f"known {PLANTED[k]:.2f}",
            color=color,
            ha="right",
        )
    left.set(
        xlabel="time (s)",
        ylabel="position (m)",
        title="Dots: measured. Dashed: the first guess. Lines: learned",
    )
    right.set(
        xlabel="films computed",
        ylabel="friction coefficient μ",
        title="Learning, by the exact derivative",
    )
    figure.savefig(out / "learn_friction.png", dpi=150)


if __name__ == "__main__":
    typer.run(main)
