"""The reward of a deployment's motion, from its log."""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.errors import DeploymentError
from fastmimic.base.rotations import rotate_planar, yaw_from_quat
from fastmimic.control.config import ControllerConfig
from fastmimic.deploy.log import DeploymentLog
from fastmimic.episode.metrics import Metrics
from fastmimic.episode.rollout import Rollout, summarised
from fastmimic.episode.scorer import Scorer
from fastmimic.imitation.evaluate import Evaluation
from fastmimic.motion.motion import Motion
from fastmimic.reference.table import advance_clocks, make_clocks, reference_table
from fastmimic.robot import Robot
from fastmimic.robot.state import MEMORY
from fastmimic.simulation.conditions import Conditions

_FIGURES: Final = (
    "reward_mean",
    "components",
    "swing_clearance_m",
    "drift_m_per_s",
    "early_contacts_per_s",
    "stance_slip_m",
)


def score_log(
    robot: Robot, log: DeploymentLog, config: ControllerConfig, observation: NDArray[Any] | None = None
) -> Rollout | None:
    """Scores the periods in the motion itself against its demonstration, as one episode; None if there are none.

    The reference starts as the controller's did and is then synchronised to the states scored.

    Args:
        log: of the deployment.
        config: of its controller.
        observation: (t,) of `OBSERVATION`, the state in each row of the log; the estimate if None.
    """
    motion, rows = log.motion, np.flatnonzero(log.rows["in_motion"])
    if not len(rows):
        return None
    seen = log.rows["estimate"] if observation is None else observation
    if len(seen) != len(log.rows):
        raise DeploymentError(f"{len(seen)} states for the {len(log.rows)} periods of the log")
    seen = np.ascontiguousarray(seen[rows])
    counts = log.rows[rows]
    clock = _first_clock(motion, counts[0], seen[0])
    table = reference_table(motion.target, robot)
    scorer, memory = Scorer(robot, table, 1, config, log.rate_hz), np.zeros(1, MEMORY)
    before = counts[0]
    for i in range(len(rows)):
        if i > 0:
            # periods that are not there were left out of the reference as well
            advance_clocks(clock, table[None], seen["root_pos"][i : i + 1])
        memory["early_touchdowns"] = counts["early_touchdowns"][i] - before["early_touchdowns"]
        memory["qp_failures"] = counts["qp_failures"][i] - before["qp_failures"]
        scorer.score(clock, seen[i : i + 1], memory)
    return summarised(scorer.counted(), len(rows), log.rate_hz)


def evaluation_of(robot: Robot, log: DeploymentLog, config: ControllerConfig) -> Evaluation:
    """The `fastmimic.evaluate` result of a deployment, by the true states if known, else by the estimate. Raises
    `DeploymentError` if the robot did not reach the motion."""
    rollout = score_log(robot, log, config, log.truth)
    if rollout is None:
        raise DeploymentError(f"the robot never came to the motion: {log.meta['result']['stopped_because']}")
    conditions = Conditions(observe="sensors")
    return Evaluation(log.motion, rollout, str(log.meta["method"]), config, robot.name, conditions)


def figures(rollout: Rollout | None) -> dict[str, Any]:
    """An episode's figures, JSON-serialisable; each None without an episode."""
    if rollout is None:
        return {"reward_mean": None, "components": None, "swing_clearance_m": None, "motion_s": 0.0}
    found = Metrics.of(rollout).as_dict()
    return {name: found[name] for name in _FIGURES} | {"motion_s": rollout.duration_s}


def true_states(log: DeploymentLog, truth: NDArray[Any], sequence: NDArray[np.int64]) -> NDArray[Any]:
    """A simulated robot's true states in the log's rows, (t,) of `OBSERVATION`. `truth` (k,) of `OBSERVATION` belongs
    to the ascending message numbers `sequence` (k,). Raises `DeploymentError` if a message of the log is not among
    them."""
    wanted = log.rows["sequence"]
    at = np.searchsorted(sequence, wanted)
    found = at < len(sequence)
    found[found] = sequence[at[found]] == wanted[found]
    if not found.all():
        raise DeploymentError(
            f"the log has state {wanted[~found][0]}, and there are true ones of {sequence[0]} to {sequence[-1]}:"
            " another run's?"
        )
    return truth[at]


def _first_clock(motion: Motion, row: Any, seen: Any) -> NDArray[Any]:
    """The reference's clock in the first row, moved from the robot's estimated place to the true one."""
    clock = make_clocks(motion, 1)
    clock["sample"] = row["sample"]
    believed = row["estimate"]
    turn = float(yaw_from_quat(seen["root_quat"]) - yaw_from_quat(believed["root_quat"]))
    offset = row["origin"][:2] - believed["root_pos"][:2]
    clock["origin"][0, :2] = seen["root_pos"][:2] + rotate_planar(turn, offset)
    clock["origin"][0, 2] = row["origin"][2] + turn
    return clock
