"""From lying to lying: what is done, in which order, and what it is worth."""

import dataclasses

import numpy as np
import pytest

from deploy.rig import Rig, once
from fastmimic.base.errors import ConfigError, DriverError, LogError, MotionError
from fastmimic.control.config import ControllerConfig
from fastmimic.deploy.computer import LoopClock, Rehearsal, VirtualClock
from fastmimic.deploy.deployment import Deployment, figures, score_log
from fastmimic.deploy.log import DeploymentLog
from fastmimic.deploy.safety import SafetyLimits, StopReason
from fastmimic.deploy.sequence import Follower, MotionSequence, make_sequence
from fastmimic.deploy.sim import LinkFaults, SimDriver
from fastmimic.deploy.state_machine import DeploymentPhase, StateMachine
from fastmimic.deploy.summary import summary_rows
from fastmimic.imitation.evaluate import evaluate
from fastmimic.motion.motion import Motion
from fastmimic.reference.table import SAMPLE, world_root
from fastmimic.robot import Robot
from fastmimic.robot.state import COMMAND, MEMORY, OBSERVATION
from fastmimic.runs.loading import load_motion
from fastmimic.simulation.conditions import Conditions
from fastmimic.stitching.join import stitch_motions


@pytest.fixture(scope="module")
def trotted(a1: Robot, way: MotionSequence) -> tuple[Rig, Deployment]:
    """Six cycles of the trot. Not to be changed."""
    rig = Rig(a1, way)
    return rig, rig.run(cycles=6)


def test_it_stands_up_trots_and_sits_down(trotted: tuple[Rig, Deployment]) -> None:
    _, done = trotted
    result = done.result
    assert done.outcome.stopped_by is StopReason.CYCLES
    assert not result["fell"]
    phases = done.log.rows["phase"]
    assert list(dict.fromkeys(phases.tolist())) == [int(p) for p in DeploymentPhase if p < DeploymentPhase.DONE]
    truth = done.log.truth
    assert truth is not None
    walked = truth["root_pos"][-1, :2] - truth["root_pos"][0, :2]
    assert walked[0] > 2.0, "m, forwards"
    height = truth["root_pos"][:, 2]
    assert height[phases == DeploymentPhase.SETTLE].min() > 0.25, "m: it stands"
    assert height[-1] < 0.15, "m: it lies"
    assert truth["other_contact"][phases == DeploymentPhase.FOLLOW].max() == 0.0
    last = done.log.rows["command"][-1]
    assert last["stiffness"].max() < 1e-9, "it has been let go"
    assert 6.0 <= result["cycles"] <= 7.1
    assert result["deadline_misses"] == result["periods_skipped"] == 0
    assert result["packets"]["lost"] == result["packets"]["rejected"] == 0


def test_everything_that_is_sent_is_within_the_limits(trotted: tuple[Rig, Deployment], a1: Robot) -> None:
    sent = np.concatenate(trotted[0].driver.written)
    assert np.isfinite(sent.view(np.float64)).all()
    assert (sent["joint_pos"] >= a1.joint_lower).all()
    assert (sent["joint_pos"] <= a1.joint_upper).all()
    assert (np.abs(sent["torque"]) <= a1.torque_limit).all()
    assert (np.abs(sent["joint_vel"]) <= a1.joint_speed_limit).all()


def test_the_reward_is_that_of_the_closed_loop_with_sensors(trotted: tuple[Rig, Deployment], a1: Robot) -> None:
    rig, done = trotted
    conditions = Conditions(observe="sensors")
    loop = evaluate(rig.sequence.motion, a1, duration_s=3.0, conditions=conditions).rollout
    assert done.result["reward_truth_mean"] == pytest.approx(loop.reward[0], abs=0.02)
    lifted = np.array(done.result["swing_clearance_truth_m"])
    np.testing.assert_allclose(lifted, loop.clearance[0], atol=0.005)  # m
    assert done.result["reward_mean"] == pytest.approx(done.result["reward_truth_mean"], abs=0.05)


@pytest.mark.slow
def test_lock_step_is_the_same_every_time(a1: Robot, standstill: MotionSequence) -> None:
    first, second = Rig(a1, standstill).run(), Rig(a1, standstill).run()
    assert first.log.rows.tobytes() == second.log.rows.tobytes()
    assert first.result == second.result


@pytest.mark.slow
def test_a_wire_that_loses_and_delays_is_survived(trotting: Rig, a1: Robot) -> None:
    trotting.put_in(SimDriver(a1, trotting.clock, faults=LinkFaults(latency_s=0.004, loss=0.05)))
    done = trotting.run(duration_s=3.0)
    assert done.outcome.stopped_by is StopReason.DURATION
    assert not done.result["fell"]
    packets = done.result["packets"]
    assert 0.03 < packets["lost"] / packets["received"] < 0.08
    assert done.result["reward_truth_mean"] > 0.85


@pytest.mark.slow
def test_what_is_wrong_with_messages_is_counted_and_not_used(stands: Rig, a1: Robot) -> None:
    faults = LinkFaults(duplicate=0.05, reorder=0.05, corrupt=0.05, not_finite=0.02)
    stands.put_in(SimDriver(a1, stands.clock, faults=faults))
    done = stands.run()
    assert done.outcome.stopped_by is StopReason.DURATION
    packets = done.result["packets"]
    assert 0.1 < packets["rejected"] / packets["received"] < 0.25
    sequence = done.log.rows["sequence"]
    assert (np.diff(sequence) >= 0).all()
    assert np.isfinite(done.log.rows["reading"]["joint_pos"]).all()


@pytest.mark.slow
def test_a_person_has_it_sit_down(trotting: Rig) -> None:
    def press(machine: object) -> None:
        trotting.switch.leave = True

    done = trotting.run(endless=True, watch=once(lambda machine: machine.in_motion, press))
    assert done.outcome.stopped_by is StopReason.ASKED
    assert 0.0 < done.result["cycles"] <= 1.1
    assert done.log.rows["phase"][-1] == DeploymentPhase.RELEASE


def test_asked_while_it_stands_up_it_does_not_begin_to_step(trotting: Rig) -> None:
    trotting.switch.leave = True
    done = trotting.run()
    assert done.outcome.stopped_by is StopReason.ASKED
    assert DeploymentPhase.FOLLOW not in done.log.rows["phase"]
    assert done.result["reward_mean"] is None


def test_a_robot_that_stands_already_does_not_lie_down_first(stands: Rig, a1: Robot) -> None:
    stands.put_in(SimDriver(a1, stands.clock, start="standing"))
    done = stands.run()
    assert done.outcome.stopped_by is StopReason.DURATION
    assert DeploymentPhase.FOLD not in done.log.rows["phase"]
    truth = done.log.truth
    assert truth is not None
    assert truth["root_pos"][done.log.rows["phase"] <= DeploymentPhase.FOLLOW, 2].min() > 0.2


def followed(way: MotionSequence) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Each step of a sequence whose robot does as it should: rows (t,) of `SAMPLE`, roots (t, 3), world, m, and whether
    the robot is in the motion itself (t,)."""
    follower, seen, memory = Follower(way), np.zeros(1, OBSERVATION), np.zeros(1, MEMORY)
    rows, roots, inside = [], [], []
    while not follower.done:
        follower.leaving = follower.steps >= way.motion.n_samples
        rows.append(follower.tables[0][follower.clock["sample"][0]].copy())
        roots.append(world_root(follower.tables[0], follower.clock["sample"], follower.clock["origin"])[0][0])
        inside.append(follower.in_motion)
        ahead = roots[-1] + (roots[-1] - roots[-2] if len(roots) > 1 else 0.0)
        seen["root_pos"] = ahead
        follower.advance(seen, memory)
        assert len(rows) < 20_000
    return np.array(rows, SAMPLE), np.array(roots), np.array(inside)


def test_the_reference_goes_on_where_one_part_ends_and_the_next_begins(way: MotionSequence, a1: Robot) -> None:
    rows, roots, inside = followed(way)
    entered, left = np.flatnonzero(np.diff(inside))
    assert entered > 500
    assert left - entered >= way.motion.n_samples
    assert len(rows) - left > 500
    speed = np.abs(np.diff(rows["joint_pos"], axis=0)) * 500.0
    assert speed.max() < a1.joint_speed_limit.min()
    assert speed[[entered, left]].max() < 1.2 * speed[inside[1:]].max()
    assert np.linalg.norm(np.diff(roots, axis=0), axis=1).max() * 500.0 < 2.0, "m/s"
    assert (rows["contact"][-500:] == 1).all()


@pytest.mark.slow
def test_a_stitched_motion_is_done_once(a1: Robot, trot: Motion) -> None:
    stitched = stitch_motions(a1, [trot, load_motion("turn", a1)], [2, 2])
    way = make_sequence(a1, stitched, ControllerConfig())
    follower = Follower(way)
    seen, memory, steps, feet = np.zeros(1, OBSERVATION), np.zeros(1, MEMORY), 0, []
    while not follower.done:
        follower.advance(seen, memory)
        steps += follower.in_motion
        feet.append(follower.tables[0]["joint_pos"][follower.clock["sample"][0]].copy())
        assert len(feet) < 20_000
    assert stitched.n_samples - trot.n_samples <= steps <= stitched.n_samples
    speed = np.abs(np.diff(feet, axis=0)).max() * 500.0
    assert speed < 1.2 * a1.joint_speed_limit.min()


def test_haste_passes_no_end_of_a_part(way: MotionSequence) -> None:
    """Two samples in a control step would jump over the one at which the motion is left, for another period."""
    seen, memory = np.zeros(1, OBSERVATION), np.zeros(1, MEMORY)
    for first in range(4):
        follower = Follower(way)
        follower.leaving = True
        while not follower.done:
            memory["haste"] = 0.5 if follower.steps >= first else 0.0
            follower.advance(seen, memory)
            assert follower.steps <= way.motion.n_samples


@pytest.mark.slow
def test_a_passage_is_entered_and_left_within_its_strides(a1: Robot, trot: Motion) -> None:
    stitched = stitch_motions(a1, [trot, load_motion("turn", a1)], [3, 3])
    passage = dataclasses.replace(stitched, parts=())
    way = make_sequence(a1, passage, ControllerConfig())
    assert way.first < trot.n_samples
    assert passage.n_samples - way.last < 1.5 * trot.n_samples
    assert way.text.startswith(f"{passage.name} from 0.")
    rows, _, inside = followed(way)
    assert inside.sum() == way.last - way.first
    assert np.abs(np.diff(rows["joint_pos"], axis=0)).max() * 500.0 < 1.2 * a1.joint_speed_limit.min()


def test_a_passage_too_short_is_refused(a1: Robot, trot: Motion) -> None:
    with pytest.raises(MotionError, match=r"lasts 0\.50 s, too short to be entered from standing"):
        make_sequence(a1, dataclasses.replace(trot, cycle=None), ControllerConfig())


@pytest.mark.slow
def test_the_log_is_read_back(stands: Rig, tmp_path, a1: Robot) -> None:
    log = stands.run(log=tmp_path / "log.mcap").log
    again = DeploymentLog.load(tmp_path / "log.mcap")
    assert again.rows.tobytes() == log.rows.tobytes()
    assert again.truth is not None
    assert log.truth is not None
    assert again.truth.tobytes() == log.truth.tobytes()
    assert again.facts.result["periods"] == len(log.rows)
    assert again.motion.joint_pos.tobytes() == log.motion.joint_pos.tobytes()
    score = score_log(a1, again, ControllerConfig())
    assert score is not None
    assert score.rollout.reward[0] == log.facts.result["reward_mean"]
    for name, value in (("sample", log.motion.n_samples), ("sample", -1), ("haste", -1e9), ("haste", np.nan)):
        rows = again.rows.copy()
        rows[name] = value
        with pytest.raises(LogError, match="samples that its motion has not"):
            score_log(a1, dataclasses.replace(again, rows=rows), ControllerConfig())


@pytest.mark.slow
def test_a_run_is_scored_with_its_own_contact_threshold(trotting: Rig) -> None:
    usual = ControllerConfig()
    config = dataclasses.replace(usual, gait=dataclasses.replace(usual.gait, contact_threshold=1.2))
    done = trotting.run(cycles=2, config=config)
    own, other = (figures(score_log(trotting.robot, done.log, c)) for c in (config, usual))
    assert {name: done.result[name] for name in own} == own
    assert own["stance_slip_m"] != other["stance_slip_m"]


def test_a_long_run_keeps_its_end(stands: Rig) -> None:
    said: list[str] = []
    done = stands.run(note=said.append, logged_s=2.5)
    rows = done.log.rows
    assert len(rows) < done.result["periods"]
    np.testing.assert_allclose(np.diff(rows["time_s"]), 0.002, atol=1e-9)
    assert rows["phase"][-1] == DeploymentPhase.RELEASE
    assert "without the first" in said[0]


def test_a_dry_run_sends_nothing(stands: Rig) -> None:
    done = stands.run(dry_run=True)
    assert stands.driver.written == []
    assert done.outcome.stopped_by is StopReason.DURATION, "it went through all of it"
    assert not done.log.rows["sent"].any()
    standing = done.log.rows[done.log.rows["phase"] == DeploymentPhase.SETTLE]["command"]
    assert standing["stiffness"].min() > 100.0, "the commands were computed"
    assert any("posture" in line for line in done.noted), "the robot lay all the time"


def test_no_state_within_three_seconds(stands: Rig, a1: Robot) -> None:
    stands.put_in(SimDriver(a1, stands.clock, faults=LinkFaults(loss=1.0)))
    with pytest.raises(DriverError, match="no state of the robot within 3 s"):
        stands.run()
    assert stands.clock.now() == pytest.approx(3.0, abs=0.01)
    assert stands.driver.written == []
    assert stands.driver.closed == 1


def test_called_off_nothing_is_sent(stands: Rig) -> None:
    with pytest.raises(DriverError, match="cancelled"):
        stands.run(on_ready=lambda: False)
    assert stands.driver.written == []


def test_stopped_while_it_prepares_nothing_is_sent(stands: Rig) -> None:
    stands.switch.signals = 1
    with pytest.raises(DriverError, match="cancelled"):
        stands.run()
    assert stands.driver.written == []


def test_a_robot_on_its_side_is_not_made_to_stand(stands: Rig) -> None:
    def rolled(state):
        state.reading["quat"] = np.cos(0.7), np.sin(0.7), 0.0, 0.0
        state.reading["accel"] = 0.0, 9.81 * np.sin(1.4), 9.81 * np.cos(1.4)
        return state

    stands.driver.change = rolled
    with pytest.raises(DriverError, match=r"not fit to begin: the trunk's tilt is 1\.4"):
        stands.run()
    assert stands.driver.written == []


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"cycles": 2, "duration_s": 3.0}, "cycles and duration"),
        ({"cycles": 0}, "at least 1"),
        ({"duration_s": -1.0}, "must be positive"),
        ({"solve_rate_hz": 100.0}, "does not plan ahead"),
    ],
)
def test_arguments_that_cannot_be(arguments: dict, said: str, stands: Rig) -> None:
    with pytest.raises(ConfigError, match=said):
        stands.run(**({"duration_s": None} | arguments))
    assert stands.driver.opened == 0


def test_without_commands_the_simulated_robot_damps_by_itself(a1: Robot) -> None:
    """What a robot does whose computer has died."""
    clock = VirtualClock()
    hold = np.zeros(1, COMMAND)
    hold["stiffness"], hold["damping"], hold["joint_pos"] = 120.0, 3.0, a1.home_joint_pos
    with SimDriver(a1, clock, start="standing") as sim:
        for _ in range(100):
            clock.time_s += 0.002
            sim.read()
            sim.write(hold)
        stood = sim.body.observation[0]["root_pos"][2]
        assert not sim.body.damped
        for _ in range(500):
            clock.time_s += 0.002
            sim.read()
        assert sim.body.damped
        assert sim.body.observation[0]["root_pos"][2] < 0.6 * stood


def test_a_simulated_robot_that_nobody_looked_at_stood_still(a1: Robot) -> None:
    clock = VirtualClock()
    with SimDriver(a1, clock) as sim:
        sim.read()
        clock.time_s += 100.0
        assert sim.read() is not None
        assert sim.body.steps <= 2


def test_a_link_says_what_it_cannot_be() -> None:
    with pytest.raises(ConfigError, match=r"link: loss must be in \[0, 1\]"):
        LinkFaults(loss=1.5)


@pytest.mark.slow
def test_without_foot_sensors_it_stands_up_trots_and_sits(trotting: Rig, a1: Robot) -> None:
    dead = Conditions(observe="sensors", disturbances=("foot-force-scale=0",))  # type: ignore[arg-type]  # a text
    trotting.put_in(SimDriver(a1, trotting.clock, conditions=dead))
    done = trotting.run(duration_s=3.0)
    assert done.outcome.stopped_by is StopReason.DURATION
    assert done.outcome.phase is DeploymentPhase.DONE
    assert done.result["reward_truth_mean"] > 0.9
    assert done.result["foot_sensors"] == []
    said = dict(summary_rows(done.result | {"commands_cut": 3}))
    assert said["commands cut to the limits"] == "3, no fault: what is beyond is not sent"
    assert said["contact by"] == "joint torques; foot sensors FR, FL, RR, RL were not found right"


def test_what_told_of_contacts_is_in_the_account(trotted: tuple[Rig, Deployment]) -> None:
    result = trotted[1].result
    assert (result["foot_force"], result["foot_sensors"]) == ("auto", ["FR", "FL", "RR", "RL"])


def test_a_robot_on_its_back_has_fallen_whatever_stopped_it(trotting: Rig, a1: Robot) -> None:
    pushed = Conditions(observe="sensors", disturbances=("side-push=60@6",))  # type: ignore[arg-type]
    trotting.put_in(SimDriver(a1, trotting.clock, conditions=pushed))

    def tipped(machine: StateMachine) -> bool:
        _, x, y, _ = trotting.sim.body.observation[0]["root_quat"]
        return 1 - 2 * (x * x + y * y) < 0.3

    def press(machine: StateMachine) -> None:
        trotting.switch.key = "q"

    lenient = dataclasses.replace(SafetyLimits.of(a1), tilt=1.5, height_least=0.01, sensors_gravity=9.0)
    done = trotting.run(duration_s=6.0, limits=lenient, watch=once(tipped, press))
    assert done.outcome.stopped_by is StopReason.KEY
    assert done.result["fell"]


def test_a_rehearsal_lasts_a_second_whenever_it_begins_and_says_what_is_too_late() -> None:
    class Slow(LoopClock):
        """A computer whose every hundredth period begins 30 ms late."""

        time_s, waits = 5.0, 0

        def now(self) -> float:
            return self.time_s

        def sleep_until(self, moment: float) -> None:
            self.waits += 1
            self.time_s = moment + (0.03 if self.waits % 100 == 0 else 1e-5)

    clock = Slow()
    rehearsal = Rehearsal(clock, 0.002)
    clock.time_s += 60.0  # the first use compiles
    periods = 0
    while rehearsal():
        periods += 1
        clock.time_s += 0.0005
    assert periods == 500
    said = rehearsal.text(0.02)
    assert "rehearsed 500 Hz: periods at most 30.0 ms late, done in 0.5 ms: this computer is too busy" in said
    kept = "done in 0.5 ms: this computer keeps up (below 50 ms late, and 99 of 100 done in 2 ms)"
    assert rehearsal.text(0.05).endswith(kept)
