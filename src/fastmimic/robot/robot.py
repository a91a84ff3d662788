"""`Robot`: the geometry, inertia and limits of a quadruped, read from its MJCF, by name or from a file.

Parameters are given for an A1 and scaled to other robots. The A1's constants have all digits, so that each ratio of an
A1 is exactly 1; `tests/control/test_config.py` checks them.
"""

import os
import re
from dataclasses import dataclass, field, fields
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.errors import RobotError, did_you_mean, naming

if TYPE_CHECKING:
    import mujoco

ROBOT_NAMES: Final = ("a1", "go1", "go2")  # each is the file NAME.xml beside this one
ROBOT_CHOICES: Final = f"{', '.join(ROBOT_NAMES)}, or the MJCF or URDF of your own"  # for help texts

A1_MASS_KG: Final = 12.453000000000001
A1_JOINT_INERTIA: Final = 0.037411360960741595  # mean of `Robot.joint_inertia`, kg·m²
A1_LEG_LENGTH_M: Final = 0.4

_NOWHERE: Final = re.compile(r' (pos="0 0 0"|quat="1 0 0 0")')
_ROUNDED_ZERO: Final = re.compile(r"-?\d(\.\d+)?e-(1[2-9]|[2-9]\d)\b|(?<![\d.])-0(?![\d.])")


@dataclass(frozen=True, eq=False)
class Robot:
    """A quadruped with abduction, hip and knee joints in each leg. Legs and joints are in the common order.

    Attributes:
        name, xml: the model's name and its MJCF text.
        mass: total, kg.
        inertia_b: (3, 3) of the whole robot in its home pose about its centre of mass, body axes, kg·m².
        com_b: (3,) centre of mass in the home pose, body frame, m.
        hip_pos_b: (4, 3) origins of the abduction joints, body frame, m.
        lateral_offset: (4,) from the abduction axis to the leg's plane, positive left, m.
        thigh_vector, calf_vector: (4, 3) hip → knee in the thigh's frame and knee → foot in the calf's, m.
        hip_shift: (4, 2) x and z of the hip joint in the abduction frame, m.
        knee_sign: (4,) +1 or −1, the side to which the knee bends.
        foot_radius: m.
        joint_lower, joint_upper: (12,) rad.
        torque_limit, joint_speed_limit: (12,) N·m and rad/s.
        armature: (12,) reflected rotor inertia, kg·m².
        joint_damping, joint_friction: (12,) viscous, N·m·s/rad, and dry friction of the joints, N·m.
        joint_inertia: (12,) diagonal of the joint-space inertia at zero angles, trunk held, rotors included, kg·m².
        home_joint_pos, home_height: (12,) rad, and base height in the home pose, m.
        trunk_mass, trunk_com_b: of the body that carries the legs.
        link_mass, link_com, link_inertia: (4, 3), (4, 3, 3), (4, 3, 3, 3) in each link's frame; thigh and calf frames
            are moved along the joint axis into the leg's plane (`lateral_offset`).
        joint_names, foot_geoms: names of the model's elements in the common order.
        joint_sign: (12,) −1 where the joint turned about the opposite axis in the source file. `xml` and `base_spec`
            have the common axes.
        assumed: assumptions where the model has no value, as sentences.
        base_spec: the source specification; see `spec()`.
        files_digest: SHA-256 of the mesh files; empty if there are none.
    """

    name: str
    xml: str
    mass: float
    inertia_b: Array
    com_b: Array
    hip_pos_b: Array
    lateral_offset: Array
    thigh_vector: Array
    calf_vector: Array
    hip_shift: Array
    knee_sign: Array
    foot_radius: float
    joint_lower: Array
    joint_upper: Array
    torque_limit: Array
    joint_speed_limit: Array
    armature: Array
    joint_damping: Array
    joint_friction: Array
    joint_inertia: Array
    home_joint_pos: Array
    home_height: float
    trunk_mass: float
    trunk_com_b: Array
    link_mass: Array
    link_com: Array
    link_inertia: Array
    joint_names: tuple[str, ...]
    foot_geoms: tuple[str, ...]
    joint_sign: Array
    assumed: tuple[str, ...] = ()
    base_spec: "mujoco.MjSpec | None" = field(default=None, repr=False)
    files_digest: str = ""

    def spec(self) -> "mujoco.MjSpec":
        """A fresh copy of the MuJoCo specification, for building scenes. Unlike `xml`, its numbers are not rounded."""
        assert self.base_spec is not None
        return self.base_spec.copy()

    def model(self) -> "mujoco.MjModel":
        """A compiled model of the robot alone, without ground or gains: of `xml`, which identifies results everywhere,
        or, if that refers to files such as meshes, of the specification, which knows their folder."""
        import mujoco

        if ' file="' in self.xml:
            return self.spec().compile()
        return mujoco.MjModel.from_xml_string(self.xml)

    @property
    def said(self) -> str:
        """All that it consists of, as text, to tell robots apart; numbers to eight digits."""
        values = {each.name: getattr(self, each.name) for each in fields(self) if each.repr}
        arrays = {name: [f"{x:.8g}" for x in v.ravel()] for name, v in values.items() if isinstance(v, np.ndarray)}
        return repr(values | arrays)

    @property
    def content(self) -> bytes:
        """Its content for digests: `xml`, without MuJoCo's rounded zeros for meshes' positions, and `files_digest`."""
        if not self.files_digest:
            return self.xml.encode()
        return (_NOWHERE.sub("", _ROUNDED_ZERO.sub("0", self.xml)) + self.files_digest).encode()

    def __repr__(self) -> str:
        torque, speed = float(self.torque_limit.max()), float(self.joint_speed_limit.max())
        legs = f"legs of {self.thigh_length:.3f} + {self.calf_length:.3f} m"
        return f"<Robot {self.name}: {self.mass:.2f} kg, {legs}, up to {torque:g} N·m and {speed:g} rad/s>"

    @property
    def thigh_length(self) -> float:
        """Mean over the legs, m."""
        return float(np.mean(np.linalg.norm(self.thigh_vector[:, [0, 2]], axis=1)))

    @property
    def calf_length(self) -> float:
        """Mean over the legs, m."""
        return float(np.mean(np.linalg.norm(self.calf_vector[:, [0, 2]], axis=1)))

    @property
    def leg_length(self) -> float:
        """Thigh plus calf, m."""
        return self.thigh_length + self.calf_length

    @cached_property
    def geometry(self) -> Array:
        """(4, 12) legs for the kinematics: p₀ (3), d, s_x, s_z, t_x, t_z, c_x, c_z, knee sign, 0."""
        links = self.thigh_vector[:, [0, 2]], self.calf_vector[:, [0, 2]]
        rows = (self.hip_pos_b, self.lateral_offset, self.hip_shift, *links, self.knee_sign, np.zeros(4))
        return np.ascontiguousarray(np.column_stack(rows))


def load_robot(robot: str | Path | Robot) -> Robot:
    """A built-in robot by name, or the user's own MJCF, URDF or folder with one URDF; a `Robot` as it is. Raises
    `RobotError`: no such robot or file, neither MJCF nor URDF, or no quadruped with abduction, hip and knee joints."""
    import mujoco

    from fastmimic.robot.mjcf import check_elements, one_line, robot_from_spec, warn_by_log
    from fastmimic.robot.urdf import robot_from_urdf, urdf_in

    if isinstance(robot, Robot):
        return robot
    warn_by_log()
    name = str(robot)
    path = Path(name)
    if name.lower() in ROBOT_NAMES:
        text = resources.files("fastmimic.robot").joinpath(f"{name.lower()}.xml").read_text(encoding="utf-8")
        spec = mujoco.MjSpec.from_string(text)
    elif not os.path.exists(path):
        hint = did_you_mean(name, ROBOT_NAMES)
        raise RobotError(f"unknown robot '{name}': not one of {', '.join(ROBOT_NAMES)} and not a file{hint}")
    else:
        path = urdf_in(path) if path.is_dir() else path
        try:
            check_elements(path)
            spec = None if path.suffix.lower() == ".urdf" else mujoco.MjSpec.from_file(str(path))
        except (RobotError, ValueError, OSError, UnicodeDecodeError) as error:
            kind = "URDF" if path.suffix.lower() == ".urdf" else "MJCF"
            raise RobotError(f"{path}: not a readable {kind} ({one_line(error)})") from None
    with naming(path, RobotError):
        return robot_from_urdf(path) if spec is None else robot_from_spec(spec, path.stem)


def mass_ratio(robot: Robot) -> float:
    """An A1's mass over the robot's."""
    return A1_MASS_KG / robot.mass


def joint_ratio(robot: Robot) -> float:
    """Joint inertia of the robot over an A1's. Gains in this ratio keep frequency and damping of the legs."""
    return float(np.mean(robot.joint_inertia)) / A1_JOINT_INERTIA


def length_ratio(robot: Robot) -> float:
    """The robot's leg length over an A1's."""
    return robot.leg_length / A1_LEG_LENGTH_M


def combined(parts: list[tuple[float, Array, Array]]) -> tuple[float, Array, Array]:
    """Mass, centre of mass and central inertia of several bodies in one frame, from those of each."""
    mass = sum(m for m, _, _ in parts)
    if mass <= 0:
        return 0.0, np.zeros(3), np.zeros((3, 3))
    com = sum((m * c for m, c, _ in parts), np.zeros(3)) / mass
    inertia = np.zeros((3, 3))
    for m, c, i in parts:
        d = c - com
        inertia += i + m * (d @ d * np.eye(3) - np.outer(d, d))
    return mass, com, inertia
