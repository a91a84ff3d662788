"""Cycles in long takes: of built-in gaits one after another, and of a real dog."""

from dataclasses import replace
from itertools import groupby, pairwise
from pathlib import Path

import numpy as np
import pytest

from fastmimic.base.errors import ClipError, ConfigError
from fastmimic.clips.catalogue import RECORDED, open_clip
from fastmimic.clips.clip import Clip, ClipOrigin
from fastmimic.clips.segment import (
    DISCRETE,
    FOOTFALLS,
    GAITS,
    STAND,
    TURN,
    Segment,
    SegmentConfig,
    find_segments,
    footfall_of,
)

CUTS = {  # of the recordings: file, first frame, end, and whether it turns
    "pace": ("dog_walk00", 162, 201, False),
    "trot": ("dog_walk03", 448, 481, False),
    "canter": ("dog_run00", 430, 459, False),
    "right turn": ("dog_walk09", 1085, 1124, True),
}


def cycles(name: str, count: int, **options: float) -> Clip:
    """A built-in gait, `count` cycles of it, as a take whose source says nothing of cycles."""
    clip = open_clip(name, **options)
    travel = clip.points_w[-1] - clip.points_w[0]
    step = travel[:2].mean(axis=0) * clip.n_frames / (clip.n_frames - 1)
    points = np.concatenate([clip.points_w + k * step for k in range(count)])
    return Clip(points, clip.rate_hz, origin=ClipOrigin(source=name))


def still(seconds: float, rate_hz: float, like: Clip) -> Clip:
    return Clip(np.repeat(like.points_w[-1:], round(seconds * rate_hz), axis=0), rate_hz)


def joined(*parts: Clip) -> Clip:
    """One after another, each beginning where the trunk was."""
    points = [parts[0].points_w]
    for part in parts[1:]:
        shift = points[-1][-1, :2].mean(axis=0) - part.points_w[0, :2].mean(axis=0)
        shift[2] = 0
        points.append(part.points_w + shift)
    return Clip(np.concatenate(points), parts[0].rate_hz)


def repeating(segments: list[Segment]) -> list[Segment]:
    return [segment for segment in segments if segment.period_frames is not None]


@pytest.mark.parametrize("name", ["walk", "trot", "pace", "bound"])
def test_a_gait_is_one_segment_with_its_name_period_and_speed(name: str) -> None:
    period = open_clip(name).n_frames
    take = cycles(name, 5)
    (found,) = find_segments(take)
    assert (found.start, found.end, found.gait, found.footfall) == (0, take.n_frames, name, name)
    assert found.period_frames == pytest.approx(period, abs=1)
    assert found.confidence > 0.95
    travel = np.linalg.norm(take.points_w[-1, 0, :2] - take.points_w[0, 0, :2])
    assert found.speed_m_per_s == pytest.approx(travel * take.rate_hz / (take.n_frames - 1), rel=0.03)
    assert abs(found.yaw_rate_rad_per_s) < 0.02


def test_the_best_cycle_is_in_its_segment_and_closes() -> None:
    (found,) = find_segments(cycles("trot", 4))
    assert found.cycle is not None
    first, end = found.cycle
    assert found.start <= first < end <= found.end
    assert end - first == round(found.period_frames or 0)


def test_standing_gaits_and_what_is_between_them_come_in_order() -> None:
    walk, trot = cycles("walk", 4), cycles("trot", 5)
    take = joined(still(1.0, walk.rate_hz, walk), walk, trot, still(1.0, walk.rate_hz, trot))
    found = find_segments(take)
    assert all(a.end <= b.start for a, b in pairwise(found))
    assert all(0 <= s.start < s.end <= take.n_frames for s in found)
    gaits = [gait for gait, _ in groupby(s.gait for s in found if s.gait != DISCRETE)]
    assert gaits == [STAND, "walk", "trot", STAND]  # the cycle of the change may stand for itself
    walking, *_, trotting = repeating(found)
    change = round(1.0 * walk.rate_hz) + walk.n_frames
    assert abs(walking.end - change) < 0.5 * (walking.period_frames or 0)
    assert trotting.period_frames == pytest.approx(open_clip("trot").n_frames, abs=1)


def test_a_change_of_tempo_is_a_new_segment() -> None:
    slow = cycles("trot", 5)
    fast = Clip(slow.points_w[:: 4 // 3 + 1][: slow.n_frames // 2], slow.rate_hz)
    found = repeating(find_segments(joined(slow, fast)))
    periods = [s.period_frames or 0.0 for s in found]
    assert len(found) == 2
    assert periods[0] / periods[1] == pytest.approx(2.0, rel=0.05)


def test_turning_enough_in_a_cycle_is_a_turn_and_keeps_its_footfall() -> None:
    (turning,) = find_segments(open_clip("turn"))
    assert turning.gait == TURN
    assert turning.footfall in FOOTFALLS
    assert turning.yaw_rate_rad_per_s > 0.8
    (straight,) = find_segments(open_clip("trot"))
    assert straight.gait == straight.footfall == "trot"


def test_a_clip_that_its_source_calls_a_cycle_is_one() -> None:
    clip = open_clip("trot")
    assert clip.is_cycle
    (found,) = find_segments(clip)
    assert (found.start, found.end, found.period_frames, found.cycle) == (0, clip.n_frames, clip.n_frames, (0, 60))
    (unknown,) = find_segments(replace(clip, is_cycle=None))
    assert unknown.gait == DISCRETE  # one cycle alone shows no repetition


def test_noise_repeats_nowhere() -> None:
    rng = np.random.default_rng(0)
    clip = cycles("trot", 4)
    wander = np.cumsum(rng.normal(0, 0.02, clip.toes_w.shape), axis=0)
    points = clip.points_w[:1] + np.zeros_like(clip.points_w)
    points[:, 6:10] += wander
    assert not repeating(find_segments(Clip(points, clip.rate_hz)))


def test_the_frame_rate_changes_frames_only() -> None:
    clip = cycles("pace", 6)
    half = Clip(clip.points_w[::2], clip.rate_hz / 2)
    (full,), (found,) = find_segments(clip), find_segments(half)
    assert found.gait == full.gait == "pace"
    assert found.period_frames == pytest.approx((full.period_frames or 0) / 2, abs=1)
    assert found.speed_m_per_s == pytest.approx(full.speed_m_per_s, rel=0.03)


@pytest.mark.parametrize(
    ("phases", "gait"),
    [
        ((0, 0.5, 0.75, 0.25), "walk"),
        ((0, 0.5, 0.25, 0.75), "walk"),
        ((0, 0.5, 0.5, 0), "trot"),
        ((0, 0.5, 0, 0.5), "pace"),
        ((0, 0, 0.5, 0.5), "bound"),
        ((0, 0.3, 0.6, 0), "canter"),
        ((0, 0.18, 0.45, 0.28), "gallop"),
    ],
)
def test_footfall_by_the_legs_phases(phases: tuple[float, ...], gait: str) -> None:
    rng = np.random.default_rng(1)
    for start in rng.uniform(0, 1, 5):
        assert footfall_of(np.array(phases) + start) == gait
        mirrored = np.array(phases)[[1, 0, 3, 2]]
        assert footfall_of(mirrored + start) == gait


@pytest.mark.parametrize("name", CUTS)
def test_the_known_cycles_of_a_real_dog_are_found(name: str, data_folder: Path) -> None:
    file, start, end, turns = CUTS[name]
    take = open_clip(str(data_folder / "dog_keypoints" / f"{file}_joint_pos.txt"))
    found = find_segments(take)
    best = max(found, key=lambda s: min(end, s.end) - max(start, s.start))
    assert min(end, best.end) - max(start, best.start) >= 0.9 * (end - start)
    assert best.period_frames is not None
    assert abs(best.period_frames - (end - start)) <= 3
    assert (best.gait == TURN) == turns
    if name in ("pace", "trot"):
        assert best.gait == name
    assert {s.gait for s in found} <= set(GAITS)
    assert all(0 <= s.confidence <= 1 for s in found)


def test_recorded_cycles_are_named_as_their_catalogue_does(data_folder: Path) -> None:
    for name in ("dog:pace", "dog:trot"):
        assert name in RECORDED
        (found,) = find_segments(open_clip(name, folder=data_folder))
        assert found.gait == name.removeprefix("dog:")


def test_a_take_that_is_too_short_or_too_slow_is_refused() -> None:
    clip = cycles("trot", 3)
    with pytest.raises(ClipError, match="too few to find cycles in"):
        find_segments(clip.cut(0, 20))
    with pytest.raises(ClipError, match="frames a second are too few"):
        find_segments(Clip(clip.points_w, 12.0))


def test_a_take_can_be_named() -> None:
    assert [segment.gait for segment in find_segments("trot")] == ["trot"]


def test_settings_out_of_range_are_refused() -> None:
    with pytest.raises(ConfigError, match="tempo must be positive"):
        SegmentConfig(tempo=0.0)
    with pytest.raises(ConfigError, match="must be longer than the shortest"):
        SegmentConfig(shortest_s=2.0)
