"""A small fully connected network with channels first: the layout in which the encodings deliver."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from koala3d.reconstruct.kernels import network


class Mlp(eqx.Module):
    """Layers of `width` with ReLU between them; the input joins again before layer `skip`, where that is not zero."""

    weights: tuple[Float[Array, "_ _"], ...]
    """Of (outputs, inputs) per layer."""
    biases: tuple[Float[Array, " _"], ...]
    skip: int = eqx.field(static=True)

    @classmethod
    def create(cls, key: PRNGKeyArray, *, channels: int, width: int, depth: int, outputs: int, skip: int = 0):
        """`depth` hidden layers of `width`, He-uniform weights, zero biases."""
        sizes = [channels] + [width] * depth + [outputs]
        weights = []
        for layer, layer_key in enumerate(jax.random.split(key, depth + 1)):
            into = sizes[layer] + (channels if skip and layer == skip else 0)
            bound = (6 / into) ** 0.5 if layer < depth else (3 / into) ** 0.5
            weights.append(jax.random.uniform(layer_key, (sizes[layer + 1], into), minval=-bound, maxval=bound))
        return cls(tuple(weights), tuple(jnp.zeros(size) for size in sizes[1:]), skip)

    def __call__(self, inputs: Float[Array, "channels n"]) -> Float[Array, "outputs n"]:
        """Evaluate for n columns."""
        if self._in_kernels(inputs):
            return network.evaluate(self._layers, inputs)
        return self.in_jax(inputs)

    def with_sensitivity(
        self, inputs: Float[Array, "channels n"]
    ) -> tuple[Float[Array, "outputs n"], Float[Array, "channels n"]]:
        """Outputs, and the derivative of the first of them to the inputs."""
        if self._in_kernels(inputs) and len(self.weights) == 2:
            return network.evaluate_with_sensitivity(self._layers, inputs)
        outputs, pull = jax.vjp(self.in_jax, inputs)
        return outputs, pull(jnp.zeros_like(outputs).at[0].set(1.0))[0]

    def only(self, outputs: int) -> "Mlp":
        """The network of the first `outputs` outputs."""
        last = (self.weights[-1][:outputs], self.biases[-1][:outputs])
        return replace(self, weights=(*self.weights[:-1], last[0]), biases=(*self.biases[:-1], last[1]))

    @property
    def _layers(self) -> network.Layers:
        return tuple(zip(self.weights, self.biases, strict=True))

    def _in_kernels(self, inputs: Float[Array, "channels n"]) -> bool:
        return not self.skip and network.takes(self._layers, inputs)

    def in_jax(self, inputs: Float[Array, "channels n"]) -> Float[Array, "outputs n"]:
        """Evaluate without compiled kernels."""
        hidden = inputs
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            if self.skip and layer == self.skip:
                hidden = jnp.concatenate([hidden, inputs])
            hidden = weight @ hidden + bias[:, None]
            if layer < len(self.weights) - 1:
                hidden = jax.nn.relu(hidden)
        return hidden
