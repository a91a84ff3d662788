"""Robot motions as tracking references for other projects; docs/learning.md lists each format's contents.

`deepmimic` and `csv` have the same 19 numbers a frame: root x, y, z, quaternion x, y, z, w, joints; a cycle loops in
DeepMimic's (`Wrap`): its last frame is its first, moved by the cycle. `amp` has the 61 numbers that AMP_for_hardware's
loader reads, feet and velocities in the body frame. Velocities of bodies are those of their frames, in world axes.
`motion-lib` leaves out the pickle and the `pose_aa` of PHC's and ASAP's libraries, which is of their skeletons.

Joints are about the common axes in `deepmimic` and `csv`, which are read back here, else about the model file's own.
"""

import io
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.conventions import JOINT_NAMES
from fastmimic.base.errors import ConfigError, check_positive, unknown
from fastmimic.base.files import packaged, replace_file
from fastmimic.base.rotations import (
    quat_continuous,
    quat_from_yaw,
    quat_multiply,
    quat_rotate_inverse,
    rotate_planar,
    turned_about_z,
    yaw_from_quat,
)
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot

EXPORTS: Final = {
    **{"mjlab": ".npz", "deepmimic": ".txt", "csv": ".csv"},
    **{"isaaclab": ".npz", "amp": ".txt", "motion-lib": ".npz"},
}  # format -> file suffix
_ARCHIVES: Final = packaged("fastmimic.motion", "exports.json", dict[str, dict[str, str]])
"""Of the formats with arrays: what each calls ours."""
DEFAULT_FPS: Final = 50.0
REPEATED_S: Final = 10.0  # default duration of a cycle in a format that does not loop
DECIMALS: Final = 6  # of numbers in text


@dataclass(frozen=True, eq=False)
class Frames:
    """A motion at evenly spaced times, with its cycles one after another. Root position (t, 3) m, quaternion (t, 4),
    linear and angular velocity (t, 3) m/s and rad/s, in the world frame; joints (t, 12) rad and rad/s."""

    fps: float
    root_pos_w: Array
    root_quat_wxyz: Array
    joint_pos: Array
    joint_vel: Array
    root_lin_vel_w: Array
    root_ang_vel_w: Array

    @property
    def n(self) -> int:
        return len(self.root_pos_w)


def export_motion(
    motion: Motion,
    robot: Robot,
    path: str | Path,
    form: str,
    *,
    fps: float = DEFAULT_FPS,
    duration_s: float | None = None,
) -> Frames:
    """Writes a motion, without its demonstration, for another trainer, over any existing file; returns the frames.

    `form` is one of `EXPORTS`; `fps` for a cycle the nearest rate that divides it evenly; `duration_s` the length, s,
    if None all of a motion, of a cycle one in a format that loops, else `REPEATED_S`. Raises `ConfigError` for a bad
    argument, `MotionError` for another robot's motion, `OutputError` if writing fails.
    """
    if form not in EXPORTS:
        raise unknown("format", form, EXPORTS)
    motion.check_robot(robot.name)
    looping = form == "deepmimic" and motion.cycle is not None and duration_s is None
    frames = sample(motion, fps, duration_s, looping=looping)
    if form == "deepmimic":
        about = {"Robot": robot.name, "Joints": list(JOINT_NAMES)}
        content = _framed("Wrap" if looping else "Clamp", frames.fps, about, _rows(frames))
    else:
        content = _archive(form, frames, robot) if form in _ARCHIVES else _TEXTS[form](frames, robot)
    replace_file(path, lambda file: file.write(content))
    return frames


def sample(motion: Motion, fps: float, duration_s: float | None = None, *, looping: bool = False) -> Frames:
    """A motion at evenly spaced times; `fps` and `duration_s` as in `export_motion`. With `looping`, one cycle followed
    by its first frame moved by the cycle. Raises `ConfigError` for a bad rate or duration."""
    if not (math.isfinite(fps) and 0 < fps <= motion.rate_hz):
        raise ConfigError(f"frames a second must be above 0 and at most the motion's {motion.rate_hz:g}, found {fps:g}")
    if duration_s is not None:
        check_positive(duration_s, "the duration", shown=f"{duration_s:g}")
    whole = motion.period_s - motion.dt
    if motion.cycle is not None:
        per_cycle = max(2, round(motion.period_s * fps))
        fps = per_cycle / motion.period_s
        length = motion.period_s if looping else duration_s if duration_s is not None else REPEATED_S
    else:
        length = whole if duration_s is None else duration_s
        if length > whole + 1e-9:
            raise ConfigError(f"the motion does not repeat and lasts {whole:g} s; found a duration of {length:g} s")
    count = math.floor(length * fps + 1e-6) + 1
    if count < 2:
        raise ConfigError(f"{length:g} s at {fps:g} frames a second are less than two frames")
    at = np.arange(count) / fps * motion.rate_hz
    before = np.floor(at + 1e-9).astype(np.int64)
    share = np.clip(at - before, 0.0, 1.0)
    first, second = at_samples(motion, before), at_samples(motion, before + (share > 0))
    second[1] = np.where(np.sum(first[1] * second[1], axis=1, keepdims=True) < 0, -second[1], second[1])
    mixed = [(1 - share[:, None]) * a + share[:, None] * b for a, b in zip(first, second, strict=True)]
    mixed[1] = quat_continuous(mixed[1] / np.linalg.norm(mixed[1], axis=1, keepdims=True))
    return Frames(fps, *mixed)


def at_samples(motion: Motion, index: NDArray[np.int64]) -> list[Array]:
    """The motion (t, …) at samples (t,) that may lie in later cycles, in the order of `Frames`."""
    n = motion.n_samples
    if motion.cycle is None:
        step, lap, index = np.zeros(3), np.zeros_like(index), np.minimum(index, n - 1)
    else:
        step, lap, index = motion.cycle, index // n, index % n
    shift = np.zeros((int(lap.max()) + 1, 2))
    for k in range(1, len(shift)):
        shift[k] = shift[k - 1] + rotate_planar(np.array((k - 1) * step[2]), step[:2])
    turn = lap * step[2]
    origin = motion.root_pos_w[0, :2]
    heading = float(yaw_from_quat(motion.root_quat_wxyz[0]))
    position = np.array(motion.root_pos_w[index])
    position[:, :2] = origin + rotate_planar(heading, shift[lap]) + rotate_planar(turn, position[:, :2] - origin)
    velocities = [turned_about_z(v[index], turn) for v in (motion.root_lin_vel_w, motion.root_ang_vel_w)]
    quat = quat_multiply(quat_from_yaw(turn), motion.root_quat_wxyz[index])
    return [position, quat, np.array(motion.joint_pos[index]), np.array(motion.joint_vel[index]), *velocities]


def _rows(frames: Frames) -> Array:
    return np.hstack([frames.root_pos_w, frames.root_quat_wxyz[:, [1, 2, 3, 0]], frames.joint_pos])


def _csv(frames: Frames, _: Robot) -> bytes:
    header = ["time", *(f"root_{axis}" for axis in "xyz"), *(f"root_q{axis}" for axis in "xyzw"), *JOINT_NAMES]
    lines = [",".join(header)]
    for i, row in enumerate(_rows(frames)):
        lines.append(",".join(f"{value:.{DECIMALS}f}" for value in (i / frames.fps, *row)))
    return ("\n".join(lines) + "\n").encode()


def _framed(loop: str, fps: float, about: dict[str, Any], rows: Array) -> bytes:
    """JSON text with a line for each frame, as DeepMimic's family has it."""
    offsets = {"EnableCycleOffsetPosition": True, "EnableCycleOffsetRotation": True}
    head = {"LoopMode": loop, "FrameDuration": 1 / fps, **offsets, **about}
    listed = ",\n".join(f"  [{', '.join(f'{value:.{DECIMALS}f}' for value in row)}]" for row in rows)
    said = "".join(f"{json.dumps(name)}: {json.dumps(value)},\n" for name, value in head.items())
    return f'{{\n{said}"Frames":\n[\n{listed}\n]\n}}\n'.encode()


def _amp(frames: Frames, robot: Robot) -> bytes:
    from fastmimic.robot.kinematics import foot_jacobians, foot_positions

    feet = foot_positions(robot, frames.joint_pos)
    moving = np.einsum("tlij,tlj->tli", foot_jacobians(robot, frames.joint_pos), frames.joint_vel.reshape(-1, 4, 3))
    velocities = [quat_rotate_inverse(frames.root_quat_wxyz, v) for v in (frames.root_lin_vel_w, frames.root_ang_vel_w)]
    pose = [frames.root_pos_w, frames.root_quat_wxyz[:, [1, 2, 3, 0]], robot.joint_sign * frames.joint_pos]
    speeds = [robot.joint_sign * frames.joint_vel, moving.reshape(-1, 12)]
    about = {"MotionWeight": 1.0, "Robot": robot.name, "Joints": list(robot.joint_names)}
    return _framed("Clamp", frames.fps, about, np.hstack([*pose, feet.reshape(-1, 12), *velocities, *speeds]))


_TEXTS: Final = {"csv": _csv, "amp": _amp}


def _archive(form: str, frames: Frames, robot: Robot) -> bytes:
    """An `.npz` with real numbers of single precision, but the rate."""
    known: dict[str, NDArray[Any]] = {
        "root_pos_w": frames.root_pos_w,
        "root_quat_xyzw": frames.root_quat_wxyz[:, [1, 2, 3, 0]],
        "joint_names": np.array(robot.joint_names),
        "joint_pos": robot.joint_sign * frames.joint_pos,
        "joint_vel": robot.joint_sign * frames.joint_vel,
    }
    wanted = _ARCHIVES[form]
    if "body_names" in wanted:
        known |= body_states(frames, robot)
    arrays = {name: known[own] for name, own in wanted.items()}
    plain: dict[str, Any] = {k: v.astype(np.float32) if v.dtype == np.float64 else v for k, v in arrays.items()}
    out = io.BytesIO()
    np.savez_compressed(out, fps=np.array([frames.fps] if form == "mjlab" else frames.fps), **plain)
    return out.getvalue()


def body_states(frames: Frames, robot: Robot) -> dict[str, NDArray[Any]]:
    """All bodies of the robot, the base first: `body_names` (b,), `body_pos_w` (t, b, 3), `body_quat_w` (t, b, 4),
    `body_lin_vel_w` and `body_ang_vel_w` (t, b, 3) of the bodies' frames in world axes."""
    import mujoco

    model = robot.spec().compile()
    data = mujoco.MjData(model)
    joints = [model.joint(name).id for name in robot.joint_names]
    positions, speeds = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
    bodies = range(1, model.nbody)
    pos, quat, lin, ang = (np.zeros((frames.n, len(bodies), k)) for k in (3, 4, 3, 3))
    velocity, turning, inverse = np.zeros(6), np.zeros(3), np.zeros(4)
    for i in range(frames.n):
        data.qpos[:3], data.qpos[3:7] = frames.root_pos_w[i], frames.root_quat_wxyz[i]
        data.qpos[positions] = frames.joint_pos[i]
        mujoco.mju_negQuat(inverse, frames.root_quat_wxyz[i])
        mujoco.mju_rotVecQuat(turning, frames.root_ang_vel_w[i], inverse)
        data.qvel[:3], data.qvel[3:6] = frames.root_lin_vel_w[i], turning
        data.qvel[speeds] = frames.joint_vel[i]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        pos[i], quat[i] = data.xpos[1:], data.xquat[1:]
        for k in bodies:
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, k, velocity, 0)
            ang[i, k - 1], lin[i, k - 1] = velocity[:3], velocity[3:]
    names = np.array([model.body(k).name for k in bodies])
    return {"body_names": names, "body_pos_w": pos, "body_quat_w": quat, "body_lin_vel_w": lin, "body_ang_vel_w": ang}
