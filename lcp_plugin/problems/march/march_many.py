"""march(): time stepping for one or many problems, such as strikes of an option."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from ...auto import parse_call
from ...core.algorithm import Algorithm
from ...core.checks import checked_vector, is_number
from ...core.deadline import Clock
from ...core.errors import InvalidOption, InvalidProblem, did_you_mean
from ...core.lcp import LCP
from ...core.problem_classes import class_of, refusal, takes
from ...core.settings import OF_SOLVE, Settings, whole_number
from ..cones.data import Blocks
from ..many.data import length_of_all, rows_of_a_batch
from . import March, checked_propagator, checked_rows, take_steps, take_steps_on_band

BOUNDS = "lower", "upper"
# options of `march`, not of `solve`
OF_MARCH = "problem", "forcing", "propagator", *BOUNDS, "algorithm", "keep"


@np.errstate(all="ignore")
def march(
    problem: LCP | Blocks | Sequence[LCP],
    forcing: ArrayLike,
    propagator: Any = -1.0,
    *,
    lower: ArrayLike | None = None,
    upper: ArrayLike | None = None,
    z0: ArrayLike | None = None,
    algorithm: str | Algorithm = "auto",
    max_seconds: float | None = None,
    keep: int | str = 1,
    **wishes: Any,
) -> Any:
    """Return the results of steps in time: step j has q = forcing[j] + propagator @ z, z from the step before.

    If forcing, z0, lower or upper have an additional first axis, or if problem or propagator is a list, m marches run
    one after the other.

    Parameters
    ----------
    problem : LCP or ConeProblem or FrictionalContact, or a list of m LCPs
        Gives M and the bounds or cones; its q is not used. In a list, one problem per march.
    forcing : array, shape (k, n), or (m, k, n) for m marches
        One row per step; use ``np.broadcast_to(row, (k, n))`` for constant forcing.
    propagator : number or array or sparse array, shape (n, n), or a list of m of these
        Map from the z of one step to its contribution to the next q; a number means a multiple of the identity. An
        implicit Euler step (I + Δt A) z = z_before has −1.
    lower, upper : number or array, shape (n,) or (m, n), optional
        Replace the bounds of an LCP.
    z0 : array, shape (n,) or (m, n), optional
        The state before the first step; by default the point of [lower, upper] nearest to 0.
    max_seconds : float, optional
        Wall-clock limit in seconds for all marches together. The current step is then the last step.
    keep : int or "last"
        Steps that the result contains: every k-th step and the last, or the last only. Other steps are dropped as soon
        as the next step is taken, which saves memory; the derivative of a march needs all steps.
    algorithm, **wishes
        Other options of :func:`lcp_plugin.solve`, for each step.

    Returns
    -------
    March, or a list of m of them
        A sequence of k Results. The sequence is shorter after Ctrl-C, after a step that was not solved, or if the q of
        a step overflows (see ``error``). Ctrl-C and a callback also end the other marches.

    Raises
    ------
    InvalidOption, InvalidProblem, UnknownAlgorithm, UnsuitableProblem
        Before the first step.

    Notes
    -----
    Each step starts from the solution of the previous step, and has its own certificate. On narrow bands, for which
    `auto` uses `banded`, all steps run in one compiled loop, certificates included. Otherwise `auto` chooses in the
    first two steps; later steps start with the method that finished the previous step. If few rows have a bound,
    as in contact, the others are eliminated by one factorization for all steps, if that is cheaper. A march of 1000
    steps and 10⁴ unknowns takes 80 MB; for longer ones set `keep`.

    A θ-scheme for B ż + A z = f, (B + θ Δt A) z = (B − (1 − θ) Δt A) z_before + Δt f, has M = B + θ Δt A, the
    propagator (1 − θ) Δt A − B and the forcing −Δt f. Crank–Nicolson, θ = ½, is of order 2 after data with a kink only
    with damping: take four implicit half steps first, with the same M, the propagator −B and the forcing
    −½ Δt f (Rannacher 1984).

    Contacts with friction on elastic bodies: W has displacements by forces. A slow load determines, step by step, the
    gaps without contact and the tangential displacements from the step before. Use the propagator −W with zeros in the
    rows of the normals, because the slip is the tangential displacement of a step. If contacts change, W changes: use
    ``solve(FrictionalContact(W, b, friction), z0=result.z)`` for each step instead of `march`.

    References
    ----------
    R. Rannacher, *Finite element solution of diffusion problems with irregular data*, Numer. Math. 43 (1984),
    doi:10.1007/BF01390130.

    Examples
    --------
    >>> rod = LCP([[3, -1], [-1, 3]], [0, 0], upper=1)  # cools in two steps, heated on the left
    >>> [z.round(3) for z in march(rod, [[-1, 0], [-1, 0]], z0=[1, 1]).z]
    [array([0.875, 0.625]), array([0.781, 0.469])]
    >>> [done.z[-1].round(3) for done in march(rod, [[-1, 0], [-1, 0]], z0=[1, 1], upper=[[1, 1], [0.5, 1]])]
    [array([0.781, 0.469]), array([0.5  , 0.333])]
    >>> stiffer = LCP([[4, -2], [-2, 4]], [0, 0], upper=1)
    >>> [done.z[-1].round(3) for done in march([rod, stiffer], [[-1, 0], [-1, 0]], z0=[1, 1])]
    [array([0.781, 0.469]), array([0.722, 0.528])]
    """
    of_states = lower, upper, z0
    is_list = isinstance(problem, (list, tuple))
    are_many = is_list or _is_one_a_march(propagator) or _axes(forcing) == 3
    are_many = are_many or 2 in map(_axes, of_states)
    problems: list[Any] = [*problem] if is_list else [problem]  # type: ignore[misc]
    if not problems:
        return []
    clock, limit = Clock(), Settings(max_seconds=max_seconds).max_seconds
    given = zip((*BOUNDS, "z0"), of_states, strict=True)
    states = {name: values for name, values in given if values is not None}
    marches = _begin(problems, forcing, propagator, states, algorithm, wishes, are_many=are_many)
    every = 0 if keep == "last" else whole_number(keep, "keep", 1, ', or "last"')
    for k, one in enumerate(marches):
        one.keep = every
        take_steps_on_band(one, algorithm, wishes, limit - clock.read())
        take_steps(one, algorithm, wishes, max(limit - clock.read(), 0.0))
        if one.is_interrupted:
            for later in marches[k + 1 :]:
                later.all_solved = not len(later.forcing)
            break
    return marches if are_many else marches[0]


def _axes(values: Any) -> int:
    """Return the number of axes of an argument."""
    try:
        return np.ndim(values)
    except ValueError:  # rows of different lengths, which later raise InvalidProblem
        return 0


def _begin(
    problems: list[Any],
    forcing: ArrayLike,
    propagator: Any,
    states: dict[str, Any],
    algorithm: str | Algorithm,
    wishes: dict[str, Any],
    *,
    are_many: bool,
) -> list[March]:
    """Return the marches before their first steps; raise an error for invalid data."""
    n = getattr(problems[0], "n", 0)
    for j, one in enumerate(problems):
        if not takes("march", one):
            raise InvalidOption(refusal("march", one))
        if not isinstance(one, LCP) and states.keys() - {"z0"}:
            raise InvalidOption(
                f"lower and upper of a march are bounds of an LCP; a {class_of(one)} has none"
            )
        if one.n != n:
            raise InvalidProblem(
                f"all problems must have one size, got n = {n}, and {one.n} of problem {j}; "
                "call march once per size"
            )
    if algorithm == "auto" and (unknown := [name for name in wishes if name not in OF_SOLVE]):
        raise InvalidOption(
            f"march has no option {unknown[0]!r}{did_you_mean(unknown[0], (*OF_MARCH, *OF_SOLVE))}"
        )
    shape = "(m, k, n), or (k, n) for all marches" if are_many else "(k, n), a row a step"
    axes = (2, 3) if are_many else (2,)
    given = checked_rows(
        "forcing", forcing, f"{shape}, n = {n}", lambda of: len(of) in axes and of[-1] == n
    )
    each = propagator if _is_one_a_march(propagator) else [propagator]
    several: dict[str, Any] = {
        "problem": problems,
        "forcing": [given] if given.ndim == 2 else list(given),
        "propagator": [checked_propagator(C, n) for C in each],
    }
    for name, values in states.items():
        several[name] = rows_of_a_batch(values, name, n) if are_many else [values]
    if isinstance(problems[0], LCP):
        parse_call(algorithm, wishes)
    lengths = {name: len(one) for name, one in several.items() if len(one) != 1}
    marches: list[March] = []
    for j in range(length_of_all(lengths)):
        own = {name: one[min(j, len(one) - 1)] for name, one in several.items()}
        stated, bounds = own["problem"], {name: own[name] for name in BOUNDS if name in own}
        stated = stated.with_q(stated.q, **bounds) if bounds else stated
        state = checked_vector(own["z0"], "z0", n) if "z0" in own else stated.nearest_to_zero
        marches.append(March(stated, own["forcing"], own["propagator"], state))
    return marches


def _is_one_a_march(propagator: Any) -> bool:
    """Return whether the argument is a sequence of propagators: sparse arrays, or a batch axis."""
    if sp.issparse(propagator) or is_number(propagator):
        return False
    if isinstance(propagator, (list, tuple)) and any(map(sp.issparse, propagator)):
        return True
    return _axes(propagator) in (1, 3)  # numbers, or matrices
