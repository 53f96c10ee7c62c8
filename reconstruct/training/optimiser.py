"""Adam, with the learning rates of tables, networks and poses."""

from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Bool, Float

from reconstruct.config import Config
from reconstruct.rendering.model import Model
from reconstruct.scene.facts import SceneFacts
from reconstruct.scene.twists import without_gauge
from reconstruct.training.schedules import late, learning_rate

ADAM = optax.scale_by_adam(b1=0.9, b2=0.99, eps=1e-15)


@dataclass(frozen=True)
class PoseRates:
    """How poses are corrected."""

    sigma: tuple[float, ...]
    """Standard deviations of a correction's six parts [scene unit, rad]."""
    rate: float
    """In these standard deviations."""
    final_rate: float
    start: float
    """Share of the training before poses move."""

    def at(self, progress: Float[Array, ""]) -> Float[Array, ""]:
        """Learning rate, in standard deviations."""
        rate = learning_rate(progress, rate=self.rate, final_rate=self.final_rate, warmup=0.0)
        return late(progress, start=self.start) * rate


@dataclass(frozen=True)
class Optimiser:
    """One step down a gradient. Takes and returns what is learned of a model (`Model.split`)."""

    rate: float
    final_rate: float
    warmup: float
    network_share: float
    """The networks' rate as a share of the tables': tables see few samples each, networks all of them."""
    poses: PoseRates

    @classmethod
    def of(cls, config: Config, facts: SceneFacts) -> "Optimiser":
        """As configured, for one scene."""
        train, poses = config.train, config.poses
        rates = PoseRates(poses.sigma(facts.normalisation.scale), poses.rate, poses.final_rate, poses.start)
        return cls(train.rate, train.final_rate, train.warmup, train.network_share, rates)

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
        rate = learning_rate(progress, rate=self.rate, final_rate=self.final_rate, warmup=self.warmup)
        update, new_moments = ADAM.update(_parameters(gradient), moments)
        rates = jax.tree.map_with_path(lambda path, _: rate * self._share(path), learned)
        new = jax.tree.map(lambda p, u, r: p - r * u, learned, update, rates)
        if learned.poses is not None:
            sigma = jnp.array(self.poses.sigma)
            step = self.poses.at(progress) * without_gauge(_parameters(update).poses, origins, sigma)
            new = eqx.tree_at(lambda m: m.poses, new, learned.poses - step * sigma)
        keep = lambda new, old: jax.tree.map(lambda a, b: jnp.where(finite, a, b), new, old)  # noqa: E731
        return keep(new, learned), keep(new_moments, moments)

    def _share(self, path: tuple[Any, ...]) -> float:
        """Factor on the learning rate of the parameter at `path`."""
        return 1.0 if any(getattr(part, "name", "") == "table" for part in path) else self.network_share


def _parameters(model: Any) -> Any:
    """A model as optax has it: any tree of arrays."""
    return model
