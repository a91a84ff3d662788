"""Retargeting without the consistency step: the scaled animal as it is, for comparisons."""

import numpy as np
import pytest

from fastmimic.clips.synthesis import generate
from fastmimic.motion.motion import Motion
from fastmimic.retargeting.retarget import RetargetConfig, RetargetReport, retarget
from fastmimic.robot import Robot

RAW = RetargetConfig(consistent=False)


@pytest.fixture(scope="module")
def raw(a1: Robot) -> tuple[Motion, RetargetReport]:
    return retarget(generate("pace"), a1, config=RAW)


def test_the_feet_slide_as_the_animals_do(a1: Robot, raw: tuple[Motion, RetargetReport]) -> None:
    consistent = retarget(generate("pace"), a1, executable=False)[1]
    assert max(consistent.after.slip_m) < 1e-3
    np.testing.assert_allclose(raw[1].after.slip_m, raw[1].before.slip_m, rtol=0.02)
    assert max(raw[1].after.slip_m) > 5e-3


def test_contacts_and_trunk_are_left_alone(raw: tuple[Motion, RetargetReport]) -> None:
    report = raw[1]
    assert report.after.duty == report.before.duty
    assert (
        report.changes.pairing,
        report.changes.common_duty,
        report.changes.closed_flights,
        report.changes.widened_swings,
    ) == (None, False, 0, 0)
    assert report.heading_aligned_deg == 0.0


def test_it_is_still_a_cycle_within_the_joints_limits(a1: Robot, raw: tuple[Motion, RetargetReport]) -> None:
    motion = raw[0]
    assert motion.cycle is not None
    assert motion.n_samples == retarget(generate("pace"), a1, executable=False)[0].n_samples
    assert np.all(motion.joint_pos >= a1.joint_lower)
    assert np.all(motion.joint_pos <= a1.joint_upper)
