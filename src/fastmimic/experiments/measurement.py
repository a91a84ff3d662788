"""The common evaluation of all methods and motions."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.text import plain
from fastmimic.episode.loop import MakeController, run_episodes
from fastmimic.episode.metrics import TRACKED, Metrics, style_distance, swing_clearance
from fastmimic.episode.plan import episode_duration, perturbed_start, start_room
from fastmimic.episode.rollout import Rollout
from fastmimic.imitation.imitate import Imitation
from fastmimic.imitation.methods import method_named
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot
from fastmimic.robot.kinematics import foot_positions

Row = dict[str, Any]

EVALUATION_S: Final = 10.0
PERTURBED_EPISODES: Final = 8
_BEFORE: Final = ("reward_animal", "reward_mean", "fell", "foot_z_rmse_m", "foot_x_rmse_m")
_STEPS: Final = ("drift_m_per_s", "mean_clearance_m", "early_contacts_per_s", "stance_slip_m")
_NOMINAL: Final = (*_BEFORE, *_STEPS, *TRACKED)
_PERTURBED: Final = ("reward_animal", "reward_mean", "reward_std", "fell", "success", "mpjpe_mm")
_EVALUATION_SEED: Final = 20230617  # of the perturbed starts of every run; no optimisation uses it


@dataclass(frozen=True, eq=False)
class Measured:
    """Metrics of a motion."""

    figures: Row  # by column name, JSON-serialisable
    before: Rollout  # nominal episode of the demonstration, logged
    after: Rollout  # that of the motion
    seconds: float  # length of each episode, s
    simulated_s: float  # total simulated time, s


def measure(
    result: Imitation,
    evaluation_s: float = EVALUATION_S,
    perturbed_episodes: int = PERTURBED_EPISODES,
    controller: MakeController | None = None,
) -> Measured:
    """Evaluates the result of a method in one nominal episode and in episodes from perturbed starts, of `evaluation_s`,
    s, each, or the length of a motion that does not repeat. The perturbed starts are the same for every motion; no
    optimisation has seen them. `controller` is that of a learned method."""
    robot, demonstration = result.robot, result.demonstration
    method = method_named(result.method)
    controller = controller or method.controller
    seconds = episode_duration(demonstration, evaluation_s)

    def episode(motion: Motion) -> Rollout:
        return run_episodes(robot, motion, duration_s=seconds, config=result.config, log=True, controller=controller)

    after = episode(result.motion)
    before = episode(demonstration) if method.optimises else after
    rng = np.random.default_rng(_EVALUATION_SEED)
    room = start_room(demonstration, seconds)
    start = perturbed_start(perturbed_episodes + 1, room, rng).part(slice(1, None))
    rough = run_episodes(
        robot, result.motion, start=start, duration_s=seconds, config=result.config, controller=controller
    )
    nominal, unoptimised, perturbed = Metrics.of(after), Metrics.of(before), Metrics.of(rough)
    share = after.clearance[0] / swing_clearance(demonstration, robot.foot_radius)
    style = None if method.own_feet else style_distance(result.motion.foot_pos_b, demonstration.foot_pos_b)
    figures = {
        **nominal.named(_NOMINAL),
        **unoptimised.named(_BEFORE, "before"),
        **perturbed.named(_PERTURBED, "perturbed"),
        "swing_clearance_least_share": np.nanmin(share) if np.isfinite(share).any() else None,
        "style_distance": style,
        "style_distance_realised": _realised_style(after, demonstration, robot),
        **{f"components_{name}": value for name, value in nominal.components.items()},
    }
    simulated_s = seconds * (1 + method.optimises + perturbed_episodes)
    return Measured(plain(figures), before, after, seconds, simulated_s)


def named_values(result: Imitation) -> str:
    """The optimised parameters by name, with all digits."""
    return " ".join(f"{p.name}={v!r}" for p, v in zip(result.parameters, result.values.tolist(), strict=True))


def foot_courses(rollout: Rollout, robot: Robot) -> tuple[Array, Array]:
    """Feet in the first episode, (t, 4, 3) body frame, m: the reference's, and the realised ones, NaN after a fall."""
    assert rollout.log is not None, "the courses are in the log"
    feet = foot_positions(robot, rollout.log.observation["joint_pos"][0])
    feet[rollout.steps[0] :] = np.nan
    return rollout.log.demonstration["foot_pos"][0], feet


def _realised_style(rollout: Rollout, demonstration: Motion, robot: Robot) -> float | None:
    """Style distance of the realised feet until a fall; None for less than a cycle, or a whole motion without one."""
    if rollout.steps[0] < demonstration.n_samples - (demonstration.cycle is None):
        return None
    wanted, feet = foot_courses(rollout, robot)
    return style_distance(feet, wanted, demonstration.foot_pos_b)
