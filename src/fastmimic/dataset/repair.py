"""Checks a library by reading its files, or by running its motions, and repairs it."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fastmimic.base.errors import LibraryError, MotionError, RobotError
from fastmimic.base.files import remove_file
from fastmimic.control.config import controller_config
from fastmimic.dataset.excerpts import SOURCES, reason_of
from fastmimic.dataset.folder import INDEX, ROBOTS, SETTINGS, MotionDataset, working
from fastmimic.dataset.index import MOTIONS, RECORDS, damage
from fastmimic.episode.loop import run_episodes
from fastmimic.episode.plan import episode_duration
from fastmimic.imitation.methods import METHODS
from fastmimic.robot import load_robot

Progress = Callable[[int, int], None]

_DRAW_SEED = 0
_COLUMNS = ("id", "name", "robot", "robot_file", "method", "motion_file", "reward_mean", "lacks")


@dataclass(frozen=True)
class DatasetHealth:
    """Result of `check`."""

    records: int
    damaged: tuple[str, ...]  # defects, one line each; a new build repairs them
    useless: tuple[str, ...]  # files of damaged records, relative to the library
    foreign: tuple[str, ...]  # files of no record that belongs to it: of other recipes and sources, or killed builders
    unreadable: tuple[str, ...]  # the lines of `damaged` about the recipe, sources and robots
    outdated: bool  # whether the index does not match the records

    @property
    def sound(self) -> bool:
        """Whether there is no defect."""
        return not self.damaged and not self.outdated


def check(library: MotionDataset, progress: Progress = lambda done, total: None) -> DatasetHealth:
    """Reads every file of a library and reports defects; calls `progress` with (files done, files in all)."""
    there = {f"{MOTIONS}/{path.name}" for path in (library.path / MOTIONS).glob("*")}
    plan = library.plan()
    found = library.gathered(plan)
    damaged = [*plan.unreadable, *(f"{RECORDS}/{name}: not a whole record" for name in found.torn)]
    useless = [f"{RECORDS}/{name}" for name in found.torn]
    rows = found.table.select(["id", "status", "motion_sha256", "motion_file"]).to_pylist()
    for i, row in enumerate(rows, 1):
        motion, wrong = row["motion_file"], damage(library.path, row)
        there.discard(motion)
        if wrong is not None:
            damaged.append(f"{row['id']}: {wrong}")
            useless += [f"{RECORDS}/{row['id']}.json", *([motion] if motion is not None else [])]
        progress(i, len(rows))
    foreign = {*there, *(f"{RECORDS}/{old.id}.json" for old in found.superseded)}
    # what a killed `fastmimic.base.files.replace_file` leaves
    left = (f".{INDEX}.*", f".{SETTINGS}.*", *(f"{name}/.*.json.*" for name in (RECORDS, SOURCES, ROBOTS)))
    foreign |= {str(path.relative_to(library.path)) for pattern in left for path in library.path.glob(pattern)}
    records = len(rows) + len(found.superseded) + len(found.torn)
    try:
        outdated = not found.table.equals(library.index_table().select(found.table.column_names))
    except LibraryError:
        outdated = True
    return DatasetHealth(records, tuple(damaged), tuple(useless), tuple(sorted(foreign)), plan.unreadable, outdated)


def rerun(library: MotionDataset, count: int, progress: Progress = lambda done, total: None) -> tuple[list[str], int]:
    """Runs the nominal episodes of `count` random motions (at most all) again; calls `progress` with (done, all).
    Returns a line for each motion with another reward than recorded, or a damaged or missing file or robot, and the
    number drawn. Raises `LibraryError` for a missing or damaged index, `ConfigError` for a missing parameter file."""
    recipe = library.recipe()
    assert recipe is not None, "an open library has one"
    controller = controller_config(recipe.config)
    rows = [row for row in library.index(_COLUMNS) if row["motion_file"] is not None]
    drawn = np.random.default_rng(_DRAW_SEED).permutation(len(rows))[:count]
    found = []
    for i, at in enumerate(drawn):
        row = rows[at]
        config = METHODS[row["method"]].configure(controller)
        what = f"{row['id']} {row['name']} on {row['robot']}"
        try:
            motion = library.motion(row)
            seconds = episode_duration(motion.target, recipe.evaluation_s)
            robot = load_robot(row["robot_file"] or row["robot"])
            reward = float(run_episodes(robot, motion, duration_s=seconds, config=config).reward[0])
        except (MotionError, RobotError) as error:
            found.append(f"{what}: {reason_of(error)}")
        else:
            if reward != row["reward_mean"]:
                found.append(f"{what}: {row['reward_mean']!r} recorded, {reward!r} now")
        progress(i + 1, len(drawn))
    return found, len(drawn)


def repair(library: MotionDataset, progress: Progress = lambda done, total: None) -> tuple[DatasetHealth, int]:
    """Removes damaged files and those of no record that belongs to the library, and writes the index; returns the
    defects found before, and the number of removed files. Raises `LibraryError` while a build runs, because its files
    do not have records yet, and `OutputError` if a file cannot be removed."""
    removed = 0
    with working(library.path, alone=True):
        health = check(library, progress)
        for name in sorted({*health.useless, *health.foreign}):
            removed += remove_file(library.path / name)
        library.write_index()
    return health, removed
