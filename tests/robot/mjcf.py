"""Variations of the built-in A1 for the tests: what users' own models look like, right and wrong."""

import xml.etree.ElementTree as ElementTree
from importlib import resources
from pathlib import Path

import mujoco
import numpy as np

from fastmimic.robot import Robot


def a1_tree() -> ElementTree.Element:
    """The A1's MJCF as a tree to be changed."""
    text = resources.files("fastmimic.robot").joinpath("a1.xml").read_text(encoding="utf-8")
    return ElementTree.fromstring(text)


def heavier(tree: ElementTree.Element, times: float) -> ElementTree.Element:
    """The same robot of a denser material and with stronger motors: it can move exactly as the original."""
    for element in tree.iter():
        for key in ("mass", "fullinertia", "armature", "forcerange"):
            if key in element.attrib:
                element.set(key, " ".join(repr(times * float(number)) for number in element.attrib[key].split()))
    return tree


def find(tree: ElementTree.Element, tag: str, name: str) -> ElementTree.Element:
    element = tree.find(f".//{tag}[@name='{name}']")
    assert element is not None, f"no {tag} '{name}'"
    return element


def remove(tree: ElementTree.Element, child: ElementTree.Element) -> None:
    parent = next(element for element in tree.iter() if child in list(element))
    parent.remove(child)


def drop(tree: ElementTree.Element, tag: str) -> None:
    """Removes a section such as `keyframe`, which no longer fits once joints are gone."""
    section = tree.find(tag)
    if section is not None:
        tree.remove(section)


def remove_joint(tree: ElementTree.Element, name: str) -> None:
    remove(tree, find(tree, "joint", name))
    remove(tree, find(tree, "motor", name))
    drop(tree, "keyframe")


def write(tree: ElementTree.Element, path: Path) -> Path:
    ElementTree.ElementTree(tree).write(path, encoding="unicode")
    return path


class Simulated:
    """A robot's own model in MuJoCo, posed at will: the independent witness of kinematics and dynamics."""

    def __init__(self, robot: Robot) -> None:
        self.model = robot.spec().compile()
        self.data = mujoco.MjData(self.model)
        joints = [self.model.joint(name).id for name in robot.joint_names]
        self.qpos = self.model.jnt_qposadr[joints]
        self.dofs = self.model.jnt_dofadr[joints]
        self.feet = [self.model.geom(name).id for name in robot.foot_geoms]
        free = int(np.flatnonzero(self.model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)[0])
        self.trunk = int(self.model.jnt_bodyid[free])
        self.base_qpos = int(self.model.jnt_qposadr[free])
        self.base_dof = int(self.model.jnt_dofadr[free])

    def pose(self, joint_pos: np.ndarray, base_pos: np.ndarray, base_quat: np.ndarray) -> None:
        self.data.qpos[self.base_qpos : self.base_qpos + 3] = base_pos
        self.data.qpos[self.base_qpos + 3 : self.base_qpos + 7] = base_quat
        self.data.qpos[self.qpos] = joint_pos
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)

    @property
    def rotation(self) -> np.ndarray:
        """(3, 3) body → world."""
        return self.data.xmat[self.trunk].reshape(3, 3)

    def feet_b(self) -> np.ndarray:
        """(4, 3) foot centres in the body frame."""
        return (self.data.geom_xpos[self.feet] - self.data.xpos[self.trunk]) @ self.rotation

    def jacobians_b(self) -> np.ndarray:
        """(4, 3, 3) derivatives of each foot by its own leg's joints, body frame."""
        out = np.empty((4, 3, 3))
        jacobian = np.empty((3, self.model.nv))
        for leg, foot in enumerate(self.feet):
            body = int(self.model.geom_bodyid[foot])
            mujoco.mj_jac(self.model, self.data, jacobian, None, self.data.geom_xpos[foot], body)
            out[leg] = self.rotation.T @ jacobian[:, self.dofs[3 * leg : 3 * leg + 3]]
        return out


def random_quat(generator: np.random.Generator) -> np.ndarray:
    quat = generator.normal(size=4)
    return quat / np.linalg.norm(quat)


def random_joints(robot: Robot, generator: np.random.Generator) -> np.ndarray:
    return generator.uniform(robot.joint_lower, robot.joint_upper)
