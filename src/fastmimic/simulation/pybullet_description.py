"""The manufacturer's URDF of a robot in the package `pybullet_data`, and PyBullet itself, if it is installed."""

import contextlib
import io
import os
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from fastmimic.base.errors import ConfigError
from fastmimic.robot import Robot
from fastmimic.simulation.disturbance_kinds import PAYLOAD_HEIGHT_M, PAYLOAD_SIDE_M

DESCRIPTIONS: Final = {"a1": "a1/a1.urdf"}  # in the package `pybullet_data`, by robot
_TRUNK: Final = "trunk"


def require_pybullet() -> Any:
    """PyBullet's module; raises `ConfigError`, with what to do, if it is not installed."""
    with contextlib.redirect_stderr(io.StringIO()), quiet():  # it tells when it was built
        try:
            import pybullet
            import pybullet_data  # noqa: F401
        except ImportError:
            raise ConfigError("the second simulator needs PyBullet: pip install 'fastmimic[pybullet]'") from None
    return pybullet


def read_description(robot: Robot) -> str:
    """The robot's URDF without visual shapes; raises `ConfigError` if there is none."""
    import pybullet_data

    if robot.name not in DESCRIPTIONS:
        raise ConfigError(
            f"PyBullet has a description of {' and '.join(DESCRIPTIONS)}, none of '{robot.name}'; run it in mujoco"
        )
    path = Path(pybullet_data.getDataPath()) / DESCRIPTIONS[robot.name]
    tree = ElementTree.fromstring(path.read_text(encoding="utf-8"))
    for link in tree.iter("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
    return ElementTree.tostring(tree, encoding="unicode")


def changed_description(description: str, payload: float, com_x: float, com_y: float) -> str:
    """The description with a payload on the trunk and the trunk's centre of mass shifted."""
    if not (payload or com_x or com_y):
        return description
    tree = ElementTree.fromstring(description)
    origin = tree.find(f"link[@name='{_TRUNK}']/inertial/origin")
    assert origin is not None, "the trunk has a centre of mass"
    x, y, z = (float(value) for value in origin.get("xyz", "0 0 0").split())
    origin.set("xyz", f"{x + com_x!r} {y + com_y!r} {z!r}")
    if payload:
        moment = payload * PAYLOAD_SIDE_M**2 / 6.0
        load = ElementTree.SubElement(tree, "link", name="payload")
        inertial = ElementTree.SubElement(load, "inertial")
        ElementTree.SubElement(inertial, "mass", value=repr(payload))
        moments = {f"i{a}{b}": repr(moment) if a == b else "0" for a, b in ("xx", "xy", "xz", "yy", "yz", "zz")}
        ElementTree.SubElement(inertial, "inertia", moments)
        joint = ElementTree.SubElement(tree, "joint", name="payload_joint", type="fixed")
        ElementTree.SubElement(joint, "parent", link=_TRUNK)
        ElementTree.SubElement(joint, "child", link="payload")
        ElementTree.SubElement(joint, "origin", xyz=f"0 0 {PAYLOAD_HEIGHT_M!r}", rpy="0 0 0")
    return ElementTree.tostring(tree, encoding="unicode")


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Silences the terminal output of C code."""
    with open(os.devnull, "wb") as nowhere:
        kept = [(fd, os.dup(fd)) for fd in (1, 2)]
        try:
            for fd, _ in kept:
                os.dup2(nowhere.fileno(), fd)
            yield
        finally:
            for fd, copy in kept:
                os.dup2(copy, fd)
                os.close(copy)
