"""What is read from an MJCF, and what is refused."""

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fastmimic.base.conventions import LEGS
from fastmimic.base.errors import RobotError
from fastmimic.clips.catalogue import open_clip
from fastmimic.motion.export import export_motion
from fastmimic.retargeting.retarget import retarget
from fastmimic.robot import ROBOT_NAMES, Robot, load_robot
from fastmimic.robot.kinematics import foot_jacobians, foot_positions
from robot.mjcf import (
    Simulated,
    a1_tree,
    drop,
    find,
    random_joints,
    random_quat,
    remove,
    remove_joint,
    write,
)

# Published by the maker: see the comment at the top of each MJCF.
PUBLISHED = {
    "a1": {
        "mass": 12.453,
        "hip": (0.183, 0.047),
        "lateral": 0.08505,
        "thigh": 0.2,
        "calf": 0.2,
        "foot": 0.02,
        "torque": (33.5, 33.5, 33.5),
        "speed": (21.0, 21.0, 21.0),
        "front": ((-0.802851, 0.802851), (-1.0472, 4.18879), (-2.69653, -0.916298)),
        "rear": ((-0.802851, 0.802851), (-1.0472, 4.18879), (-2.69653, -0.916298)),
    },
    "go1": {
        "mass": 12.743,
        "hip": (0.1881, 0.04675),
        "lateral": 0.08,
        "thigh": 0.213,
        "calf": 0.213,
        "foot": 0.023,
        "torque": (23.7, 23.7, 35.55),
        "speed": (30.1, 30.1, 20.06),
        "front": ((-0.863, 0.863), (-0.686, 4.501), (-2.818, -0.888)),
        "rear": ((-0.863, 0.863), (-0.686, 4.501), (-2.818, -0.888)),
    },
    "go2": {
        "mass": 15.206,
        "hip": (0.1934, 0.0465),
        "lateral": 0.0955,
        "thigh": 0.213,
        "calf": math.hypot(0.213, 0.002),
        "foot": 0.022,
        "torque": (23.7, 23.7, 45.43),
        "speed": (30.1, 30.1, 15.7),
        "front": ((-1.0472, 1.0472), (-1.5708, 3.4907), (-2.7227, -0.83776)),
        "rear": ((-1.0472, 1.0472), (-0.5236, 4.5379), (-2.7227, -0.83776)),
    },
}


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_a_built_in_robot_has_the_published_figures(name: str) -> None:
    robot, published = load_robot(name), PUBLISHED[name]
    assert robot.mass == pytest.approx(published["mass"], abs=5e-4)
    x, y = published["hip"]
    expected = [(x, -y, 0), (x, y, 0), (-x, -y, 0), (-x, y, 0)]
    np.testing.assert_allclose(robot.hip_pos_b, expected, atol=1e-12)
    np.testing.assert_allclose(robot.lateral_offset, published["lateral"] * np.array([-1, 1, -1, 1]), atol=1e-12)
    assert robot.thigh_length == pytest.approx(published["thigh"], abs=1e-12)
    assert robot.calf_length == pytest.approx(published["calf"], abs=1e-12)
    assert robot.foot_radius == published["foot"]
    np.testing.assert_array_equal(robot.torque_limit.reshape(4, 3), np.tile(published["torque"], (4, 1)))
    np.testing.assert_array_equal(robot.joint_speed_limit.reshape(4, 3), np.tile(published["speed"], (4, 1)))
    limits = np.stack([robot.joint_lower, robot.joint_upper], axis=-1).reshape(4, 3, 2)
    for leg, of_leg in zip(LEGS, limits, strict=True):
        np.testing.assert_array_equal(of_leg, published["front" if leg[0] == "F" else "rear"])


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_a_built_in_robot_is_the_same_on_both_sides(name: str) -> None:
    robot = load_robot(name)
    mirror = np.array([1, -1, 1])
    np.testing.assert_array_equal(robot.link_mass[0], robot.link_mass[1])
    inertias = robot.link_inertia * mirror * mirror[:, None]
    for right, left in ((0, 1), (2, 3)):
        legs = slice(0, 2) if name == "go1" else slice(None)  # Go1's description does not mirror the calves
        np.testing.assert_allclose(robot.link_com[right, legs] * mirror, robot.link_com[left, legs], atol=1e-12)
        np.testing.assert_allclose(inertias[right, legs], robot.link_inertia[left, legs], atol=1e-12)


def test_a_robot_may_be_given_by_path_or_by_a_name_in_any_case(tmp_path: Path) -> None:
    path = write(a1_tree(), tmp_path / "own.xml")
    assert load_robot(path).mass == load_robot("A1").mass == load_robot("a1").mass


def own_robot() -> ElementTree.Element:
    """Somebody else's robot: other names, order of legs and lengths, feet on bodies of their own, a floor."""
    tree = a1_tree()
    trunk = find(tree, "body", "trunk")
    names = {"FR": "right_fore", "FL": "left_fore", "RR": "right_hind", "RL": "left_hind"}
    legs = {leg: find(tree, "body", f"{leg}_hip") for leg in LEGS}
    for leg in LEGS:
        for geom in (f"{leg}_thigh",):
            find(tree, "geom", geom).set("fromto", "0 0 0 -0.01 0 -0.25")
        calf = find(tree, "body", f"{leg}_calf")
        calf.set("pos", "-0.01 0 -0.25")
        foot = find(tree, "geom", f"{leg}_foot")
        remove(tree, foot)
        socket = ElementTree.SubElement(calf, "body", {"name": f"{leg}_socket", "pos": "0.02 0 -0.22"})
        foot.set("pos", "0 0 0")
        socket.append(foot)
        trunk.remove(legs[leg])
    for leg in ("RL", "FR", "RR", "FL"):
        trunk.append(legs[leg])
    drop(tree, "keyframe")
    drop(tree, "custom")
    floor = {"name": "floor", "type": "plane", "size": "0 0 1"}
    world = tree.find("worldbody")
    assert world is not None
    ElementTree.SubElement(world, "geom", floor)
    for element in tree.iter():
        for key in ("name", "joint"):
            value = element.get(key, "")
            if value[:2] in names and value[2:3] == "_":
                element.set(key, names[value[:2]] + value[2:])
    tree.set("model", "mutt")
    return tree


def test_speed_limits_of_another_number_of_joints_are_refused(tmp_path: Path) -> None:
    def with_limits(data: str) -> Path:
        tree = own_robot()
        limits = ElementTree.SubElement(tree, "custom")
        ElementTree.SubElement(limits, "numeric", {"name": "joint_speed_limit", "data": data})
        return write(tree, tmp_path / "mutt.xml")

    np.testing.assert_array_equal(load_robot(with_limits("9")).joint_speed_limit, 9.0)
    np.testing.assert_array_equal(load_robot(with_limits("1 2 3")).joint_speed_limit, [1.0, 2.0, 3.0] * 4)
    with pytest.raises(RobotError, match=r"has 2 numbers; expected 1, 3 \(abduction, hip, knee\) or 12"):
        load_robot(with_limits("1 2"))
    with pytest.raises(RobotError, match=r"'joint_speed_limit' must be above 0 rad/s, found 0"):
        load_robot(with_limits("9 0 9"))


def test_a_joint_that_hardly_moves_is_refused(tmp_path: Path) -> None:
    tree = a1_tree()
    find(tree, "joint", "RL_knee").set("range", "-0.05 -0.02")
    with pytest.raises(RobotError, match=r"joint 'RL_knee' only moves from -0.05 to -0.02 rad; are its angles radians"):
        load_robot(write(tree, tmp_path / "degrees.xml"))


def test_somebody_elses_robot_works_whatever_its_names_order_and_lengths(tmp_path: Path) -> None:
    robot = load_robot(write(own_robot(), tmp_path / "mutt.xml"))
    assert robot.name == "mutt"
    assert robot.joint_names[:3] == ("right_fore_abduction", "right_fore_hip", "right_fore_knee")
    assert robot.foot_geoms == ("right_fore_foot", "left_fore_foot", "right_hind_foot", "left_hind_foot")
    assert robot.thigh_length == pytest.approx(math.hypot(0.01, 0.25))
    assert robot.calf_length == pytest.approx(math.hypot(0.02, 0.22))
    assert robot.mass == pytest.approx(12.453), "the floor is not part of the robot"
    np.testing.assert_array_equal(robot.joint_speed_limit, 21.0)
    assert "21 rad/s assumed" in robot.assumed[0]
    generator = np.random.default_rng(7)
    simulated = Simulated(robot)
    for _ in range(50):
        q = random_joints(robot, generator)
        simulated.pose(q, generator.normal(size=3), random_quat(generator))
        np.testing.assert_allclose(foot_positions(robot, q), simulated.feet_b(), rtol=0, atol=1e-9)
        np.testing.assert_allclose(foot_jacobians(robot, q), simulated.jacobians_b(), rtol=0, atol=1e-9)


def test_a_robot_with_meshes_beside_its_file_can_be_simulated(tmp_path: Path) -> None:
    tree = a1_tree()
    (tmp_path / "assets").mkdir()
    corners = "v 0 0 0\nv .125 0 0\nv 0 .125 0\nv 0 0 .125\n"
    (tmp_path / "assets" / "shell.obj").write_text(corners + "f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    compiler = tree.find("compiler")
    assert compiler is not None
    compiler.set("meshdir", "assets")
    ElementTree.SubElement(ElementTree.SubElement(tree, "asset"), "mesh", {"name": "shell", "file": "shell.obj"})
    shell = {"type": "mesh", "mesh": "shell", "contype": "0", "conaffinity": "0"}
    ElementTree.SubElement(find(tree, "body", "trunk"), "geom", shell)
    robot = load_robot(write(tree, tmp_path / "meshes.xml"))
    assert Simulated(robot).model.nmesh == 1
    assert robot.model().nmesh == 1
    assert retarget(open_clip("walk"), robot)[0].n_samples > 0

    assert load_robot(tmp_path / "meshes.xml").content == robot.content
    text = (tmp_path / "assets" / "shell.obj").read_text()
    (tmp_path / "assets" / "shell.obj").write_text(text.replace(".125", ".25"))
    longer = load_robot(tmp_path / "meshes.xml")
    assert longer.content != robot.content


def test_what_rounding_leaves_of_a_meshs_place_is_not_its_robots_content() -> None:
    def content(place: str, files: str = "of its meshes") -> bytes:
        return replace(load_robot("a1"), xml=f'<geom{place} type="mesh"/>', files_digest=files).content

    same = ["", ' pos="0 0 0"', ' pos="-2.63678e-16 -0 1e-17"', ' pos="0 0 0" quat="1 -2e-18 0 0"']
    assert len({content(place) for place in same}) == 1
    assert content(' pos="1e-05 0 0"') != content("")
    assert content("", "of others") != content("")
    assert load_robot("a1").content == load_robot("a1").xml.encode()


def test_joints_that_turn_without_end_have_a_range_that_is_said(tmp_path: Path) -> None:
    tree = a1_tree()
    for name in ("FL_hip", "FR_knee"):
        find(tree, "joint", name).set("limited", "false")
    robot, a1 = load_robot(write(tree, tmp_path / "endless.xml")), load_robot("a1")
    assert robot.assumed == ("no range of FR_knee, FL_hip in the model: ±3.14 rad assumed",)
    np.testing.assert_array_equal(robot.joint_upper[[2, 4]], np.pi)
    np.testing.assert_array_equal(np.delete(robot.joint_lower, [2, 4]), np.delete(a1.joint_lower, [2, 4]))
    np.testing.assert_array_equal(robot.knee_sign, a1.knee_sign)


def reversed_joint(tree: ElementTree.Element, name: str) -> None:
    """The same robot with an angle of the other sign."""
    joint = find(tree, "joint", name)
    axis, limits = {"abduction": ("-1 0 0", "-0.6 1.0"), "hip": ("0 -1 0", "-3.5 0.8"), "knee": ("0 -1 0", "0.9 2.6")}[
        name.split("_")[1]
    ]
    joint.attrib.update(axis=axis, range=limits)


def test_joints_that_turn_the_other_way_are_turned_round(tmp_path: Path) -> None:
    tree, names = a1_tree(), ("FR_abduction", "RL_hip", "FL_knee")
    (key,) = tree.iter("key")
    pose = [float(number) for number in key.attrib["qpos"].split()]
    for name in names:
        reversed_joint(tree, name)
        at = 7 + [joint.get("name") for joint in tree.iter("joint") if joint.get("name")].index(name)
        pose[at] = -pose[at]
    key.set("qpos", " ".join(map(str, pose)))
    find(tree, "joint", "FL_knee").attrib.update(stiffness="5", springref="1.5")
    robot, a1 = load_robot(write(tree, tmp_path / "other.xml")), load_robot("a1")
    assert [name for name, sign in zip(robot.joint_names, robot.joint_sign, strict=True) if sign < 0] == [
        "FR_abduction",
        "FL_knee",
        "RL_hip",
    ]
    np.testing.assert_allclose(robot.home_joint_pos, a1.home_joint_pos)
    np.testing.assert_array_equal(robot.knee_sign, a1.knee_sign)
    assert robot.model().joint("FL_knee").qpos_spring == [-1.5]
    assert (robot.joint_lower[0], robot.joint_upper[0]) == (-1.0, 0.6)
    assert (robot.joint_lower[5], robot.joint_upper[5]) == (-2.6, -0.9)
    q = random_joints(a1, np.random.default_rng(0))
    np.testing.assert_allclose(foot_positions(robot, q), foot_positions(a1, q), atol=1e-12)
    np.testing.assert_allclose(Simulated(robot).model.jnt_axis, Simulated(a1).model.jnt_axis)
    motion = retarget(open_clip("walk"), robot)[0]
    export_motion(motion, robot, tmp_path / "out.npz", "mjlab", fps=50)
    export_motion(retarget(open_clip("walk"), a1)[0], a1, tmp_path / "a1.npz", "mjlab", fps=50)
    mine, ordinary = (np.load(tmp_path / name)["joint_pos"] for name in ("out.npz", "a1.npz"))
    np.testing.assert_allclose(mine[:, [0, 5, 10]], -ordinary[:, [0, 5, 10]], atol=2e-3)
    np.testing.assert_allclose(mine[:, [1, 2, 3]], ordinary[:, [1, 2, 3]], atol=2e-3)


def test_degrees_are_read_as_degrees(tmp_path: Path) -> None:
    tree = a1_tree()
    compiler = tree.find("compiler")
    assert compiler is not None
    compiler.set("angle", "degree")
    for joint in tree.iter("joint"):
        if "range" in joint.attrib:
            joint.set("range", " ".join(f"{math.degrees(float(v)):.9f}" for v in joint.attrib["range"].split()))
    robot = load_robot(write(tree, tmp_path / "degrees.xml"))
    np.testing.assert_allclose(robot.joint_upper, load_robot("a1").joint_upper, atol=1e-9)


def eight_joints(tree: ElementTree.Element) -> None:
    for leg in LEGS:
        remove_joint(tree, f"{leg}_abduction")


def extra_slide(tree: ElementTree.Element) -> None:
    body = ElementTree.SubElement(find(tree, "body", "trunk"), "body", {"name": "tail"})
    ElementTree.SubElement(body, "joint", {"type": "slide", "name": "tail"})
    ElementTree.SubElement(body, "inertial", {"mass": "0.1", "pos": "0 0 0", "diaginertia": "1e-4 1e-4 1e-4"})
    drop(tree, "keyframe")


def no_free_joint(tree: ElementTree.Element) -> None:
    free = tree.find(".//freejoint")
    assert free is not None
    remove(tree, free)
    drop(tree, "keyframe")


def missing_leg(tree: ElementTree.Element) -> None:
    remove(tree, find(tree, "body", "RL_hip"))
    for joint in ("abduction", "hip", "knee"):
        remove(tree, find(tree, "motor", f"RL_{joint}"))
    drop(tree, "keyframe")


def wrong_axis(tree: ElementTree.Element) -> None:
    find(tree, "joint", "FL_knee").set("axis", "0 0 1")


def uneven_chains(tree: ElementTree.Element) -> None:
    remove_joint(tree, "FR_knee")
    calf = find(tree, "body", "FL_calf")
    ankle = ElementTree.SubElement(calf, "body", {"name": "FL_toe", "pos": "0 0 -0.2"})
    ElementTree.SubElement(ankle, "joint", {"name": "FL_ankle", "axis": "0 1 0", "range": "-1 1"})
    ElementTree.SubElement(ankle, "inertial", {"mass": "0.1", "pos": "0 0 0", "diaginertia": "1e-4 1e-4 1e-4"})


def two_right_fore_legs(tree: ElementTree.Element) -> None:
    find(tree, "body", "RL_hip").set("pos", "0.05 -0.047 0")


def no_range(tree: ElementTree.Element) -> None:
    find(tree, "joint", "RL_hip").set("limited", "false")
    drop(tree, "keyframe")


def no_torque(tree: ElementTree.Element) -> None:
    remove(tree, find(tree, "motor", "FR_knee"))


def no_foot(tree: ElementTree.Element) -> None:
    foot = find(tree, "geom", "RR_foot")
    foot.set("contype", "0")
    foot.set("conaffinity", "0")


def reference_angle(tree: ElementTree.Element) -> None:
    find(tree, "joint", "FR_hip").set("ref", "0.5")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (eight_joints, r"expected one free joint and 12 hinge .* found 1 free, 8 hinge and 0 other"),
        (extra_slide, r"found 1 free, 12 hinge and 1 other"),
        (no_free_joint, r"found 0 free, 12 hinge"),
        (missing_leg, r"found 1 free, 9 hinge"),
        (wrong_axis, r"knee joint 'FL_knee' turns about \[0\.0, 0\.0, 1\.0\]; expected \[0\.0, 1\.0, 0\.0\]"),
        (uneven_chains, r"leg at body 'F[RL]_hip' is not a chain of three links"),
        (two_right_fore_legs, r"expected one leg front right, front left, .* hips at .*\[0\.05, -0\.047\]"),
        (no_range, r"joint 'RL_hip' has no range, and no keyframe"),
        (no_torque, r"joint 'FR_knee' has no torque limit; give its actuator a forcerange"),
        (no_foot, r"leg at body 'RR_hip' has no colliding sphere on its last link"),
        (reference_angle, r"joint 'FR_hip' has a reference angle"),
    ],
)
def test_another_kind_of_robot_is_refused_with_what_was_found(
    change: Callable[[ElementTree.Element], None], message: str, tmp_path: Path
) -> None:
    tree = a1_tree()
    change(tree)
    path = write(tree, tmp_path / "other.xml")
    with pytest.raises(RobotError, match=message) as caught:
        load_robot(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_unknown_name_lists_the_names_there_are() -> None:
    with pytest.raises(RobotError, match=r"unknown robot 'g01'.*a1, go1, go2.*did you mean 'go1'"):
        load_robot("g01")


@pytest.mark.parametrize("content", [b"", b"hello", b"\x00\xff\xfe", b"<mujoco><worldbody/></mujoco>", b"<robot/>"])
def test_a_file_that_is_no_quadruped_is_refused_in_one_line(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "junk.xml"
    path.write_bytes(content)
    with pytest.raises(RobotError) as caught:
        load_robot(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RobotError, match="expected one URDF in this folder, found none"):
        load_robot(tmp_path)


def test_what_tells_robots_apart_does_not_depend_on_how_numbers_are_printed(robot: Robot) -> None:
    said = robot.said
    with np.printoptions(precision=2, suppress=True, linewidth=200, threshold=5, sign="+"):
        assert robot.said == said
