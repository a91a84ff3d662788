"""A trained policy: a multilayer perceptron, its file, its inference without a learning library, and a controller with
it for the closed loop, in place of the model-based one.

The file is an `.npz` without pickles: `format_version`, `meta_json`, `mean` and `deviation` of the observation, and for
each layer `weight0` (inputs, outputs) and `bias0`, `weight1`, …, all float32. `meta_json` holds `robot`, `motion`,
`samples` (of the motion), `observation_size`, `action_size`, `activation`, `config` (see `PolicyConfig`), `seed`,
`library`, `versions`, `training`, and the motion's `source` and `licence`.
"""

import json
from dataclasses import asdict, dataclass, field
from functools import cached_property, partial
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array, Indices, Records, fingerprint
from fastmimic.base.configuration import changed
from fastmimic.base.errors import ConfigError, PolicyError, naming
from fastmimic.base.files import from_json, read_arrays, replace_file
from fastmimic.base.jit import inlined, kernel
from fastmimic.control.config import ControllerConfig, pack_config
from fastmimic.control.stance import begin_legs, plan_leg
from fastmimic.episode.loop import MakeController
from fastmimic.learning.config import ACTION_SIZE, OBSERVATION_SIZE, PolicyConfig, pack_settings
from fastmimic.learning.observation import act, command, make_senses, observe
from fastmimic.motion.motion import Motion
from fastmimic.reference.table import stack_tables
from fastmimic.robot import Robot
from fastmimic.robot.state import COMMAND, MEMORY

Weights = NDArray[np.float32]

FORMAT_VERSION: Final = 2
ACTIVATIONS: Final = ("none", "relu", "elu", "tanh")
POLICY_FILE: Final = "policy.npz"
_PLAIN: Final = {"robot": str, "motion": str, "samples": int, "activation": str, "seed": int}  # of a `Policy`


class Network(NamedTuple):
    """A policy in the kernels' format."""

    sizes: Indices  # (layers + 1,) widths, the observation's first
    parameters: Array  # all weights (inputs, outputs) and biases in sequence
    activation: int  # index into `ACTIVATIONS`, of all layers but the last
    mean: Array  # (observation,) of the normalisation
    deviation: Array
    work: Array  # (2, width) scratch


@dataclass(frozen=True, eq=False)
class Policy:
    """A trained policy; `fastmimic.learning.observation` defines observation and action."""

    weights: tuple[Weights, ...]  # of each layer, (inputs, outputs)
    biases: tuple[Weights, ...]  # (outputs,)
    mean: Weights  # (observation,) of the normalisation
    deviation: Weights
    robot: str  # the training's
    motion: str
    samples: int  # of the training's motion
    activation: str = "elu"  # one of `ACTIVATIONS`
    config: PolicyConfig = field(default_factory=PolicyConfig)
    seed: int = 0
    about: dict[str, Any] = field(default_factory=dict)  # entries of its file: `library`, `versions`, `training`

    def __post_init__(self) -> None:
        if self.activation not in ACTIVATIONS:
            raise PolicyError(f"unknown activation '{self.activation}'; there are {', '.join(ACTIVATIONS)}")
        if not self.weights or len(self.weights) != len(self.biases):
            raise PolicyError(f"{len(self.weights)} weights and {len(self.biases)} biases are no layers")
        sizes = [w.shape[0] if w.ndim == 2 else -1 for w in self.weights] + [len(self.biases[-1])]
        for (inputs, outputs), weight, bias in zip(pairwise(sizes), self.weights, self.biases, strict=True):
            if weight.shape != (inputs, outputs) or bias.shape != (outputs,):
                raise PolicyError(f"layers do not fit together: weight {weight.shape}, bias {bias.shape}")
        if self.mean.shape != (sizes[0],) or self.deviation.shape != (sizes[0],):
            raise PolicyError(f"normalisation of {self.mean.shape} for observations of {sizes[0]} numbers")
        if sizes[0] != OBSERVATION_SIZE or sizes[-1] != ACTION_SIZE:
            said = f"takes observations of {sizes[0]} numbers and gives {sizes[-1]}"
            raise PolicyError(f"{said}; this release's have {OBSERVATION_SIZE} and {ACTION_SIZE}")
        arrays = (*self.weights, *self.biases, self.mean, self.deviation)
        if not all(np.isfinite(a).all() for a in arrays) or not (self.deviation > 0).all():
            raise PolicyError("has weights that are not finite, or a deviation that is not positive")

    @property
    def sizes(self) -> tuple[int, ...]:
        """Widths of the layers, the observation's first."""
        return (*(w.shape[0] for w in self.weights), self.weights[-1].shape[1])

    @property
    def training(self) -> dict[str, Any]:
        """Cost of the training, if recorded: `steps`, `wall_s`, `cpu_s`, `simulated_s`."""
        found = self.about.get("training")
        return found if isinstance(found, dict) else {}

    @cached_property
    def digest(self) -> str:
        """16 hexadecimal digits of everything that determines its actions."""
        arrays = (*self.weights, *self.biases, self.mean, self.deviation)
        return fingerprint(self._meta(), *(array.astype(np.float32) for array in arrays))

    def network(self) -> Network:
        """The policy for the kernels, with its own work memory."""
        parts = [a.astype(np.float64).ravel() for pair in zip(self.weights, self.biases, strict=True) for a in pair]
        sizes, work = np.array(self.sizes, np.int64), np.zeros((2, max(self.sizes)))
        mean, deviation = self.mean.astype(np.float64), self.deviation.astype(np.float64)
        return Network(sizes, np.concatenate(parts), ACTIVATIONS.index(self.activation), mean, deviation, work)

    def check(self, robot: Robot, motion: Motion) -> None:
        """Raises `PolicyError` if the policy was trained for another robot or another motion."""
        if self.robot != robot.name:
            raise PolicyError(f"the policy is for robot '{self.robot}', not for '{robot.name}'; train one for it")
        if self.motion != motion.name:
            said = f"the policy imitates '{self.motion}', not '{motion.name}'"
            raise PolicyError(f"{said}; a policy can do the motion that it was trained on only")
        if self.samples != motion.n_samples:
            said = f"the policy imitates a '{self.motion}' of {self.samples} samples"
            raise PolicyError(f"{said}, and this one has {motion.n_samples}: it was retargeted otherwise")

    def save(self, path: str | Path) -> None:
        """Writes the file atomically; raises `OutputError` if it cannot."""
        arrays: dict[str, Any] = {"mean": self.mean, "deviation": self.deviation}
        for i, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            arrays |= {f"weight{i}": weight, f"bias{i}": bias}
        arrays = {name: np.ascontiguousarray(a, np.float32) for name, a in arrays.items()}
        meta = np.str_(json.dumps({**self._meta(), **self.about}, sort_keys=True))
        version = np.int64(FORMAT_VERSION)
        replace_file(path, lambda file: np.savez_compressed(file, format_version=version, meta_json=meta, **arrays))

    @classmethod
    def load(cls, path: str | Path) -> "Policy":
        """Reads a file of `save`; raises `PolicyError` if it is missing, damaged, or of another release."""
        arrays = read_arrays(path, PolicyError, "policy")
        if "meta_json" not in arrays or "weight0" not in arrays:
            raise PolicyError(f"{path}: an .npz without 'meta_json' and 'weight0'; not a FastMimic policy")
        try:
            if int(version := arrays["format_version"]) != FORMAT_VERSION:
                raise PolicyError(f"format version {version}; this release reads version {FORMAT_VERSION}")
            return cls._of(arrays)
        except KeyError as error:
            raise PolicyError(f"{path}: {error} is missing") from None
        except (PolicyError, ConfigError, ValueError, TypeError, OverflowError) as error:
            raise PolicyError(f"{path}: {error}") from None

    @classmethod
    def _of(cls, arrays: dict[str, NDArray[Any]]) -> "Policy":
        meta = dict(from_json(str(arrays["meta_json"])))
        known: dict[str, Any] = {name: kind(meta.pop(name)) for name, kind in _PLAIN.items()}
        config = changed(PolicyConfig(), dict(meta.pop("config")), "policy configuration")
        del meta["observation_size"], meta["action_size"]  # the weights have them

        def array(name: str) -> Weights:
            return np.asarray(arrays[name], np.float32)

        layers = range(sum(name.startswith("weight") for name in arrays))
        weights, biases = (tuple(array(f"{kind}{i}") for i in layers) for kind in ("weight", "bias"))
        return cls(weights, biases, array("mean"), array("deviation"), config=config, about=meta, **known)

    def _meta(self) -> dict[str, Any]:
        known = {name: getattr(self, name) for name in _PLAIN}
        sizes = {"observation_size": self.sizes[0], "action_size": self.sizes[-1]}
        return {**known, **sizes, "config": asdict(self.config)}


@kernel
def infer(network: Any, observations: NDArray[np.float32], actions: Array) -> None:
    """Actions (n, 12) for observations (n, k); each row depends only on its own observation, to the bit."""
    last = network.sizes.shape[0] - 2
    for i in range(observations.shape[0]):
        source, target, at = network.work[0], network.work[1], 0
        for k in range(network.sizes[0]):
            source[k] = (observations[i, k] - network.mean[k]) / network.deviation[k]
        for layer in range(last + 1):
            inputs, outputs = network.sizes[layer], network.sizes[layer + 1]
            bias = at + inputs * outputs
            for j in range(outputs):
                target[j] = network.parameters[bias + j]
            for k in range(inputs):
                row = network.parameters[at + k * outputs : at + (k + 1) * outputs]
                x = source[k]
                for j in range(outputs):  # independent sums over the outputs, so that the loop vectorises
                    target[j] += x * row[j]
            if layer < last:
                _activate(network.activation, target, outputs)
            source, target = target, source
            at = bias + outputs
        for j in range(actions.shape[1]):
            actions[i, j] = source[j]


@inlined
def _activate(kind: int, values: Array, n: int) -> None:
    for j in range(n):
        x = values[j]
        if kind == 1:
            values[j] = max(x, 0.0)
        elif kind == 2:
            values[j] = x if x > 0 else np.expm1(x)
        elif kind == 3:
            values[j] = np.tanh(x)


@kernel
def plan_legs(config: Any, tables: Any, clocks: Any, observations: Any, memories: Any) -> None:
    """Runs the gait planner, for leg states and early touch-downs to compare with the model-based controller's."""
    for i in range(observations.shape[0]):
        ref = tables[min(i, tables.shape[0] - 1)][clocks[i].sample]
        for leg in range(4):
            force_z = observations[i].foot_force[leg, 2]
            plan_leg(config[0], memories[i], leg, ref.contact[leg] == 1, ref.swung[leg], force_z)


class PolicyController:
    """n robots under one policy; steps like `fastmimic.control.controller.Controller`. Not for several threads."""

    def __init__(self, policy: Policy, robot: Robot, motion: Motion, n: int, config: ControllerConfig) -> None:
        """Raises `PolicyError` if the policy is for another robot, another motion, or another control rate."""
        policy.check(robot, motion)
        if abs(policy.config.control_rate_hz - config.rate_hz) > 1e-9:
            said = f"the policy's joint targets go out at {policy.config.control_rate_hz:g} Hz"
            raise PolicyError(f"{said}, and the loop runs at {config.rate_hz:g} Hz")
        self.config = config  # the model-based controller's, for the loop's rate and the contact thresholds
        self.tables = stack_tables([motion], robot)  # (1 or n, t) of `SAMPLE`, the reference motions
        self.memory = np.zeros(n, MEMORY)  # leg states of the gait planner
        self.command = np.zeros(n, COMMAND)  # the last ones
        self._config = pack_config(config, robot)
        self._settings = pack_settings(policy.config, robot)
        self._network = policy.network()
        self._senses = make_senses(n)
        self._rotation = np.zeros((3, 3))
        self._seen = np.zeros((n, OBSERVATION_SIZE), np.float32)
        self._action = np.zeros((n, ACTION_SIZE))

    def reset(self, sample: Indices) -> None:
        """Clears the memory; leg states become those of the reference motion at `sample` (n,)."""
        begin_legs(self.memory, self.tables, sample)
        self._senses[...] = make_senses(len(self._senses))

    def step(self, observation: Records, clocks: Records) -> Records:
        """The next control step's commands, (n,), overwritten by the next call; from (n,) of `OBSERVATION`, `CLOCK`."""
        plan_legs(self._config, self.tables, clocks, observation, self.memory)
        if not 0 <= self._senses["age"][0] < self._settings["decimation"][0]:  # of all robots, which begin together
            observe(self._settings, self.tables, clocks, observation, self._senses, self._rotation, self._seen)
            infer(self._network, self._seen, self._action)
            act(self._settings, self._action, self._senses)
        command(self._settings, self._senses, self.command)
        return self.command


def policy_for(path: Path, robot: Robot, motion: Motion) -> Policy:
    """Reads a policy and checks that it is for this robot and motion; raises `PolicyError`, naming the file."""
    policy = Policy.load(path)
    with naming(path, PolicyError):
        policy.check(robot, motion)
    return policy


def controlled_by(policy: Policy) -> MakeController:
    """A factory of controllers for the closed loop."""
    return partial(PolicyController, policy)
