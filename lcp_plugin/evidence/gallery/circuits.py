"""Circuits with ideal diodes, a mixed problem, and relays, a problem in a box."""

from __future__ import annotations

import numpy as np

from ...problem.lcp import LCP
from .parameters import Count, Positive, Seed
from .scene import Scene, scene_builder


@scene_builder
def diode_bridge(*, current: float = 3.0, leak: Positive = 0.125, load: Positive = 0.375) -> Scene:
    """Full-wave rectifier with four ideal diodes: potentials are free, currents are not negative.

    Parameters
    ----------
    current
        Fed into the first terminal and out of the second, ampere; with either sign it flows through the load one way.
    leak
        Conductance between the terminals, siemens.
    load
        Conductance of the load, siemens.

    Notes
    -----
    Unknowns: potentials of terminals 1, 2 and of the load's ends 3, 4 in volt, then the currents of the diodes 1→3,
    2→3, 4→1, 4→2 in ampere. Rows: Kirchhoff's current law in each node (equations), and no forward voltage across a
    diode. M = [[G, A], [−Aᵀ, 0]] is positive semidefinite, half of its diagonal may be zero. The load's lower end is
    earthed through 1 siemens, so that it lies at 0 volt; two diodes conduct, and the terminals are
    |current|/(leak + load) apart.

    References
    ----------
    Acary, Bonnefon, Brogliato, *Nonsmooth Modeling and Simulation for Switched Circuits*, Springer 2011,
    doi:10.1007/978-90-481-9681-4.
    """
    G = np.array([[leak, -leak, 0, 0], [-leak, leak, 0, 0], [0, 0, load, -load], [0, 0, -load, load + 1.0]])
    A = np.array([[1, 0, -1, 0], [0, 1, 0, -1], [-1, -1, 0, 0], [0, 0, 1, 1]])
    M = np.block([[G, A], [-A.T, np.zeros((4, 4))]])
    voltage = abs(current) / (leak + load)
    through = voltage * load
    forward = current >= 0.0
    potentials = [voltage * forward, voltage * (not forward), voltage, 0.0]
    currents = [through * forward, through * (not forward), through * (not forward), through * forward]
    exact = np.array(potentials + currents)
    lower = np.repeat([-np.inf, 0.0], 4)
    return Scene(
        problem=LCP(M, np.array([-current, current, 0, 0, 0, 0, 0, 0]), lower=lower),
        exact=exact,
    )


@scene_builder
def relay_control(*, n: Count = 20, seed: Seed = 0) -> Scene:
    """Relays that steer a system to its sliding surfaces in one implicit Euler step: z in [−1, 1], skew M.

    Parameters
    ----------
    n
        Number of relays.
    seed
        Of the generator that draws everything.

    Notes
    -----
    z_i = 1 where the surface is still to be reached from above (w_i < 0), −1 from below, between where the system
    slides. M = D + K with D diagonal and positive and K skew and much larger: positive definite, far from dominant,
    so that relaxation methods go astray; the answer is unique. It is planted, multiples of ¼, some relays exactly at
    the switch (|z_i| = 1 and w_i = 0).

    References
    ----------
    Acary, Brogliato, *Implicit Euler numerical scheme and chattering-free implementation of sliding mode systems*,
    Systems & Control Letters 59, 2010.
    """
    generator = np.random.default_rng(seed)
    above = np.triu(generator.integers(-4, 5, (n, n)), 1).astype(np.float64)
    M = np.diag(generator.integers(1, 4, n)) + above - above.T
    exact = np.clip(generator.integers(-6, 7, n) / 4.0, -1.0, 1.0)
    w = np.where(np.abs(exact) == 1.0, -exact * generator.integers(0, 4, n), 0.0)
    return Scene(
        problem=LCP(M, w - M @ exact, lower=-1.0, upper=1.0),
        exact=exact,
        is_symmetric=not above.any(),
        is_h_plus=not above.any(),
    )
