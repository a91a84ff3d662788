"""What was run before, for the viewer: a report's episodes, and deployments."""

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from fastmimic.base.arrays import Indices
from fastmimic.base.errors import LogError
from fastmimic.base.rotations import quat_from_yaw, quat_rotate, yaw_from_quat
from fastmimic.control.config import ControllerConfig
from fastmimic.deploy.deployment import score_log
from fastmimic.deploy.log import DeploymentLog
from fastmimic.deploy.state_machine import DeploymentPhase
from fastmimic.episode.reward import REWARD_TERMS, reward_weights
from fastmimic.render.tracks import poses_of
from fastmimic.robot import Robot
from fastmimic.viewer.scene import line_up
from fastmimic.viewer.take import Take, cycle_rows, rollout_take
from fastmimic.viewer.viewer import FRAMES_PER_S, Cameras, WebPage

if TYPE_CHECKING:
    from fastmimic.report.html_pages import RerunEpisodes

SHOWN: Final = ("ghost", "contacts", "paths")  # layers of a recording at first; its scene tree switches others on
LONGEST_S: Final = 10.0


def recorded(e: "RerunEpisodes") -> str:
    """One self-contained page, viser's client and a recording of its scene, with the robot before and after side by
    side. They repeat their episodes, up to `LONGEST_S`; the shorter one stays at its end. While recording, a server
    runs on loopback. Raises `ConfigError` as `WebPage`."""
    names = [*e.rollouts] if len(e.rollouts) > 1 else ["robot"]  # in the scene tree
    takes = [
        rollout_take(rollout, motion, e.robot, e.config, name if len(e.rollouts) > 1 else "")
        for rollout, motion, name in zip(e.rollouts.values(), (e.motion.target, e.motion), names, strict=False)
    ]
    with WebPage() as page:
        server = page.server
        robots = line_up(server, takes, names=names)
        for name, scene in zip(names, robots, strict=True):
            for layer in scene.layers:
                scene.set_layer(layer, layer in SHOWN)
            # the robot stays in its place: its title need not move, which labels do late on a slow machine
            above = (0.0, scene.aside, e.robot.home_height + 0.6 * e.robot.leg_length)
            server.scene.add_label(f"/title/{name}", scene.take.title, position=above, anchor="bottom-center")
        Cameras(server, e.robot, [scene.aside for scene in robots], float(takes[0].heading[0]))
        rate_hz = takes[0].rate_hz
        last = min(max(take.rows for take in takes), round(LONGEST_S * rate_hz))
        stride = max(1, round(rate_hz / FRAMES_PER_S))
        serializer = server.get_scene_serializer()
        for row in range(0, last, stride):
            for scene in robots:
                scene.show(row, follow=True)
            serializer.insert_sleep(stride / rate_hz)
        return str(serializer.as_html())


def deployment_take(robot: Robot, log: DeploymentLog) -> Take:
    """A deployment from standing up to its end: by the true states if they are known, else from the moment at which the
    robot knew its place. Before and after the motion itself its reference stands still, and there is no reward. Raises
    `LogError` if it was never known where the robot was."""
    config = log.facts.controller
    seen = log.rows["estimate"] if log.truth is None else log.truth
    known = seen["root_quat"].any(axis=1)
    if log.truth is None:
        known &= log.rows["phase"] < DeploymentPhase.DONE  # then the estimator stands still
    at = np.flatnonzero(known)
    if not len(at):
        raise LogError("the robot had not stood up yet, so nobody knows where it was")
    rows, seen = log.rows[at], seen[at]
    force = seen["foot_force"]
    yaw = yaw_from_quat(seen["root_quat"])
    take = Take(
        robot,
        f"deployed by driver {log.facts.driver}",
        log.rate_hz,
        poses_of(seen),
        rows["stance"],
        np.zeros(len(at), np.int64),
        np.zeros(1, np.int64),
        None,
        caption=f"stopped by {log.facts.result['stopped_by']}, {'estimate' if log.truth is None else 'ground truth'}",
        measured=force[..., 2] > config.release_force(robot),
        stance=rows["stance"],
        force=force,
        asked=quat_rotate(quat_from_yaw(yaw)[:, None], rows["force"]),
        friction=config.stance.friction,
    )
    return _scored(take, at, log, config)


def _scored(take: Take, at: Indices, log: DeploymentLog, config: ControllerConfig) -> Take:
    """The take with the reference and the reward, where the motion was reached; row i is row at[i] of the log."""
    score = score_log(take.robot, log, config, log.truth)
    if score is None:
        return take
    begin = np.searchsorted(at, score.rows)
    due = np.maximum(np.searchsorted(score.rows, at, side="right") - 1, 0)
    terms = np.full((len(at), len(REWARD_TERMS)), np.nan)
    terms[begin] = score.terms
    moving = np.isin(at, score.rows)
    samples = score.sample[due]
    return replace(
        take,
        wanted=np.where(moving[:, None], score.demonstration["contact"][due].astype(bool), take.wanted),
        samples=samples,
        cycle_starts=cycle_rows(log.motion.target, samples),
        reference=poses_of(score.demonstration)[due],
        caption=f"reward {score.rollout.reward[0]:.2f}, {take.caption}",
        terms=terms,
        reward=terms @ reward_weights(),
    )
