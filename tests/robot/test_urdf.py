"""Robots from URDFs, as vendors publish them: a dummy base, fixed feet, packages of meshes that may not be there."""

import re
import struct
from pathlib import Path

import numpy as np
import pytest

from fastmimic.base.conventions import JOINT_NAMES, LEGS
from fastmimic.base.errors import RobotError
from fastmimic.cli import main
from fastmimic.imitation.evaluate import evaluate
from fastmimic.robot import Robot, load_robot
from fastmimic.robot.kinematics import foot_positions

ORDER = ("RL", "FR", "RR", "FL")  # not ours
RANGES = {"hip": (-0.8, 0.8), "thigh": (-1.05, 4.19), "calf": (-2.7, -0.92)}
MASSES = {"hip": 0.7, "thigh": 1.0, "calf": 0.2}


def inertial(mass: float) -> str:
    i = 0.004 * mass
    return (
        f'<inertial><mass value="{mass}"/><inertia ixx="{i}" ixy="0" ixz="0" iyy="{i}" iyz="0" izz="{i}"/></inertial>'
    )


def mesh(tag: str, name: str) -> str:
    return f'<{tag}><geometry><mesh filename="package://dog_description/meshes/{name}"/></geometry></{tag}>'


def joint(
    name: str, parent: str, child: str, xyz: tuple[float, float, float], rest: str = "", kind: str = "fixed"
) -> str:
    origin = '<origin xyz="{} {} {}"/>'.format(*xyz)
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="{kind}">{origin}{ends}{rest}</joint>'


def speed(leg: str, part: str) -> float:
    """Of each joint another one, rad/s."""
    return 10.0 + 3 * LEGS.index(leg) + list(RANGES).index(part)


def leg_text(leg: str, *, sphere: bool, effort: float) -> str:
    front, left = 1 if leg[0] == "F" else -1, 1 if leg[1] == "L" else -1
    origins = {"hip": (0.18 * front, 0.047 * left, 0.0), "thigh": (0.0, 0.085 * left, 0.0), "calf": (0.0, 0.0, -0.2)}
    text, above = "", "trunk"
    for part, origin in origins.items():
        name = f"{leg}_{part}"
        axis = "1 0 0" if part == "hip" else "0 1 0"
        low, high = RANGES[part]
        limit = f'<limit lower="{low}" upper="{high}" effort="{effort}" velocity="{speed(leg, part)}"/>'
        text += f'<link name="{name}">{inertial(MASSES[part])}{mesh("visual", part + ".dae")}</link>'
        text += joint(f"{name}_joint", above, name, origin, f'<axis xyz="{axis}"/>{limit}', "revolute")
        above = name
    ball = '<collision><geometry><sphere radius="0.02"/></geometry></collision>' if sphere else ""
    text += f'<link name="{leg}_foot">{inertial(0.06)}{ball}</link>'
    return text + joint(f"{leg}_foot_fixed", above, f"{leg}_foot", (0.0, 0.0, -0.2))


def urdf(*, sphere: bool = True, trunk_mesh: str = "trunk.stl", effort: float = 33.5) -> str:
    """A quadruped of an A1's measures."""
    zero = '<inertial><mass value="0"/><inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial>'
    box = '<collision><geometry><box size="0.26 0.19 0.11"/></geometry></collision>'
    trunk = (
        f'<link name="trunk">{inertial(6.0)}{box}{mesh("collision", trunk_mesh)}{mesh("visual", "trunk.dae")}</link>'
    )
    ear = f'<link name="ear">{box}</link>' + joint("ear_fixed", "trunk", "ear", (0.2, 0.0, 0.1))
    legs = "".join(leg_text(leg, sphere=sphere, effort=effort) for leg in ORDER)
    base = f'<link name="base">{zero}</link>{joint("floating_base", "base", "trunk", (0.0, 0.0, 0.0))}'
    return f'<robot name="dog">{base}{trunk}{ear}{legs}<gazebo><plugin filename="lib.so"/></gazebo></robot>'


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    found = tmp_path / "ros" / "dog_description"
    (found / "urdf").mkdir(parents=True)
    (found / "urdf" / "dog.urdf").write_text(urdf())
    return found


def test_legs_limits_and_mass_are_those_of_the_file(folder: Path) -> None:
    robot = load_robot(folder / "urdf" / "dog.urdf")
    assert (robot.name, robot.joint_names[:4]) == (
        "dog",
        ("FR_hip_joint", "FR_thigh_joint", "FR_calf_joint", "FL_hip_joint"),
    )
    assert len(robot.joint_names) == len(JOINT_NAMES)
    np.testing.assert_allclose(robot.hip_pos_b[0], [0.18, -0.047, 0.0], atol=1e-9)
    np.testing.assert_allclose(robot.lateral_offset, [-0.085, 0.085, -0.085, 0.085], atol=1e-9)
    assert (robot.thigh_length, robot.calf_length, robot.foot_radius) == pytest.approx((0.2, 0.2, 0.02))
    np.testing.assert_allclose(robot.joint_lower.reshape(4, 3)[2], [low for low, _ in RANGES.values()])
    np.testing.assert_allclose(robot.torque_limit, 33.5)
    np.testing.assert_allclose(robot.joint_speed_limit, [speed(leg, part) for leg in LEGS for part in RANGES])
    assert robot.mass == pytest.approx(6.0 + 4 * (1.9 + 0.06))  # nothing for shapes without inertia, or the dummy base


def test_it_stands_on_bent_legs(folder: Path) -> None:
    robot = load_robot(folder)  # the vendor's folder has one URDF
    feet = foot_positions(robot, robot.home_joint_pos[None])[0]
    np.testing.assert_allclose(feet[:, :2], robot.hip_pos_b[:, :2] + np.outer(robot.lateral_offset, [0, 1]), atol=1e-6)
    np.testing.assert_allclose(feet[:, 2], robot.foot_radius - robot.home_height, atol=1e-6)
    assert np.all(robot.knee_sign < 0)
    assert np.all(robot.armature > 0)
    assert sum("in a URDF" in sentence for sentence in robot.assumed) == 2


def test_meshes_are_found_beside_the_package_or_left_out_with_a_word(folder: Path) -> None:
    assert any("meshes left out" in s and s.endswith("at trunk") for s in load_robot(folder).assumed)
    corners = [(0, 0, 0), (0.1, 0, 0), (0, 0.1, 0), (0, 0, 0.1)]
    faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    data = b"\0" * 80 + struct.pack("<I", 4)
    for face in faces:
        data += struct.pack("<12fH", 0, 0, 0, *(x for i in face for x in corners[i]), 0)
    (folder / "meshes").mkdir()
    (folder / "meshes" / "trunk.stl").write_bytes(data)
    robot = load_robot(folder)
    assert not any("meshes" in sentence for sentence in robot.assumed)
    assert robot.files_digest
    assert 'file="../meshes/trunk.stl"' in robot.xml  # the same on every machine
    assert robot.model().nmesh == 1
    (folder / "urdf" / "dog.urdf").write_text(urdf(trunk_mesh="trunk.dae"))
    assert any("neither STL nor OBJ" in sentence for sentence in load_robot(folder).assumed)


def test_a_link_without_a_shape_is_drawn_and_collides_with_nothing(folder: Path) -> None:
    box = '<collision><geometry><box size="0.26 0.19 0.11"/></geometry></collision><collision><geometry><mesh'
    (folder / "urdf" / "dog.urdf").write_text(urdf().replace(box, "<collision><geometry><mesh"))
    robot = load_robot(folder)
    model = robot.model()
    (drawn,) = np.flatnonzero(model.geom_bodyid == model.body("trunk").id)
    assert not model.geom_contype[drawn]
    assert not model.geom_conaffinity[drawn]
    np.testing.assert_allclose(model.geom_size[drawn, :2], np.abs(robot.hip_pos_b[:, :2]).max(axis=0), atol=1e-6)


def test_a_foot_without_a_sphere_gets_one(folder: Path) -> None:
    (folder / "urdf" / "dog.urdf").write_text(urdf(sphere=False))
    robot = load_robot(folder)
    assert robot.foot_radius == pytest.approx(0.02)  # a tenth of the calf
    assert any("no spheres as feet: assumed at" in s and "FR_foot 20 mm" in s for s in robot.assumed)


def test_without_top_speeds_one_is_assumed(folder: Path) -> None:
    (folder / "urdf" / "dog.urdf").write_text(re.sub(r' velocity="[\d.]+"', "", urdf()))
    robot = load_robot(folder)
    np.testing.assert_array_equal(robot.joint_speed_limit, 21.0)
    assert [s for s in robot.assumed if "rad/s" in s] == [
        'no <limit velocity="…"/> of every joint in the URDF: 21 rad/s assumed'
    ]


def test_it_trots(folder: Path) -> None:
    result = evaluate("trot", load_robot(folder), duration_s=2.0)
    assert not result.rollout.fell.any()
    assert result.as_dict()["reward_mean"] > 0.85


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<robot name='dog'><link", "not a readable URDF"),
        (urdf().replace('RL_calf_joint" type="revolute', 'RL_calf_joint" type="fixed'), "found 11 revolute"),
        (
            urdf().replace('RL_calf_joint" type="revolute', 'RL_calf_joint" type="prismatic'),
            "found 11 revolute, 1 prismatic",
        ),
        (
            '<robot name="brick"><link name="brick"/></robot>',
            r"expected twelve revolute joints, four legs of three .*; found no joints that move",
        ),
        (urdf(effort=0.0), r'joint \'RL_hip_joint\' has no torque limit; give it <limit effort="…"/>'),
    ],
)
def test_what_is_no_such_robot_is_refused_in_a_line(
    text: str, words: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "urdf" / "dog.urdf").write_text(text)
    with pytest.raises(RobotError, match=words):
        load_robot(folder)
    assert main(["robots", str(folder)]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_a_folder_with_two_robots_is_asked_about(folder: Path) -> None:
    (folder / "urdf" / "cat.urdf").write_text(urdf())
    with pytest.raises(RobotError, match=r"found urdf/cat.urdf, urdf/dog.urdf; give the file"):
        load_robot(folder)
    (folder / "meshes").mkdir()
    with pytest.raises(RobotError, match="found none"):
        load_robot(folder / "meshes")


def test_the_command_says_what_a_file_is_taken_for(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["robots", str(folder / "urdf" / "dog.urdf")]) == 0
    lines = {line.split()[0]: line for line in capsys.readouterr().out.splitlines()}
    assert "FR at (+0.180, -0.047) m" in lines["legs"]
    assert "FR_foot, FL_foot, RR_foot, RL_foot: spheres of 20 mm" in lines["feet"]
    assert "knee 33.5 N·m" in lines["torque"]
    assert "knees point back" in lines["stands"]
    for robot in (str(folder), "go2"):
        assert main(["robots", robot]) == 0
        *_, assumed = lines = capsys.readouterr().out.splitlines()
        assert len(lines) == 10
        assert ("meshes left out" in assumed and "rotor inertia" in assumed) == (robot != "go2")


def published(name: str) -> Robot:
    data = pytest.importorskip("pybullet_data", reason="the extra 'pybullet' brings vendors' URDFs")
    return load_robot(Path(data.getDataPath()) / name)


def test_pybullets_a1_is_an_a1() -> None:
    robot, own = published("a1/a1.urdf"), load_robot("a1")
    assert robot.mass == pytest.approx(own.mass, rel=0.01)
    np.testing.assert_allclose(robot.hip_pos_b, own.hip_pos_b, atol=0.01)
    np.testing.assert_allclose(robot.joint_lower, own.joint_lower, atol=0.01)
    assert robot.leg_length == pytest.approx(own.leg_length, rel=0.01)


def test_pybullets_laikago_has_no_inertia_and_is_refused() -> None:
    with pytest.raises(RobotError, match=r"mass and inertia of moving bodies .* 'chassis'"):
        published("laikago/laikago_toes_limits.urdf")
