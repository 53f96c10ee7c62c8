"""Adam, with the learning rates of tables, networks and poses, and the weight decay of what encodings learn."""

from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Bool, Float

from koala3d.reconstruct.config import Config
from koala3d.reconstruct.kernels import adam
from koala3d.reconstruct.rendering.model import Model
from koala3d.reconstruct.scene.facts import SceneFacts
from koala3d.reconstruct.scene.twists import without_gauge
from koala3d.reconstruct.training.schedule import Schedule

DECAYS, SMALLEST = (0.9, 0.99), 1e-15
"""Of Adam: what its mean and its mean square keep of the steps before, and what is added to the root of the latter."""
ADAM = optax.scale_by_adam(b1=DECAYS[0], b2=DECAYS[1], eps=SMALLEST)


def descent(gradient: Any, moments: Any, finite: Bool[Array, ""]) -> tuple[Any, Any]:
    """Direction and moments of `ADAM`; the moments stay to the bit where the gradient is not `finite`.

    What is not finite is replaced before it meets a moment, and the rates of the moments by one: each array is then read once
    and written in place. A choice between old and new arrays would need both to be kept.
    """
    b1, b2 = (jnp.where(finite, decay, 1.0) for decay in DECAYS)
    gradient = jax.tree.map(lambda g: jnp.where(finite, g, 0.0), gradient)
    mu = jax.tree.map(lambda m, g: b1 * m + (1 - b1) * g, moments.mu, gradient)
    nu = jax.tree.map(lambda m, g: b2 * m + (1 - b2) * (g * g), moments.nu, gradient)
    count = moments.count + finite.astype(moments.count.dtype)
    age = jnp.maximum(count, 1)
    unbias, unbias_square = (1 - decay**age for decay in DECAYS)
    update = jax.tree.map(lambda m, v: (m / unbias) / (jnp.sqrt(v / unbias_square) + SMALLEST), mu, nu)
    return update, moments._replace(count=count, mu=mu, nu=nu)


@dataclass(frozen=True)
class Optimiser:
    """One step down a gradient. Takes and returns what is learned of a model (`Model.split`)."""

    schedule: Schedule
    decay: float
    """Weight of the mean square of the encodings' features, summed over levels: a loss whose value nothing needs."""
    network_share: float
    """Learning rate of networks, of that of tables."""
    pose_sigma: tuple[float, ...]
    """Standard deviations of a pose's correction [scene unit, rad]."""

    @classmethod
    def of(cls, config: Config, facts: SceneFacts) -> "Optimiser":
        """As configured, for one scene."""
        sigma = config.poses.sigma(facts.normalisation.scale)
        return cls(Schedule(config), config.losses.decay, config.train.network_share, sigma)

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
        state, rate = _parameters(moments), self.schedule.rate(progress)
        tables = jax.tree.map_with_path(lambda path, p: _is_table(path) and adam.takes(p), learned)
        trees = [eqx.partition(tree, tables) for tree in (gradient, learned, state.mu, state.nu, self._shrinks(learned))]
        others = self._others([rest for _, rest in trees], state.count, rate, progress, finite, origins)
        new = _with_tables([table for table, _ in trees], others, state.count, rate, finite)
        return new[0], optax.ScaleByAdamState(jnp.where(finite, optax.safe_increment(state.count), state.count), *new[1:])

    def _others(
        self,
        trees: list[Model],
        count: Array,
        rate: Float[Array, ""],
        progress: Float[Array, ""],
        finite: Bool[Array, ""],
        origins: Float[Array, "views 3"],
    ) -> list[Model]:
        """Parameters, means and squares of what no compiled kernel takes; `trees` as in `descended`."""
        gradient, learned, means, squares, shrinks = trees
        gradient = jax.tree.map(lambda g, p, s: g + s * p if s else g, gradient, learned, shrinks)
        moments = optax.ScaleByAdamState(count, _parameters(means), _parameters(squares))
        update, moments = descent(_parameters(gradient), moments, finite)
        rates = jax.tree.map_with_path(lambda path, _: jnp.where(finite, rate * self._share(path), 0.0), learned)
        new = jax.tree.map(lambda p, u, r: p - r * u, learned, update, rates)
        if learned.session is not None:
            by, step = learned.session.by, self.schedule.pose_rate(progress) * _parameters(update).session.by
            new = eqx.tree_at(lambda m: m.session.by, new, jnp.where(finite, by - step, by))
        if learned.poses is not None:
            sigma = jnp.array(self.pose_sigma)
            step = self.schedule.pose_rate(progress) * without_gauge(
                _parameters(update).poses, origins[: len(learned.poses)], sigma
            )
            new = eqx.tree_at(lambda m: m.poses, new, jnp.where(finite, learned.poses - step * sigma, learned.poses))
        return [new, _parameters(moments).mu, _parameters(moments).nu]

    def _shrinks(self, learned: Model) -> Model:
        """What times each parameter its weight decay adds to its gradient."""
        encodings = (learned.field.encoding, *learned.sampler.encodings)
        by_leaf = {id(leaf): self.decay * encoding.decay for encoding in encodings for leaf in jax.tree.leaves(encoding)}
        return jax.tree.map(lambda leaf: by_leaf.get(id(leaf), 0.0), learned)

    def _share(self, path: tuple[Any, ...]) -> float:
        """Factor on the learning rate of the parameter at `path`."""
        return 1.0 if _is_table(path) else self.network_share


def _with_tables(
    tables: list[Model], others: list[Model], count: Array, rate: Float[Array, ""], finite: Bool[Array, ""]
) -> list[Model]:
    """Parameters, means and squares of everything: those of tables, each read and written once, with those of the others."""
    count = optax.safe_increment(count)
    new: list[list[Array]] = [[], [], []]
    for table in zip(*map(jax.tree.leaves, tables), strict=True):
        *arrays, shrinks = table
        options = {"decays": DECAYS, "smallest": SMALLEST, "shrinks": shrinks, "count": count, "rate": rate, "finite": finite}
        found = adam.descended(*arrays, **options)
        for one, array in zip(new, found, strict=True):
            one.append(array)
    structure = jax.tree.structure(tables[0])
    return [eqx.combine(jax.tree.unflatten(structure, one), rest) for one, rest in zip(new, others, strict=True)]


def _is_table(path: tuple[Any, ...]) -> bool:
    return any(getattr(part, "name", "") == "table" for part in path)


def _parameters(model: Any) -> Any:
    """A model as optax has it: any tree of arrays."""
    return model
