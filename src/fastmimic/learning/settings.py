"""Settings of a training: they determine its result, with robot, motion and number of steps."""

import dataclasses
import math
from dataclasses import dataclass, field
from typing import Any

from fastmimic.base.errors import ConfigError
from fastmimic.learning.config import PolicyConfig
from fastmimic.learning.episodes import EPISODE_S
from fastmimic.simulation.ranges import Range


@dataclass(frozen=True)
class TrainingSettings:
    """Settings of PPO and its episodes.

    Attributes:
        seed: of weights, actions and episodes.
        robots: simulated at once.
        horizon: policy steps of each robot between two updates.
        hidden: widths of the hidden layers of actor and critic.
        learning_rate: initial value; it then adapts to `desired_kl`.
        desired_kl: target change of the policy per update.
        discount, trace: γ and λ.
        entropy: weight of the entropy bonus.
        exploration: initial standard deviation of the actions, in units of `PolicyConfig.action_scale`.
        randomize: ranges for robots and grounds.
        update_threads: of the linear algebra; the bits of the result depend on it.
    """

    seed: int = 0
    robots: int = 64
    horizon: int = 32
    hidden: tuple[int, ...] = (512, 256)
    epochs: int = 10
    minibatches: int = 4
    learning_rate: float = 1e-3
    desired_kl: float = 0.04
    discount: float = 0.95
    trace: float = 0.95
    entropy: float = 0.0
    exploration: float = 0.5
    episode_s: float = EPISODE_S
    randomize: tuple[Range, ...] = ()
    update_threads: int = 1
    policy: PolicyConfig = field(default_factory=PolicyConfig)

    def __post_init__(self) -> None:
        whole = ("robots", "horizon", "epochs", "minibatches", "update_threads")
        checks = (
            *((getattr(self, name) >= 1, f"{name} must be at least 1, found {getattr(self, name)}") for name in whole),
            (self.seed >= 0, f"seed must not be negative, found {self.seed}"),
            (bool(self.hidden) and min(self.hidden) >= 1, f"hidden layers need a width, found {self.hidden}"),
            (0 < self.discount < 1 and 0 <= self.trace <= 1, "discount must be in (0, 1) and trace in [0, 1]"),
            (self.learning_rate > 0 and self.desired_kl > 0, "learning_rate and desired_kl must be positive"),
            (self.exploration > 0 and self.entropy >= 0, "exploration must be positive, entropy not negative"),
            (math.isfinite(self.episode_s) and self.episode_s > 0, f"episodes of {self.episode_s:g} s are none"),
            (
                self.robots * self.horizon >= self.minibatches,
                f"{self.robots * self.horizon} steps cannot be divided into {self.minibatches} minibatches",
            ),
        )
        for ok, message in checks:
            if not ok:
                raise ConfigError(f"training: {message}")

    @property
    def steps_per_iteration(self) -> int:
        """Policy steps of all robots between two updates."""
        return self.robots * self.horizon

    def as_dict(self) -> dict[str, Any]:
        return {**dataclasses.asdict(self), "hidden": list(self.hidden)}
