"""A trained policy: a multilayer perceptron, its file, and its inference without a learning library.

The file is an `.npz` without pickles: `format_version`, `meta_json`, `mean` and `deviation` of the observation, and for
each layer `weight0` (inputs, outputs) and `bias0`, `weight1`, …, all float32. `meta_json` holds `robot`, `motion`,
`samples` (of the motion), `observation_size`, `action_size`, `activation`, `config` (see `PolicyConfig`), `seed`,
`library`, `versions`, `training`, and the motion's `source` and `licence`.
"""

import hashlib
import json
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.arrays import Array
from fastmimic.base.errors import ConfigError, PolicyError
from fastmimic.base.files import read_arrays, replace_file
from fastmimic.base.jit import inlined, kernel
from fastmimic.learning.config import ACTION_SIZE, OBSERVATION_SIZE, PolicyConfig
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot

Weights = NDArray[np.float32]

FORMAT_VERSION: Final = 1
ACTIVATIONS: Final = ("none", "relu", "elu", "tanh")
POLICY_FILE: Final = "policy.npz"


class Network(NamedTuple):
    """A policy in the kernels' format.

    Attributes:
        sizes: (layers + 1,) widths, the observation's first.
        parameters: all weights (inputs, outputs) and biases in sequence.
        activation: index into `ACTIVATIONS`, of all layers but the last.
        mean, deviation: (observation,) of the normalisation.
        work: (2, width) scratch.
    """

    sizes: NDArray[np.int64]
    parameters: Array
    activation: int
    mean: Array
    deviation: Array
    work: Array


@dataclass(frozen=True, eq=False)
class Policy:
    """A trained policy; `fastmimic.learning.observation` defines observation and action.

    Attributes:
        weights, biases: of each layer, (inputs, outputs) and (outputs,).
        mean, deviation: (observation,) of the normalisation.
        robot, motion: names of the training's robot and motion.
        samples: of that motion.
        activation: one of `ACTIVATIONS`.
        about: further entries of its file: `library`, `versions`, `training` (`steps`, `wall_s`, …).
    """

    weights: tuple[Weights, ...]
    biases: tuple[Weights, ...]
    mean: Weights
    deviation: Weights
    robot: str
    motion: str
    samples: int
    activation: str = "elu"
    config: PolicyConfig = field(default_factory=PolicyConfig)
    seed: int = 0
    about: dict[str, Any] = field(default_factory=dict)

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
            raise PolicyError(
                f"takes observations of {sizes[0]} numbers and gives {sizes[-1]}; this release's have"
                f" {OBSERVATION_SIZE} and {ACTION_SIZE}"
            )
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
        found = hashlib.sha256(json.dumps(self._meta(), sort_keys=True).encode())
        for array in (*self.weights, *self.biases, self.mean, self.deviation):
            found.update(np.ascontiguousarray(array, np.float32).tobytes())
        return found.hexdigest()[:16]

    def network(self) -> Network:
        """The policy for the kernels, with its own work memory."""
        parts = [a.astype(np.float64).ravel() for pair in zip(self.weights, self.biases, strict=True) for a in pair]
        return Network(
            np.array(self.sizes, np.int64),
            np.concatenate(parts),
            ACTIVATIONS.index(self.activation),
            self.mean.astype(np.float64),
            self.deviation.astype(np.float64),
            np.zeros((2, max(self.sizes))),
        )

    def act(self, observations: NDArray[Any]) -> Array:
        """Actions (n, 12) for observations (n, `OBSERVATION_SIZE`); raises `PolicyError` for another size."""
        seen = np.atleast_2d(np.asarray(observations, np.float32))
        if seen.shape[-1] != self.sizes[0]:
            raise PolicyError(f"observations of {seen.shape[-1]} numbers for a policy that takes {self.sizes[0]}")
        actions = np.zeros((len(seen), ACTION_SIZE))
        infer(self.network(), seen, actions)
        return actions

    def check(self, robot: Robot, motion: Motion) -> None:
        """Raises `PolicyError` if the policy was trained for another robot or another motion."""
        if self.robot != robot.name:
            raise PolicyError(f"the policy is for robot '{self.robot}', not for '{robot.name}'; train one for it")
        if self.motion != motion.name:
            raise PolicyError(
                f"the policy imitates '{self.motion}', not '{motion.name}'; a policy can do the motion that it was"
                " trained on only"
            )
        if self.samples != motion.n_samples:
            raise PolicyError(
                f"the policy imitates a '{self.motion}' of {self.samples} samples, and this one has"
                f" {motion.n_samples}: it was retargeted otherwise"
            )

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
            if int(arrays["format_version"]) != FORMAT_VERSION:
                raise PolicyError(
                    f"format version {arrays['format_version']}; this release reads version {FORMAT_VERSION}"
                )
            return cls._of(arrays)
        except KeyError as error:
            raise PolicyError(f"{path}: {error} is missing") from None
        except (PolicyError, ConfigError, ValueError, TypeError) as error:
            raise PolicyError(f"{path}: {error}") from None

    @classmethod
    def _of(cls, arrays: dict[str, NDArray[Any]]) -> "Policy":
        meta = dict(json.loads(str(arrays["meta_json"])))
        layers = range(sum(name.startswith("weight") for name in arrays))
        robot, motion, activation = (str(meta.pop(name)) for name in ("robot", "motion", "activation"))
        config = PolicyConfig.from_dict(dict(meta.pop("config")))
        samples, seed = (int(meta.pop(name)) for name in ("samples", "seed"))
        del meta["observation_size"], meta["action_size"]  # the weights have them
        return cls(
            weights=tuple(np.asarray(arrays[f"weight{i}"], np.float32) for i in layers),
            biases=tuple(np.asarray(arrays[f"bias{i}"], np.float32) for i in layers),
            mean=np.asarray(arrays["mean"], np.float32),
            deviation=np.asarray(arrays["deviation"], np.float32),
            robot=robot,
            motion=motion,
            samples=samples,
            activation=activation,
            config=config,
            seed=seed,
            about=meta,
        )

    def _meta(self) -> dict[str, Any]:
        return {
            "robot": self.robot,
            "motion": self.motion,
            "samples": self.samples,
            "observation_size": self.sizes[0],
            "action_size": self.sizes[-1],
            "activation": self.activation,
            "config": self.config.as_dict(),
            "seed": self.seed,
        }


@kernel
def infer(network: Any, observations: NDArray[np.float32], actions: Array) -> None:
    """Actions (n, 12) for observations (n, k); each row depends only on its own observation, to the bit."""
    for i in range(observations.shape[0]):
        infer_robot(network, observations[i], actions[i])


@kernel
def infer_robot(network: Any, observation: NDArray[np.float32], action: Array) -> None:
    """`infer` of one robot."""
    source, target = network.work[0], network.work[1]
    for k in range(network.sizes[0]):
        source[k] = (observation[k] - network.mean[k]) / network.deviation[k]
    at, last = 0, network.sizes.shape[0] - 2
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
    for j in range(action.shape[0]):
        action[j] = source[j]


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
