"""Learned perceptual distance of two images (LPIPS: Zhang et al. 2018), with AlexNet, version 0.1 of its weights.

The features of AlexNet's five convolutions are normalised per pixel; the distance is the sum over layers of the mean over pixels
of a weighted squared difference (their equation 1).

The weights are not part of Koala. They come from an .npz file with the names of the published program's state, see `WEIGHTS` and
docs/numbers.md.
"""

# Our own AlexNet instead of the package `lpips`: that needs torch, which installs more than 2 GB with CUDA from PyPI, for five
# convolutions that JAX computes as well.

from dataclasses import dataclass
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from koala3d.datasets.core import arrays, files
from koala3d.datasets.core.errors import UsageError

Picture = Float[np.ndarray, "height width 3"]


@dataclass(frozen=True)
class Layer:
    """One convolution of AlexNet, and the pooling before it."""

    name: str  # name of its weights in the file
    inputs: int
    outputs: int
    size: int  # side of the square kernel [px]
    stride: int
    padding: int
    pooled: bool  # whether max pooling (3x3, stride 2) comes first


LAYERS = (
    Layer("net.slice1.0", 3, 64, 11, 4, 2, pooled=False),
    Layer("net.slice2.3", 64, 192, 5, 1, 2, pooled=True),
    Layer("net.slice3.6", 192, 384, 3, 1, 1, pooled=True),
    Layer("net.slice4.8", 384, 256, 3, 1, 1, pooled=False),
    Layer("net.slice5.10", 256, 256, 3, 1, 1, pooled=False),
)
WEIGHTS: dict[str, tuple[int, ...]] = {
    **{f"{layer.name}.weight": (layer.outputs, layer.inputs, layer.size, layer.size) for layer in LAYERS},
    **{f"{layer.name}.bias": (layer.outputs,) for layer in LAYERS},
    **{f"lin{index}.model.1.weight": (1, layer.outputs, 1, 1) for index, layer in enumerate(LAYERS)},
}
"""Names and shapes of the required arrays; others in the file are ignored."""
SHIFT, SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)
"""Normalisation of colours in -1..1 before the first layer, from the published program."""
SMALLEST = 31  # smallest image side for which every layer has a pixel
SHORTEST = 1e-10  # added to the length of features before the division


class Lpips(eqx.Module):
    """The distance for one set of weights."""

    kernels: tuple[Float[Array, "outputs inputs size size"], ...]
    biases: tuple[Float[Array, " outputs"], ...]
    shares: tuple[Float[Array, " outputs"], ...]  # weight of each channel's squared difference, per layer; at least 0
    file: str = eqx.field(static=True, default="")  # file of the weights
    sha256: str = eqx.field(static=True, default="")  # hash of that file: only values with the same hash are comparable

    @classmethod
    def load(cls, path: Path) -> "Lpips":
        """Read the weights.

        Raises:
            UsageError: the file is missing, or lacks an array of `WEIGHTS`.
            DatasetError: it is not a file of plain arrays.
        """
        found = arrays.read_npz(path, tuple(f"{name}.npy" for name in WEIGHTS))
        advice = "make it as docs/numbers.md says"
        for name, shape in WEIGHTS.items():
            if name not in found:
                problem = "does not hold the weights of LPIPS with AlexNet"
                raise UsageError(problem, where=path, why=f"no array {name}", remedy=advice)
            array = found[name]
            if array.shape != shape or array.dtype.kind != "f":
                why = f"{array.shape} of {array.dtype}, not {shape}"
                raise UsageError(f"array {name} has another shape than AlexNet's", where=path, why=why, remedy=advice)
            if not np.isfinite(array).all():
                raise UsageError(f"array {name} holds values that are not finite", where=path, remedy=advice)
        get = lambda name: jnp.asarray(found[name], jnp.float32)  # noqa: E731
        shares = tuple(get(f"lin{index}.model.1.weight").reshape(-1) for index in range(len(LAYERS)))
        if any((share < 0).any() for share in shares):
            why = "the published ones are at least 0"
            raise UsageError("weighs differences with negative numbers", where=path, why=why, remedy=advice)
        kernels, biases = (tuple(get(f"{layer.name}.{part}") for layer in LAYERS) for part in ("weight", "bias"))
        return cls(kernels, biases, shares, path.name, files.sha256(path))

    def __call__(self, rendered: Picture, truth: Picture) -> float | None:
        """Distance of two sRGB images after clipping to 0..1: 0 for equal ones; None below `SMALLEST` pixels."""
        if rendered.shape != truth.shape or rendered.shape[-1] != 3:
            raise UsageError("LPIPS compares two colour images of the same size", why=f"{rendered.shape} and {truth.shape}")
        if min(truth.shape[:2]) < SMALLEST:
            return None
        return float(_distance(self, *(jnp.asarray(np.clip(picture, 0, 1), jnp.float32) for picture in (rendered, truth))))


@eqx.filter_jit
def _distance(weights: Lpips, first: Float[Array, "height width 3"], second: Float[Array, "height width 3"]) -> Float[Array, ""]:
    """Sum over layers. The images are processed one by one, so that equal images have exactly equal features."""
    features = jax.lax.map(lambda picture: _features(weights, picture), jnp.stack([first, second]))
    total = jnp.zeros(())
    for (one, other), share in zip(features, weights.shares, strict=True):
        total += jnp.mean(jnp.sum(share[:, None, None] * (one - other) ** 2, 0))
    return total


def _features(weights: Lpips, picture: Float[Array, "height width 3"]) -> list[Float[Array, "channels _ _"]]:
    """Features of each layer, normalised per pixel."""
    channels = jnp.moveaxis(2 * picture - 1, -1, 0)
    features, found = (channels - jnp.asarray(SHIFT)[:, None, None]) / jnp.asarray(SCALE)[:, None, None], []
    for layer, kernel, bias in zip(LAYERS, weights.kernels, weights.biases, strict=True):
        features = _convolved(_pooled(features) if layer.pooled else features, kernel, bias, layer)
        found.append(features / (jnp.sqrt(jnp.sum(features**2, 0)) + SHORTEST))
    return found


def _convolved(features: Float[Array, "inputs h w"], kernel: Array, bias: Array, layer: Layer) -> Float[Array, "outputs _ _"]:
    """Convolution (without flipping the kernel) and ReLU, in full float32 on any device."""
    around = [(layer.padding, layer.padding)] * 2
    sums = jax.lax.conv_general_dilated(features[None], kernel, (layer.stride, layer.stride), around, precision="highest")[0]
    return jax.nn.relu(sums + bias[:, None, None])


def _pooled(features: Float[Array, "channels h w"]) -> Float[Array, "channels _ _"]:
    return jax.lax.reduce_window(features, -jnp.inf, jax.lax.max, (1, 3, 3), (1, 2, 2), "VALID")
