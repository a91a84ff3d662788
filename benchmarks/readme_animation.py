"""The README's animation: the animal, the robot with its motion as retargeted, and the robot in simulation.

    python benchmarks/readme_animation.py dog:trot --out docs/images/dog-trot.gif
    python benchmarks/readme_animation.py trot --out trot.gif     # a built-in gait, without the recordings

It shows whole cycles after the simulation has settled, so that it can be played again and again. A picture made from
the recordings of a dog is under their licence (CC BY-NC 4.0, credit AI4Animation).
"""

import argparse
from dataclasses import replace

import numpy as np

import fastmimic as fm
from fastmimic.base.rotations import quat_from_yaw, quat_multiply, yaw_from_quat
from fastmimic.clips.catalogue import open_clip
from fastmimic.render.tracks import AnimalTrack, Track, motion_track, rollout_track
from fastmimic.render.video import render_video
from fastmimic.robot import load_robot

SETTLED_CYCLES = 6
STRAIGHT_RAD = 0.1
"""Yaw in a cycle up to which it is taken out, and the ground fitted to the loop; what turns further jumps."""


class Straight:
    """Turns and moves what is seen so that a loop ends where it began, one step of the ground further along x.

    The net turn of a cycle, 2.4° in the dog's trot, is taken out evenly over its time, as no ground could be looped
    under it.

    Args:
        position: (3 n, 3) base, world, m; the loop is the middle third.
        yaw: (3 n,) rad.
        step: of the ground, m.
    """

    def __init__(self, position: np.ndarray, yaw: np.ndarray, step: float) -> None:
        n = len(position) // 3
        share = np.arange(len(position)) / n - 1
        path = position[:, 0] + 1j * position[:, 1]
        travel, turn = path[2 * n] - path[n], np.angle(np.exp(1j * (yaw[2 * n] - yaw[n])))
        along = travel if abs(turn) < 1e-9 else travel * 1j * turn / np.expm1(1j * turn)  # the twist, exp. coordinates
        made = share * along if abs(turn) < 1e-9 else along * np.expm1(1j * share * turn) / (1j * turn)
        self.turn = -(share * turn + np.angle(along))
        self.origin, self.ahead = path[n] + made, share * step

    def points(self, points: np.ndarray) -> np.ndarray:
        """Points (3 n, …, 3), world, m."""
        rows = (slice(None), *(None,) * (points.ndim - 2))
        planar = points[..., 0] + 1j * points[..., 1]
        planar = (planar - self.origin[rows]) * np.exp(1j * self.turn)[rows] + self.ahead[rows]
        return np.stack([planar.real, planar.imag, points[..., 2]], axis=-1)

    def track(self, track: Track) -> Track:
        """A robot's track."""
        quat = quat_multiply(quat_from_yaw(self.turn), track.pose[:, 3:7])
        return replace(track, pose=np.hstack([self.points(track.pose[:, :3]), quat, track.pose[:, 7:]]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("motion", nargs="?", default="dog:trot", help="a cyclic clip")
    parser.add_argument("--out", required=True, help=".gif, .mp4 or .webm")
    parser.add_argument("--robot", default="a1")
    parser.add_argument("--iterations", type=int, default=60, help="of the optimisation")
    parser.add_argument("--cycles", type=int, default=2, help="in the loop")
    parser.add_argument("--fps", type=float, default=20.0)
    parser.add_argument("--size", default="900x300")
    parser.add_argument("--quality", default="high")
    args = parser.parse_args()
    width, height = (int(side) for side in args.size.split("x"))

    robot = load_robot(args.robot)
    clip = open_clip(args.motion, robot=robot)
    result = fm.imitate(clip, robot, iterations=args.iterations)
    motion, demonstration = result.motion, result.demonstration
    if demonstration.cycle is None:
        parser.error(f"{args.motion} does not repeat, so it cannot be looped")
    n, rate = demonstration.n_samples, demonstration.rate_hz
    loop_s = args.cycles * n / rate
    shown_s = 3 * loop_s  # one before and one after, for trails and camera
    settled = SETTLED_CYCLES * n - 1  # row i of a log is the state after step i + 1
    steps = settled + round(shown_s * rate)
    rollout = fm.evaluate(motion, robot, duration_s=steps / rate, log=True).rollout
    if rollout.fell[0]:
        parser.error(f"the robot falls in {args.motion}")
    track = rollout_track(rollout, result.config.release_force(robot), "simulated", note="MBC-DMP")
    rows = slice(settled, steps)
    assert track.contact is not None
    simulated = Track(track.pose[rows], "simulated", track.caption, contact=track.contact[rows])
    recorded = clip.origin.format != "built-in"
    words = ("dog", "motion capture, scaled") if recorded else ("animal", "keypoints, by formula")
    animal = AnimalTrack.of(clip, robot, motion, shown_s, *words)
    retargeted = motion_track(demonstration, shown_s, "retargeted", caption=f"to the {robot.name.upper()}")
    dx, dy, dyaw = demonstration.cycle
    loop_m = args.cycles * float(np.hypot(dx, dy)) if abs(dyaw) < STRAIGHT_RAD else None
    if loop_m is not None:
        poses = retargeted.pose, simulated.pose
        wanted, done = (Straight(pose[:, :3], yaw_from_quat(pose[:, 3:7]), loop_m) for pose in poses)
        animal = replace(animal, points=wanted.points(animal.points))
        retargeted, simulated = wanted.track(retargeted), done.track(simulated)
    info = render_video(
        robot,
        [animal, retargeted, simulated],
        args.out,
        rate_hz=rate,
        fps=max(1, round(loop_s * args.fps)) / loop_s,  # a whole number of frames in a loop
        size=(width, height),
        quality=args.quality,
        columns=3,
        clock=False,
        window_s=(loop_s, 2 * loop_s),
        loop_m=loop_m,
    )
    if info is None:
        parser.exit(1, "there is no OpenGL to draw with\n")
    print(f"{info.frames} frames, {info.seconds:.2f} s, reward {result.after.reward[0]:.3f}, in {args.out}")


if __name__ == "__main__":
    main()
