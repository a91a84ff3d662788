"""The controller's parameters in a file, and a payload that it knows of."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fastmimic.base.configuration import changed
from fastmimic.base.errors import ConfigError
from fastmimic.control.config import (
    CONFIGS,
    FILE_FORMAT,
    ControllerConfig,
    LoadConfig,
    controller_config,
    loaded_robot,
    read_config,
)
from fastmimic.control.controller import Controller
from fastmimic.robot import load_robot
from fastmimic.runs.loading import load_motion


def write(path: Path, **content: Any) -> Path:
    path.write_text(json.dumps({**FILE_FORMAT, **content}))
    return path


def test_changes_the_set_that_it_names(tmp_path: Path) -> None:
    path = write(
        tmp_path / "mine.json", base="paper", stance={"friction": 0.3}, load={"mass": 2, "position": [0, 0, 0.1]}
    )
    config = controller_config(str(path))
    assert config.name == "mine.json"
    assert config.stance.friction == 0.3
    assert config.load == LoadConfig(2.0, (0.0, 0.0, 0.1))
    assert config.swing == CONFIGS["paper"].swing


@pytest.mark.parametrize("name", sorted(CONFIGS))
def test_comes_back_from_a_record(name: str) -> None:
    config = changed(controller_config(name), {"robot": "a1", "load": {"mass": 1.0}}, "here")
    assert ControllerConfig.from_dict(json.loads(json.dumps(config.as_dict()))) == config


@pytest.mark.parametrize(
    "damage",
    [
        lambda record: record["stance"].pop("friction"),
        lambda record: record["stance"].update(fricton=0.3),
        lambda record: record["stance"].update(friction=-1.0),
        lambda record: record.update(gait=3),
        lambda record: record.clear(),
    ],
)
def test_a_record_of_another_release_is_refused(damage: Any) -> None:
    record = json.loads(json.dumps(ControllerConfig().as_dict()))
    damage(record)
    with pytest.raises(ConfigError, match="another release"):
        ControllerConfig.from_dict(record)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ({"stance": {"fricton": 0.3}}, "unknown 'fricton'.*did you mean 'friction'"),
        ({"stances": {}}, "unknown 'stances'"),
        ({"stance": 0.3}, "'stance' must be an object with the fields of StanceConfig"),
        ({"stance": {"friction": "low"}}, "'friction' must be of the kind of 0.6, not 'low'"),
        ({"stance": {"friction": -1}}, "stance.friction must be positive"),
        ({"stance": {"position_gain": [1, 2]}}, "'position_gain' must be a list of 6 numbers"),
        ({"load": {"mass": -2}}, "load.mass must not be negative"),
        ({"base": "defualt"}, "unknown base 'defualt'.*did you mean 'default'"),
        ({"version": 2}, "not a controller's configuration"),
    ],
)
def test_one_line_for_what_is_wrong(tmp_path: Path, content: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        read_config(write(tmp_path / "mine.json", **content))


def test_one_line_for_no_file(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no such file"):
        read_config(tmp_path / "none.json")
    (tmp_path / "half.json").write_text('{"format":')
    with pytest.raises(ConfigError, match="cannot be read"):
        read_config(tmp_path / "half.json")


def test_is_for_its_robot_only() -> None:
    robot, config = load_robot("a1"), changed(ControllerConfig(), {"robot": "go1"}, "here")
    with pytest.raises(ConfigError, match="is for robot 'go1', not 'a1'"):
        Controller(robot, [load_motion("trot", robot)], 1, config)


class TestLoad:
    def test_nothing_leaves_the_robot_as_it_is(self) -> None:
        robot = load_robot("a1")
        assert loaded_robot(robot, LoadConfig()) is robot

    def test_moves_the_centre_of_mass_and_adds_inertia(self) -> None:
        robot = load_robot("a1")
        loaded = loaded_robot(robot, LoadConfig(2.0, (0.0, 0.0, 0.1)))
        assert loaded.mass == pytest.approx(robot.mass + 2.0)
        assert loaded.mass * loaded.com_b == pytest.approx(robot.mass * robot.com_b + np.array([0.0, 0.0, 0.2]))
        assert loaded.trunk_mass * loaded.trunk_com_b == pytest.approx(
            robot.trunk_mass * robot.trunk_com_b + np.array([0.0, 0.0, 0.2])
        )
        # of two bodies: about the common centre by the reduced mass, and nothing about the line between them
        d = np.array([0.0, 0.0, 0.1]) - robot.com_b
        reduced = 2.0 * robot.mass / (2.0 + robot.mass)
        expected = robot.inertia_b + reduced * (d @ d * np.eye(3) - np.outer(d, d))
        assert loaded.inertia_b == pytest.approx(expected)
