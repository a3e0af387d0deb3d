"""The step of examples/mujoco_step.py against closed forms: stick, slip, a limit of a joint, an equality."""

from __future__ import annotations

import numpy as np
import pytest

mujoco = pytest.importorskip("mujoco", minversion="4")


def moved(text: str, steps: int = 500, **start: float):
    """Return the data after so many steps with exact cones."""
    from mujoco_step import step

    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qpos[:1] = start.get("position", data.qpos[:1])
    for _ in range(steps):
        step(model, data)
    return data


def test_a_box_on_a_slope_sticks_or_slides_by_the_closed_form():
    """On 30°, friction .6 holds, where MuJoCo creeps by 161 µm/s, and .5 slides with g (sin 30° − .5 cos 30°)."""
    from mujoco_step import speed, step

    assert abs(speed(step, 0.6)) < 1e-3
    assert 100 < speed(mujoco.mj_step, 0.6, impratio=10) < 200
    exact = 9.81e6 * (np.sin(np.pi / 6) - 0.5 * np.cos(np.pi / 6))
    assert speed(step, 0.5) == pytest.approx(exact, rel=1e-9)


JOINTS = """<mujoco><option timestep="0.002" cone="elliptic"/><worldbody>{bodies}</worldbody>{more}</mujoco>"""
PENDULUM = """<body><joint type="hinge" axis="0 1 0" limited="true" range="-30 30" margin=".05"/>
<geom type="capsule" fromto="0 0 0 .5 0 0" size=".02" mass="1"/></body>"""
MASS = """<body pos="{x} 0 1"><joint name="{name}" type="slide" axis="0 0 1" {more}/>
<geom type="sphere" size=".05" mass="{mass}" contype="0" conaffinity="0"/></body>"""


def test_a_pendulum_rests_at_the_limit_of_its_joint():
    """It falls to 30°, and neither passes the limit nor springs back."""
    data = moved(JOINTS.format(bodies=PENDULUM, more=""), position=0.4)
    assert data.qpos[0] == pytest.approx(np.pi / 6, abs=1e-9)
    assert abs(data.qvel[0]) < 1e-12


def test_two_masses_that_an_equality_couples_move_as_one():
    """q₂ = −q₁ is a pulley: masses 3 and 1 accelerate with g (3 − 1) / (3 + 1)."""
    bodies = MASS.format(x=0, name="a", mass=3, more="") + MASS.format(
        x=1, name="b", mass=1, more=""
    )
    more = '<equality><joint joint1="a" joint2="b" polycoef="0 -1 0 0 0"/></equality>'
    data = moved(JOINTS.format(bodies=bodies, more=more), steps=100)
    assert data.qvel.tolist() == pytest.approx([-0.2 * 9.81 / 2, 0.2 * 9.81 / 2], rel=1e-9)
