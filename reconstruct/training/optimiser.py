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

B1, B2, EPS = 0.9, 0.99, 1e-15
ADAM = optax.scale_by_adam(b1=B1, b2=B2, eps=EPS)


def adam(gradient: Any, moments: Any, finite: Bool[Array, ""]) -> tuple[Any, Any]:
    """Direction and moments of `ADAM`; the moments stay to the bit where the gradient is not `finite`.

    What is not finite is replaced before it meets a moment, and the rates of the moments by one: each array is then read once
    and written in place. A choice between old and new arrays would need both to be kept.
    """
    b1, b2 = (jnp.where(finite, decay, 1.0) for decay in (B1, B2))
    gradient = jax.tree.map(lambda g: jnp.where(finite, g, 0.0), gradient)
    mu = jax.tree.map(lambda m, g: b1 * m + (1 - b1) * g, moments.mu, gradient)
    nu = jax.tree.map(lambda m, g: b2 * m + (1 - b2) * (g * g), moments.nu, gradient)
    count = moments.count + finite.astype(moments.count.dtype)
    age = jnp.maximum(count, 1)
    unbias, unbias_square = 1 - B1**age, 1 - B2**age
    update = jax.tree.map(lambda m, v: (m / unbias) / (jnp.sqrt(v / unbias_square) + EPS), mu, nu)
    return update, moments._replace(count=count, mu=mu, nu=nu)


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
        update, moments = adam(_parameters(gradient), moments, finite)
        rates = jax.tree.map_with_path(lambda path, _: jnp.where(finite, rate * self._share(path), 0.0), learned)
        new = jax.tree.map(lambda p, u, r: p - r * u, learned, update, rates)
        if learned.poses is not None:
            sigma = jnp.array(self.pose_sigma)
            step = self._pose_rate(progress) * without_gauge(_parameters(update).poses, origins, sigma)
            new = eqx.tree_at(lambda m: m.poses, new, jnp.where(finite, learned.poses - step * sigma, learned.poses))
        return new, moments

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
