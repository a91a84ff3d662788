"""PPO on the batch of episodes, one iteration at a time, with bit-exact resume.

The algorithm is `rsl_rl.algorithms.PPO`, as in Isaac Lab and mjlab. rsl-rl's own runner is not used, because its
checkpoints hold neither the episodes' state nor the random generators'.
"""

import json
import tempfile
import time
import warnings
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.configuration import check, tabulated
from fastmimic.base.errors import ConfigError
from fastmimic.learning.config import ACTION_SIZE, PolicyConfig
from fastmimic.learning.episodes import EPISODE_S, Episodes
from fastmimic.learning.policy import Policy
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot
from fastmimic.simulation.conditions import Range

if find_spec("torch") is not None:  # else `check_installed` says what is missing
    import torch

_SMALL: Final = 0.01  # scale of the last layer's initial weights: the first actions hold the home pose
_ACTIVATION: Final = "elu"


def check_installed() -> None:
    """Raises `ConfigError` if a learning library is missing."""
    missing = [name for name in ("torch", "rsl_rl", "tensordict", "tensorboard", "onnx") if find_spec(name) is None]
    if missing:
        raise ConfigError(f"training needs {', '.join(missing)}; install it with: pip install 'fastmimic[rl]'")


def choose_device(name: str) -> str:
    """Resolves `auto` to cuda:0 if PyTorch can use a GPU, else cpu; raises `ConfigError` for a device it cannot use."""
    if name == "auto":
        return "cuda:0" if torch.cuda.is_available() else "cpu"
    try:
        torch.zeros(1, device=name)
    except (RuntimeError, AssertionError) as error:
        raise ConfigError(f"device '{name}' cannot be used: {str(error).splitlines()[0]}") from None
    return name


@tabulated
@dataclass(frozen=True)
class TrainingSettings:
    """Settings of PPO and its episodes: they determine the result, with robot, motion and number of steps."""

    seed: int = 0
    robots: int = 64
    horizon: int = 32
    hidden: tuple[int, ...] = (512, 256)  # widths of the hidden layers of actor and critic
    epochs: int = 10
    minibatches: int = 4
    learning_rate: float = 1e-3
    desired_kl: float = 0.04
    discount: float = 0.95
    trace: float = 0.95
    entropy: float = 0.0
    exploration: float = 0.5
    episode_s: float = EPISODE_S
    randomize: tuple[Range, ...] = ()  # of robots and grounds
    update_threads: int = 1
    policy: PolicyConfig = field(default_factory=PolicyConfig)

    def __post_init__(self) -> None:
        check(self, "training: ")
        if not self.hidden or min(self.hidden) < 1:
            raise ConfigError(f"training: hidden layers need a width, found {self.hidden}")
        if self.steps_per_iteration < self.minibatches:
            said = f"{self.steps_per_iteration} steps cannot be divided into {self.minibatches} minibatches"
            raise ConfigError(f"training: {said}")

    @property
    def steps_per_iteration(self) -> int:
        """Policy steps of all robots between two updates."""
        return self.robots * self.horizon


@dataclass(frozen=True)
class Iteration:
    """Result of an iteration."""

    reward: float  # mean over all robots and steps
    scores: tuple[float, ...]  # mean rewards of the ended episodes over their full length, 0 after a fall
    lengths: tuple[int, ...]
    falls: int  # number of episodes that ended by a fall
    losses: dict[str, float]  # of the update, by name
    deviation: float  # mean standard deviation of the actions
    learning_rate: float
    collect_s: float  # wall time of the rollouts
    update_s: float  # and of the update


class Learner:
    def __init__(
        self, robot: Robot, motion: Motion, settings: TrainingSettings, *, device: str = "cpu", threads: int = 1
    ) -> None:
        """`device` as from `choose_device`; the result does not depend on `threads`. Raises as `Episodes`."""
        check_installed()
        self.settings, self.device = settings, device
        options: dict[str, Any] = {"duration_s": settings.episode_s, "randomize": settings.randomize}
        self.episodes = Episodes(
            robot, motion, settings.robots, settings.policy, seed=settings.seed, threads=threads, **options
        )
        torch.set_num_threads(settings.update_threads)
        torch.manual_seed(settings.seed)
        self._seen = self._tensors(self.episodes.reset())
        self._algorithm = self._make(self._seen)

    def iterate(self) -> Iteration:
        """Runs the robots for the horizon, then updates the policy."""
        began = time.perf_counter()
        rewards: list[float] = []
        scores: list[float] = []
        lengths: list[int] = []
        falls = 0
        with torch.inference_mode():
            for _ in range(self.settings.horizon):
                outcome = self.episodes.step(self._algorithm.act(self._seen).cpu().numpy())
                self._seen = self._tensors(outcome.seen)
                reward, done = self._tensor(outcome.reward, np.float32), self._tensor(outcome.done, np.uint8)
                more = {"time_outs": self._tensor(outcome.ended, np.float32)}
                self._algorithm.process_env_step(self._seen, reward, done, more)
                rewards.append(float(outcome.reward.mean()))
                scores += outcome.score.tolist()
                lengths += outcome.steps.tolist()
                falls += int(outcome.fell.sum())
            self._algorithm.compute_returns(self._seen)
        collected = time.perf_counter()
        losses = self._algorithm.update()
        return Iteration(
            reward=float(np.mean(rewards)),
            scores=tuple(scores),
            lengths=tuple(lengths),
            falls=falls,
            losses={name: float(value) for name, value in losses.items()},
            deviation=float(self._algorithm.actor.output_std.detach().mean()),
            learning_rate=float(self._algorithm.learning_rate),
            collect_s=collected - began,
            update_s=time.perf_counter() - collected,
        )

    def policy(self, about: dict[str, Any] | None = None) -> Policy:
        """The present policy, without exploration; `about` adds entries to its file."""
        actor = self._algorithm.get_policy()
        layers = [layer for layer in actor.mlp if hasattr(layer, "weight")]
        normaliser = actor.obs_normalizer
        robot, motion, settings = self.episodes.robot, self.episodes.motion, self.settings
        trained = robot.name, motion.name, motion.n_samples, _ACTIVATION, settings.policy, settings.seed
        weights = tuple(np.ascontiguousarray(layer.weight.detach().cpu().numpy().T) for layer in layers)
        biases = tuple(layer.bias.detach().cpu().numpy().copy() for layer in layers)
        mean, deviation = normaliser.mean.cpu().numpy(), (normaliser.std + normaliser.eps).cpu().numpy()
        return Policy(weights, biases, mean, deviation, *trained, about or {})

    def onnx(self) -> bytes:
        """The actor as ONNX, normalisation included: `obs` (batch, observation) to `actions` (batch, 12)."""
        network = self._algorithm.get_policy().as_onnx(verbose=False).cpu().eval()
        with tempfile.TemporaryDirectory() as folder, torch.no_grad(), warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # the newer exporter needs one more library
            path = Path(folder) / "policy.onnx"
            torch.onnx.export(
                network,
                (torch.zeros(1, network.input_size),),
                path,
                input_names=["obs"],
                output_names=["actions"],
                dynamic_axes={"obs": {0: "batch"}, "actions": {0: "batch"}},
                dynamo=False,
            )
            return path.read_bytes()

    def state(self) -> dict[str, Any]:
        """The complete state apart from the arguments: tensors and plain values."""
        episodes = self.episodes.state()
        random = episodes.pop("random")
        return {
            "algorithm": self._algorithm.save(),
            "learning_rate": self._algorithm.learning_rate,
            "torch_random": torch.get_rng_state(),
            "cuda_random": torch.cuda.get_rng_state(self.device) if self.device.startswith("cuda") else None,
            "numpy_random": json.dumps(random),
            "episodes": {
                name: torch.frombuffer(bytearray(array.tobytes()), dtype=torch.uint8)
                for name, array in episodes.items()
            },
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Restores the `state` of a learner with the same arguments."""
        self._algorithm.load(state["algorithm"], None, True)
        self._algorithm.learning_rate = state["learning_rate"]
        torch.set_rng_state(state["torch_random"])
        if state["cuda_random"] is not None and self.device.startswith("cuda"):
            torch.cuda.set_rng_state(state["cuda_random"], self.device)
        like = self.episodes.state()
        found: dict[str, Any] = {
            name: tensor.numpy().view(like[name].dtype).reshape(like[name].shape)
            for name, tensor in state["episodes"].items()
        }
        self._seen = self._tensors(self.episodes.restore({**found, "random": json.loads(state["numpy_random"])}))

    def close(self) -> None:
        self.episodes.close()

    def _make(self, seen: Any) -> Any:
        from rsl_rl.algorithms import PPO
        from rsl_rl.models import MLPModel
        from rsl_rl.storage import RolloutStorage

        s = self.settings
        groups = {"actor": ["policy"], "critic": ["policy"]}
        gaussian = {"class_name": "GaussianDistribution", "init_std": s.exploration}
        actor = MLPModel(seen, groups, "actor", ACTION_SIZE, s.hidden, _ACTIVATION, True, gaussian)
        critic = MLPModel(seen, groups, "critic", 1, s.hidden, _ACTIVATION, True)
        with torch.no_grad():
            actor.mlp[-1].weight.mul_(_SMALL)
            actor.mlp[-1].bias.zero_()
        algorithm = PPO(
            actor,
            critic,
            RolloutStorage("rl", s.robots, s.horizon, seen, [ACTION_SIZE], self.device),
            num_learning_epochs=s.epochs,
            num_mini_batches=s.minibatches,
            learning_rate=s.learning_rate,
            desired_kl=s.desired_kl,
            gamma=s.discount,
            lam=s.trace,
            entropy_coef=s.entropy,
            device=self.device,
        )
        algorithm.train_mode()
        return algorithm

    def _tensor(self, array: NDArray[Any], dtype: Any) -> Any:
        return torch.from_numpy(array.astype(dtype)).to(self.device)

    def _tensors(self, seen: NDArray[np.float32]) -> Any:
        from tensordict import TensorDict

        return TensorDict({"policy": self._tensor(seen, np.float32)}, batch_size=[len(seen)], device=self.device)
