"""Alignment of a view's pose to a trained model: the field is frozen and the camera moves until the rendering fits the image.

Applied to test views, it separates errors of their poses from errors of the model. The twist x of the pose (see `twists`)
minimises

    sum_i w_i |r_i(x)|^2 / (2 s^2) + |x / sigma|^2 / 2

by the method of Levenberg and Marquardt: r the colour errors at some pixels of the view, w robust weights (Huber 1964), s the
robust spread of the first errors, sigma the accuracy of the poses as calibrated.
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import NDArray

from koala3d.datasets.scene import View
from koala3d.reconstruct.numerics.compiling import compiled
from koala3d.reconstruct.output.trained_model import TrainedModel
from koala3d.reconstruct.rendering.exposure import exposed, fitted
from koala3d.reconstruct.rendering.model import Model, render
from koala3d.reconstruct.rendering.pictures import on_device, taken
from koala3d.reconstruct.sampling.samples import cloud_of
from koala3d.reconstruct.scene.poses import corrected
from koala3d.reconstruct.scene.rays import Rays, over, read_scaled
from koala3d.reconstruct.scene.space import Space
from koala3d.reconstruct.scene.twists import moved

PIXELS = 2048  # maximum number of pixels used for the alignment; at most half of the view's
STEPS = 30  # maximum number of steps, accepted or not
SETTLED = 1e-3  # the alignment ends with a step shorter than this [standard deviation of the pose]
HUBER = 2.0  # errors beyond this many standard deviations count linearly


@dataclass(frozen=True)
class Aligned:
    """A view with an aligned pose."""

    view: View  # the view with the new pose
    pixels: int  # number of pixels used for the alignment
    steps: int


@dataclass
class Aligner:
    """Aligns views to one trained model. Compiles once."""

    trained: TrainedModel

    def __post_init__(self) -> None:
        space, behind = self.trained.run.normalisation.space, jnp.asarray(self.trained.renderer.behind)
        self._linearised = compiled(lambda model, rays, twist: _linearised(model, rays, twist, behind, space))

    def __call__(self, view: View) -> Aligned:
        """Align a view to its image."""
        trained, camera = self.trained, self.trained.camera(view)
        picture = read_scaled(view, trained.run.config.scale, trained.run.copies).reshape(camera.height * camera.width, -1)
        colour = np.clip(over(picture), 0, 1)  # metrics clip in the same way
        chosen = np.random.default_rng(0).permutation(len(colour))[: min(PIXELS, len(colour) // 2)]
        lists, target = taken(trained.renderer.rays_of(view, camera), chosen), colour[chosen]
        if (gains := trained.model.per_image) is not None:
            shown, behind = trained.renderer.rays(trained.model, *lists), trained.renderer.behind[0]
            log_gain = fitted(shown["rgb"], shown["opacity"], target, behind, gains.shape[1])
            target = exposed(target, shown["opacity"], behind, -log_gain)  # as the model's exposure would have it
        rays = replace(on_device(lists), view=jnp.zeros(len(chosen), jnp.int32))
        twist, steps = self._solved(rays, target)
        pose = corrected(view.world_from_camera, twist, trained.run.normalisation.scale)
        return Aligned(replace(view, world_from_camera=pose), len(chosen), steps)

    def _solved(self, rays: Rays, target: NDArray[np.float32]) -> tuple[NDArray[np.float64], int]:
        """The twist, and the number of steps."""
        sigma = np.array(self.trained.run.config.poses.sigma(self.trained.run.normalisation.scale))
        twist, damping = np.zeros(6), 1e-3
        error, slopes = self._errors(rays, target, twist * sigma, sigma)
        sensitive = np.abs(error[np.any(slopes != 0, -1)])
        spread = max(1.4826 * float(np.median(sensitive)), 1e-3) if len(sensitive) else 1.0
        cost = _cost(error, twist, spread)
        steps = 0
        while steps < STEPS:
            steps += 1
            weight = np.minimum(1, HUBER * spread / np.maximum(np.abs(error), 1e-12)) / spread**2
            normal = np.einsum("ni,n,nj->ij", slopes, weight, slopes) + np.eye(6)
            toward = np.einsum("ni,n->i", slopes, weight * error) + twist
            change = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), -toward)
            tried = self._errors(rays, target, (twist + change) * sigma, sigma)
            if (lower := _cost(tried[0], twist + change, spread)) < cost:
                twist, (error, slopes), cost, damping = twist + change, tried, lower, damping / 5
            else:
                damping = damping * 10
            if np.abs(change).max() < SETTLED:
                break
        return twist * sigma, steps

    def _errors(self, rays: Rays, target: NDArray[np.float32], twist: NDArray[np.float64], sigma: NDArray[np.float64]):
        """(n,) colour errors and (n, 6) their slopes per standard deviation of the pose; zeros for dropped rays."""
        rgb, slopes, used = (np.asarray(v) for v in self._linearised(self.trained.model, rays, jnp.asarray(twist, jnp.float32)))
        error = (rgb - target) * used[:, None]
        return error.reshape(-1).astype(np.float64), (slopes * used[:, None, None]).reshape(-1, 6) * sigma


def _cost(error: NDArray[np.float64], twist: NDArray[np.float64], spread: float) -> float:
    """Huber loss of the errors plus the cost of the twist."""
    size = np.abs(error) / spread
    return float(np.sum(np.where(size < HUBER, size**2 / 2, HUBER * (size - HUBER / 2))) + np.sum(twist**2) / 2)


def _linearised(
    model: Model, rays: Rays, twist: Float[Array, " 6"], behind: Float[Array, " 3"], space: Space
) -> tuple[Float[Array, "n 3"], Float[Array, "n 3 6"], Array]:
    """Colours of rays after a twist, their derivative with respect to a further twist, and which rays were not dropped.

    A ray's colour depends on no other ray: one backward pass per colour gives its slopes along every ray at once.
    """
    rays = moved(rays, twist[None])
    found = model.sampler.unjittered(rays)

    def colours(origins: Float[Array, "n 3"], directions: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
        shifted = Rays(origins, directions, rays.radii, light=rays.light)
        cloud = cloud_of(shifted, found.samples, space=space, footprint=found.footprint)
        rendered, _ = render(model.field, shifted, found.samples, replace(cloud, followed=True))
        return jnp.clip(rendered.over(behind[None]), 0, 1)

    rgb, pull = jax.vjp(colours, rays.origins, rays.directions)
    per_colour = [pull(jnp.zeros_like(rgb).at[:, channel].set(1.0)) for channel in range(3)]
    slopes = [jnp.concatenate([shift, jnp.cross(rays.directions, turn)], -1) for shift, turn in per_colour]
    return rgb, jnp.stack(slopes, 1), found.fits
