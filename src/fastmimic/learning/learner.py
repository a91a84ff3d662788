"""PPO on the batch of episodes: one iteration at a time, resumable to the bit.

The algorithm is rsl-rl's (`rsl_rl.algorithms.PPO`), the one of the field's trainers (Isaac Lab, mjlab), stepped here
instead of by its runner, whose checkpoints hold neither the episodes' state nor the random generators'.
"""

import tempfile
import time
import warnings
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fastmimic.base.errors import ConfigError
from fastmimic.learning.config import ACTION_SIZE
from fastmimic.learning.episodes import Episodes
from fastmimic.learning.policy import Policy
from fastmimic.learning.settings import TrainingSettings
from fastmimic.motion.motion import Motion
from fastmimic.robot import Robot

_SMALL: Final = 0.01
"""Of the last layer's first weights: the first actions are those of the home pose."""
_ACTIVATION: Final = "elu"


def check_installed() -> None:
    """Raises `ConfigError` where the learning libraries are missing."""
    missing = [name for name in ("torch", "rsl_rl", "tensordict", "tensorboard", "onnx") if find_spec(name) is None]
    if missing:
        raise ConfigError(f"training needs {', '.join(missing)}; install it with: pip install 'fastmimic[rl]'")


def choose_device(name: str) -> str:
    """`auto` as cuda:0 where there is a GPU that PyTorch can use, else cpu; anything else as it is.

    Raises:
        ConfigError: PyTorch cannot use that device.
    """
    import torch

    if name == "auto":
        return "cuda:0" if torch.cuda.is_available() else "cpu"
    try:
        torch.zeros(1, device=name)
    except (RuntimeError, AssertionError) as error:
        raise ConfigError(f"device '{name}' cannot be used: {str(error).splitlines()[0]}") from None
    return name


@dataclass(frozen=True)
class Iteration:
    """What an iteration led to.

    Attributes:
        reward: mean over all robots and steps.
        scores: mean rewards of the episodes that ended, over their whole length, steps after a fall counting 0.
        lengths: their policy steps.
        falls: how many of them ended by a fall.
        losses: of the update, by name.
        deviation: mean standard deviation of the actions.
        learning_rate: after the update.
        collect_s, update_s: wall time of both halves.
    """

    reward: float
    scores: tuple[float, ...]
    lengths: tuple[int, ...]
    falls: int
    losses: dict[str, float]
    deviation: float
    learning_rate: float
    collect_s: float
    update_s: float


class Learner:
    """A policy under training, and the robots that it learns from."""

    def __init__(
        self, robot: Robot, motion: Motion, settings: TrainingSettings, *, device: str = "cpu", threads: int = 1
    ) -> None:
        """
        Args:
            robot: the robot.
            motion: what it is to imitate.
            settings: how it learns.
            device: of PyTorch, as `choose_device` gives it.
            threads: to divide the robots among; the result does not depend on it.

        Raises:
            ConfigError: a missing library, or as `Episodes`.
        """
        check_installed()
        import torch

        self.settings, self.device = settings, device
        self.episodes = Episodes(
            robot,
            motion,
            settings.robots,
            settings.policy,
            seed=settings.seed,
            threads=threads,
            duration_s=settings.episode_s,
            randomize=settings.randomize,
        )
        torch.set_num_threads(settings.update_threads)
        torch.manual_seed(settings.seed)
        seen = self.episodes.reset()
        self._seen = self._tensors(seen)
        self._algorithm = self._make(self._seen)

    def iterate(self) -> Iteration:
        """Lets the robots run for the horizon, and learns from it."""
        import torch

        began = time.perf_counter()
        rewards: list[float] = []
        scores: list[float] = []
        lengths: list[int] = []
        falls = 0
        with torch.inference_mode():
            for _ in range(self.settings.horizon):
                actions = self._algorithm.act(self._seen)
                outcome = self.episodes.step(actions.cpu().numpy())
                self._seen = self._tensors(outcome.seen)
                self._algorithm.process_env_step(
                    self._seen,
                    self._tensor(outcome.reward, np.float32),
                    self._tensor(outcome.done, np.uint8),
                    {"time_outs": self._tensor(outcome.ended, np.float32)},
                )
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
        """The present policy, acting without exploration.

        Args:
            about: what its file is to say besides.
        """
        actor = self._algorithm.get_policy()
        weights, biases = [], []
        for layer in actor.mlp:
            if hasattr(layer, "weight"):
                weights.append(np.ascontiguousarray(layer.weight.detach().cpu().numpy().T))
                biases.append(layer.bias.detach().cpu().numpy().copy())
        normaliser = actor.obs_normalizer
        return Policy(
            tuple(weights),
            tuple(biases),
            normaliser.mean.cpu().numpy(),
            (normaliser.std + normaliser.eps).cpu().numpy(),
            self.episodes.robot.name,
            self.episodes.motion.name,
            self.episodes.motion.n_samples,
            _ACTIVATION,
            self.settings.policy,
            self.settings.seed,
            about or {},
        )

    def onnx(self) -> bytes:
        """The actor's plain network as ONNX: `obs` (batch, observation) to `actions` (batch, 12), normalisation
        included."""
        import torch

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
        """All that the future depends on besides the arguments: tensors and plain values."""
        import torch

        episodes = self.episodes.state()
        random = episodes.pop("random")
        return {
            "algorithm": self._algorithm.save(),
            "learning_rate": self._algorithm.learning_rate,
            "torch_random": torch.get_rng_state(),
            "cuda_random": torch.cuda.get_rng_state(self.device) if self.device.startswith("cuda") else None,
            "numpy_random": _plain(random),
            "episodes": {name: torch.from_numpy(_bytes(array)) for name, array in episodes.items()},
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Goes on from what `state` gave, of a learner with the same arguments."""
        import torch

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
        self._seen = self._tensors(self.episodes.restore({**found, "random": _unplain(state["numpy_random"])}))

    def close(self) -> None:
        """Stops the threads."""
        self.episodes.close()

    def _make(self, seen: Any) -> Any:
        import torch
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
        import torch

        return torch.from_numpy(array.astype(dtype)).to(self.device)

    def _tensors(self, seen: NDArray[np.float32]) -> Any:
        from tensordict import TensorDict

        return TensorDict({"policy": self._tensor(seen, np.float32)}, batch_size=[len(seen)], device=self.device)


def _bytes(array: NDArray[Any]) -> NDArray[np.uint8]:
    return np.frombuffer(np.ascontiguousarray(array).tobytes(), np.uint8).copy()


def _plain(value: Any) -> Any:
    """A generator's state with its numbers as text: they are longer than a tensor's."""
    if isinstance(value, dict):
        return {name: _plain(v) for name, v in value.items()}
    return value if isinstance(value, str) else f"{int(value)}"


def _unplain(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _unplain(v) for name, v in value.items()}
    return int(value) if value.lstrip("-").isdigit() else value
