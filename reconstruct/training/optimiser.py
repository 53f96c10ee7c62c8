"""Adam, with the learning rates of tables, networks and poses."""

from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Bool, Float

from reconstruct.config import Config, PoseConfig, TrainConfig
from reconstruct.rendering.model import Model
from reconstruct.scene.facts import SceneFacts
from reconstruct.scene.twists import without_gauge
from reconstruct.training.schedules import late, learning_rate

ADAM = optax.scale_by_adam(b1=0.9, b2=0.99, eps=1e-15)


@dataclass(frozen=True)
class Optimiser:
    """One step down a gradient. Takes and returns what is learned of a model (`Model.split`)."""

    train: TrainConfig
    poses: PoseConfig
    pose_sigma: tuple[float, ...]
    """Standard deviations of a pose's correction [scene unit, rad]."""

    @classmethod
    def of(cls, config: Config, facts: SceneFacts) -> "Optimiser":
        """As configured, for one scene."""
        return cls(config.train, config.poses, config.poses.sigma(facts.normalisation.scale))

    def begin(self, learned: Model) -> optax.OptState:
        """Moments before the first step."""
        return ADAM.init(_parameters(learned))

    def descended(
        self,
        learned: Model,
        gradient: Model,
        moments: optax.OptState,
        progress: Float[Array, ""],
        finite: Bool[Array, ""],
        origins: Float[Array, "views 3"],
    ) -> tuple[Model, optax.OptState]:
        """Parameters and moments after a step; the same as before where the gradient is not `finite`.

        Args:
            origins: the cameras' positions.
        """
        train = self.train
        rate = learning_rate(progress, rate=train.rate, final_rate=train.final_rate, warmup=train.warmup)
        update, new_moments = ADAM.update(_parameters(gradient), moments)
        rates = jax.tree.map_with_path(lambda path, _: rate * self._share(path), learned)
        new = jax.tree.map(lambda p, u, r: p - r * u, learned, update, rates)
        if learned.poses is not None:
            sigma = jnp.array(self.pose_sigma)
            step = self._pose_rate(progress) * without_gauge(_parameters(update).poses, origins, sigma)
            new = eqx.tree_at(lambda m: m.poses, new, learned.poses - step * sigma)
        keep = lambda new, old: jax.tree.map(lambda a, b: jnp.where(finite, a, b), new, old)  # noqa: E731
        return keep(new, learned), keep(new_moments, moments)

    def _share(self, path: tuple[Any, ...]) -> float:
        """Factor on the learning rate of the parameter at `path`."""
        return 1.0 if any(getattr(part, "name", "") == "table" for part in path) else self.train.network_share

    def _pose_rate(self, progress: Float[Array, ""]) -> Float[Array, ""]:
        """Learning rate of poses, in the standard deviations of their corrections."""
        rate = learning_rate(progress, rate=self.poses.rate, final_rate=self.poses.final_rate, warmup=0.0)
        return late(progress, start=self.poses.start) * rate


def _parameters(model: Any) -> Any:
    """A model as optax has it: any tree of arrays."""
    return model
