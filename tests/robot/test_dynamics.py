"""Inverse dynamics of the legs against MuJoCo's recursive Newton-Euler and its mass matrix."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from fastmimic.base.conventions import GRAVITY
from fastmimic.base.rotations import quat_conjugate, quat_multiply, quat_rotate
from fastmimic.robot import ROBOT_NAMES, Robot, load_robot
from fastmimic.robot.dynamics import leg_torques
from fastmimic.robot.mjcf import robot_from_spec
from robot.mjcf import Simulated, a1_tree, find, random_joints, random_quat, write

UPWARDS = np.array([0.0, 0.0, GRAVITY])
EXACT = 1e-9  # N·m, on torques of up to some hundred


@pytest.fixture(scope="module", params=[*ROBOT_NAMES, "links in axes of their own"])
def robot(request: pytest.FixtureRequest) -> Robot:
    if request.param in ROBOT_NAMES:
        return load_robot(request.param)
    return robot_from_spec(with_turned_links(load_robot("a1"), np.random.default_rng(7)), "turned")


def with_turned_links(robot: Robot, generator: np.random.Generator) -> mujoco.MjSpec:
    """The same robot, the frames of whose hips, thighs and calves are turned anyhow, as some makers have them."""
    spec = mujoco.MjSpec.from_string(robot.xml)
    for body in spec.bodies:
        if not body.joints or body.joints[0].type == mujoco.mjtJoint.mjJNT_FREE:
            continue
        turn = random_quat(generator)
        back = quat_conjugate(turn)
        body.quat = quat_multiply(np.array(body.quat), turn)
        body.ipos, body.iquat = quat_rotate(back, body.ipos), quat_multiply(back, np.array(body.iquat))
        for joint in body.joints:
            joint.axis = quat_rotate(back, joint.axis)
        for part in (*body.geoms, *body.bodies):
            part.pos, part.quat = quat_rotate(back, part.pos), quat_multiply(back, np.array(part.quat))
    return spec


def moving(robot: Robot, generator: np.random.Generator) -> tuple[Simulated, np.ndarray, np.ndarray]:
    """MuJoCo in a random state of motion, with joint positions and velocities."""
    simulated = Simulated(robot)
    q, dq = random_joints(robot, generator), generator.normal(size=12) * 8
    simulated.pose(q, generator.normal(size=3), random_quat(generator))
    simulated.data.qvel[:] = generator.normal(size=simulated.model.nv)
    simulated.data.qvel[simulated.dofs] = dq
    return simulated, q, dq


@pytest.mark.nojit
def test_torques_agree_with_mujocos_inverse_dynamics(robot: Robot) -> None:
    generator = np.random.default_rng(4)
    for _ in range(50):
        simulated, q, dq = moving(robot, generator)
        ddq, base_acc_w = generator.normal(size=12) * 100, generator.normal(size=3) * 5
        base = simulated.base_dof
        simulated.data.qacc[:] = 0
        simulated.data.qacc[base : base + 3] = base_acc_w
        simulated.data.qacc[simulated.dofs] = ddq
        expected = inverse_dynamics(simulated)
        torques = leg_torques(
            robot,
            q[None],
            dq[None],
            ddq[None],
            simulated.data.qvel[None, base + 3 : base + 6],  # MuJoCo's free joint turns in the body frame
            ((base_acc_w + UPWARDS) @ simulated.rotation)[None],
        )
        np.testing.assert_allclose(torques[0], expected, rtol=0, atol=EXACT)


def test_the_acceleration_part_is_the_leg_block_of_the_mass_matrix(robot: Robot) -> None:
    generator = np.random.default_rng(5)
    simulated, q, dq = moving(robot, generator)
    mujoco.mj_forward(simulated.model, simulated.data)
    full = np.empty((simulated.model.nv, simulated.model.nv))
    mujoco.mj_fullM(simulated.model, simulated.data, full)
    base = np.zeros((12, 3))
    rest = leg_torques(robot, np.tile(q, (12, 1)), np.tile(dq, (12, 1)), np.zeros((12, 12)), base, base)
    unit = leg_torques(robot, np.tile(q, (12, 1)), np.tile(dq, (12, 1)), np.eye(12), base, base)
    np.testing.assert_allclose((unit - rest).T, full[np.ix_(simulated.dofs, simulated.dofs)], rtol=0, atol=EXACT)


def test_the_remainder_is_mujocos_bias_force(robot: Robot) -> None:
    generator = np.random.default_rng(6)
    simulated, q, dq = moving(robot, generator)
    mujoco.mj_forward(simulated.model, simulated.data)
    base = simulated.base_dof
    bias = leg_torques(
        robot,
        q[None],
        dq[None],
        np.zeros((1, 12)),
        simulated.data.qvel[None, base + 3 : base + 6],
        (UPWARDS @ simulated.rotation)[None],
    )
    np.testing.assert_allclose(bias[0], simulated.data.qfrc_bias[simulated.dofs], rtol=0, atol=EXACT)


def inverse_dynamics(simulated: Simulated) -> np.ndarray:
    """Joint torques from MuJoCo with contacts, limits and friction switched off, (12,)."""
    flags = mujoco.mjtDisableBit
    simulated.model.opt.disableflags |= int(flags.mjDSBL_CONSTRAINT) | int(flags.mjDSBL_ACTUATION)
    mujoco.mj_inverse(simulated.model, simulated.data)
    return simulated.data.qfrc_inverse[simulated.dofs].copy()


def test_links_beside_the_plane_of_the_hip_keep_their_place(tmp_path: Path) -> None:
    """With the knee 3 cm beside the hip, the feet depend on the sum of the offsets only; moments do not."""
    tree = a1_tree()
    for leg, side in (("FR", -1), ("FL", 1), ("RR", -1), ("RL", 1)):
        find(tree, "body", f"{leg}_calf").set("pos", f"0 {0.03 * side} -0.2")
    robot = load_robot(write(tree, tmp_path / "wide.xml"))
    generator = np.random.default_rng(8)
    simulated, q, dq = moving(robot, generator)
    mujoco.mj_forward(simulated.model, simulated.data)
    base = simulated.base_dof
    bias = leg_torques(
        robot,
        q[None],
        dq[None],
        np.zeros((1, 12)),
        simulated.data.qvel[None, base + 3 : base + 6],
        (UPWARDS @ simulated.rotation)[None],
    )
    np.testing.assert_allclose(bias[0], simulated.data.qfrc_bias[simulated.dofs], rtol=0, atol=EXACT)
