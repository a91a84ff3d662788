"""Retargeting: an animal's clip as a consistent reference motion of a robot."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fastmimic.conventions import LEFT
from fastmimic.motion.clip import Clip
from fastmimic.motion.contacts import ContactConfig, contact_effort, detect, duty_factors, make_consistent, mask_of
from fastmimic.motion.motion import Motion
from fastmimic.motion.retarget_cycle import Track, cycle_displacement, track_cycle, track_open
from fastmimic.motion.retarget_feet import SwingConfig, plant_feet
from fastmimic.motion.retarget_signal import differentiate, pad_open
from fastmimic.motion.retarget_source import Source, extract
from fastmimic.robot import Robot
from fastmimic.robot.kinematics import foot_positions, inverse_kinematics
from fastmimic.rotations import (
    quat_continuous, quat_from_rotvec, quat_from_yaw, quat_multiply, quat_rotate_inverse, rotate_planar, rotvec_from_quat, quat_conjugate,
)

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RetargetConfig:
    roll_share: float = 0.5
    width_share: float = 0.59
    trunk_hz: float = 6.0
    foot_hz: float = 12.0
    crouch: float = 0.04
    contact: ContactConfig = field(default_factory=ContactConfig)
    swing: SwingConfig = field(default_factory=SwingConfig)


def retarget(clip: Clip, robot: Robot, *, rate_hz=500.0, scale=None, cycle=None, config=RetargetConfig()):
    if scale is None:
        scale = clip.scale if clip.scale is not None else (robot.leg_length / clip.leg_length_m if clip.leg_length_m else 0.825 * robot.leg_length / 0.4)
    source = extract(clip, scale, config.roll_share)
    periodic = cycle if cycle is not None else clip.is_cycle if clip.is_cycle is not None else True
    info = {'scale': scale}
    straight = False
    if periodic:
        d = cycle_displacement(source)
        aim = np.arctan2(d[1], d[0])
        aim = aim - d[2] / 2
        straight = abs(d[2]) < np.radians(10)
        h = np.unwrap(source.heading)
        mean_off = np.arctan2(d[1], d[0]) - (np.mean(h) - h[0])
        info['dir'] = np.degrees(mean_off)
        if straight and np.hypot(*d[:2]) / (len(h) / source.rate_hz) > 0.2 and abs(mean_off) < np.radians(15):
            source = source.turned(mean_off)
    n_frames = clip.n_frames
    duration = (n_frames if periodic else n_frames - 1) / clip.rate_hz
    n = round(duration * rate_hz)
    track = (track_cycle if periodic else track_open)(source, n, config.trunk_hz, config.foot_hz)
    effort = contact_effort(source.toe_height, source.toe_speed)
    ti = np.arange(n) * duration / n * clip.rate_hz
    xp = np.arange(n_frames + 1)
    effort = np.stack([np.interp(ti, xp, np.append(effort[:, l], effort[0 if periodic else -1, l])) for l in range(4)], 1)
    raw_st = detect(effort, rate_hz, periodic, config.contact)
    stances, notes = make_consistent(raw_st, n, rate_hz, periodic, straight, config.contact)
    info |= notes
    info['duty'] = duty_factors(raw_st, n).round(2), duty_factors(stances, n).round(2)
    side = np.where(LEFT, 1.0, -1.0)
    local = robot.hip_pos_b[:, :2] + track.toe_from_hip
    mask = mask_of(stances, n)
    stance_mean = np.array([local[mask[:, l], l].mean(0) for l in range(4)])
    width = (robot.hip_pos_b[:, 1] + config.width_share * robot.lateral_offset) * side
    info['stance x'] = (stance_mean[:, 0] - robot.hip_pos_b[:, 0]).round(3), 'y', stance_mean[:, 1].round(3)
    x_shift = robot.com_b[0] + robot.hip_pos_b[:, 0] - robot.hip_pos_b[:, 0].mean() - np.repeat([stance_mean[:2, 0].mean(), stance_mean[2:, 0].mean()], 2)
    y_now = (stance_mean[:, 1] * side).reshape(2, 2).mean(1)
    y_shift = side * (width - np.repeat(y_now, 2))
    local = local + np.stack([x_shift, y_shift], 1)
    raw_xy = track.root_xy[:, None] + rotate_planar(track.heading[:, None], local)
    feet = plant_feet(raw_xy, np.maximum(track.toe_height, 0), track, stances, robot.foot_radius, rate_hz, config.swing)
    height = source.hip_height + robot.foot_radius - config.crouch * scale / .825
    tilt = track.tilt; o = np.zeros(n)
    quat = quat_multiply(quat_from_yaw(track.heading), quat_multiply(quat_from_rotvec(np.stack([o, tilt[:, 1], o], 1)), quat_from_rotvec(np.stack([tilt[:, 0], o, o], 1))))
    lo, hi = robot.joint_lower + 0.02, robot.joint_upper - 0.02
    for lower in np.arange(0, 0.081, 0.005):
        z = track.root_z - track.root_z.mean() + height - lower
        pos = np.concatenate([track.root_xy, z[:, None]], 1)
        foot_b = quat_rotate_inverse(quat[:, None], feet - pos[:, None])
        q, ok = inverse_kinematics(robot, foot_b)
        clamp = (q < lo) | (q > hi)
        if not clamp.any() and ok.all(): break
    info['height'] = round(height, 3), 'lowered', lower
    info['unreach'] = (~ok).sum(0); info['clamp'] = clamp.sum(0).reshape(4, 3)
    info['knee max'] = q.reshape(-1, 4, 3)[:, :, 2].max(0).round(2)
    def pad(v):
        return np.concatenate([v[-2:], v, v[:2]]) if periodic else pad_open(v)
    def padxy():
        if not periodic: return pad_open(pos)
        a, b = pos[-2:].copy(), pos[:2].copy()
        a[:, :2] = track.moved(a[:, :2], -1); b[:, :2] = track.moved(b[:, :2], 1)
        return np.concatenate([a, pos, b])
    dt = 1 / rate_hz
    vel = differentiate(padxy(), dt)
    dq = differentiate(pad(q), dt)
    if periodic:
        qa = quat_multiply(quat_from_yaw(-track.cycle[2]), quat[-2:]); qb = quat_multiply(quat_from_yaw(track.cycle[2]), quat[:2])
        qq = quat_continuous(np.concatenate([qa, quat, qb]))
    else:
        qq = quat_continuous(pad_open(quat_continuous(quat)));
    omega = 2 * quat_multiply(differentiate(qq, dt), quat_conjugate(quat_continuous(quat) if False else qq[2:-2]))[:, 1:]
    info['dqmax'] = np.abs(dq).max(0).reshape(4, 3).max(0).round(1)
    info['rawslip'] = [round(float(max([np.linalg.norm(np.ptp(raw_xy[np.arange(s, e) % n if not periodic else np.arange(s, min(e, n)), l], axis=0)) for s, e in stances[l]] or [0])), 3) for l in range(4)]
    info['clear'] = (feet[..., 2].max(0) - robot.foot_radius).round(3), source.toe_height.max(0).round(3)
    info['rms'] = np.sqrt(((feet[..., :2] - raw_xy) ** 2).sum(-1).mean(0)).round(3)
    motion = Motion(rate_hz, pos, quat, q, dq, foot_b, mask, vel, omega, track.cycle, meta={'name': clip.meta.get('name', '')})
    motion_feet = feet
    return motion, dict(info=info, feet=feet, raw_xy=raw_xy, track=track, source=source, raw_st=raw_st, stances=stances, n=n)
