"""The controller's parameters: named sets, refusal of nonsense, units for the kernels."""

import dataclasses
import json

import numpy as np
import pytest

from control.bodies import body
from control.motions import gait
from fastmimic.base.conventions import GRAVITY
from fastmimic.base.errors import ConfigError
from fastmimic.control.config import (
    CONFIGS,
    ControllerConfig,
    GaitConfig,
    StanceConfig,
    SwingConfig,
    controller_config,
    pack_config,
)
from fastmimic.control.controller import gains_of
from fastmimic.learning.config import PolicyConfig, pack_settings
from fastmimic.reference.standing import standing_gains
from fastmimic.retargeting.config import RetargetConfig
from fastmimic.robot import load_robot


@pytest.mark.parametrize("name", sorted(CONFIGS))
def test_sets_are_found_by_name_and_know_it(name: str) -> None:
    assert controller_config(name).name == name


def test_an_unknown_set_is_refused_with_the_names_there_are() -> None:
    with pytest.raises(
        ConfigError,
        match=r"unknown configuration 'defualt'; there are default, paper, or a file .* did you mean 'default'",
    ):
        controller_config("defualt")


def test_factories_return_fresh_and_equal_objects() -> None:
    assert ControllerConfig() == ControllerConfig() == ControllerConfig()
    assert ControllerConfig() is not ControllerConfig()
    assert ControllerConfig() != CONFIGS["paper"]


@pytest.mark.parametrize("name", sorted(CONFIGS))
def test_a_set_can_be_written_to_a_file(name: str) -> None:
    text = json.dumps(controller_config(name).as_dict(), allow_nan=False)
    assert json.loads(text)["stance"]["friction"] == controller_config(name).stance.friction


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"rate_hz": 0.0}, r"rate_hz must be in \(0, 10000\]"),
        ({"gait": {"planner": "clever"}}, "gait.planner must be one of schedule, full"),
        ({"gait": {"min_switch_time": -0.1}}, "gait.min_switch_time must not be negative"),
        ({"gait": {"contact_threshold": 0.1, "release_threshold": 0.2}}, "gait.release_threshold must be in"),
        ({"stance": {"adaptation": "some"}}, "stance.adaptation must be one of off, paper, full"),
        ({"stance": {"friction": 0.0}}, "stance.friction must be positive"),
        ({"stance": {"leg_momentum": 2}}, "stance.leg_momentum must be true or false"),
        ({"stance": {"friction_sides": 6}}, "stance.friction_sides must be one of 4, 8"),
        ({"stance": {"force_weight": 0.0}}, "stance.force_weight must be positive"),
        ({"stance": {"min_force": 2.0, "max_force": 1.0}}, "stance.min_force must be in"),
        ({"stance": {"acceleration_weight": (1, 1, 1, 1, 1, -1)}}, "stance.acceleration_weight must not be negative"),
        ({"swing": {"liftoff_blend_time": -0.1}}, "swing.liftoff_blend_time must not be negative"),
        ({"stance": {"disturbance_time": -0.1}}, "stance.disturbance_time must not be negative"),
        ({"stance": {"friction": float("nan")}}, "stance.friction must be finite"),
        ({"stance": {"position_gain": (1, 2, 3, 4, 5, float("inf"))}}, "stance.position_gain must be finite"),
        ({"swing": {"velocity_feedback": (0.1, float("nan"))}}, "swing.velocity_feedback must be finite"),
        ({"swing": {"joint_damping": -1.0}}, "swing.joint_damping must not be negative"),
    ],
)
def test_nonsense_is_refused_by_name(changes: dict[str, object], message: str) -> None:
    parts = {"gait": GaitConfig(), "stance": StanceConfig(), "swing": SwingConfig()}
    given = {k: dataclasses.replace(parts[k], **v) if isinstance(v, dict) else v for k, v in changes.items()}
    with pytest.raises(ConfigError, match=f"configuration 'mine': {message}"):
        ControllerConfig(name="mine", **given)


def test_forces_are_multiples_of_the_weight() -> None:
    """One set for all robots: a robot twice as heavy is pushed and felt twice as hard."""
    light, heavy = (pack_config(ControllerConfig(), body(mass))[0] for mass in (10.0, 20.0))
    for name in ("contact_threshold", "release_threshold", "min_force", "max_force"):
        assert heavy[name] == 2 * light[name]
    assert light["max_force"] == 10.0 * GRAVITY * ControllerConfig().stance.max_force


def test_the_a1_gets_the_numbers_as_they_are() -> None:
    packed, config = pack_config(ControllerConfig(), load_robot("a1"))[0], ControllerConfig()
    assert packed["r_weight"] == config.stance.force_weight
    assert packed["stance_kp"] == config.stance.joint_stiffness
    assert packed["swing_kd"] == config.swing.joint_damping
    assert packed["swing_height"] == config.swing.swing_height


def test_a_heavier_robot_is_as_stiff_for_what_it_has_to_move() -> None:
    """R f² stays what it is relative to ẍ², and legs keep their frequency and damping."""
    one, other = (pack_config(ControllerConfig(), body(mass, inertia))[0] for mass, inertia in ((10, 0.03), (30, 0.12)))
    assert other["r_weight"] * 9 == pytest.approx(one["r_weight"], rel=1e-12)
    for name in ("stance_kp", "stance_kd", "swing_kp", "swing_kd"):
        assert other[name] == pytest.approx(4 * one[name], rel=1e-12)


def test_lengths_and_speeds_of_recoveries_are_those_of_the_legs() -> None:
    small, robot = load_robot("a1"), load_robot("go2")
    large = dataclasses.replace(robot, thigh_vector=2 * robot.thigh_vector, calf_vector=2 * robot.calf_vector)
    a1, one, other = (pack_config(ControllerConfig(), each)[0] for each in (small, robot, large))
    assert (a1["size"], a1["recovery_top_speed"]) == (1.0, ControllerConfig().gait.recovery_top_speed)
    for name in ("size", "recovery_top_speed", "recovery_reach", "swing_height"):
        np.testing.assert_allclose(other[name], 2 * one[name], rtol=1e-12)
    given = RetargetConfig()
    assert given.for_robot(small) == given
    one, other = given.for_robot(robot), given.for_robot(large)
    for name in ("knee_clearance_m", "turning_radius_m"):
        assert getattr(other, name) == pytest.approx(2 * getattr(one, name), rel=1e-12)
    assert other.swing.min_clearance_m == pytest.approx(2 * one.swing.min_clearance_m, rel=1e-12)


def test_a_robot_stands_and_is_trained_with_gains_of_its_size() -> None:
    a1, go2 = load_robot("a1"), load_robot("go2")
    assert standing_gains(a1) == (120.0, 3.0)
    assert standing_gains(go2)[0] == pytest.approx(120.0 * go2.mass / a1.mass)
    one, other = (pack_settings(PolicyConfig(), robot)["stiffness"][0] for robot in (a1, go2))
    np.testing.assert_array_equal(one, PolicyConfig().stiffness)
    np.testing.assert_allclose(other / one, np.mean(go2.joint_inertia) / np.mean(a1.joint_inertia), rtol=1e-12)


def test_kernels_get_what_was_set() -> None:
    stance = StanceConfig(position_gain=(1, 2, 3, 4, 5, 6), velocity_gain=(7, 8, 9, 10, 11, 12), friction=0.7)
    swing = SwingConfig(velocity_feedback=(0.04, 0.05))
    packed = pack_config(ControllerConfig(rate_hz=250.0, stance=stance, swing=swing), body(10.0))[0]
    assert packed["dt"] == 0.004
    assert packed["mu"] == 0.7
    np.testing.assert_array_equal(packed["velocity_feedback"], [0.04, 0.05])


def test_every_parameter_reaches_the_kernels() -> None:
    """A setting that is accepted and ignored is worse than none."""
    robot = load_robot("a1")
    motion = gait(robot, (0.4, 0.0))

    def kernels(config: ControllerConfig) -> bytes:
        constant = dataclasses.replace(config, stance=dataclasses.replace(config.stance, feedback="constant"))
        gains = [gains_of(motion, robot, each).tobytes() for each in (config, constant)]
        return b"".join([pack_config(config, robot).tobytes(), *gains])

    config = ControllerConfig()
    packed = kernels(config)
    for part in ("gait", "stance", "horizon", "swing", "regulator"):
        settings = getattr(config, part)
        for field in dataclasses.fields(settings):
            value = getattr(settings, field.name)
            changed = {
                "forces": "horizon" if value == "instant" else "instant",
                "steps": 7,
                "solve_rate_hz": 100.0,
                "foothold": "raibert",
                "feedback": "constant",
                "planner": "schedule" if value == "full" else "full",
                "adaptation": "off" if value != "off" else "full",
                "friction_sides": 4,
            }.get(field.name)
            if changed is None:
                changed = (
                    not value
                    if isinstance(value, bool)
                    else tuple(1.01 * v + 0.001 for v in value)
                    if isinstance(value, tuple)
                    else 1.01 * value + 1e-4
                )
            other = dataclasses.replace(config, **{part: dataclasses.replace(settings, **{field.name: changed})})
            assert kernels(other) != packed, f"{part}.{field.name}"
