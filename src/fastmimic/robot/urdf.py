"""Reads a robot's URDF, from a file or a vendor's folder, as the MuJoCo specification that `mjcf` reads.

MuJoCo compiles the URDF. What a URDF cannot say is added: the trunk floats, the joints' top speeds are kept, the legs
stand bent in the keyframe `home`, and a leg without a sphere at its end gets one as its foot.
"""

import os
import xml.etree.ElementTree as ElementTree
from collections import Counter
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Final

import mujoco
import numpy as np

from fastmimic.base.errors import RobotError
from fastmimic.robot.mjcf import DEFAULT_JOINT_SPEED_LIMIT, SPEED_LIMIT, bodies_below, one_line, robot_from_spec
from fastmimic.robot.robot import Robot

MOST_FOLDERS: Final = 2000  # that are searched: a vendor's has some dozens
_MESHES: Final = (".stl", ".obj")  # that MuJoCo reads
_NO_MASS_KG: Final = 1e-4
_STANDS: Final = 0.65  # height of the hips above the feet in `home`, share of the leg's length
_ROTORS: Final = 0.36  # reflected inertia of the rotors, share of the legs' mean inertia at the joints, of an A1
_FOOT: Final = 0.1  # radius of an assumed foot, share of the calf's length
_STICK: Final = 0.07  # radius of a link that is drawn as a stick, share of its length


def urdf_in(folder: Path) -> Path:
    """The one URDF of a vendor's folder; raises `RobotError` if there is none, or more than one."""
    walked = islice(os.walk(folder), MOST_FOLDERS)
    found = sorted(Path(at, name) for at, _, names in walked for name in names if name.endswith(".urdf"))
    if len(found) != 1:
        names = ", ".join(str(path.relative_to(folder)) for path in found)
        raise RobotError(f"{folder}: expected one URDF in this folder, found {names or 'none'}; give the file")
    return found[0]


def robot_from_urdf(path: Path) -> Robot:
    """Reads a `Robot` from a URDF; `assumed` says what was added or left out. Raises `RobotError`: cannot be read or
    compiled, or not a twelve-joint quadruped."""
    try:
        tree = ElementTree.fromstring(path.read_bytes())
        _check_joints(tree)
        left_out = _prepare(tree, path)
        where = f"nothing collides at {', '.join(left_out)}"
        notes = [f"meshes left out, not found or neither STL nor OBJ: {where}"] if left_out else []
        spec = mujoco.MjSpec.from_string(ElementTree.tostring(tree, encoding="unicode"))
        spec.modelfiledir = str(path.parent)
        if all(joint.type != mujoco.mjtJoint.mjJNT_FREE for joint in spec.joints):
            spec.worldbody.first_body().add_freejoint()
        for geom in spec.geoms:
            geom.density = 0.0  # a link without inertia has none, whatever its shape
        notes += _add_feet(spec)
        _draw(spec, left_out)
        limits = {joint.get("name"): limit for joint in tree.iter("joint") for limit in joint.iter("limit")}
        speeds, efforts = (
            {str(name): float(limit.get(what, 0)) for name, limit in limits.items()} for what in ("velocity", "effort")
        )
    except (ElementTree.ParseError, ValueError, OSError) as error:
        raise RobotError(f"not a readable URDF ({one_line(error)})") from None
    for joint in _hinges(spec):
        if efforts.get(joint.name, 0.0) <= 0:
            raise RobotError(f"joint '{joint.name}' has no torque limit; give it <limit effort=\"…\"/>, in N·m")
    known = [speeds.get(joint.name, 0.0) for joint in _hinges(spec)]
    if not all(speed > 0 for speed in known):
        known = [DEFAULT_JOINT_SPEED_LIMIT]
        notes.append(f'no <limit velocity="…"/> of every joint in the URDF: {known[0]:g} rad/s assumed')
    spec.add_numeric(name=SPEED_LIMIT, data=known)
    return _standing(spec, path.stem, notes)


def _check_joints(tree: ElementTree.Element) -> None:
    """Raises `RobotError` if the joints that move are not twelve that turn."""
    kinds = Counter(str(joint.get("type")) for joint in tree.findall("joint"))
    moving = {kind: count for kind, count in kinds.items() if kind not in ("fixed", "floating")}
    if sum(moving.values()) != 12 or not moving.keys() <= {"revolute", "continuous"}:
        found = ", ".join(f"{count} {kind}" for kind, count in moving.items()) or "no joints that move"
        raise RobotError(f"expected twelve revolute joints, four legs of three (abduction, hip, knee); found {found}")


def _prepare(tree: ElementTree.Element, path: Path) -> list[str]:
    """Leaves out what is only looked at, and meshes that cannot be read, of the links that it returns; finds the
    others, relative to the file."""
    left_out = []
    for link in tree.iter("link"):
        inertial, mass = link.find("inertial"), link.find("inertial/mass")
        if inertial is not None and mass is not None and float(mass.get("value", 0)) < _NO_MASS_KG:
            link.remove(inertial)  # of a frame: MuJoCo refuses inertias that are not positive
        for part in [*link.findall("visual"), *link.findall("collision")]:
            mesh = part.find("geometry/mesh")
            file = None if mesh is None else _mesh_file(str(mesh.get("filename")), path.parent)
            if part.tag == "visual" or (mesh is not None and file is None):
                link.remove(part)
                left_out += [str(link.get("name"))] * (part.tag == "collision")
            elif mesh is not None:
                mesh.set("filename", str(file))
    for element in tree.findall("mujoco"):
        tree.remove(element)
    compiler = ElementTree.SubElement(ElementTree.SubElement(tree, "mujoco"), "compiler")
    compiler.attrib |= {"fusestatic": "false", "strippath": "false", "balanceinertia": "true", "discardvisual": "false"}
    return left_out


def _mesh_file(name: str, folder: Path) -> Path | None:
    """A mesh's file, relative to the URDF's folder: as it is named, or with its package at or above that folder."""
    if not name.lower().endswith(_MESHES):
        return None
    inside = Path(name.removeprefix("file://").removeprefix("package://"))
    above = [folder, *list(folder.resolve().parents)[:4]]
    places = [up / tail for up in above for tail in (inside, Path(*inside.parts[1:]))]
    found = next((place for place in places if place.is_file()), None)
    return None if found is None else Path(os.path.relpath(found.resolve(), folder.resolve()))


def _add_feet(spec: mujoco.MjSpec) -> list[str]:
    """Adds a sphere to each leg that has none, at the link that is fixed farthest from the knee."""
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    added = []
    for knee in np.flatnonzero(model.body_jntnum):
        group = np.flatnonzero(model.body_weldid == knee)
        geoms = np.isin(model.geom_bodyid, group) & (model.geom_type == mujoco.mjtGeom.mjGEOM_SPHERE)
        if bodies_below(model, int(knee)) or len(group) == 1 or geoms.any():
            continue
        away = np.linalg.norm(data.xpos[group] - data.xpos[knee], axis=1)
        foot = spec.body(model.body(group[away.argmax()]).name)
        foot.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[_FOOT * away.max(), 0, 0], density=0.0)
        added.append(f"{foot.name} {1e3 * _FOOT * away.max():.0f} mm")
    return [f"no spheres as feet: assumed at {', '.join(added)}"] if added else []


def _draw(spec: mujoco.MjSpec, links: list[str]) -> None:
    """Draws those links that have no shape left as sticks, and the trunk as a box; nothing collides with them."""
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    spheres = model.geom_type == mujoco.mjtGeom.mjGEOM_SPHERE
    for link in map(model.body, links):
        group = int(model.body_weldid[link.id])
        ends = [data.xpos[body] for body in bodies_below(model, group)]
        ends = ends or list(data.geom_xpos[spheres & (model.body_weldid[model.geom_bodyid] == group)])
        along = (np.reshape(ends, (-1, 3)) - data.xpos[link.id]) @ data.xmat[link.id].reshape(3, 3)
        far = float(np.abs(along).max(initial=0.0))
        shape = {"type": mujoco.mjtGeom.mjGEOM_BOX, "size": [*np.abs(along[:, :2]).max(axis=0, initial=0), _FOOT * far]}
        if len(ends) == 1:
            stick = {"fromto": [0.0, 0.0, 0.0, *along[0]], "size": [_STICK * far, 0.0, 0.0]}
            shape = {"type": mujoco.mjtGeom.mjGEOM_CAPSULE, **stick}
        if far > 0.0 and not (model.geom_bodyid == link.id).any():
            spec.body(link.name).add_geom(**shape, contype=0, conaffinity=0, density=0.0)


def _standing(spec: mujoco.MjSpec, name: str, notes: list[str]) -> Robot:
    """The robot with rotors, and a keyframe `home` in which its feet stand below its hips, with bent knees."""
    from fastmimic.robot.kinematics import inverse_kinematics

    trial = spec.copy()
    trial.add_key(name="home", qpos=[0, 0, 0.3, 1, 0, 0, 0, *(np.mean(joint.range) for joint in _hinges(spec))])
    robot = robot_from_spec(trial, name)
    height = _STANDS * robot.leg_length
    feet = robot.hip_pos_b + np.outer(robot.lateral_offset, [0.0, 1.0, 0.0])
    feet[:, 2] = robot.hip_pos_b[:, 2].mean() - height
    joints = np.clip(inverse_kinematics(robot, feet)[0], robot.joint_lower, robot.joint_upper)
    bent = dict(zip(robot.joint_names, joints * robot.joint_sign, strict=True))
    base = robot.foot_radius - feet[:, 2].mean()
    spec.add_key(name="home", qpos=[0, 0, base, 1, 0, 0, 0, *(bent[joint.name] for joint in _hinges(spec))])
    rotors = _ROTORS * float(np.mean(robot.joint_inertia))
    for joint in _hinges(spec):
        joint.armature = rotors
    notes.append(f"no standing pose in a URDF: hips {height:.2f} m above the feet")
    notes.append(f"no rotor inertia in a URDF: {rotors:.2g} kg·m² at each joint, the A1's share of its legs' inertia")
    robot = robot_from_spec(spec, name)
    return replace(robot, assumed=(*notes, *robot.assumed))


def _hinges(spec: mujoco.MjSpec) -> list[mujoco.MjsJoint]:
    """The joints but for the trunk's, in the file's order."""
    return [joint for joint in spec.joints if joint.type != mujoco.mjtJoint.mjJNT_FREE]
