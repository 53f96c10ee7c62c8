"""When in a training what begins and ends: everything that follows its progress, in one place.

Progress is the share of the training that is done, in [0, 1]. Stages of a default training (`schedule.*` of a model's file moves
those with a key):

    0 to 2 %        the learning rate rises (`warmup`), then it falls log-linearly to the end
    2 to 20 %       a shape that begins as the masks' hull is let go
    0 to 80 %       the blur of samples shrinks (`blur_until`), and with it the finest levels come in
    from 4 %        among surroundings the grid rules out cells (`grid_from`)
    8 to 18 %       among surroundings what is solid is kept dense behind its surface
    10 to 20 %      corrections of poses begin to move
    from 20 %       light lost in front of a surface counts
    20 to 50 %      among surroundings ever more of the object's surfaces are where half the largest weight is (`share_from`)
    40 to 50 %      among surroundings the Lambertian bias of the object comes in (`bias_from`)
    40 to 80 %      the density follows predicted normals ever more strongly
    throughout      second passes become more frequent, log-linearly (`surface.first_period`, `last_period`)
"""

import math
from dataclasses import dataclass

import jax.numpy as jnp
from jaxtyping import Array, Float

from koala3d.reconstruct.config import Config

RISE = 0.1
"""Share of the training over which a late loss comes to its weight."""
FOG_FROM = 0.2
"""Fog counts from here on: at the start there is nothing else."""
FREED = (0.02, 0.2)
"""The network moves the shape ever more freely between these: sooner the light is not known, later gaps stay filled."""
SETTLING = 0.3
"""First surfaces change from the one rule to the other over this share of the training: all at once spoils what is learned."""
GAIN = 4.0
"""What raw densities are multiplied by from then on: with 1, gaps stay filled."""
HOLLOWNESS_FROM = 0.08
"""The hollowness comes in from here on: early fog must not be made solid."""
POSES_FROM = 0.1
"""Poses move from here on; their rate rises over `RISE`."""
FOLLOWING = (0.4, 0.8)
"""The density follows predicted normals ever more strongly between these: the reflection shows late that they are right."""
POSE_RATE, LAST_POSE_RATE = 2.0, 0.1
"""Learning rates of poses at the start and at the end, in their standard deviations, of that of tables after the warm-up."""

Progress = Float[Array, ""]


@dataclass(frozen=True)
class Schedule:
    """What follows the progress of a training of one configuration."""

    config: Config

    def rate(self, progress: Progress) -> Float[Array, ""]:
        """Learning rate of tables."""
        train = self.config.train
        return learning_rate(progress, rate=train.rate, final_rate=train.final_rate, warmup=self.config.schedule.warmup)

    def pose_rate(self, progress: Progress) -> Float[Array, ""]:
        """Learning rate of poses, in their standard deviations."""
        first, last = (share * self.config.train.rate for share in (POSE_RATE, LAST_POSE_RATE))
        return late(progress, start=POSES_FROM) * learning_rate(progress, rate=first, final_rate=last, warmup=0.0)

    def blur(self, progress: Progress) -> Float[Array, ""]:
        """Standard deviation that every sample has at least [scene unit]."""
        train = self.config.train
        return encoding_blur(progress, first=train.first_blur, last=train.last_blur, until=self.config.schedule.blur_until)

    def gain(self, progress: Progress) -> Float[Array, ""]:
        """Factor on the raw density, if the shape begins as the masks' hull."""
        return between(progress, first=0.0, last=GAIN, over=FREED)

    def hollowness(self, progress: Progress) -> Float[Array, ""]:
        """Weight of the hollowness."""
        return self.config.losses.hollowness * late(progress, start=HOLLOWNESS_FROM)

    def fog(self, progress: Progress) -> Float[Array, ""]:
        """Weight of the fog."""
        return self.config.losses.fog * (progress >= FOG_FROM)

    def density_normals(self, progress: Progress) -> Float[Array, ""]:
        """Weight with which the density's normals follow the predicted ones."""
        losses = self.config.losses
        last = losses.density_normals if losses.last_density_normals is None else losses.last_density_normals
        return between(progress, first=losses.density_normals, last=last, over=FOLLOWING)

    def bias(self, progress: Progress) -> Float[Array, ""]:
        """Factor on the Lambertian bias of the object, in [0, 1]."""
        return late(progress, start=self.config.schedule.bias_from)

    def by_share(self, progress: Progress) -> Float[Array, ""]:
        """Share of the object's first surfaces that are found by the share of the largest weight, and no longer by the median."""
        begin = self.config.schedule.share_from
        return between(progress, first=0.0, last=1.0, over=(begin, begin + SETTLING))

    def rules_out_cells(self, progress: float) -> bool:
        """Whether the occupancy grid may rule out cells."""
        return progress >= self.config.schedule.grid_from

    def second_pass_period(self, progress: float) -> int:
        """Steps between second passes: log-linear in progress, rounded to a power of two ("512/4", supplement H)."""
        first, last = self.config.surface.first_period, self.config.surface.last_period
        exponent = math.log2(first) + min(max(progress, 0.0), 1.0) * (math.log2(last) - math.log2(first))
        return 2 ** round(exponent)


def learning_rate(progress: Float[Array, ""], *, rate: float, final_rate: float, warmup: float) -> Float[Array, ""]:
    """Log-linear from `rate` to `final_rate`, rising log-linearly from 1e-8 of it over the share `warmup`."""
    decayed = jnp.exp(jnp.log(rate) + progress * (jnp.log(final_rate) - jnp.log(rate)))
    rise = jnp.clip(progress / warmup, 0, 1) if warmup > 0 else jnp.ones(())
    return decayed * jnp.exp((1 - rise) * jnp.log(1e-8))


def late(progress: Float[Array, ""], *, start: float) -> Float[Array, ""]:
    """Factor on a loss that begins at `start`: zero before, then linear to one over the share `RISE`; one throughout from 0."""
    return jnp.clip((progress - start) / RISE, 0, 1) if start > 0 else jnp.ones(())


def between(progress: Float[Array, ""], *, first: float, last: float, over: tuple[float, float]) -> Float[Array, ""]:
    """A weight that goes linearly from `first` to `last` between two shares of the training."""
    return first + (last - first) * jnp.clip((progress - over[0]) / (over[1] - over[0]), 0, 1)


def encoding_blur(progress: Float[Array, ""], *, first: float, last: float, until: float) -> Float[Array, ""]:
    """Width of the encoding's blur: log-linear from `first` to `last` over the share `until` of the training; 0 is no blur."""
    if first == 0 or last == 0:
        return jnp.zeros(())
    share = jnp.clip(progress / until, 0, 1)
    return jnp.exp(jnp.log(first) + share * (jnp.log(last) - jnp.log(first)))
