"""Reads a `Robot` from an MJCF model. The legs are recognised by geometry, not by names."""

import hashlib
import logging
import math
import re
import xml.etree.ElementTree as ElementTree
from contextlib import suppress
from pathlib import Path
from typing import Final, NamedTuple

import mujoco
import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.conventions import JOINTS_PER_LEG, LEGS
from fastmimic.base.errors import RobotError
from fastmimic.base.rotations import matrix_from_quat, quat_multiply, quat_rotate
from fastmimic.robot.robot import Robot, combined

DEFAULT_JOINT_SPEED_LIMIT: Final = 21.0  # rad/s, for a model without a `joint_speed_limit`; MJCF has no element for it

SPEED_LIMIT: Final = "joint_speed_limit"
_LEAST_RANGE: Final = 0.2  # rad
"""A custom numeric, rad/s: one for all joints, three for abduction, hip and knee, or twelve in the file's order."""

_AXES: Final = {"abduction": (1.0, 0.0, 0.0), "hip": (0.0, 1.0, 0.0), "knee": (0.0, 1.0, 0.0)}
_AXIS_TOLERANCE: Final = 1e-6


MOST_ELEMENTS: Final = 5000  # of a robot's XML, copies counted; MuJoCo takes minutes for 200,000


def warn_by_log() -> None:
    """Has MuJoCo's warnings logged, unless the user has a handler: it would write MUJOCO_LOG.TXT where one works."""
    if mujoco.get_mju_user_warning() is None:
        mujoco.set_mju_user_warning(logging.getLogger("fastmimic").warning)


def check_elements(path: Path) -> None:
    """Raises `RobotError` if an MJCF or URDF has more than `MOST_ELEMENTS`, before MuJoCo reads it."""
    copies, count = [1], 0
    with suppress(OSError, ElementTree.ParseError):  # MuJoCo tells where, or can read it
        for event, element in ElementTree.iterparse(path, ("start", "end")):
            if event == "end":
                copies.pop()
                continue
            more = re.findall(r"\d+", element.get("count", ""))  # of `replicate`, `composite` and `flexcomp`
            copies.append(copies[-1] * math.prod(map(int, more)))
            count += copies[-1]
            if count > MOST_ELEMENTS:
                raise RobotError(f"more than {MOST_ELEMENTS} elements, copies counted; a robot has some hundreds")


def robot_from_spec(spec: mujoco.MjSpec, default_name: str) -> Robot:
    """Reads a `Robot` from a MuJoCo specification, which may have no name. Raises `RobotError`: the model does not
    compile or is not a twelve-joint quadruped."""
    try:
        for i, geom in enumerate(spec.geoms):  # scenes address feet by name
            if geom.type == mujoco.mjtGeom.mjGEOM_SPHERE and not geom.name:
                geom.name = f"sphere_{i}"
        model = spec.compile()
        xml = spec.to_xml()
        _ = ' file="' in xml or mujoco.MjModel.from_xml_string(xml)  # rounded: a small mass may be none
    except (ValueError, RuntimeError) as error:
        raise RobotError(f"MuJoCo cannot compile this model ({one_line(error)})") from None
    trunk = _trunk(model)
    chains = [_chain(model, root) for root in _leg_roots(model, trunk)]
    at_zero = mujoco.MjData(model)  # all joints at zero, the trunk upright
    at_zero.qpos[:] = 0
    at_zero.qpos[model.jnt_qposadr[model.body_jntadr[trunk]] + 3] = 1
    mujoco.mj_kinematics(model, at_zero)
    reversed_joints = [joint for chain in chains for joint in _reversed(model, at_zero, chain)]
    if reversed_joints:
        _turn_round(spec, model, reversed_joints)
        model, xml = spec.compile(), spec.to_xml()  # the zero pose stays
    legs = _in_order([_leg(model, at_zero, trunk, chain) for chain in chains])

    home = _home(model)
    data = mujoco.MjData(model)
    data.qpos[:] = home
    mujoco.mj_forward(model, data)
    joints = [j for leg in legs for j in leg.joints]
    bodies = np.array([[model.jnt_bodyid[j] for j in leg.joints] for leg in legs])
    links = [[_link(model, at_zero, trunk, int(b)) for b in row] for row in bodies]
    trunk_link = composite(model, trunk)
    com_b, inertia_b = _whole_body(model, data, trunk)
    speed, speed_assumed = _speed_limit(model, joints)
    lower, upper, range_assumed = _ranges(model, joints)
    return Robot(
        name=model.names[: model.names.index(b"\0")].decode() or default_name,
        xml=xml,
        mass=float(model.body_subtreemass[trunk]),
        inertia_b=inertia_b,
        com_b=com_b,
        **{name: np.array([leg.geometry[name] for leg in legs]) for name in legs[0].geometry},
        foot_radius=float(model.geom_size[legs[0].foot, 0]),
        joint_lower=lower,
        joint_upper=upper,
        torque_limit=_torque_limits(model, joints),
        joint_speed_limit=speed,
        armature=model.dof_armature[model.jnt_dofadr[joints]].copy(),
        joint_damping=model.dof_damping[model.jnt_dofadr[joints]].copy(),
        joint_friction=model.dof_frictionloss[model.jnt_dofadr[joints]].copy(),
        joint_inertia=model.dof_M0[model.jnt_dofadr[joints]].copy(),
        home_joint_pos=home[model.jnt_qposadr[joints]].copy(),
        home_height=float(home[2]),
        trunk_mass=trunk_link[0],
        trunk_com_b=trunk_link[1],
        link_mass=np.array([[link[0] for link in row] for row in links]),
        link_com=_in_leg_plane(np.array([[link[1] for link in row] for row in links]), legs),
        link_inertia=np.array([[link[2] for link in row] for row in links]),
        joint_names=tuple(model.joint(j).name for j in joints),
        joint_sign=np.where(np.isin(joints, reversed_joints), -1.0, 1.0),
        foot_geoms=tuple(model.geom(leg.foot).name for leg in legs),
        assumed=(*range_assumed, *speed_assumed),
        base_spec=spec,
        files_digest=_files_digest(spec),
    )


class _Leg(NamedTuple):
    joints: list[int]
    foot: int
    geometry: dict[str, Array]  # by the names of `Robot`


def _files_digest(spec: mujoco.MjSpec) -> str:
    """SHA-256 of the mesh files; empty if there are none."""
    names = [mesh.file for mesh in spec.meshes if mesh.file]
    if not names:
        return ""
    folder, found = Path(spec.modelfiledir) / spec.compiler.meshdir, hashlib.sha256()
    for name in names:
        found.update(name.encode())
        with suppress(OSError):  # one of MuJoCo's own resources
            found.update((folder / name).read_bytes())
    return found.hexdigest()


def one_line(error: Exception) -> str:
    """An exception's message without line breaks."""
    return " ".join(str(error).split())


def _trunk(model: mujoco.MjModel) -> int:
    hinges = int(np.sum(model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE))
    free = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)
    if len(free) != 1 or hinges != 12 or model.njnt != 13:
        found = f"{len(free)} free, {hinges} hinge and {model.njnt - len(free) - hinges} other joints"
        expected = "one free joint and 12 hinge joints (abduction, hip, knee in each of four legs)"
        raise RobotError(f"expected {expected}; found {found}")
    return int(model.jnt_bodyid[free[0]])


def _leg_roots(model: mujoco.MjModel, trunk: int) -> list[int]:
    """The first bodies of the four legs."""
    roots = bodies_below(model, trunk)
    if len(roots) != 4:
        raise RobotError(f"expected 4 legs on body '{model.body(trunk).name}', found {len(roots)}")
    return roots


def bodies_below(model: mujoco.MjModel, body: int) -> list[int]:
    """Bodies with a joint on a body, or on what is fixed to it."""
    carrier = model.body_weldid[model.body_parentid]
    return [int(b) for b in np.flatnonzero((model.body_jntnum > 0) & (carrier == body))]


def _chain(model: mujoco.MjModel, root: int) -> list[int]:
    """The three bodies of a leg."""
    chain, children = [root], [root]
    while len(children) == 1 and len(chain) <= 3:
        children = bodies_below(model, chain[-1])
        chain += children[:1]
    if len(chain) != 3 or any(model.body_jntnum[b] != 1 for b in chain):
        raise RobotError(f"{_label(model, root)} is not a chain of three links with one joint each")
    return chain


def _label(model: mujoco.MjModel, root: int) -> str:
    return f"the leg at body '{model.body(root).name}'"


def _reversed(model: mujoco.MjModel, at_zero: mujoco.MjData, chain: list[int]) -> list[int]:
    """The joints of a leg that turn about the opposite of the common axis; `RobotError` for any other axis."""
    found = []
    joints = (int(model.body_jntadr[b]) for b in chain)
    for joint, role in zip(joints, JOINTS_PER_LEG, strict=True):
        axis, common = at_zero.xaxis[joint], np.array(_AXES[role])
        if np.max(np.abs(axis + common)) <= _AXIS_TOLERANCE:
            found.append(joint)
        elif np.max(np.abs(axis - common)) > _AXIS_TOLERANCE:
            said = f"{role} joint '{model.joint(joint).name}' turns about {np.round(axis, 3).tolist()}"
            expected = f"{list(_AXES[role])} (x forward, y left), or its opposite, when all joints are at zero"
            raise RobotError(f"{said}; expected {expected}")
    return found


def _turn_round(spec: mujoco.MjSpec, model: mujoco.MjModel, joints: list[int]) -> None:
    """Reverses the axes of joints, by their ids, so that the same robot has other signs."""
    for joint in spec.joints:
        if joint.id in joints:
            joint.axis = -np.array(joint.axis)
            joint.range = -np.array(joint.range)[::-1]
            joint.springref = -joint.springref
            joint.actfrcrange = -np.array(joint.actfrcrange)[::-1]
    for key in spec.keys:
        pose = np.array(key.qpos)
        if pose.size < model.nq:
            continue
        pose[model.jnt_qposadr[joints]] *= -1.0
        key.qpos = pose


def _leg(model: mujoco.MjModel, data: mujoco.MjData, trunk: int, chain: list[int]) -> _Leg:
    """A leg, from the positions of its parts with all joints at zero."""
    joints = [int(model.body_jntadr[b]) for b in chain]
    for joint in joints:
        if not (model.jnt_limited[joint] or model.nkey):
            raise RobotError(f"joint '{model.joint(joint).name}' has no range, and no keyframe shows how it is bent")
        if model.qpos0[model.jnt_qposadr[joint]] != 0:
            raise RobotError(f"joint '{model.joint(joint).name}' has a reference angle; expected ref=0")
    anchors = [data.xanchor[j] - data.xpos[trunk] for j in joints]
    foot = _foot_geom(model, data, chain)
    foot_pos = data.geom_xpos[foot] - data.xpos[trunk]
    to_hip, thigh, calf = anchors[1] - anchors[0], anchors[2] - anchors[1], foot_pos - anchors[2]
    bent = _home(model)[model.jnt_qposadr[joints[2]]]
    angle = np.arctan2(calf[0], -calf[2]) - np.arctan2(thigh[0], -thigh[2])
    geometry = {
        "hip_pos_b": anchors[0],
        "lateral_offset": to_hip[1] + thigh[1] + calf[1],
        "thigh_vector": thigh,
        "calf_vector": calf,
        "hip_shift": to_hip[[0, 2]],
        "knee_sign": np.float64(1.0 if bent - angle > 0 else -1.0),
    }
    return _Leg(joints, foot, geometry)


def _foot_geom(model: mujoco.MjModel, data: mujoco.MjData, chain: list[int]) -> int:
    """The lowest colliding sphere on the last link or on a body fixed to it."""
    spheres = [
        g
        for g in range(model.ngeom)
        if model.geom_type[g] == mujoco.mjtGeom.mjGEOM_SPHERE
        and model.body_weldid[model.geom_bodyid[g]] == model.body_weldid[chain[-1]]
        and (model.geom_contype[g] or model.geom_conaffinity[g])
    ]
    if not spheres:
        raise RobotError(f"{_label(model, chain[0])} has no colliding sphere on its last link to serve as the foot")
    return min(spheres, key=lambda g: float(data.geom_xpos[g, 2]))


def _in_order(legs: list[_Leg]) -> list[_Leg]:
    """The legs FR, FL, RR, RL, by hip position."""
    signs = {"FR": (1, -1), "FL": (1, 1), "RR": (-1, -1), "RL": (-1, 1)}
    found = [tuple(np.sign(leg.geometry["hip_pos_b"][:2]).astype(int)) for leg in legs]
    ordered = [legs[found.index(signs[leg])] for leg in LEGS if signs[leg] in found]
    if len(ordered) != 4:
        hips = ", ".join(str(np.round(leg.geometry["hip_pos_b"][:2], 3).tolist()) for leg in legs)
        raise RobotError(f"expected one leg front right, front left, rear right, rear left; hips at {hips}")
    return ordered


def _home(model: mujoco.MjModel) -> Array:
    """The keyframe `home`, or the only one; else the middle of the joints' ranges."""
    for key in range(model.nkey):
        if model.key(key).name == "home" or model.nkey == 1:
            return np.array(model.key_qpos[key])
    home = np.array(model.qpos0)
    limited = np.flatnonzero(model.jnt_limited)
    home[model.jnt_qposadr[limited]] = np.mean(model.jnt_range[limited], axis=1)
    return home


def composite(model: mujoco.MjModel, body: int) -> tuple[float, Array, Array]:
    """Mass, centre of mass and central inertia of a body and all that is fixed to it, in the body's frame."""
    parts: list[tuple[float, Array, Array]] = []

    def collect(b: int, pos: Array, quat: Array) -> None:
        rotation = matrix_from_quat(quat_multiply(quat, model.body_iquat[b]))
        com = pos + quat_rotate(quat, model.body_ipos[b])
        parts.append((float(model.body_mass[b]), com, rotation @ np.diag(model.body_inertia[b]) @ rotation.T))
        for child in range(b + 1, model.nbody):
            if model.body_parentid[child] == b and not model.body_jntnum[child]:
                at = pos + quat_rotate(quat, model.body_pos[child])
                collect(child, at, quat_multiply(quat, model.body_quat[child]))

    collect(body, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
    return combined(parts)


def _link(model: mujoco.MjModel, at_zero: mujoco.MjData, trunk: int, body: int) -> tuple[float, Array, Array]:
    """The same of a leg's link from its joint on, in the axes that the trunk has when all joints are at zero."""
    mass, com, inertia = composite(model, body)
    turn = at_zero.xmat[trunk].reshape(3, 3).T @ at_zero.xmat[body].reshape(3, 3)
    return mass, turn @ (com - model.jnt_pos[model.body_jntadr[body]]), turn @ inertia @ turn.T


def _whole_body(model: mujoco.MjModel, data: mujoco.MjData, trunk: int) -> tuple[Array, Array]:
    """Centre of mass and central inertia of the whole robot in the pose of `data`, body frame."""
    rotation = data.xmat[trunk].reshape(3, 3)
    parts = []
    for body in range(trunk, model.nbody):
        axes = data.ximat[body].reshape(3, 3)
        inertia = axes @ np.diag(model.body_inertia[body]) @ axes.T
        parts.append((float(model.body_mass[body]), data.xipos[body] - data.xpos[trunk], inertia))
    _, com, inertia = combined(parts)
    return rotation.T @ com, rotation.T @ inertia @ rotation


def _torque_limits(model: mujoco.MjModel, joints: list[int]) -> Array:
    """From the actuator's force range, the control range of a plain motor, or the joint's own force range."""
    limits = np.zeros(len(joints))
    for i, joint in enumerate(joints):
        candidates = []
        if model.jnt_actfrclimited[joint]:
            candidates.append(model.jnt_actfrcrange[joint, 1])
        for actuator in np.flatnonzero(model.actuator_trnid[:, 0] == joint):
            gear = abs(model.actuator_gear[actuator, 0])
            if model.actuator_forcelimited[actuator]:
                candidates.append(gear * model.actuator_forcerange[actuator, 1])
            elif model.actuator_ctrllimited[actuator] and model.actuator_biasprm[actuator, 1] == 0:
                gain = model.actuator_gainprm[actuator, 0]
                candidates.append(gear * gain * model.actuator_ctrlrange[actuator, 1])
        if not candidates or min(candidates) <= 0:
            said = f"joint '{model.joint(joint).name}' has no torque limit"
            raise RobotError(f"{said}; give its actuator a forcerange or the joint an actuatorfrcrange")
        limits[i] = min(candidates)
    return limits


def _in_leg_plane(com: Array, legs: list[_Leg]) -> Array:
    """Centres of mass (4, 3, 3) with the origins of thigh and calf moved sideways into the plane of the foot."""
    for of_leg, leg in zip(com, legs, strict=True):
        thigh, calf = leg.geometry["thigh_vector"], leg.geometry["calf_vector"]
        of_leg[1, 1] -= thigh[1] + calf[1]
        of_leg[2, 1] -= calf[1]
    return com


def _ranges(model: mujoco.MjModel, joints: list[int]) -> tuple[Array, Array, tuple[str, ...]]:
    """Lower and upper limits (12,), rad, and the assumption for joints without a range."""
    lower, upper = model.jnt_range[joints].T.copy()
    free = np.flatnonzero(~model.jnt_limited[joints].astype(bool))
    lower[free], upper[free] = -np.pi, np.pi
    i = int(np.argmin(upper - lower))
    if upper[i] - lower[i] < _LEAST_RANGE:
        said = f"joint '{model.joint(joints[i]).name}' only moves from {lower[i]:.3g} to {upper[i]:.3g} rad"
        raise RobotError(
            f'{said}; are its angles radians, and is angle="radian" missing in the file\'s compiler element?'
        )
    names = ", ".join(model.joint(joints[i]).name for i in free)
    return lower, upper, (f"no range of {names} in the model: ±3.14 rad assumed",) if names else ()


def _speed_limit(model: mujoco.MjModel, joints: list[int]) -> tuple[Array, tuple[str, ...]]:
    """Limits (12,), rad/s, and the assumption if there are none."""
    for i in range(model.nnumeric):
        if model.numeric(i).name == SPEED_LIMIT:
            data = np.array(model.numeric(i).data, dtype=np.float64)
            if not (data > 0).all():
                raise RobotError(f"'{SPEED_LIMIT}' must be above 0 rad/s, found {data.min():g}")
            if data.size == len(joints):
                return data[np.argsort(np.argsort(joints))], ()
            if data.size not in (1, 3):
                raise RobotError(f"'{SPEED_LIMIT}' has {data.size} numbers; expected 1, 3 (abduction, hip, knee) or 12")
            return np.tile(data, 12 // data.size), ()
    text = f"no custom numeric '{SPEED_LIMIT}' in the model: {DEFAULT_JOINT_SPEED_LIMIT:g} rad/s assumed"
    return np.full(12, DEFAULT_JOINT_SPEED_LIMIT), (text,)
