"""A time step of MuJoCo with exact Coulomb cones: a body that sticks does not creep.

``step(model, data)`` takes the place of ``mujoco.mj_step``. It has elliptic contacts of condim 3, limits of joints, and
equalities; activations, sensors and friction of joints are left out. A margin of joints and geoms lets the step see a
limit before it is passed. It needs ``pip install 'mujoco>=4'``.
"""

import mujoco
import numpy as np

from lcp_plugin import FrictionalContact, solve


def step(model, data):
    """Advance the data by one time step; return the result of the contact problem, None without any constraint."""
    model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    mujoco.mj_forward(model, data)
    dt, kinds = model.opt.timestep, data.efc_type[: data.nefc]
    J = data.efc_J.reshape(-1, model.nv)
    velocities, result = data.qvel + dt * data.qacc_smooth, None
    touching = [c for c in data.contact[: data.ncon] if c.efc_address >= 0]
    first = np.array([c.efc_address for c in touching], int)
    limits = np.flatnonzero(kinds == mujoco.mjtConstraint.mjCNSTR_LIMIT_JOINT)
    equations = J[kinds == mujoco.mjtConstraint.mjCNSTR_EQUALITY]
    if first.size + limits.size + len(equations):
        mass = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, mass)
        at = np.append(first, limits)  # a limit is a contact without friction
        tangents = (
            np.stack([J[first + 1], J[first + 2]], axis=1)
            if first.size
            else np.zeros((0, 2, model.nv))
        )
        problem = FrictionalContact(
            (mass, J[at], np.append(tangents, np.zeros((limits.size, 2, model.nv)), axis=0)),
            velocities,
            np.append([c.friction[0] for c in touching], np.zeros(limits.size)),
            gaps=np.maximum(data.efc_pos[at], 0.0),
            time_step=dt,
            dimension=3,
            equations=equations,
        )
        result = solve(problem).require_solved()
        velocities = result.motion.body_velocities
    data.qvel[:] = velocities
    mujoco.mj_integratePos(model, data.qpos, data.qvel, dt)
    data.time += dt
    return result


SLOPE = """<mujoco><option timestep="0.002" cone="elliptic" impratio="{impratio}" gravity="4.905 0 -8.495709211125342"/>
<worldbody><geom type="plane" size="5 5 1" friction="{friction} .005 .0001"/><body pos="0 0 .05"><freejoint/>
<geom type="box" size=".1 .1 .05" mass="1" friction="{friction} .005 .0001"/></body></worldbody></mujoco>"""


def speed(advance, friction, impratio=1.0):
    """Return the speed in µm/s of a box after one second on a slope of 30°."""
    model = mujoco.MjModel.from_xml_string(SLOPE.format(friction=friction, impratio=impratio))
    data = mujoco.MjData(model)
    for _ in range(500):
        advance(model, data)
    return 1e6 * data.qvel[0]


if __name__ == "__main__":
    for impratio in (1, 10, 100):
        print(
            f"friction .6, MuJoCo with impratio {impratio}: {speed(mujoco.mj_step, 0.6, impratio):.1f} µm/s"
        )
    print(f"friction .6, exact cones: {speed(step, 0.6):.1f} µm/s")
    sliding = 9.81e6 * (np.sin(np.pi / 6) - 0.5 * np.cos(np.pi / 6))
    print(f"friction .5, exact cones: {speed(step, 0.5):.1f} µm/s; closed form {sliding:.1f} µm/s")
