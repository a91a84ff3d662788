"""A solution of the optimal control problem as a motion: at the rate of the animal's, between the nodes as well."""

from dataclasses import replace
from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.rotations import (
    quat_from_yaw,
    quat_multiply,
    quat_rotate,
    quat_rotate_inverse,
    rotate_planar,
    trunk_quaternion,
)
from fastmimic.motion.motion import Motion
from fastmimic.robot.kinematics import foot_positions, inverse_kinematics
from fastmimic.trajectory.contact_modes import ContactModes, interpolated
from fastmimic.trajectory.program import Program, Solution, displacement

_MOMENT_S: Final = 1e-4  # for rates of joint angles
_SLOW_NODES: Final = 6  # over which a path between nodes is led back to them


def sampled(program: Program, solution: Solution) -> Motion:
    """The solution at the rate of the animal's motion; the period becomes a whole number of samples."""
    robot, animal, modes = program.robot, program.motion, program.modes
    last = max(2, round(solution.time[-1] * animal.rate_hz))
    n = last if modes.periodic else last + 1
    time = np.arange(n) * solution.time[-1] / last  # of the solution
    stretch = last / animal.rate_hz / solution.time[-1]
    wide = _Path(program, solution)
    root, rates = wide.root(time)
    before, joints, after = (wide.joints(time + moment) for moment in (-_MOMENT_S, 0.0, _MOMENT_S))
    contact = modes.contact[np.searchsorted(np.cumsum(solution.durations)[:-1], time + 1e-9, side="right")]
    motion = Motion(
        rate_hz=animal.rate_hz,
        root_pos_w=root[:, :3],
        root_quat_wxyz=trunk_quaternion(root[:, 5], root[:, 3:5]),
        joint_pos=joints,
        joint_vel=(after - before) / (2 * _MOMENT_S * stretch),
        foot_pos_b=foot_positions(robot, joints),
        contact=contact,
        root_lin_vel_w=rates[:, :3] / stretch,
        root_ang_vel_w=_angular_velocity(root, rates) / stretch,
        cycle=_cycle(program, solution, root[0]) if modes.periodic else None,
        provenance=animal.provenance,
    )
    return replace(motion, animal=aligned(animal, modes, solution, time))


def _cycle(program: Program, solution: Solution, root: Array) -> Array:
    """(dx, dy, dyaw) of a period in the heading frame of the first sample, from its x, y, …, yaw (6,)."""
    step, turn = program.displacement
    moved = rotate_planar(turn, root[:2]) + solution.stride * step - root[:2]
    return np.array([*rotate_planar(-root[5], moved), turn])


def aligned(animal: Motion, modes: ContactModes, solution: Solution, time: Array) -> Motion:
    """The animal's motion at the phases of the executable one at `time` (t,), s: its pose and velocities of the same
    share of the same contact mode."""
    nodes = np.append(modes.sample, modes.end[-1]) if modes.periodic else modes.sample
    sample = np.interp(time, solution.time, nodes)
    moved, turn = displacement(animal)

    def at(values: Array, following: Array) -> Array:
        return interpolated(values, following if modes.periodic else values[-1], sample)

    position = animal.root_pos_w - np.array([*animal.root_pos_w[0, :2], 0.0])
    end = np.array([*moved, position[0, 2]])
    following = quat_multiply(quat_from_yaw(turn), animal.root_quat_wxyz[0])
    if following @ animal.root_quat_wxyz[-1] < 0:
        following = -following
    quat = at(animal.root_quat_wxyz, following)

    def turned(vector: Array) -> Array:
        return np.array([*rotate_planar(turn, vector[:2]), vector[2]])

    return Motion(
        rate_hz=animal.rate_hz,
        root_pos_w=at(position, end),
        root_quat_wxyz=quat / np.linalg.norm(quat, axis=1, keepdims=True),
        joint_pos=at(animal.joint_pos, animal.joint_pos[0]),
        joint_vel=at(animal.joint_vel, animal.joint_vel[0]),
        foot_pos_b=at(animal.foot_pos_b, animal.foot_pos_b[0]),
        contact=animal.contact[np.minimum(np.floor(sample + 1e-9).astype(int), animal.n_samples - 1)],
        root_lin_vel_w=at(animal.root_lin_vel_w, turned(animal.root_lin_vel_w[0])),
        root_ang_vel_w=at(animal.root_ang_vel_w, turned(animal.root_ang_vel_w[0])),
        cycle=animal.cycle,
        provenance=animal.provenance,
    )


class _Path:
    """The solution as functions of time; a cycle's with the periods before and after it.

    Halfway between two nodes a path has the speed from one to the other, and from there to the next half way the
    node's own acceleration, so that it keeps the limits that the nodes keep. Where nodes are not evenly spaced it is
    led back to them slowly: it differs by less than 0.1 mm, a swinging foot by 1 mm.
    """

    def __init__(self, program: Program, solution: Solution) -> None:
        from scipy.interpolate import PchipInterpolator

        modes, q, time = program.modes, solution.coordinates, solution.time
        if modes.periodic:
            step, turn = solution.stride * program.displacement[0], program.displacement[1]
            before, after = q.copy(), q.copy()
            before[:, :2], before[:, 5] = rotate_planar(-turn, q[:, :2] - step), q[:, 5] - turn
            after[:, :2], after[:, 5] = rotate_planar(turn, q[:, :2]) + step, q[:, 5] + turn
            time, period = time[:-1], time[-1]
            q, time = np.concatenate([before, q, after]), np.concatenate([time - period, time, time + period])
        self.robot, turned = program.robot, trunk_quaternion(q[:, 5], q[:, 3:5])
        feet = q[:, None, :3] + quat_rotate(turned[:, None], foot_positions(program.robot, q[:, 6:]))
        self._root, self._feet, self._joints = (_smooth(time, values) for values in (q[:, :6], feet, q[:, 6:]))
        swings = np.tile(~modes.stands, (len(time) // modes.n_nodes + 1, 1))[: len(time)]
        self._swings = PchipInterpolator(time, np.repeat(swings, 3, axis=1).astype(float))

    def root(self, time: Array) -> tuple[Array, Array]:
        """Position, roll, pitch, yaw (t, 6) and their rates."""
        return self._root(time), self._root(time, 1)

    def joints(self, time: Array) -> Array:
        """Joint angles (t, 12): a standing leg's by its foot's path, a swinging one's by their own; between two nodes
        from the one to the other."""
        root = self._root(time)
        quat = trunk_quaternion(root[:, 5], root[:, 3:5])
        foot_b = quat_rotate_inverse(quat[:, None], self._feet(time) - root[:, None, :3])
        standing = np.unwrap(inverse_kinematics(self.robot, foot_b)[0], axis=0)
        return np.asarray(standing + self._swings(time) * (self._joints(time) - standing))


def _smooth(time: Array, values: Array) -> Any:
    """A path near values (n, …) at the nodes' times (n,); it begins and ends at the first and last of them."""
    from scipy.interpolate import CubicSpline, PPoly
    from scipy.ndimage import gaussian_filter1d

    flat = values.reshape(len(values), -1)
    speed = np.diff(flat, axis=0) / np.diff(time)[:, None]
    speed = np.concatenate([speed[:1], speed, speed[-1:]])
    at = np.concatenate([time[:1], 0.5 * (time[1:] + time[:-1]), time[-1:]])
    span = np.diff(at)[:, None]
    place = flat[0] + np.concatenate([0 * flat[:1], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * span, axis=0)])
    path = PPoly(np.stack([0.5 * np.diff(speed, axis=0) / span, speed[:-1], place[:-1]]), at)
    away = np.concatenate([flat[:1], 0.5 * (flat[1:] + flat[:-1]), flat[-1:]]) - place
    wide = np.pad(away, ((4 * _SLOW_NODES,) * 2, (0, 0)), "reflect", reflect_type="odd")
    back = CubicSpline(at, gaussian_filter1d(wide, _SLOW_NODES, axis=0)[4 * _SLOW_NODES : -4 * _SLOW_NODES])

    def moved(at: Array, derivative: int = 0) -> Array:
        return np.asarray((path(at, derivative) + back(at, derivative)).reshape(-1, *values.shape[1:]))

    return moved


def _angular_velocity(root: Array, rates: Array) -> Array:
    """(t, 3) rad/s, world, from roll, pitch, yaw and their rates in columns 3 to 5."""
    pitch, yaw = root[:, 4], root[:, 5]
    roll_rate, pitch_rate, yaw_rate = rates[:, 3:].T
    planar = rotate_planar(yaw, np.stack([np.cos(pitch) * roll_rate, pitch_rate], axis=1))
    return np.column_stack([planar, yaw_rate - np.sin(pitch) * roll_rate])
