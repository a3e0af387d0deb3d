"""A step of spheres poured into a box, beside engines of others: its time, and what residual its impulses leave.

Seconds are of the processor. MuJoCo and Drake, where they are installed, make their own contacts of the same spheres,
with their own softness, and their time includes that; Siconos (see ``cones``) and 50 sweeps of projected Gauss–Seidel
get ours. The residual is ours throughout, of the impulses that an engine has, in the contacts that it has: 1 where
nothing is done. Of all steps the later half counts, when the spheres lie.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from typing import Any

import numpy as np

from lcp_plugin import FrictionalContact, solve

from .cones import SICONOS, SYSTEM_PYTHON, Pile, fifty_sweeps, has_siconos, siconos_answer

FRICTION, SWEEPS, SAMPLES = 0.5, 50, 8
#: Seconds of a step, contacts and residual.
Steps = list[tuple[float, int, float]]


def run(*, quick: bool = False) -> Iterator[str]:
    """Yield a line for each engine and size."""
    for count, steps in ((8, 10),) if quick else ((30, 1000), (100, 300)):
        engines: dict[str, Steps] = {"lcp_plugin": [], f"{SWEEPS} sweeps": []}
        later: list[tuple[FrictionalContact, Any]] = []
        unsolved = 0
        for number, (problem, start, seconds, is_solved) in enumerate(_ours(count, steps, engines)):
            unsolved += not is_solved
            later += [(problem, start)] * (number % max(steps // SAMPLES, 1) == 0 and seconds > 0.0)
        yield _line(count, "lcp_plugin", engines["lcp_plugin"], f", {unsolved} of {steps} unsolved")
        yield _line(count, f"{SWEEPS} sweeps", engines[f"{SWEEPS} sweeps"])
        for name in SICONOS if has_siconos() else ():
            found = [(*siconos_answer(name, problem, start), problem) for problem, start in later]
            told: Steps = [(seconds, one.slope.size, residual) for seconds, residual, one in found]
            yield _line(count, f"Siconos {name}", told, f", {len(told)} of these steps")
        for name, module, way in (
            ("MuJoCo", "mujoco", _mujoco),
            ("Drake (SAP)", "pydrake", _drake),
        ):
            if find_spec(module) is not None:
                yield _line(count, name, list(way(Pile(count), steps)))
    if not has_siconos():
        yield f"without Siconos: {SYSTEM_PYTHON} has none; apt-get install python3-siconos python3-scipy"
    for name, module, package in (("MuJoCo", "mujoco", "mujoco"), ("Drake", "pydrake", "drake")):
        if find_spec(module) is None:
            yield f"without {name}: it is not installed; pip install {package}"


def _line(count: int, name: str, steps: Steps, more: str = "") -> str:
    seconds, contacts, residuals = (
        np.array(column) for column in zip(*steps[len(steps) // 2 :], strict=True)
    )
    median = float(np.median(seconds))
    return (
        f"{count} spheres, {name}: {1e3 * median:.2f} ms a step, worst {1e3 * seconds.max():.1f}, "
        f"{int((seconds > 3.0 * median).sum())} later than 3 × the median, {int(np.median(contacts))} contacts, "
        f"residual {np.median(residuals):.0e}{more}"
    )


def _ours(
    count: int, steps: int, engines: dict[str, Steps]
) -> Iterator[tuple[FrictionalContact, Any, float, bool]]:
    """Yield each step's problem, start, seconds, and whether it is solved; add it, and that of sweeps, to the lists."""
    pile, kept = Pile(count), dict[Any, Any]()
    for _ in range(steps):
        problem, rows, pairs = pile.contacts()
        start = np.concatenate([kept.get(pair, np.zeros(3)) for pair in pairs])
        began = time.process_time()
        result = solve(problem, z0=start, max_seconds=2.0)
        seconds = time.process_time() - began
        engines["lcp_plugin"].append((seconds, len(pairs), result.certificate.relative_residual))
        spent, residual = fifty_sweeps(problem, start, time.process_time)
        engines[f"{SWEEPS} sweeps"].append((spent, len(pairs), residual))
        yield problem, start, seconds, result.is_solved
        kept = dict(zip(pairs, result.z.reshape(-1, 3), strict=True))
        pile.move(rows, result.z)


def _residual(pile: Pile, velocities: Any, contacts: list[tuple[int, int, Any, Any, Any]]) -> float:
    """Return the residual of contacts (body, body, point, normal, impulse), of bodies with these velocities without."""
    if not contacts:
        return 0.0
    J, r = np.zeros((3 * len(contacts), velocities.size)), []
    for k, (one, other, point, n, impulse) in enumerate(contacts):
        t = np.cross(n, np.eye(3)[np.argmin(np.abs(n))])
        frame = np.array([n, t / np.linalg.norm(t), np.cross(n, t) / np.linalg.norm(t)])
        for body, sign in ((one, 1.0), (other, -1.0)):
            if body >= 0:
                arms = np.cross(point - pile.at[body], frame)
                J[3 * k : 3 * k + 3, 6 * body : 6 * body + 6] = sign * np.hstack([frame, arms])
        r.append(frame @ impulse)
    problem = FrictionalContact(J / pile.mass @ J.T, J @ velocities, FRICTION, dimension=3)
    return float(
        solve(problem, z0=np.concatenate(r), max_iterations=0).certificate.relative_residual
    )


def _walls(pile: Pile) -> list[tuple[Any, Any]]:
    """Return the inward normal and a point of the ground and the four sides."""
    normals = [np.eye(3)[2], *(sign * np.eye(3)[k] for k in (0, 1) for sign in (1.0, -1.0))]
    return [(n, np.zeros(3) if n[2] else -pile.half * n) for n in normals]


def _mujoco(pile: Pile, steps: int) -> Iterator[tuple[float, int, float]]:
    import mujoco

    def geom(kind: str, place: Any, rest: str) -> str:
        return f'<geom type="{kind}" pos="{" ".join(map(str, place))}" friction="{FRICTION} 0 0" {rest}/>'

    walls = "".join(
        geom("plane", at, f'size="9 9 1" zaxis="{" ".join(map(str, n))}"') for n, at in _walls(pile)
    )
    balls = "".join(
        f'<body pos="{" ".join(map(str, at))}"><freejoint/>'
        f'{geom("sphere", np.zeros(3), f"""size="{pile.radius}" density="1000" condim="3" """)}</body>'
        for at in pile.at
    )
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{pile.step}" cone="elliptic" gravity="0 0 -9.81"/>'
        f"<worldbody>{walls}{balls}</worldbody></mujoco>"
    )
    data, force = mujoco.MjData(model), np.zeros(6)
    for _ in range(steps):
        before = data.qvel.reshape(-1, 6).copy()
        # to the world's axes
        before[:, 3:] = np.einsum("bij,bj->bi", data.xmat[1:].reshape(-1, 3, 3), before[:, 3:])
        began = time.process_time()
        mujoco.mj_step(model, data)
        seconds = time.process_time() - began
        contacts = []
        for k in range(data.ncon):
            mujoco.mj_contactForce(model, data, k, force)
            one, two = (int(model.geom_bodyid[geom]) - 1 for geom in data.contact[k].geom)
            # its normal from the first to the second
            frame = np.array(data.contact[k].frame).reshape(3, 3)
            contacts.append(
                (two, one, np.array(data.contact[k].pos), frame[0], frame.T @ force[:3] * pile.step)
            )
        before[:, 2] -= 9.81 * pile.step
        yield seconds, len(contacts), _residual(pile, before.ravel(), contacts)
        pile.at = data.qpos.reshape(-1, 7)[:, :3].copy()


def _drake(pile: Pile, steps: int) -> Iterator[tuple[float, int, float]]:
    from pydrake.geometry import HalfSpace, Sphere
    from pydrake.math import RigidTransform
    from pydrake.multibody.plant import (
        AddMultibodyPlantSceneGraph,
        CoulombFriction,
        DiscreteContactApproximation,
    )
    from pydrake.multibody.tree import SpatialInertia
    from pydrake.systems.analysis import Simulator
    from pydrake.systems.framework import DiagramBuilder

    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, pile.step)
    plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
    rough = CoulombFriction(FRICTION, FRICTION)
    for k, (n, at) in enumerate(_walls(pile)):
        plant.RegisterCollisionGeometry(
            plant.world_body(), HalfSpace.MakePose(n, at), HalfSpace(), f"wall{k}", rough
        )
    bodies = []
    for k in range(len(pile.at)):
        body = plant.AddRigidBody(
            f"ball{k}", SpatialInertia.SolidSphereWithMass(pile.mass[6 * k], pile.radius)
        )
        plant.RegisterCollisionGeometry(
            body, RigidTransform(), Sphere(pile.radius), f"ball{k}", rough
        )
        bodies.append(body)
    plant.Finalize()
    diagram = builder.Build()
    simulator = Simulator(diagram)
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    number = {body.index(): k for k, body in enumerate(bodies)}
    for body, at in zip(bodies, pile.at, strict=True):
        plant.SetFreeBodyPose(context, body, RigidTransform(at))
    simulator.Initialize()

    def state(read: Callable[[Any], Any]) -> Any:
        return np.array([read(body) for body in bodies])

    for number_of_step in range(steps):
        twist = state(lambda body: plant.EvalBodySpatialVelocityInWorld(context, body).get_coeffs())
        before = np.hstack([twist[:, 3:], twist[:, :3]])
        began = time.process_time()
        simulator.AdvanceTo((number_of_step + 1) * pile.step)
        seconds = time.process_time() - began
        found, contacts = plant.get_contact_results_output_port().Eval(context), []
        for k in range(found.num_point_pair_contacts()):
            one = found.point_pair_contact_info(k)
            pair = [number.get(index, -1) for index in (one.bodyB_index(), one.bodyA_index())]
            # Its normal leads from B to A, and the force acts on B.
            contacts.append(
                (
                    *pair,
                    one.contact_point(),
                    -one.point_pair().nhat_BA_W,
                    one.contact_force() * pile.step,
                )
            )
        before[:, 2] -= 9.81 * pile.step
        yield seconds, len(contacts), _residual(pile, before.ravel(), contacts)
        pile.at = state(lambda body: plant.EvalBodyPoseInWorld(context, body).translation())
