"""Retargeted robot motion as CSV: root position, root quaternion x, y, z, w and 12 joint angles, one frame a line. With
a header, columns are found by name in any order. Without one they are taken as x, y, z, qx, qy, qz, qw and the joints
in the order FR, FL, RR, RL, each abduction, hip, knee, and the clip says so.

The same as arrays is what trajectory optimisation with Pinocchio leaves (yusongmin1/go2_flip_TO): `q` (t, 19) with the
legs in the order FL, FR, RL, RR, and the steps `dt` (t,), s. Its `v` (t, 18) and the joints' names are not read."""

import io
import re
from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.conventions import JOINT_NAMES, LARGEST, LEGS
from fastmimic.base.errors import ClipError, did_you_mean
from fastmimic.base.files import UNREADABLE, open_arrays, packaged
from fastmimic.base.rotations import quat_rotate
from fastmimic.clips.clip import Clip, ClipOrigin
from fastmimic.clips.formats.format import Content
from fastmimic.clips.formats.points import robot_points, unit_wxyz_from_xyzw
from fastmimic.clips.formats.text_table import Table, check_frames, check_rate, read_table, to_array
from fastmimic.robot.robot import Robot

COLUMN_NAMES: Final = (*(f"root_{axis}" for axis in "xyz"), *(f"root_q{axis}" for axis in "xyzw"), *JOINT_NAMES)
COLUMNS: Final = len(COLUMN_NAMES)
DEFAULT_RATE_HZ: Final = 30.0  # of the common retargeted CSV data sets (Unitree's and others)

_SPELLINGS: Final = packaged("fastmimic.clips.formats", "column_names.json", dict[str, Any])
JOINT_SPELLINGS: Final = _SPELLINGS["joints"]
"""A file uses one row: FR_hip is the abduction next to FR_thigh, and the hip next to FR_abduction."""

_LEG_SPELLINGS: Final = _SPELLINGS["legs"]
_TIME_NAMES: Final = ("time", "t", "time_s", "timestamp", "seconds")
_MAX_ANGLE: Final = 2 * np.pi
_MIN_UPRIGHT: Final = 0.5


def parse(text: str, *, robot: Robot | None, fps: float | None = None) -> Clip:
    """Reads the text of a retargeted motion of `robot`; `fps` replaces the file's time column or the default. Raises
    `ClipError`: malformed (says which line and column), a joint without a column, or not upright."""
    table = read_table(text)
    header = table.header if table.header is not None and names_joints(table.header) else None
    columns, names = _columns(header)
    largest = [np.inf if name in _TIME_NAMES else LARGEST for name in names]  # a time may count from 1970
    unused = [c for c in range(len(names)) if c not in columns and names[c] not in _TIME_NAMES]
    values = to_array(table.rows, names, "retargeted motion", largest, unused=unused)
    rate, assumed = _rate(table, names, values, fps)
    if header is None:
        assumed.append("columns are root x y z, quaternion x y z w, then joints " + ", ".join(JOINT_NAMES))
    if unused:
        assumed.append("columns that are not used: " + ", ".join(names[c] for c in unused))
    motion = values[:, columns]
    _check_radians(motion[:, 7:], lambda i: f"line {table.rows[i].number}", [names[c] for c in columns[7:]])
    return _clip_of(motion, rate, robot, assumed, lambda i: f"line {table.rows[i].number} (frame {i})")


def _clip_of(motion: Array, rate_hz: float, robot: Robot | None, notes: list[str], where: Callable[[int], str]) -> Clip:
    """The clip of a robot's motion (t, 19); `where` gives a frame's place in the file."""
    from fastmimic.robot.kinematics import foot_positions

    if robot is None:
        raise ClipError("a retargeted motion holds joint angles: the robot that they belong to is needed")
    quat = unit_wxyz_from_xyzw(motion[:, 3:7], where)
    _check_upright(quat)
    return Clip(
        points_w=robot_points(motion[:, :3], quat, robot.hip_pos_b, foot_positions(robot, motion[:, 7:])),
        rate_hz=rate_hz,
        root_quat_wxyz=quat,
        leg_length_m=robot.leg_length,
        scale=1.0,
        origin=ClipOrigin(assumed=(*notes, f"joint angles are those of the {robot.name}"), robot=robot.name),
    )


def parse_arrays(data: bytes, *, robot: Robot | None, fps: float | None = None) -> Clip:
    """Reads q and dt of such an archive; the other arguments, and errors, as for `parse`."""
    try:
        with open_arrays(io.BytesIO(data)) as file:
            q, steps = (np.array(file[name], dtype=float) for name in ("q", "dt"))
    except UNREADABLE as error:
        raise ClipError(f"not a readable trajectory ({error})") from None
    if q.ndim != 2 or q.shape[1] != COLUMNS or steps.shape != q.shape[:1]:
        shapes = f"q of shape {q.shape} and dt of shape {steps.shape}"
        raise ClipError(f"{shapes}; expected (frames, {COLUMNS}) and (frames,)")
    check_frames(len(q))
    if not (np.isfinite(q).all() and np.abs(q).max() <= LARGEST):
        raise ClipError(f"q has numbers that are not finite or beyond {LARGEST:g}")
    if fps is None and not np.allclose(steps, steps[0], rtol=1e-3):
        uneven = f"dt goes from {steps.min():g} to {steps.max():g} s"
        raise ClipError(f"{uneven}; expected even steps, or give the frame rate")
    rate = fps if fps is not None else 1.0 / steps[0] if steps[0] > 0 else steps[0]
    check_rate(rate)
    q[:, 7:] = q[:, 7:].reshape(-1, 4, 3)[:, [1, 0, 3, 2]].reshape(-1, 12)
    _check_radians(q[:, 7:], lambda i: f"q, row {i}", JOINT_NAMES)
    return _clip_of(q, float(rate), robot, ["legs are in Pinocchio's order FL, FR, RL, RR"], lambda i: f"q, row {i}")


def detect(content: Content) -> bool:
    """Whether a text is a retargeted motion, by its header or the number of its columns."""
    return names_joints(content.table.header or []) or COLUMNS in content.columns


def names_joints(header: list[str]) -> bool:
    """Whether a line of names is the header of a retargeted motion."""
    legs = {leg for spellings in _LEG_SPELLINGS.values() for leg in spellings}
    joints = {joint for row in JOINT_SPELLINGS for joint in row}
    return any(leg in legs and joint in joints for leg, _, joint in (_plain(name).partition("_") for name in header))


def _columns(header: list[str] | None) -> tuple[list[int], list[str]]:
    """Indices of `COLUMN_NAMES` in the file, and the file's names of all its columns."""
    if header is None:
        return list(range(COLUMNS)), list(COLUMN_NAMES)
    plain = [_plain(name) for name in header]
    wanted = [_root_names(name) for name in COLUMN_NAMES[:7]] + _joint_names(plain)
    columns = []
    for name, spellings in zip(COLUMN_NAMES, wanted, strict=True):
        found = [c for c, column in enumerate(plain) if column in spellings]
        if len(found) != 1:
            problem = "no column" if not found else f"{len(found)} columns ({', '.join(plain[c] for c in found)})"
            hint = f"e.g. '{sorted(spellings)[0]}'{did_you_mean(name.lower(), plain)}"
            raise ClipError(f"the header has {problem} for {name}, {hint} (found: {', '.join(plain)[:300]})")
        columns.append(found[0])
    return columns, plain


def _plain(name: str) -> str:
    """A column's name in lower case without quotes, SI units and filler words."""
    name = name.strip().strip("\"'").lower()
    name = re.sub(r"\s*[\[(]\s*(m|s|rad|-|1)?\s*[\])]$", "", name)  # columns in other units must not match
    name = re.sub(r"[\s.\-/:]+", "_", name)
    return re.sub(r"(_(joint|pos|position|angle|rad))+$", "", name)


def _root_names(name: str) -> set[str]:
    quantities = _SPELLINGS["rotation" if name.startswith("root_q") else "position"]
    return {f"{base}{quantity}{name[-1]}" for base in _SPELLINGS["bases"] for quantity in quantities}


def _joint_names(plain: list[str]) -> list[set[str]]:
    """Accepted names of the twelve joints, in the spelling that fits most columns of this header."""
    spelled = [
        [{f"{leg}_{joint}" for leg in _LEG_SPELLINGS[name]} for name in LEGS for joint in row]
        for row in JOINT_SPELLINGS
    ]
    return max(spelled, key=lambda names: sum(bool(n & set(plain)) for n in names))


def _rate(table: Table, names: list[str], values: Array, fps: float | None) -> tuple[float, list[str]]:
    if fps is not None:
        check_rate(fps)
        return float(fps), []
    column = next((c for c, name in enumerate(names) if name in _TIME_NAMES), None)
    if column is None:
        return DEFAULT_RATE_HZ, [f"{DEFAULT_RATE_HZ:g} frames a second: the file does not say"]
    time = values[:, column]
    step = (time[-1] - time[0]) / (len(time) - 1)
    uneven = np.flatnonzero(~(np.abs(np.diff(time) - step) <= 0.5 * abs(step)))
    if step <= 0 or len(uneven):
        i = int(uneven[0]) + 1 if len(uneven) else 1
        where = f"line {table.rows[i].number}, column {column + 1} ({names[column]})"
        expected = f"even, growing steps (here {step:.4g} s), or give the frame rate"
        raise ClipError(f"{where}: time goes from {time[i - 1]:g} to {time[i]:g} s; expected {expected}")
    check_rate(1 / step)
    return float(1 / step), [f"{1 / step:.6g} frames a second, from column '{names[column]}' in seconds"]


def _check_upright(quat: Array) -> None:
    """Detects a file with w first: a level trunk then appears to lie on its back."""
    tilt = float(np.median(quat_rotate(quat, np.array([0.0, 0.0, 1.0]))[:, 2]))
    if tilt < _MIN_UPRIGHT:
        said = f"in most frames the trunk is tilted by more than {np.degrees(np.arccos(_MIN_UPRIGHT)):.0f}°"
        raise ClipError(f"{said}; expected z up and quaternions in the order x, y, z, w")


def _check_radians(joints: Array, where: Callable[[int], str], names: Sequence[str]) -> None:
    wrong = np.argwhere(np.abs(joints) > _MAX_ANGLE)
    if len(wrong):
        i, j = wrong[0]
        raise ClipError(f"{where(i)}, {names[j]}: {joints[i, j]:g} is more than a turn; joints are in radians")
