"""Checks a library by running its motions, and repairs it."""

from collections.abc import Callable

import numpy as np

from fastmimic.base.errors import MotionError, OutputError, RobotError
from fastmimic.control.config import controller_config
from fastmimic.dataset.excerpts import reason_of
from fastmimic.dataset.folder import DatasetHealth, MotionDataset, check
from fastmimic.dataset.lock import mending
from fastmimic.episode.loop import run_episodes
from fastmimic.episode.plan import episode_duration
from fastmimic.imitation.methods import method_named
from fastmimic.robot import load_robot

_DRAW_SEED = 0
_COLUMNS = ("id", "name", "robot", "robot_file", "method", "motion_file", "reward", "lacks")


def rerun(
    library: MotionDataset, count: int, progress: Callable[[int, int], None] | None = None
) -> tuple[list[str], int]:
    """Runs the nominal episodes of `count` random motions (at most all) again; calls `progress` with (done, all).
    Returns the motions with another reward than recorded, or with a damaged or missing file or robot, one line each,
    and the number drawn. Raises `LibraryError` for a missing or damaged index, `ConfigError` for a missing parameter
    file."""
    recipe = library.recipe()
    assert recipe is not None, "an open library has one"
    controller = controller_config(recipe.config)
    rows = [row for row in library.index(_COLUMNS) if row["motion_file"] is not None]
    drawn = np.random.default_rng(_DRAW_SEED).permutation(len(rows))[:count]
    found = []
    for i, at in enumerate(drawn):
        row = rows[at]
        config = method_named(row["method"]).configure(controller)
        what = f"{row['id']} {row['name']} on {row['robot']}"
        try:
            motion = library.motion(row)
            seconds = episode_duration(motion.target, recipe.evaluation_s)
            robot = load_robot(row["robot_file"] or row["robot"])
            reward = float(run_episodes(robot, motion, duration_s=seconds, config=config).reward[0])
        except (MotionError, RobotError) as error:
            found.append(f"{what}: {reason_of(error)}")
        else:
            if reward != row["reward"]:
                found.append(f"{what}: {row['reward']!r} recorded, {reward!r} now")
        if progress is not None:
            progress(i + 1, len(drawn))
    return found, len(drawn)


def mend(library: MotionDataset, progress: Callable[[int, int], None] | None = None) -> tuple[DatasetHealth, int]:
    """Removes damaged files and those of no record that belongs to the library, and writes the index.

    Returns the defects found before, and the number of removed files. Raises `LibraryError` while a build runs, because
    its files do not have records yet, and `OutputError` if a file cannot be removed.
    """
    removed = 0
    with mending(library.path):
        health = check(library, progress)
        for name in sorted({*health.useless, *health.foreign}):
            try:
                (library.path / name).unlink()
                removed += 1
            except FileNotFoundError:
                continue
            except OSError as error:
                raise OutputError(f"{library.path / name}: cannot be removed ({error.strerror or error})") from None
        library.write_index()
    return health, removed
