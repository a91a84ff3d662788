"""Built-in gaits: animal-like keypoints that keep their promises once they are the robot's."""

import numpy as np
import pytest

from fastmimic.base.errors import ConfigError
from fastmimic.base.rotations import rotate_planar
from fastmimic.clips.synthesis import GAITS, RATE_HZ, gait, generate
from fastmimic.retargeting.retarget import retarget
from fastmimic.robot import Robot


@pytest.mark.parametrize("name", GAITS)
def test_a_gait_is_one_period_that_closes(name: str) -> None:
    """The frame after the last one repeats the first: about as far from the last as the last from the one before."""
    clip = generate(name)
    assert clip.is_cycle is True
    spec = GAITS[name]
    period = clip.n_frames / clip.rate_hz
    assert period == pytest.approx(spec.period, abs=0.5 / RATE_HZ)
    shape = clip.points_w - clip.points_w[:, :1]  # travel taken out
    turn = spec.yaw_rate * period
    repeated = shape[0].copy()
    repeated[:, :2] = rotate_planar(turn, repeated[:, :2])
    last_step = np.linalg.norm(shape[-1] - shape[-2], axis=-1)
    seam = np.linalg.norm(repeated - shape[-1], axis=-1)
    fastest = np.linalg.norm(np.diff(shape, axis=0), axis=-1).max()
    assert np.all(seam <= last_step + 0.35 * fastest)


@pytest.mark.parametrize("name", GAITS)
def test_standing_paws_do_not_move(name: str) -> None:
    clip = generate(name)
    toes = clip.toes_w
    still = np.linalg.norm(np.diff(toes, axis=0), axis=-1) < 1e-9
    share = still.mean(axis=0)
    # one frame fewer at each end, since a difference needs two frames at rest
    assert share == pytest.approx(GAITS[name].duty, abs=2.5 / clip.n_frames)
    assert np.all(toes[1:][still][:, 2] == toes[..., 2].min())


@pytest.mark.parametrize(
    ("name", "forward", "sideways", "turning"),
    [
        ("trot", 1.2, 0.0, 0.0),
        ("pace", 0.9, 0.0, 0.0),
        ("turn", 0.4, 0.0, 1.0),
        ("side-step", 0.0, 0.4, 0.0),
        ("walk", 0.5, 0.0, 0.0),
        ("bound", 0.8, 0.0, 0.0),
        ("backward-trot", -0.5, 0.0, 0.0),
        ("spin", 0.0, 0.0, 1.5),
    ],
)
def test_promised_speed_and_lift_on_the_a1(
    a1: Robot, name: str, forward: float, sideways: float, turning: float
) -> None:
    """After retargeting: at least the promised speed in its direction, and feet lifted by 4 cm or more."""
    motion, report = retarget(generate(name), a1)
    assert motion.cycle is not None
    heading = motion.cycle[2] * np.arange(motion.n_samples) / motion.n_samples
    velocity = rotate_planar(-heading, motion.root_lin_vel_w[:, :2]).mean(axis=0)
    rate = motion.cycle[2] / motion.period_s
    for promised, found in ((forward, velocity[0]), (sideways, velocity[1]), (turning, rate)):
        assert found * np.sign(promised) >= abs(promised)
        if promised == 0.0:
            assert abs(found) < 0.1
    assert min(report.after.clearance_m) >= 0.04


def test_parameters_act_as_they_say(a1: Robot) -> None:
    slow, _ = retarget(generate("trot", speed=0.5), a1, executable=False)
    assert slow.cycle is not None
    assert slow.cycle[0] / slow.period_s == pytest.approx(0.5, rel=0.03)
    turning, _ = retarget(generate("walk", yaw_rate=0.8), a1, executable=False)
    assert turning.cycle is not None
    assert turning.cycle[2] / turning.period_s == pytest.approx(0.8, rel=0.03)
    walks = [retarget(generate("walk", duty=duty), a1, executable=False)[0] for duty in (0.55, 0.75)]
    short, long = (walk.contact.mean() for walk in walks)
    assert long - short == pytest.approx(0.2, abs=0.05)


def test_front_paws_lift_higher_than_hind_ones() -> None:
    height = generate("trot").toes_w[..., 2].max(axis=0)
    assert height[:2].min() > 1.1 * height[2:].max()


def test_errors_say_what_is_allowed() -> None:
    with pytest.raises(ConfigError, match="did you mean 'trot'"):
        generate("trott")
    with pytest.raises(ConfigError, match="speed must be between"):
        gait("trot", speed=9.0)
    with pytest.raises(ConfigError, match="yaw_rate must be between"):
        gait("trot", yaw_rate=float("nan"))
    with pytest.raises(ConfigError, match="duty must be between"):
        gait("trot", duty=1.0)
