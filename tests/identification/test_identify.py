"""Identification: friction from feet that slide, a bound from feet that hold, and what the robot carries."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from fastmimic.base.errors import LogError
from fastmimic.control.config import ControllerConfig, read_config
from fastmimic.identification.forces import ground_forces
from fastmimic.identification.identify import FRICTION_MARGIN, Friction, identify
from fastmimic.imitation.evaluate import evaluate
from fastmimic.robot import Robot, load_robot
from fastmimic.robot.state import OBSERVATION, RunLog
from fastmimic.simulation.conditions import Conditions, Disturbance
from identification.conftest import MakeLog


class TestForces:
    def test_are_those_that_the_torques_were_made_of(self, robot: Robot, make_log: MakeLog) -> None:
        forces = ground_forces(make_log(0.4, 2.0), robot).force()
        assert forces[..., 2] == pytest.approx(0.25 * (robot.mass + 2.0) * 9.81, rel=0.02)
        assert forces[75, :, 0] == pytest.approx(-0.4 * forces[75, :, 2], rel=0.02)

    def test_match_the_simulators(self) -> None:
        found = evaluate("trot", duration_s=1.5, conditions=Conditions(observe="sensors"), log=True)
        assert found.rollout.log is not None
        forces = ground_forces(found.run_log(), load_robot("a1"))
        truth = np.roll(found.rollout.log.observation["foot_force"][0], 2, axis=0)  # readings are two steps late
        stands = forces.loaded & (forces.settled_s > 0.02) & forces.usable[:, None]
        error = (forces.force() - truth)[stands]
        assert np.median(np.abs(error), axis=0).max() < 6.0  # N, of 60, with gains off by 5 %


class TestFriction:
    @pytest.mark.parametrize("friction", [0.2, 0.4, 0.7])
    def test_is_that_of_the_slides(self, robot: Robot, make_log: MakeLog, friction: float) -> None:
        found = identify(make_log(friction, noise=0.2), robot).friction
        assert found.value == pytest.approx(friction, abs=0.02)
        assert found.upper is not None
        assert found.lower < friction < found.upper
        assert found.slides >= 8

    def test_without_a_slide_is_a_bound_and_leaves_the_controller_alone(self, robot: Robot, make_log: MakeLog) -> None:
        found = identify(make_log(0.4, slides=False), robot)
        assert found.friction.value is None
        assert found.friction.upper is None
        assert 0.1 < found.friction.lower <= 0.2  # they held at half of 0.4
        assert found.changes(ControllerConfig()) == {"robot": "a1"}

    def test_tells_the_controller_less_and_never_more(self, robot: Robot, make_log: MakeLog) -> None:
        config = ControllerConfig()
        found = identify(make_log(0.4), robot)
        assert found.friction.value is not None
        assert found.stance_friction(config) == pytest.approx(FRICTION_MARGIN * found.friction.value)
        assert identify(make_log(1.5), robot).stance_friction(config) == config.stance.friction

    @pytest.mark.slow
    def test_of_a_simulated_floor(self, data_folder: Path, robot: Robot) -> None:
        found = [self._on_a_floor(robot, 0.4, seed).value for seed in range(3)]  # one alone scatters by 0.05
        assert np.median([value for value in found if value is not None]) == pytest.approx(0.4, abs=0.08)

    def test_of_a_floor_that_does_not_slip(self, data_folder: Path, robot: Robot) -> None:
        found = self._on_a_floor(robot, 1.0, 0)
        assert found.value is None
        assert 0.4 < found.lower < 1.0

    def _on_a_floor(self, robot: Robot, floor: float, seed: int) -> Friction:
        conditions = Conditions("mujoco", "sensors", seed, (Disturbance("friction", (floor,)),))
        log = evaluate("dog:trot", duration_s=8.0, conditions=conditions, log=True).run_log()
        return identify(log, robot).friction


class TestPayload:
    def test_of_an_ideal_log(self, robot: Robot, make_log: MakeLog) -> None:
        found = identify(make_log(payload=2.0), robot).payload
        assert found is not None
        assert found.mass == pytest.approx(2.0, abs=0.05)
        assert found.lower < 2.0 < found.upper
        assert not found.tared

    def test_an_unloaded_run_takes_the_gains_out(self, robot: Robot, make_log: MakeLog) -> None:
        def measured(log: RunLog) -> RunLog:
            reading = log.reading.copy()
            reading["torque"] *= 1.08
            reading["foot_force"] *= 0.9
            return dataclasses.replace(log, reading=reading)

        loaded, empty = measured(make_log(payload=3.0)), measured(make_log(payload=0.0))
        alone, found = identify(loaded, robot).payload, identify(loaded, robot, empty).payload
        assert alone is not None
        assert abs(alone.mass - 3.0) > 0.2
        assert found is not None
        assert found.tared
        assert found.mass == pytest.approx(3.0, abs=0.05)
        assert found.upper - found.mass < 0.5

    def test_nothing_is_told_of_what_is_not_certain(self, robot: Robot, make_log: MakeLog) -> None:
        found = identify(make_log(payload=0.1), robot)
        assert found.payload is not None
        assert found.payload.certain == 0.0
        assert "load" not in found.changes(ControllerConfig())


class TestResult:
    def test_is_a_configuration(self, robot: Robot, make_log: MakeLog, tmp_path: Path) -> None:
        found = identify(make_log(0.4, 2.0), robot)
        found.save(tmp_path / "a1.json")
        config = read_config(tmp_path / "a1.json")
        assert config.robot == "a1"
        assert config.stance.friction == pytest.approx(found.stance_friction(ControllerConfig()), abs=1e-3)
        assert config.load.mass == pytest.approx(2.0, abs=0.05)
        assert found.configure(ControllerConfig()).stance == config.stance
        said = json.loads((tmp_path / "a1.json").read_text())["identified"]
        assert said["friction"]["slides"] == found.friction.slides

    def test_never_uses_the_truth(self, robot: Robot) -> None:
        """What only a simulator knows may be anything."""
        found = evaluate("trot", duration_s=1.2, conditions=Conditions(observe="sensors"), log=True)
        log = found.rollout.log
        assert log is not None
        expected = identify(found.run_log(), robot)
        for name in OBSERVATION.names or ():
            log.observation[name] = np.nan
        log.demonstration["root_pos"] = np.nan
        log.force[:] = log.terms[:] = np.nan
        assert identify(found.run_log(), robot) == expected


class TestWhatCannotBeIdentified:
    def test_another_robot(self, make_log: MakeLog) -> None:
        with pytest.raises(LogError, match="the log is of robot 'a1', not of 'go1'; give --robot a1"):
            identify(make_log(), load_robot("go1"))

    def test_too_short(self, robot: Robot, make_log: MakeLog) -> None:
        log = make_log()
        cut = {name: getattr(log, name)[:200] for name in ("reading", "command", "estimate", "stance")}
        with pytest.raises(LogError, match=r"0\.40 s long; at least 1 s"):
            identify(dataclasses.replace(log, **cut), robot)

    def test_readings_that_are_no_numbers(self, robot: Robot, make_log: MakeLog) -> None:
        reading = make_log().reading.copy()
        reading["torque"][500, 3] = np.nan
        with pytest.raises(LogError, match="'torque' is not always finite"):
            identify(dataclasses.replace(make_log(), reading=reading), robot)

    def test_a_robot_that_lies(self, robot: Robot, make_log: MakeLog) -> None:
        log = make_log()
        lying = log.estimate.copy()
        lying["root_quat"] = [np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0]
        with pytest.raises(LogError, match="feet stand in only 0 control steps"):
            identify(dataclasses.replace(log, estimate=lying), robot)
