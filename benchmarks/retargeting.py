"""Retargeting compared on quadrupeds: ours, plain per-frame inverse kinematics, and the published motions of the same
clips.

    python benchmarks/retargeting.py [--motions dog:trot …] [--robot a1] [--episodes 8] [--duration 10] [--json]
                                     [--write]

Methods: `executable` and `kinematic` are the package's; `scaled` is its `RetargetConfig(consistent=False)`, the
published rule (Peng et al. 2020) closed and filtered; `mink` is the same rule, frame by frame, by differential inverse
kinematics in mink (extra `bench`) with the joints' ranges as limits; `published` are motion_imitation's own motions of
these cuts, at a Laikago's size and on its joints. All are measured at the animal's frames (60 Hz) of one cycle, by the
phase of the cycle. The last two have no cycle that closes: to run them they go through `scaled`, mink's with the
contacts of `scaled`, the published ones at the robot's size. Time is that of one processor, without solutions
remembered from before. `--write` puts the table into docs/retargeting.md. Needs `fastmimic data fetch`, or
FASTMIMIC_DATA.
"""

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from docs_table import put
from numpy.typing import NDArray

import fastmimic as fm
from fastmimic.base.arrays import Array
from fastmimic.base.errors import FastMimicError
from fastmimic.base.rotations import (
    matrix_from_quat,
    quat_conjugate,
    quat_continuous,
    quat_multiply,
    quat_rotate,
    rotate_planar,
    rotvec_from_quat,
    trunk_quaternion,
)
from fastmimic.clips.clip import Clip
from fastmimic.clips.data import data_folder
from fastmimic.clips.formats import read_clip
from fastmimic.clips.formats.deepmimic import laikago_feet
from fastmimic.clips.formats.points import robot_points
from fastmimic.episode.loop import share_of_falls
from fastmimic.motion.motion import Motion
from fastmimic.retargeting.config import RetargetConfig
from fastmimic.retargeting.retarget import choose_scale, retarget
from fastmimic.retargeting.track import extract
from fastmimic.robot import Robot
from fastmimic.robot.kinematics import foot_positions
from fastmimic.trajectory import solved

PAGE = Path(__file__).resolve().parent.parent / "docs" / "retargeting.md"
MOTIONS = ("dog:pace", "dog:trot", "dog:left-turn", "dog:right-turn", "dog:canter")
PUBLISHED = {"dog:pace": "dog_pace.txt", "dog:trot": "dog_trot.txt", "dog:left-turn": "dog_spin.txt"}  # the same cuts
SCALED = RetargetConfig(consistent=False)
SUNK_M = 0.001  # deeper is penetration
LOW_M, SLOW_M_PER_S = 0.015, 0.3  # a foot that is lower, and slower over the ground, stands
TOE_OUT_M = 0.05  # of the published configuration for the A1
LAIKAGO_FOOT_M = 0.03  # radius, and ranges of the joints: `laikago_toes_limits.urdf` of PyBullet's data
LAIKAGO_RANGE = np.tile([[-0.873, 1.0472], [-1.3, 3.4], [-2.164, 0.0]], (4, 1))


@dataclass(frozen=True, eq=False)
class Course:
    """A robot's motion at the animal's frames of one cycle: root (t, 3) m and (t, 4) wxyz, joints (t, 12) rad, foot
    centres (t, 4, 3) m, in the world. `ranges` (12, 2) and `fastest` (12,) are limits, None if unknown; `abduction`
    (4,) is the sign of these joints about the forward axis."""

    rate_hz: float
    root_pos: Array
    root_quat: Array
    joints: Array
    feet: Array
    radius: float
    ranges: Array
    fastest: Array | None
    abduction: Array

    @classmethod
    def of_robot(cls, robot: Robot, rate_hz: float, root_pos: Array, root_quat: Array, joints: Array) -> "Course":
        feet = root_pos[:, None] + quat_rotate(root_quat[:, None], foot_positions(robot, joints))
        ranges = np.stack([robot.joint_lower, robot.joint_upper], axis=-1)
        limits = robot.foot_radius, ranges, robot.joint_speed_limit, np.ones(4)
        return cls(rate_hz, root_pos, root_quat, joints, feet, *limits)

    @classmethod
    def of_motion(cls, robot: Robot, motion: Motion, frames: int) -> "Course":
        """A cycle at the frames' phases."""
        at = np.arange(frames) * motion.n_samples / frames

        def read(values: Array) -> Array:
            return np.stack([np.interp(at, np.arange(len(values)), column) for column in values.T], axis=-1)

        quat = read(quat_continuous(motion.root_quat_wxyz))
        quat /= np.linalg.norm(quat, axis=-1, keepdims=True)
        return cls.of_robot(robot, frames / motion.period_s, read(motion.root_pos_w), quat, read(motion.joint_pos))

    @classmethod
    def published(cls, path: Path) -> "Course":
        """A file of motion_imitation on its own robot, the Laikago."""
        document = json.loads(path.read_text())
        frames = np.array(document["Frames"])[:-1]  # the last is the first
        clip = read_clip(path)
        assert clip.root_quat_wxyz is not None
        joints = frames[:, 7:]
        feet = frames[:, None, :3] + quat_rotate(clip.root_quat_wxyz[:, None], laikago_feet(joints))
        pose = frames[:, :3], clip.root_quat_wxyz, joints, feet
        return cls(clip.rate_hz, *pose, LAIKAGO_FOOT_M, LAIKAGO_RANGE, None, np.array([-1.0, 1.0, -1.0, 1.0]))

    @property
    def slides(self) -> Array:
        """(t − 1, 4) how far each foot's contact point moves over the ground from frame to frame, m: the sphere's
        centre less what it rolls."""
        rotation = matrix_from_quat(self.root_quat[:-1])
        turn = rotvec_from_quat(quat_multiply(self.root_quat[1:], quat_conjugate(self.root_quat[:-1])))
        angles = self.joints.reshape(-1, 4, 3)
        step = np.diff(angles, axis=0)
        lean = self.abduction * angles[:-1, :, 0]
        pitch = step[..., 1] + step[..., 2]
        joint_turn = np.stack([self.abduction * step[..., 0], pitch * np.cos(lean), pitch * np.sin(lean)], axis=-1)
        omega = turn[:, None] + np.einsum("tij,tlj->tli", rotation, joint_turn)
        rolled = self.radius * np.stack([omega[..., 1], -omega[..., 0]], axis=-1)
        return np.asarray(np.linalg.norm(np.diff(self.feet[..., :2], axis=0) - rolled, axis=-1))


def at_phases(values: NDArray[Any], frames: int) -> NDArray[Any]:
    """The samples (t, …) of a cycle nearest to so many evenly spaced phases."""
    return values[np.round(np.arange(frames) * len(values) / frames).astype(int) % len(values)]


def aligned(animal: NDArray[np.bool_], course: Course) -> NDArray[np.bool_]:
    """The animal's contacts from the phase at which a course begins: where they fit the height of its feet best."""
    low = -(course.feet[..., 2] - course.feet[..., 2].min(axis=0)).ravel()
    shifted = [np.roll(animal, shift, axis=0) for shift in range(len(animal))]
    return max(shifted, key=lambda contacts: float(np.corrcoef(low, contacts.ravel())[0, 1]))


def measures(course: Course, animal: NDArray[np.bool_]) -> dict[str, float | None]:
    """Figures of a course; `animal` (t, 4) is where the animal's feet stand."""
    height, slides = course.feet[..., 2] - course.radius, course.slides
    stands = (height[:-1] < LOW_M) & (slides * course.rate_hz < SLOW_M_PER_S)
    kept = animal[:-1] & animal[1:] & np.roll(animal, 1, axis=0)[:-1]  # but for the frames of touch-down and lift-off
    stances = np.sum(animal & ~np.roll(animal, 1, axis=0))
    beyond = np.maximum(course.ranges[:, 0] - course.joints, course.joints - course.ranges[:, 1])
    speed = np.abs(np.diff(course.joints, axis=0)) * course.rate_hz
    return {
        "penetration_share": float(np.mean(height < -SUNK_M)),
        "penetration_mm": 1e3 * max(0.0, -float(height.min())),
        "hover_mm": 1e3 * float(np.maximum(height[animal], 0.0).mean()),
        "skating_mm": 1e3 * float(slides[kept].sum() / max(1, stances)),
        "contact_share": float(stands[kept].mean()),
        "beyond_range_share": float(np.any(beyond > 1e-3, axis=1).mean()),
        "too_fast_share": None if course.fastest is None else float(np.any(speed > course.fastest, axis=1).mean()),
        "jerk_rad_s3": float(np.sqrt(np.mean((np.diff(course.joints, n=3, axis=0) * course.rate_hz**3) ** 2))),
    }


def per_frame_ik(clip: Clip, robot: Robot) -> Course:
    """Each frame by itself, beginning where the last one ended: the scaled trunk, and each toe from its hip as the
    animal's, 5 cm further out, solved by mink within the joints' ranges."""
    import mink

    scale = choose_scale(clip, robot)
    source = extract(clip, scale, SCALED.roll_share)
    quat = trunk_quaternion(source.heading, source.tilt)
    lowered = SCALED.crouch_m * scale / 0.825
    rise = source.root_z - source.root_z.mean() + source.hip_height + robot.foot_radius - lowered
    root = np.column_stack([source.root_xy, rise])
    hips = robot.hip_pos_b[:, :2] + np.array([0.0, TOE_OUT_M]) * np.sign(robot.hip_pos_b[:, 1:2])
    toes_xy = source.root_xy[:, None] + rotate_planar(source.heading[:, None], hips + source.toe_from_hip)
    toes = np.concatenate([toes_xy, (source.toe_height + robot.foot_radius)[..., None]], axis=-1)

    model = robot.spec().compile()
    configuration = mink.Configuration(model)
    trunk = mink.FrameTask(model.body(1).name, "body", position_cost=1.0, orientation_cost=1.0)
    feet = [mink.FrameTask(name, "geom", position_cost=1.0, orientation_cost=0.0) for name in robot.foot_geoms]
    at = [int(model.joint(name).qposadr[0]) for name in robot.joint_names]
    limits = [mink.ConfigurationLimit(model)]
    q = np.zeros(model.nq)
    q[:3], q[3:7], q[at] = root[0], quat[0], robot.joint_sign * robot.home_joint_pos
    configuration.update(q)
    found = np.zeros((clip.n_frames, model.nq))
    for i in range(clip.n_frames):
        trunk.set_target(mink.SE3(np.concatenate([quat[i], root[i]])))
        for task, toe in zip(feet, toes[i], strict=True):
            task.set_target(mink.SE3.from_translation(toe))
        for _ in range(20 if i else 100):
            step = mink.solve_ik(configuration, [trunk, *feet], 1.0, "daqp", damping=1e-6, limits=limits)
            configuration.integrate_inplace(step, 1.0)
            if np.abs(step).max() < 1e-6:
                break
        found[i] = configuration.q
    joints = robot.joint_sign * found[:, at]
    return Course.of_robot(robot, clip.rate_hz, found[:, :3], found[:, 3:7], joints)


def closed(course: Course, robot: Robot, contact: NDArray[np.bool_]) -> Motion:
    """A robot's own frames as a cycle that can be run, with contacts (t, 4) at the motion's rate."""
    feet = foot_positions(robot, course.joints)
    points = robot_points(course.root_pos, course.root_quat, robot.hip_pos_b, feet)
    clip = Clip(points, course.rate_hz, root_quat_wxyz=course.root_quat, is_cycle=True, scale=1.0)
    return replace(retarget(clip, robot, config=SCALED, executable=False)[0], contact=contact)


def rows_of(name: str, robot: Robot, args: argparse.Namespace) -> list[dict[str, Any]]:
    """All methods on one clip."""
    clip = fm.open_clip(name, robot=robot)
    frames = clip.n_frames
    scaled = retarget(clip, robot, cycle=True, config=SCALED, executable=False)[0]
    animal = at_phases(scaled.contact, frames)  # as detected in the animal's own toes

    def ours(**options: Any) -> tuple[Course, Motion]:
        motion = retarget(clip, robot, cycle=True, **options)[0]
        return Course.of_motion(robot, motion, frames), motion

    def with_mink() -> tuple[Course, None]:
        return per_frame_ik(clip, robot), None

    methods: dict[str, Callable[[], tuple[Course, Motion | None]]] = {
        "executable": lambda: ours(falls=share_of_falls),
        "kinematic": lambda: ours(executable=False),
        "scaled": lambda: ours(config=SCALED, executable=False),
        "mink": with_mink,
    }
    rows: list[dict[str, Any]] = []
    for method, make in methods.items():
        began = time.process_time()
        try:
            course, motion = make()
        except FastMimicError as error:
            rows.append({"motion": name, "method": method, "error": str(error)})
            continue
        rate = frames / (time.process_time() - began)
        run = downstream(motion if motion is not None else closed(course, robot, scaled.contact), robot, args)
        rows.append({"motion": name, "method": method, "frames_per_s": rate, **measures(course, animal), **run})
    if name in PUBLISHED:
        path = data_folder() / "deepmimic_motions" / PUBLISHED[name]
        course = Course.published(path)
        found = aligned(at_phases(animal, len(course.joints)), course)
        run = downstream(retarget(read_clip(path), robot, config=SCALED, executable=False)[0], robot, args)
        rows.append({"motion": name, "method": "published", **measures(course, found), **run})
    for row in rows:
        print(" ".join(f"{k}={shown(v)}" for k, v in row.items()), file=sys.stderr, flush=True)
    return rows


def downstream(motion: Motion, robot: Robot, args: argparse.Namespace) -> dict[str, float | None]:
    """Falls and reward of the closed loop that follows a motion as it is; an executable one also against the animal."""
    found = fm.evaluate(motion, robot, episodes=args.episodes, duration_s=args.duration).as_dict()
    return {name: found.get(name) for name in ("fell", "reward_mean", "reward_animal", "success")}


def table(rows: list[dict[str, Any]]) -> str:
    """Rows as Markdown."""
    lines = [
        "| clip | method | penetration: share, depth, mm | standing feet above ground, mm | skating, mm a stance"
        " | contact kept | beyond range; too fast | joint jerk, rad/s³ | frames a second | fell | reward (animal) |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for row in rows:
        if "error" in row:
            lines.append(f"| `{row['motion']}` | {row['method']} | refused: {row['error']} | | | | | | | | |")
            continue
        fast = "–" if row["too_fast_share"] is None else f"{row['too_fast_share']:.0%}"
        rate = f"{row['frames_per_s']:.0f}" if "frames_per_s" in row else "–"
        animal = f" ({row['reward_animal']:.3f})" if row["reward_animal"] is not None else ""
        lines.append(
            f"| `{row['motion']}` | {row['method']} | {row['penetration_share']:.0%}, {row['penetration_mm']:.0f}"
            f" | {row['hover_mm']:.0f} | {row['skating_mm']:.0f} | {row['contact_share']:.0%}"
            f" | {row['beyond_range_share']:.0%}; {fast} | {row['jerk_rad_s3']:.0f} | {rate}"
            f" | {row['fell']:.0%} | {row['reward_mean']:.3f}{animal} |"
        )
    return "\n".join(lines)


def shown(value: Any) -> str:
    return f"{value:.3f}" if isinstance(value, float) else str(value)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--motions", nargs="+", default=list(MOTIONS))
    parser.add_argument("--robot", default="a1")
    parser.add_argument("--episodes", type=int, default=8)
    parser.add_argument("--duration", type=float, default=10.0)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--write", action="store_true")
    args = parser.parse_args()
    solved.PACKAGED = Path()  # the time is that of solving
    os.environ["XDG_CACHE_HOME"] = tempfile.mkdtemp()  # no solution is remembered from before
    robot = fm.load_robot(args.robot)
    warm = fm.open_clip("trot", robot=robot)  # what is compiled or imported is not a method's time
    fm.evaluate(retarget(warm, robot, falls=share_of_falls)[0], robot, duration_s=0.1)
    per_frame_ik(warm, robot)
    rows = [row for name in args.motions for row in rows_of(name, robot, args)]
    if args.json:
        print(json.dumps({"rows": rows}, indent=1))
    if args.write:
        put(PAGE, "retargeting", table(rows))


if __name__ == "__main__":
    main()
