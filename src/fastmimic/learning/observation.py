"""The policy's observation and the conversion of its actions (Peng et al. 2020, §VI), batched and compiled, for the
environments and for the policy as a controller.

An observation holds roll, pitch and their rates from the IMU, joint angles and the last actions, each at the last three
policy steps, newest first, and the reference motion 1, 2, 10 and 30 policy steps ahead: root position relative to the
present reference, root orientation, both in the robot's heading frame, and joint angles. It needs no global position.
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array, Records
from fastmimic.base.jit import floats, inlined, kernel, record_dtype
from fastmimic.base.vectors import copy, quat_about_z, quat_to_matrix
from fastmimic.learning.config import FRAMES, HISTORY, IMU_SIZE
from fastmimic.reference.table import next_period

SENSES: Final = record_dtype(
    [
        *floats(imu=(HISTORY, IMU_SIZE), joints=(HISTORY, 12), actions=(HISTORY, 12)),  # newest first
        # rad: unfiltered targets of the last actions; targets at the beginning and the end of the current one
        *floats(filter_in=(2, 12), filter_out=(2, 12), before=12, after=12),
        ("age", "i8"),  # control steps since the last action; −1 before the first
    ]
)  # memory of one robot between policy steps

_FRAMES: Final = np.array(FRAMES, dtype=np.int64)


def make_senses(n: int) -> Records:
    """Records (n,) of `SENSES` for robots before their first step."""
    senses = np.zeros(n, SENSES)
    senses["age"] = -1
    return senses


@kernel
def observe(
    settings: Any, tables: Any, clocks: Any, observations: Any, senses: Any, rotation: Array, out: NDArray[np.float32]
) -> None:
    """Reads the robots' states and writes the policies' observations. Call it once per policy step, before `act`.
    `settings` are (1,) of `SETTINGS`, `clocks` and `observations` (n,) of `CLOCK` and `OBSERVATION`; robot i follows
    table min(i, k − 1) of `tables` (k, t) of `SAMPLE`. Changes `senses` (n,) of `SENSES` in place and writes `out` (n,
    `OBSERVATION_SIZE`); `rotation` (3, 3) is scratch."""
    for i in range(out.shape[0]):
        table, clock, obs, memory = tables[min(i, tables.shape[0] - 1)], clocks[i], observations[i], senses[i]
        quat_to_matrix(obs.root_quat, rotation)
        _push(settings[0], rotation, obs, memory)
        at = _history(memory.imu, out[i], 0)
        at = _history(memory.joints, out[i], at)
        at = _history(memory.actions, out[i], at)
        yaw = np.arctan2(rotation[1, 0], rotation[0, 0])
        for k in range(_FRAMES.shape[0]):
            at = _frame(table, clock, clock.sample + settings[0].decimation * _FRAMES[k], yaw, out[i], at)


@kernel
def act(settings: Any, actions: Array, senses: Any) -> None:
    """Takes in actions (n, 12), clipped to the joints' limits and low-pass filtered; the last ones where not finite."""
    setting = settings[0]
    b0, b1, b2 = setting.numerator[0], setting.numerator[1], setting.numerator[2]
    a1, a2 = setting.denominator[0], setting.denominator[1]
    for i in range(actions.shape[0]):
        memory = senses[i]
        for h in range(HISTORY - 1, 0, -1):
            copy(memory.actions[h - 1], memory.actions[h])
        for j in range(12):
            wanted = setting.home[j] + setting.action_scale * actions[i, j]
            if not np.isfinite(wanted):
                wanted = memory.filter_in[0, j]
            wanted = min(max(wanted, setting.lower[j]), setting.upper[j])
            memory.actions[0, j] = (wanted - setting.home[j]) / setting.action_scale
            filtered = b0 * wanted + b1 * memory.filter_in[0, j] + b2 * memory.filter_in[1, j]
            filtered -= a1 * memory.filter_out[0, j] + a2 * memory.filter_out[1, j]
            memory.filter_in[1, j], memory.filter_in[0, j] = memory.filter_in[0, j], wanted
            memory.filter_out[1, j], memory.filter_out[0, j] = memory.filter_out[0, j], filtered
            memory.before[j], memory.after[j] = memory.after[j], filtered
        memory.age = 0


@kernel
def command(settings: Any, senses: Any, commands: Any) -> None:
    """The next control step's commands, (n,) of `COMMAND`, interpolated between the last two actions' targets."""
    setting = settings[0]
    for i in range(commands.shape[0]):
        memory, out = senses[i], commands[i]
        memory.age += 1
        share = min(memory.age / setting.decimation, 1.0)
        for j in range(12):
            target = memory.before[j] + share * (memory.after[j] - memory.before[j])
            out.joint_pos[j] = min(max(target, setting.lower[j]), setting.upper[j])
            out.joint_vel[j] = 0.0
            out.torque[j] = 0.0
            out.stiffness[j] = setting.stiffness[j % 3]
            out.damping[j] = setting.damping[j % 3]


@inlined
def _push(settings: Any, rotation: Array, obs: Any, senses: Any) -> None:
    """Adds roll, pitch, their rates and the joint angles to the histories. Before the first step, fills these with the
    present state, and with the actions that would hold it."""
    for h in range(HISTORY - 1, 0, -1):
        copy(senses.imu[h - 1], senses.imu[h])
        copy(senses.joints[h - 1], senses.joints[h])
    senses.imu[0, 0] = np.arctan2(rotation[2, 1], rotation[2, 2])
    senses.imu[0, 1] = np.arcsin(min(max(-rotation[2, 0], -1.0), 1.0))
    for k in range(2):  # body frame, as from a gyroscope
        rate = 0.0
        for a in range(3):
            rate += rotation[a, k] * obs.ang_vel[a]
        senses.imu[0, 2 + k] = rate
    copy(obs.joint_pos, senses.joints[0])
    if senses.age >= 0:
        return
    senses.age = 0
    for h in range(HISTORY):
        copy(senses.imu[0], senses.imu[h])
        copy(obs.joint_pos, senses.joints[h])
        for j in range(12):
            senses.actions[h, j] = (obs.joint_pos[j] - settings.home[j]) / settings.action_scale
    for j in range(12):
        senses.filter_in[:, j] = senses.filter_out[:, j] = obs.joint_pos[j]
        senses.before[j] = senses.after[j] = obs.joint_pos[j]


@inlined
def _history(history: Array, out: NDArray[np.float32], at: int) -> int:
    """Writes a history; returns the next index of `out`."""
    for h in range(HISTORY):
        for k in range(history.shape[1]):
            out[at] = history[h, k]
            at += 1
    return at


@inlined
def _frame(table: Any, clock: Any, sample: int, yaw: float, out: NDArray[np.float32], at: int) -> int:
    """Writes the reference motion at a sample, possibly of a later period; returns the next index of `out`."""
    n = table.shape[0]
    x = y = turned = 0.0  # of the frame's period relative to the present one
    if clock.repeats == 1:
        while sample >= n:
            x, y, turned = next_period(clock, x, y, turned)
            sample -= n
    else:
        sample = min(sample, n - 1)  # after its end, the motion keeps its last sample
    now, then = table[clock.sample], table[sample]
    c, s = np.cos(turned), np.sin(turned)
    x += c * then.root_pos[0] - s * then.root_pos[1] - now.root_pos[0]
    y += s * then.root_pos[0] + c * then.root_pos[1] - now.root_pos[1]
    heading = clock.origin[2] - yaw
    c, s = np.cos(heading), np.sin(heading)
    out[at] = c * x - s * y
    out[at + 1] = s * x + c * y
    out[at + 2] = then.root_pos[2] - now.root_pos[2]
    q = quat_about_z(heading + turned, then.root_quat)
    sign = 1.0 if q[0] >= 0 else -1.0
    for k in range(4):
        out[at + 3 + k] = sign * q[k]
    copy(then.joint_pos, out[at + 7 : at + 19])
    return at + 19
