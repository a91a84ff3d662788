"""The ground under a robot, felt by its feet: a plane through where they last stood, and how far they were off it.

The controller sees the robot's state in the plane's frame, and gravity as it leans there (after Bledt et al. 2018, MIT
Cheetah 3, who fit such a plane). Small slopes and heights are the feet's own: level ground is seen as it is.
"""

from typing import Any, Final

import numpy as np

from fastmimic.base.arrays import Array
from fastmimic.base.conventions import GRAVITY
from fastmimic.base.jit import inlined, kernel
from fastmimic.base.vectors import quat_to_matrix, times, transposed_times
from fastmimic.robot.dynamics import cross
from fastmimic.robot.kinematics import contact_jacobian, leg_forward

SMALL_SLOPE: Final = 0.03  # that is taken for level, and twice as much for what it is
SMALL_HEIGHT_M: Final = 0.01  # likewise, of the ground's height and of the feet's distances from the plane
STEEPEST: Final = 0.5
STIFF_M2: Final = 0.02  # by which one foot alone does not turn the plane
SLIDE_M_S: Final = 0.15  # speed of a foot that slides
SLIDE_M: Final = 0.008  # way after which it does
SLIDE_LOAD: Final = 0.5  # its load, share of the one with which a foot counts as loaded
NEAR_CONE: Final = 0.8  # share of the assumed friction from which a force can make it slide
SETTLED_S: Final = 0.03  # after a touch-down
LEAST_FRICTION: Final = 0.2  # that is assumed
RETURNS: Final = 50.0  # times as slowly as it falls
ROUGH_DAMPING: Final = 0.3  # share of their damping that joints of a loaded leg keep on rough ground
UNLOADED_S: Final = 0.01  # in which a foot that stands has met the ground
CAUGHT_S: Final = 0.02  # after its lift-off a swinging foot that bears weight has caught on the ground
CAUGHT_RISE: Final = 1.0  # m/s with which it is raised then,
CAUGHT_SINK: Final = 0.5  # m/s with which it comes down again,
CAUGHT_M: Final = 0.05  # and as far as it is raised at most
RISING_M: Final = 0.03  # height of a foot from which it is lifted all of what it has to be


@kernel
def see_ground(config: Any, model: Any, ref: Any, obs: Any, memory: Any, seen: Any, scratch: Any) -> None:
    """Feels the ground and writes the robot's state from there to `seen`, a record of `OBSERVATION`: height along the
    normal, orientation and velocities in the plane's frame; x, y and forces are left."""
    quat_to_matrix(obs.root_quat, scratch.rotation)
    if memory.grounded == 0:
        _assume(ref, memory, scratch)
    total = obs.root_pos[0] + obs.root_pos[1] + obs.root_pos[2]
    for j in range(12):
        total += obs.joint_pos[j]
    if np.isfinite(total):  # else nothing is felt in this step
        _feel(config, model, obs, memory, scratch)
    _write(obs, memory, seen, scratch)


@inlined
def _feel(config: Any, model: Any, obs: Any, memory: Any, scratch: Any) -> None:
    """Where feet stand, and the plane through it."""
    rotation, vector = scratch.rotation, scratch.vector
    for leg in range(4):
        standing = memory.stance[leg] == 1 and obs.foot_force[leg, 2] > config.release_threshold
        if memory.grounded == 1 and not standing:
            continue
        q = obs.joint_pos[3 * leg : 3 * leg + 3]
        vector[0], vector[1], vector[2] = leg_forward(model.geometry[leg], q[0], q[1], q[2])
        times(rotation, vector, scratch.change)
        for k in range(3):
            memory.foothold[leg, k] = obs.root_pos[k] + scratch.change[k]
        memory.foothold[leg, 2] -= model.foot_radius
    share = config.dt / config.ground_time if memory.grounded == 1 else 1.0
    _fit(memory, obs, min(share, 1.0))
    memory.grounded = 1


@inlined
def _assume(ref: Any, memory: Any, scratch: Any) -> None:
    """At first the ground leans as the robot does from its reference."""
    reference, up = scratch.reference_rotation, scratch.vector
    quat_to_matrix(ref.root_quat, reference)
    times(scratch.rotation, reference[2], up)  # the reference's vertical in its body frame
    slope = np.hypot(up[0], up[1]) / max(up[2], 0.1)
    least = 1.0 if slope > SMALL_SLOPE else 0.0
    memory.slope[0], memory.slope[1] = -least * up[0] / max(up[2], 0.1), -least * up[1] / max(up[2], 0.1)


@inlined
def _fit(memory: Any, obs: Any, share: float) -> None:
    """The plane through the last footholds, followed by a `share` of what it has changed."""
    x, y, z, n = 0.0, 0.0, 0.0, 0
    for leg in range(4):
        if memory.grounded == 0 and memory.stance[leg] == 0:  # it may be in the air
            memory.foothold[leg, 2] = np.nan
        if not np.isnan(memory.foothold[leg, 2]):
            x, y, z, n = x + memory.foothold[leg, 0], y + memory.foothold[leg, 1], z + memory.foothold[leg, 2], n + 1
    if n == 0:
        return
    x, y, z = x / n, y / n, z / n
    xx = yy = STIFF_M2
    xy = xz = yz = rough = 0.0
    for leg in range(4):
        if np.isnan(memory.foothold[leg, 2]):
            continue
        dx, dy = memory.foothold[leg, 0] - x, memory.foothold[leg, 1] - y
        off = memory.foothold[leg, 2] - z - memory.slope[0] * dx - memory.slope[1] * dy
        xx, xy, yy, xz, yz = xx + dx * dx, xy + dx * dy, yy + dy * dy, xz + dx * off, yz + dy * off
        rough = max(rough, abs(off))
    scale = share / (xx * yy - xy * xy)
    if n > 2:
        memory.slope[0] += scale * (yy * xz - xy * yz)
        memory.slope[1] += scale * (xx * yz - xy * xz)
    size = np.hypot(memory.slope[0], memory.slope[1])
    for k in range(2):
        memory.slope[k] *= min(1.0, STEEPEST / max(size, 1e-9))
    there = z + memory.slope[0] * (obs.root_pos[0] - x) + memory.slope[1] * (obs.root_pos[1] - y)
    if memory.grounded == 1:
        moved = memory.slope[0] * (obs.root_pos[0] - memory.ground_at[0])
        memory.ground += moved + memory.slope[1] * (obs.root_pos[1] - memory.ground_at[1])
    memory.ground += share * (there - memory.ground)
    memory.ground_at[0], memory.ground_at[1] = obs.root_pos[0], obs.root_pos[1]
    memory.roughness += share * (rough - memory.roughness)


@inlined
def _beyond(value: float, small: float) -> float:
    """Share that counts of a value: none up to `small`, all from twice as much."""
    return min(max(value / small - 1.0, 0.0), 1.0)


@inlined
def _write(obs: Any, memory: Any, seen: Any, scratch: Any) -> None:
    x, y = memory.slope[0], memory.slope[1]
    counts = _beyond(np.hypot(x, y), SMALL_SLOPE)
    x, y = counts * x, counts * y
    height = _beyond(abs(memory.ground), SMALL_HEIGHT_M) * memory.ground
    # the smallest rotation from z to the normal, (1 + nz, ny, −nx, 0) normalised
    w = 1.0 + np.sqrt(1.0 + x * x + y * y)
    size = np.sqrt(w * w + x * x + y * y)
    qw, qx, qy = w / size, y / size, -x / size
    ground = scratch.candidate
    scratch.quat[0], scratch.quat[1], scratch.quat[2], scratch.quat[3] = qw, qx, qy, 0.0
    quat_to_matrix(scratch.quat, ground)
    q = obs.root_quat
    seen.root_quat[0] = qw * q[0] + qx * q[1] + qy * q[2]
    seen.root_quat[1] = qw * q[1] - qx * q[0] - qy * q[3]
    seen.root_quat[2] = qw * q[2] + qx * q[3] - qy * q[0]
    seen.root_quat[3] = qw * q[3] - qx * q[2] + qy * q[1]
    transposed_times(ground, obs.lin_vel, seen.lin_vel)
    transposed_times(ground, obs.ang_vel, seen.ang_vel)
    for k in range(3):
        scratch.uphill[k] = GRAVITY * ground[2, k]
    seen.root_pos = obs.root_pos
    seen.root_pos[2] = (obs.root_pos[2] - height) * ground[2, 2]
    seen.joint_pos, seen.joint_vel, seen.foot_force = obs.joint_pos, obs.joint_vel, obs.foot_force


@inlined
def feel_slides(config: Any, model: Any, obs: Any, memory: Any, scratch: Any) -> None:
    """Lowers the friction that is assumed while a foot slides, and lets it return slowly. Forces well within the
    friction cone move no foot: one that moves under them rolls, lands or bends. A robot that catches itself needs all
    of the forces that it can get, and on rough ground feet slide off edges, whatever the friction."""
    if memory.friction == 0.0:
        memory.friction = config.mu
    if config.friction_time == 0.0:
        return
    slides, level = False, memory.recovering == 0 and memory.roughness < SMALL_HEIGHT_M
    for leg in range(4):
        force = memory.force[leg]
        near = np.hypot(force[0], force[1]) > NEAR_CONE * memory.friction * force[2]
        stands = level and memory.stance[leg] == 1 and memory.since_switch[leg] > SETTLED_S
        speed = 0.0
        if stands and near and obs.foot_force[leg, 2] > SLIDE_LOAD * config.contact_threshold:
            speed = _sliding_speed(model, obs, scratch, leg)
        memory.slid[leg] = memory.slid[leg] + config.dt * speed if speed > SLIDE_M_S else 0.0
        slides = slides or memory.slid[leg] > SLIDE_M
    if slides:
        lowered = memory.friction * (1.0 - config.dt / config.friction_time)
        memory.friction = max(lowered, min(LEAST_FRICTION, config.mu))
    else:
        memory.friction += config.dt / (RETURNS * config.friction_time) * (config.mu - memory.friction)


@inlined
def _sliding_speed(model: Any, obs: Any, scratch: Any, leg: int) -> float:
    """Horizontal speed, m/s, of the point of a foot's sphere that is on the ground: the foot may roll."""
    q, dq = obs.joint_pos[3 * leg : 3 * leg + 3], obs.joint_vel[3 * leg : 3 * leg + 3]
    foot, w, v, up, r = scratch.feet[leg], scratch.ang_vel_b, scratch.vector, scratch.rotation[2], model.foot_radius
    contact_jacobian(model.geometry[leg], q, r, up, scratch.jacobian)
    x, y, z = foot[0] - r * up[0], foot[1] - r * up[1], foot[2] - r * up[2]
    v[0], v[1], v[2] = cross(w[0], w[1], w[2], x, y, z)
    for k in range(3):
        v[k] += scratch.lin_vel_b[k]
        for a in range(3):
            v[k] += scratch.jacobian[k, a] * dq[a]
    times(scratch.rotation, v, scratch.change)
    return np.hypot(scratch.change[0], scratch.change[1])


@inlined
def feel_for_ground(config: Any, memory: Any, leg: int) -> tuple[float, float, float]:
    """What a standing leg does where the ground is rough: the shares of the joints' stiffness and damping that it
    keeps, and the speed, m/s, with which its foot is lowered. One that bears weight, maybe on its shin, gives way: held
    to the reference's way, it would lever itself over what it leans on. One that finds no ground is lowered."""
    rough = _beyond(memory.roughness, SMALL_HEIGHT_M)
    if min(memory.unloaded_time[leg], memory.since_switch[leg]) < UNLOADED_S:
        return 1.0 - rough, 1.0 - (1.0 - ROUGH_DAMPING) * rough, 0.0
    return 1.0, 1.0, rough * config.reach_speed


@inlined
def lift_over(config: Any, model: Any, obs: Any, memory: Any, scratch: Any, leg: int, target: Array) -> None:
    """Lifts a swinging foot's target (3,), body frame, higher where the feet stand off the plane; and one that has
    caught on the ground, as animals do that stumble: pulled along, it would throw the robot over."""
    caught = obs.foot_force[leg, 2] > config.contact_threshold and memory.since_switch[leg] > CAUGHT_S
    change = CAUGHT_RISE if caught else -CAUGHT_SINK
    memory.raised[leg] = min(max(memory.raised[leg] + config.dt * change, 0.0), CAUGHT_M)
    rough = _beyond(memory.roughness, SMALL_HEIGHT_M) * memory.roughness
    if rough == 0.0 and memory.raised[leg] == 0.0:
        return
    up = scratch.rotation[2]
    above = obs.root_pos[2] + up[0] * target[0] + up[1] * target[1] + up[2] * target[2] - model.foot_radius
    more = config.rough_lift * rough * min(max(above / RISING_M, 0.0), 1.0) + memory.raised[leg]
    for k in range(3):
        target[k] += more * up[k]
