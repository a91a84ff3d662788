"""The optimal control problem of a motion: its variables, their bounds, and the animal's motion at the nodes.

Positions at the nodes are the variables. Velocities and accelerations are their differences, so that a node's
constraints and cost depend on three neighbouring nodes alone.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.rotations import (
    quat_from_yaw,
    quat_multiply,
    quat_rotate,
    roll_pitch_from_quat,
    rotate_planar,
    yaw_from_quat,
)
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot
from fastmimic.trajectory.config import TrajectoryConfig
from fastmimic.trajectory.contact_modes import ContactModes, runs_of
from fastmimic.trajectory.ipopt import DIVERGED
from fastmimic.trajectory.margins import capture_margins, heaviest
from fastmimic.trajectory.node import (
    GIVEN,
    METRES,
    N_GIVEN,
    N_ROWS,
    N_VARIABLES,
    ROWS,
    VARIABLES,
    NodeFunctions,
    node_functions,
)
from fastmimic.trajectory.solve import LIMITS, answered
from fastmimic.trajectory.windows import Guess

_SHORTEST_STEP_S = 0.007
_LONGEST_STEP_S = 0.012
_MOST_DIFFERENCE = 0.6  # of the distance that a cycle covers
_JOINED = [0, 1, -2, -1]  # nodes that keep their coordinates where a motion joins others


def displacement(motion: Motion) -> tuple[Array, float]:
    """Of one period: (2,) m in the world, and its turn, rad; 0 without a period."""
    if motion.cycle is None:
        return np.zeros(2), 0.0
    yaw = float(yaw_from_quat(motion.root_quat_wxyz[0]))
    return rotate_planar(yaw, motion.cycle[:2]), float(motion.cycle[2])


@dataclass(frozen=True, eq=False)
class Solution:
    """What the solver found; positions in the motion's world frame, moved so that its first sample is at x = y = 0.

    Attributes:
        coordinates: (N, 18) at the nodes.
        force: (N, 4, 3) on the feet, world, multiples of the weight.
        time: (N + 1,) of the nodes and of the end, s; without a period (N,).
        durations: (M,) of the contact modes, s.
        stride: distance that a cycle, or all of a passage, covers, share of the animal's.
        way: (N, 2) of the animal's x and y with that stride, which the trunk follows.
        converged, status: whether the solver's tolerances were met, and IPOPT's words.
        tried: the last node of those that were tried: a window without a solution is the last one.
        so_far: a solution up to the last window, and what that began from; None if there is one piece.
        first: node of the window before that one, from which to try again.
        iterations: of the solver.
        use: of each limit its greatest use, share of the robot's own, and the share of the time at it (`LIMITS`).
        cost: of the whole.
        variables: (n,) of the program.
    """

    coordinates: Array
    force: Array
    time: Array
    durations: Array
    stride: float
    way: Array
    converged: bool
    status: str
    tried: int
    so_far: Guess | None
    first: int
    iterations: int
    use: dict[str, tuple[float, float]]
    cost: float
    variables: Array

    @property
    def guess(self) -> Guess:
        """It as the first guess of another problem."""
        return Guess(self.variables, self.way)

    @property
    def diverged(self) -> bool:
        """Whether the solver was stopped as it went away from any solution."""
        return self.status == DIVERGED


@dataclass(frozen=True, eq=False)
class Program:
    """The problem of one motion: the nearest one that the robot can execute. `joins`: its ends are parts of other
    motions, so that two nodes at either end keep their coordinates."""

    robot: Robot
    motion: Motion
    config: TrajectoryConfig
    joins: bool = False

    @cached_property
    def modes(self) -> ContactModes:
        """Nodes are closer where feet swing fast."""
        config, periodic = self.config, self.motion.cycle is not None
        phases = [run for leg in self.motion.contact.T for down in (leg, ~leg) for run in runs_of(down, periodic)]
        phase_s = float(np.quantile([len(run) for run in phases], 0.25)) * self.motion.dt
        node_s = float(np.clip(phase_s / config.phase_nodes, config.node_s, 1.5 * config.node_s))
        return ContactModes.of(self.motion, node_s)

    @cached_property
    def functions(self) -> NodeFunctions:
        return node_functions(self.robot, self.config)

    @property
    def n(self) -> int:
        """Number of variables."""
        return self.at["stride"] + 1

    @cached_property
    def at(self) -> dict[str, int]:
        """First index of the variables: coordinates and forces node by node, durations, footholds, stride."""
        modes = self.modes
        sizes = {
            "coordinates": 18 * modes.n_nodes,
            "force": 12 * modes.n_nodes,
            "durations": len(modes.steps),
            "holds": 2 * max(1, len(modes.footholds)),  # one that nothing uses, if no foot ever stands
            "stride": 1,
        }
        ends = np.cumsum([0, *sizes.values()]).tolist()
        return dict(zip(sizes, ends, strict=False))

    @cached_property
    def index(self) -> NDArray[np.int_]:
        """(N, 77) variables of the program that are those of each node."""
        modes, at = self.modes, self.at
        index = np.zeros((modes.n_nodes, N_VARIABLES), dtype=int)
        for name, node in (("before", modes.before), ("here", np.arange(modes.n_nodes)), ("after", modes.after)):
            index[:, VARIABLES[name]] = 18 * node[:, None] + np.arange(18)
        index[:, VARIABLES["force"]] = at["force"] + np.arange(12 * modes.n_nodes).reshape(-1, 12)
        index[:, VARIABLES["duration_before"]] = at["durations"] + modes.mode[modes.before][:, None]
        index[:, VARIABLES["duration"]] = at["durations"] + modes.mode[:, None]
        hold = at["holds"] + 2 * np.maximum(modes.foothold, 0)[..., None] + np.arange(2)
        index[:, VARIABLES["holds"]] = hold.reshape(-1, 8)
        index[:, VARIABLES["stride"]] = at["stride"]
        return index

    @cached_property
    def displacement(self) -> tuple[Array, float]:
        """That of the animal's motion."""
        return displacement(self.motion)

    def _lap(self, laps: int) -> Array:
        """(5,) cosine, sine, displacement and yaw that move by whole periods."""
        step, turn = self.displacement
        moved = np.zeros(2)
        for _ in range(abs(laps)):
            moved = rotate_planar(turn, moved) + step if laps > 0 else rotate_planar(-turn, moved - step)
        return np.array([np.cos(laps * turn), np.sin(laps * turn), *moved, laps * turn])

    @cached_property
    def animal(self) -> dict[str, Array]:
        """The motion at the nodes, by the names of `node.GIVEN`."""
        motion, modes = self.motion, self.modes
        step, turn = self.displacement
        origin = np.array([*motion.root_pos_w[0, :2], 0.0])
        position = motion.root_pos_w - origin
        quat = motion.root_quat_wxyz
        angles = np.column_stack([*roll_pitch_from_quat(quat), np.unwrap(yaw_from_quat(quat))])
        moved = np.array([0.0, 0.0, turn])
        if modes.periodic:
            wide = np.concatenate([angles[-1:] - moved, angles, angles[:1] + moved])
            rates = np.gradient(wide, motion.dt, axis=0)[1:-1]
        else:
            rates = np.gradient(angles, motion.dt, axis=0)
        level = quat_multiply(quat_from_yaw(-yaw_from_quat(motion.root_quat_wxyz)), motion.root_quat_wxyz)
        feet = quat_rotate(level[:, None], motion.foot_pos_b)
        feet[..., 2] = motion.foot_pos_w[..., 2]
        end = np.array([*rotate_planar(turn, position[0, :2]) + step, position[0, 2]])
        given = {
            "position": (position, end),
            "angles": (angles, angles[0] + moved),
            "joints": (motion.joint_pos, motion.joint_pos[0]),
            "velocity": (motion.root_lin_vel_w, _turned(motion.root_lin_vel_w[0], turn)),
            "angle_rates": (rates, rates[0]),
            "joint_rates": (motion.joint_vel, motion.joint_vel[0]),
            "feet": (feet.reshape(-1, 12), feet[0].ravel()),
            "feet_w": ((motion.foot_pos_w - origin).reshape(-1, 12), np.zeros(12)),
        }
        found = {}
        for name, (values, following) in given.items():
            found[name] = modes.at_nodes(values, following if modes.periodic else values[-1])
        return found

    @cached_property
    def given(self) -> Array:
        """(N, 91) parameters of the nodes."""
        modes, animal = self.modes, self.animal
        nodes = np.arange(modes.n_nodes)
        p = np.zeros((modes.n_nodes, N_GIVEN))
        p[:, GIVEN["share_before"]] = 1 / modes.steps[modes.mode[modes.before]][:, None]
        p[:, GIVEN["share"]] = 1 / modes.steps[modes.mode][:, None]
        p[:, GIVEN["lap_before"]] = self._lap(0)
        p[:, GIVEN["lap_after"]] = self._lap(0)
        if modes.periodic:
            p[0, GIVEN["lap_before"]], p[-1, GIVEN["lap_after"]] = self._lap(-1), self._lap(1)
        laps = {k: self._lap(-k)[:4] for k in np.unique(modes.laps).tolist()}
        p[:, GIVEN["lap_holds"]] = [np.concatenate([laps[k] for k in row]) for row in modes.laps.tolist()]
        p[:, GIVEN["loaded"]] = modes.loaded
        p[:, GIVEN["calf"]] = animal["joints"].reshape(-1, 4, 3)[..., 1:].sum(axis=-1).mean(axis=0)
        height = float(animal["position"][:, 2].mean())
        p[:, GIVEN["capture"]] = capture_margins(modes, self.animal_steps, self.robot, height, self.config)
        for name in ("position", "angles", "joints", "velocity", "angle_rates", "joint_rates", "feet"):
            p[:, GIVEN[name]] = animal[name]
        step = ((modes.end - modes.first) / modes.steps)[modes.mode]
        share = 0.5 * (step + step[modes.before]) / (modes.end[-1] - modes.first[0])
        p[:, GIVEN["weight"]] = np.where(modes.moves[nodes], share, 0.0)[:, None]
        return p

    def bounds_of_rows(self) -> tuple[Array, Array]:
        """Lower and upper bounds (N, 93) of the rows; infinite where a row does not apply."""
        robot, config, modes = self.robot, self.config, self.modes
        shape = (modes.n_nodes, N_ROWS)
        low, high = np.full(shape, -np.inf), np.full(shape, np.inf)
        size = robot.leg_length / 0.4
        low[:, ROWS["knees"]] = METRES * config.knee_m * size
        low[:, ROWS["apart"]] = METRES * (2 * robot.foot_radius + config.apart_m * size)
        moves = modes.moves
        low[moves, ROWS["dynamics"]] = high[moves, ROWS["dynamics"]] = 0.0
        low[moves, ROWS["torque"]], high[moves, ROWS["torque"]] = -1.0, 1.0
        low[moves, ROWS["driving"]], high[moves, ROWS["driving"]] = -1.96, 1.96  # 2 % for what is between nodes
        low[moves, ROWS["turning"]], high[moves, ROWS["turning"]] = -1.0, 1.0
        low[moves, ROWS["speed"]], high[moves, ROWS["speed"]] = -config.speed_share, config.speed_share
        height = self.animal["feet"].reshape(-1, 4, 3)[..., 2] - robot.foot_radius
        near = METRES * config.contact_m_per_s * config.node_s
        for leg in range(4):
            foot = slice(ROWS["feet"].start + 3 * leg, ROWS["feet"].start + 3 * leg + 3)
            up = foot.stop - 1
            stands, slow = modes.stands[:, leg], modes.landing[:, leg] | modes.leaving[:, leg]
            low[:, up] = METRES * np.clip(0.5 * height[:, leg], 0.0, config.swing_m * size)
            for nodes in modes.swings(leg):
                top = nodes[np.argmax(height[nodes, leg])]
                low[top, up] = max(low[top, up], METRES * config.clearance_share * height[top, leg])
            low[slow, foot], high[slow, foot] = -near, near
            low[slow, up] = 0.0
            low[stands, foot] = high[stands, foot] = 0.0
            pyramid = slice(ROWS["friction"].start + 4 * leg, ROWS["friction"].start + 4 * leg + 4)
            low[modes.loaded[:, leg] & moves, pyramid] = 0.0
        if self.joins:  # what is given there has the feet of its samples, not those of the nodes between them
            kept, inner = _JOINED, _JOINED[1:3]
            heights = [ROWS["feet"].start + 3 * leg + 2 for leg in range(4)]
            planar = [j for j in range(ROWS["feet"].start, ROWS["feet"].stop) if j not in heights]
            standing = np.repeat(modes.stands[inner], 2, axis=1)
            for bound, none in ((low, -np.inf), (high, np.inf)):
                foothold = np.where(standing, bound[np.ix_(inner, planar)], none)
                bound[kept, ROWS["feet"]] = bound[kept, ROWS["knees"]] = bound[kept, ROWS["apart"]] = none
                bound[np.ix_(inner, planar)] = foothold
        return low, high

    def bounds_of_variables(self) -> tuple[Array, Array]:
        """Lower and upper bounds (n,) of the variables."""
        robot, config, modes, at = self.robot, self.config, self.modes, self.at
        low, high = np.full(self.n, -np.inf), np.full(self.n, np.inf)
        place = at["coordinates"] + 18 * np.arange(modes.n_nodes)[:, None]
        for j in (3, 4):
            low[place + j], high[place + j] = -config.tilt_rad, config.tilt_rad
        joints = place + 6 + np.arange(12)
        low[joints] = robot.joint_lower + config.joint_margin_rad
        high[joints] = robot.joint_upper - config.joint_margin_rad
        if self.joins:
            for bound in (low, high):
                bound[place[_JOINED] + np.arange(18)] = self.coordinates()[_JOINED]
        force_low, force_high = np.zeros((2, modes.n_nodes, 4, 3))
        pushes = modes.loaded & modes.moves[:, None]
        force_low[pushes] = -config.most_force, -config.most_force, config.least_force
        force_high[pushes] = config.most_force
        force_high[pushes, 2] = heaviest(modes, self.animal_steps, config)[pushes]
        part = slice(at["force"], at["durations"])
        low[part], high[part] = force_low.ravel(), force_high.ravel()
        part = slice(at["durations"], at["holds"])
        animal = self.animal_durations
        if config.keep_time:
            low[part] = high[part] = animal
        else:
            low[part] = np.maximum(config.shortest_share * animal, _SHORTEST_STEP_S * modes.steps)
            high[part] = np.maximum(config.longest_share * animal, _LONGEST_STEP_S * modes.steps)
        free = 0.0 if config.keep_speed else _MOST_DIFFERENCE
        low[at["stride"]], high[at["stride"]] = 1 - free, 1 + free
        return low, high

    @property
    def animal_steps(self) -> Array:
        """(N,) intervals after the nodes at the animal's durations, s."""
        return np.asarray((self.animal_durations / self.modes.steps)[self.modes.mode])

    @property
    def animal_durations(self) -> Array:
        """(M,) of the contact modes, s."""
        return np.asarray((self.modes.end - self.modes.first) * self.motion.dt)

    def start(self) -> Array:
        """The animal's motion as the first guess (n,), the weight shared by the standing feet."""
        modes, at, animal = self.modes, self.at, self.animal
        low, high = self.bounds_of_variables()
        w = np.zeros(self.n)
        w[: at["force"]] = self.coordinates().ravel()
        force = np.zeros((modes.n_nodes, 4, 3))
        force[..., 2] = modes.loaded / np.maximum(1, modes.loaded.sum(axis=1, keepdims=True))
        w[at["force"] : at["durations"]] = force.ravel()
        w[at["durations"] : at["holds"]] = self.animal_durations
        feet = animal["feet_w"].reshape(-1, 4, 3)
        holds = np.array([feet[hold.node, hold.leg, :2] for hold in modes.footholds])
        w[at["holds"] : at["holds"] + holds.size] = holds.ravel()
        w[at["stride"]] = 1.0
        return np.clip(w, low, high)

    def coordinates(self) -> Array:
        """(N, 18) of the animal's motion at the nodes."""
        return np.hstack([self.animal[name] for name in ("position", "angles", "joints")])

    def solve(self, start: Guess | None = None, first: int = 0) -> Solution:
        """Solves the problem from a first guess, by default `start()`; before node `first` it is a solution."""
        animal = self.animal["position"][:, :2]
        found = answered(self, start or Guess(self.start(), animal), first)
        w = found["variables"]
        modes, at = self.modes, self.at
        one = float(w[at["stride"]])
        way = found.get("way", one * animal)
        durations = w[at["durations"] : at["holds"]]
        steps = np.repeat(durations / modes.steps, modes.steps)
        n = modes.n_nodes
        return Solution(
            coordinates=w[: at["force"]].reshape(n, 18),
            force=w[at["force"] : at["durations"]].reshape(n, 4, 3),
            time=np.concatenate([[0.0], np.cumsum(steps)]),
            durations=durations,
            stride=one if "way" not in found else _length(way) / max(_length(animal), 1e-9),
            way=way,
            converged=bool(found["converged"]),
            status=str(found["status"]),
            tried=int(found.get("tried", n - 1)),
            so_far=Guess(found["so_far"], found["way_so_far"]) if "way" in found else None,
            first=int(found.get("first", 0)),
            iterations=int(found["iterations"]),
            use=dict(zip(LIMITS, map(tuple, found["use"].tolist()), strict=True)),
            cost=float(found["cost"]),
            variables=w,
        )

    def rows(self, variables: Array) -> Array:
        """(N, 93) constraint rows for variables (n,)."""
        return np.array(self.functions.rows.map(self.modes.n_nodes)(variables[self.index].T, self.given.T)).T


def _length(way: Array) -> float:
    return float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum())


def _turned(velocity: Array, yaw: float) -> Array:
    return np.array([*rotate_planar(yaw, velocity[:2]), velocity[2]])
