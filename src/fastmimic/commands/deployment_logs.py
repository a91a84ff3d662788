"""The log of a deployment as the argument of a verb."""

import dataclasses
from pathlib import Path
from typing import Any

from fastmimic.base.errors import ConfigError
from fastmimic.commands import options as opt
from fastmimic.commands.console import note, slow_start
from fastmimic.deploy.log import DeploymentLog, load_ground_truth
from fastmimic.robot import Robot


def open_log(command: Any, reading: opt.ClipReading, *taken: str) -> tuple[Robot, DeploymentLog]:
    """The robot and the log that a command's `motion` names, by its `robot` and its `truth` if they are given. Raises
    `ConfigError` if an option of a clip's `reading` is given, or another one than those and the ones `taken`."""
    from fastmimic.deploy.account import robot_of, with_result
    from fastmimic.deploy.deployment import true_states

    path, truth, taken = command.motion, command.truth, ("motion", "robot", "truth", *taken)
    names = [field.name for field in dataclasses.fields(command) if field.name not in taken]
    for name in (*opt.given(command, *names), *opt.given(reading)):
        raise ConfigError(f"{path} is the log of a deployment, which is not simulated: drop {name}")
    log = DeploymentLog.load(path)
    if truth is not None:
        found = load_ground_truth(truth)
        log = dataclasses.replace(log, truth=true_states(log, found["observation"], found["tick"]))
    robot = robot_of(log, command.robot)
    with slow_start():
        log = with_result(robot, log)
    is_whole(log.meta["result"].get("log_ends"))
    return robot, log


def check_truth(path: str, truth: Path | None) -> None:
    """Raises `ConfigError` if true states are given for anything but a log."""
    if truth is not None:
        raise ConfigError(f"--truth is for the log of a deployment, which {path} is not")


def is_whole(ends: str | None) -> bool:
    """Whether a log has all rows; says when and why it ends if not."""
    if ends is not None:
        note(f"fastmimic: the log ends {ends}")
    return ends is None
