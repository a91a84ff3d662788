"""DeepMimic-style JSON of the Laikago: 19 numbers a frame, as distributed with Peng et al. (2020).

The joint angles belong to the Laikago's model, so the clip holds that robot's points: abduction joint origins as hips
and foot centres as toes. The formulas agree with the simulated model to 1e-5 m. A file that names another `Robot`
(`fastmimic.motion.export`) holds that robot's points.

Frames of adversarial motion priors have velocities and feet beside the 19 numbers. 61 numbers are those of
AMP_for_hardware (Escontrela et al. 2022): root position 3 and quaternion x, y, z, w; joints 12, feet from the root in
its axes 12, velocities of root 3 + 3, joints 12 and feet 12. 49 numbers are these without the feet's velocities, or
root, its velocities 3 + 3, joints 12, their velocities 12, and feet from the root in world axes. Such files differ in
the order of the legs, and name no robot: forward kinematics of the right ones gives the file's feet. Their root may be
the trunk's centre of mass, as PyBullet's is: all feet are then off by the same few millimetres.
"""

import json
import re
from itertools import islice, product
from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.conventions import FRONT, JOINT_NAMES, LARGEST, LEFT
from fastmimic.base.errors import ClipError, check_positive, did_you_mean
from fastmimic.base.rotations import quat_conjugate, quat_multiply, quat_rotate, quat_rotate_inverse, rotate_planar
from fastmimic.clips.clip import Clip, ClipOrigin
from fastmimic.clips.formats.points import robot_points, unit_wxyz_from_xyzw
from fastmimic.clips.formats.text_table import check_frames, check_rate
from fastmimic.robot.robot import ROBOT_NAMES, Robot, load_robot

FRAME_NAMES: Final = (*(f"root {axis}" for axis in "xyz"), *(f"root quaternion {a}" for a in "xyzw"), *JOINT_NAMES)
LOOP_MODES: Final = ("Wrap", "Clamp")
_CLOSED_RAD: Final = 0.01
_LOOP_KEYS: Final = ("LoopMode", "EnableCycleOffsetPosition", "EnableCycleOffsetRotation")  # kept in `ClipOrigin.loop`
_ROBOT_KEY: Final = "Robot"  # in files of `fastmimic.motion.export`: the robot of the joints, in place of the Laikago

# The Laikago's model, m. Rows are FR, FL, RR, RL.
_SIDE: Final = np.where(LEFT, 1.0, -1.0)
_ABDUCTION_ORIGIN_B: Final = np.stack([np.where(FRONT, 0.1991, -0.2382), 0.0817 * _SIDE, np.full(4, -0.03)], -1)
_HIP_OFFSET: Final = _SIDE * np.where(LEFT, 0.055855, 0.053565)
_THIGH: Final = np.stack([np.full(4, -0.1422), -0.02069 * _SIDE, np.full(4, -0.20833)], axis=-1)
_CALF: Final = np.array([-0.022, 0.0, -0.25])
_MODEL_TO_BODY_WXYZ: Final = np.array([0.5, 0.5, 0.5, 0.5])
"""Orientation in the file of a Laikago that stands with x forward and z up."""
LEG_LENGTH_M: Final = float(np.hypot(0.1422, 0.20833) + np.hypot(0.022, 0.25))  # thigh plus calf in the leg's plane


_ORDERS: Final = {"FR, FL, RR, RL": (0, 1, 2, 3), "FL, FR, RL, RR": (1, 0, 3, 2)}
_MOST_OFF_M: Final = 0.01  # RMS; an A1's feet are 0.02 off with the lengths of a Go1's or a Go2's legs
_ROOT_OFF_M: Final = (0.001, 0.005)  # from which on the file has another root, and its greatest height, or legs differ
_LAYOUTS: Final = {61: ((7, 19, False),), 49: ((7, 19, False), (13, 37, True))}
"""For each number of columns: the first of the joints and of the feet, and whether the feet are in world axes."""


def parse(text: str, *, robot: Robot | None = None, fps: float | None = None) -> Clip:
    """Reads the text of a motion file; `robot` must be the file's `Robot` if it names one, and `fps` replaces
    1/FrameDuration. Raises `ClipError`: malformed; says where."""
    document = _load(text)
    frames = _frames(document, text)
    check_frames(len(frames))
    loop, assumed = _loop_mode(document)
    rate = _rate(document) if fps is None else float(fps)
    check_rate(rate)
    quat_file = unit_wxyz_from_xyzw(frames[:, 3:7], lambda i: f"line {_frame_line(text, i)} (frame {i})")
    of = document.get(_ROBOT_KEY)
    own, joints = None if of is None else _named(of, robot), frames[:, 7:]
    with_feet = frames.shape[1] in _LAYOUTS
    if with_feet:
        own, joints, root_b, found = _identify(frames, quat_file, own or robot)
        assumed.append(found)
        frames = np.concatenate([frames[:, :3] - quat_rotate(quat_file, root_b), frames[:, 3:]], axis=1)
    gap = float(np.max(np.abs(joints[-1] - joints[0])))
    if with_feet and loop == "Wrap" and gap > _CLOSED_RAD:
        loop = None
        assumed.append("whether the motion loops is found from the motion: it says so, but its ends differ")
    if loop == "Wrap":  # the last frame repeats the first
        if gap > _CLOSED_RAD:
            assumed.append(f"the loop does not close exactly: joints of first and last frame differ by {gap:.2f} rad")
        frames, joints, quat_file = frames[:-1], joints[:-1], quat_file[:-1]
    if own is not None:
        from fastmimic.robot.kinematics import foot_positions

        quat = quat_file
        points = robot_points(frames[:, :3], quat, own.hip_pos_b, foot_positions(own, joints))
    else:
        assumed.append("joint angles are the Laikago's, retargeted through its foot positions")
        quat = quat_multiply(quat_file, quat_conjugate(_MODEL_TO_BODY_WXYZ))
        points = robot_points(frames[:, :3], quat, _ABDUCTION_ORIGIN_B, laikago_feet(joints))
    said: dict[str, Any] = {key: document[key] for key in _LOOP_KEYS if key in document}
    return Clip(
        points_w=points,
        rate_hz=rate,
        root_quat_wxyz=quat,
        is_cycle=True if loop == "Wrap" else False if loop == "Clamp" else None,
        leg_length_m=LEG_LENGTH_M if own is None else own.leg_length,
        scale=None if of is None else 1.0,
        origin=ClipOrigin(robot=of, loop=said, assumed=tuple(assumed)),
    )


def laikago_feet(joint_pos: Array) -> Array:
    """Foot centres (..., 4, 3), m, of the Laikago in its base frame (x forward, z up). `joint_pos` (..., 12), rad, has
    the legs in the common order and the signs of the Laikago's model."""
    angles = np.reshape(joint_pos, (*np.shape(joint_pos)[:-1], 4, 3))
    abduction, hip, knee = angles[..., 0], angles[..., 1], angles[..., 2]
    about_x, about_y = [1, 2], [2, 0]
    calf = _turned(np.broadcast_to(_CALF, (*knee.shape, 3)), knee, about_y)
    thigh = _turned(_THIGH + calf, hip, about_y)
    thigh[..., 1] += _HIP_OFFSET
    return _ABDUCTION_ORIGIN_B + _turned(thigh, _SIDE * abduction, about_x)


def _turned(v: Array, angle: Array, plane: list[int]) -> Array:
    """Vectors (..., 3) turned by `angle` (...) in the plane of two axes."""
    out = np.array(v)
    out[..., plane] = rotate_planar(angle, out[..., plane])
    return out


def _identify(frames: Array, quat_wxyz: Array, robot: Robot | None) -> tuple[Robot, Array, Array, str]:
    """The robot of `frames` (t, 49 or 61), its joints (t, 12) in the common order, rad, the file's root from the
    robot's (3,), m, in its axes, and a sentence on what was found. The trunk has the orientation `quat_wxyz` (t, 4);
    `robot` is tried besides the built-in ones. Raises `ClipError` if the feet are those of none."""
    from fastmimic.robot.kinematics import foot_positions

    robots = [*([robot] if robot is not None else []), *(load_robot(name) for name in ROBOT_NAMES)]
    found, least = None, np.inf
    for columns, (title, order), own, turned in product(_LAYOUTS[frames.shape[1]], _ORDERS.items(), robots, (0, 1)):
        joints, feet = _legs(frames, columns[0], order).reshape(-1, 12), _legs(frames, columns[1], order)
        joints = joints * own.joint_sign**turned  # about the common axes, or those of the robot's file
        feet_b = quat_rotate_inverse(quat_wxyz[:, None], feet) if columns[2] else feet
        apart = foot_positions(own, joints) - feet_b
        distance = float(np.linalg.norm(root_b := apart.mean(axis=(0, 1))))
        root_b = root_b if distance > _ROOT_OFF_M[0] and abs(root_b[2]) < _ROOT_OFF_M[1] else np.zeros(3)
        off = float(np.sqrt(np.mean(np.sum((apart - root_b) ** 2, axis=-1))))
        if off < least - 1e-9:
            said = f"joints are the {own.name}'s, legs {title}: the feet in the file are {1e3 * off:.1f} mm off its"
            if root_b.any():
                said += f", and its root is {1e3 * distance:.1f} mm from the robot's"
            found, least = (own, joints, root_b, said), off
    if found is None or least > _MOST_OFF_M:
        tried = ", ".join(dict.fromkeys(own.name for own in robots))
        said = f"the joints belong to none of {tried}: the feet in the file are {least:.2f} m off or more"
        raise ClipError(f"{said}; read it with the robot that they belong to (--robot FILE)")
    return found


def _legs(frames: Array, first: int, order: tuple[int, ...]) -> Array:
    """Twelve columns as (t, 4, 3), legs in the common order."""
    return frames[:, first : first + 12].reshape(-1, 4, 3)[:, list(order)]


def _named(name: Any, robot: Robot | None) -> Robot:
    if robot is not None and robot.name == name:
        return robot
    if robot is not None or name not in ROBOT_NAMES:
        given = "" if robot is None else f", not '{robot.name}'"
        raise ClipError(f"the joints are those of robot {json.dumps(name)[:40]}{given}; read it with that robot")
    return load_robot(name)


def _load(text: str) -> dict[str, Any]:
    try:
        document = json.loads(text)
    except json.JSONDecodeError as error:
        near_end = not text[error.pos :].strip() or error.pos >= len(text) - 1
        hint = "; the file may be truncated" if near_end else ""
        raise ClipError(f"line {error.lineno}, column {error.colno}: not valid JSON ({error.msg}){hint}") from None
    except (ValueError, RecursionError) as error:  # a number of thousands of digits; thousands of brackets
        raise ClipError(f"not usable JSON ({str(error).split(';')[0]})") from None
    if not isinstance(document, dict):
        raise ClipError('JSON without an object; expected {"LoopMode": …, "FrameDuration": …, "Frames": …}')
    return document


def _frames(document: dict[str, Any], text: str) -> Array:
    """All frames, (t, 19), or (t, 49) or (t, 61) with velocities and feet."""
    if "Frames" not in document:
        found = ", ".join(repr(name[:30]) for name in list(document)[:6]) or "nothing"
        raise ClipError(f"JSON without 'Frames'{did_you_mean('Frames', document)}; found {found}")
    frames = document["Frames"]
    if not isinstance(frames, list) or not all(isinstance(frame, list) for frame in frames):
        raise ClipError("'Frames' must be a list of lists of numbers")
    names = FRAME_NAMES
    if frames and len(frames[0]) in _LAYOUTS:
        names = (*FRAME_NAMES[:7], *["joints, feet or velocities"] * (len(frames[0]) - 7))
    for i, frame in enumerate(frames):
        if len(frame) != len(names):
            kinds = "root position 3, root quaternion xyzw 4, joints 12; or 49 or 61 with velocities and feet"
            where = f"line {_frame_line(text, i)} (frame {i})"
            raise ClipError(f"{where} has {len(frame)} numbers; expected {len(names)} ({kinds})")
        for c, value in enumerate(frame):
            if isinstance(value, bool) or not isinstance(value, int | float):
                problem = f"{json.dumps(value)[:20]} is not a number"
            elif not abs(value) <= LARGEST:
                problem = f"{str(value)[:20]} is {'too large' if abs(value) < np.inf else 'not finite'}"
            else:
                continue
            raise ClipError(f"line {_frame_line(text, i)} (frame {i}), number {c + 1} ({names[c]}): {problem}")
    return np.array(frames, dtype=np.float64).reshape(len(frames), len(names))


def _frame_line(text: str, index: int) -> int:
    """1-based line at which a frame starts: frames are the innermost lists after the key."""
    key = text.find('"Frames"')
    frame = next(islice(re.finditer(r"\[[^\[\]]*\]", text[key:]), index, None), None)
    return text.count("\n", 0, key if frame is None else key + frame.start()) + 1


def _loop_mode(document: dict[str, Any]) -> tuple[str | None, list[str]]:
    if "LoopMode" not in document:
        return None, ["whether the motion loops is found from the motion: the file has no LoopMode"]
    mode = document["LoopMode"]
    if mode not in LOOP_MODES:
        raise ClipError(f"LoopMode is {json.dumps(mode)[:40]}; expected one of {', '.join(LOOP_MODES)}")
    return str(mode), []


def _rate(document: dict[str, Any]) -> float:
    if "FrameDuration" not in document:
        raise ClipError("JSON without 'FrameDuration' (s); give the frame rate")
    duration = document["FrameDuration"]
    if isinstance(duration, bool) or not isinstance(duration, int | float) or not abs(duration) <= LARGEST:
        raise ClipError(f"FrameDuration is {json.dumps(duration)[:40]}; expected a number of seconds")
    check_positive(duration, "FrameDuration", ClipError, f"{duration:g} s")
    return 1.0 / duration if duration > 1e-9 else np.inf
