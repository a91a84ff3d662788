"""The survey of motions: cuts that anyone would make the same, and rows that say what happened."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from motion_survey import Surveyed, random_cycles, summary, survey, table

from fastmimic.base.errors import ClipError
from fastmimic.clips.synthesis import generate
from fastmimic.episode.feasibility import Reason
from fastmimic.robot import Robot


@pytest.fixture(scope="module")
def rows(robot: Robot) -> list[Surveyed]:
    return [survey(generate(name), robot, duration_s=1.0, episodes=2) for name in ("trot", "side-step")]


def test_built_in_gaits_are_tracked(rows: list[Surveyed]) -> None:
    for row in rows:
        assert row.tracked
        assert row.fall is None
        assert row.first_fall_s is None
        assert row.reasons == ()
        assert row.steps
        assert len(row.reward) == 2
        assert min(row.reward) > 0.8
    assert rows[0].speed_m_per_s == pytest.approx(1.25, rel=0.03)
    assert summary(rows) == "tracked: 2 of 2; of those that take steps: 2 of 2"


@pytest.mark.slow
def test_a_gait_beyond_the_robot_is_not_tracked_and_says_why(robot: Robot) -> None:
    weak = replace(robot, torque_limit=0.05 * robot.torque_limit)
    row = survey(generate("pace"), weak, duration_s=1.0, episodes=2)
    assert not row.tracked
    assert row.refused is not None
    assert "keeps the limits: joint torque by" in row.refused
    assert row.first_fall_s is not None
    assert row.fall is not None
    assert row.fall.time_s == pytest.approx(row.first_fall_s, abs=0.01) or row.fell[0]
    assert "torque" in [reason.kind for reason in row.reasons]
    assert "first reason of the falls: refused 1" in summary([row])
    assert json.loads(json.dumps(row.as_dict()))["tracked"] is False


def test_the_table_has_a_line_for_each_motion(rows: list[Surveyed]) -> None:
    fallen = replace(
        rows[1], name="fallen", fell=(True, True), first_fall_s=0.25, reasons=(Reason("reach", "too far"),)
    )
    lines = table([rows[0], fallen]).splitlines()
    assert len(lines) == 4
    assert lines[2].startswith("| `trot` | 1.2")
    assert "| 0 of 2 | – |" in lines[2]
    assert "| 2 of 2 | 0.25 | **reach**: too far |" in lines[3]
    assert summary([rows[0], fallen]).startswith("tracked: 1 of 2; of those that take steps: 1 of 2")


@pytest.mark.slow
def test_random_cycles_follow_from_the_seed(data_folder: Path) -> None:
    first, second = (random_cycles(3, np.random.default_rng(5), data_folder) for _ in range(2))
    other = random_cycles(3, np.random.default_rng(6), data_folder)
    assert [clip.origin.name for clip in first] == [clip.origin.name for clip in second]
    assert [clip.origin.name for clip in first] != [clip.origin.name for clip in other]
    for clip in first:
        assert clip.is_cycle
        assert 0.4 <= clip.n_frames / clip.rate_hz <= 1.2


def test_without_recordings_it_says_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(ClipError, match="fastmimic data fetch"):
        random_cycles(1, np.random.default_rng(0), tmp_path)
