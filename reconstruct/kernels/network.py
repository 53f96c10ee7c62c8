"""Small fully connected networks through compiled kernels: values, the first output's derivative to the input, and gradients.

A kernel takes points in blocks that stay in the first-level cache, through all layers at once. Hidden values are found anew on
the way back: that takes less time than to write and to read them.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import jax
from jaxtyping import Array, Float

from koala3d.reconstruct.kernels import native

ROWS, LANES = 4, 16
"""Matrices are padded to a multiple of so many rows and columns."""
CHUNK = 512
"""Points of a chunk, which has its own sum of the weights' gradient."""
WORTH_IT = 256
"""Points below which starting a kernel takes longer than its work."""

Layers = tuple[tuple[Float[Array, "outputs inputs"], Float[Array, " outputs"]], ...]


def takes(layers: Sequence[tuple[Array, Array]], inputs: Any) -> bool:
    """Whether the kernels are for these arrays."""
    return inputs.shape[1] >= WORTH_IT and native.usable(inputs, *(array for layer in layers for array in layer))


def padded(count: int, multiple: int) -> int:
    """The least multiple that holds so many."""
    return (count + multiple - 1) // multiple * multiple


def room(widths: Sequence[int]) -> int:
    """Numbers of a chunk's sums, of weights and biases. `widths`: channels of the inputs, and outputs of each layer."""
    return sum(padded(into + 1, ROWS) * padded(out, LANES) for into, out in pairwise(widths))


@jax.custom_vjp
def evaluate(layers: Layers, inputs: Float[Array, "channels n"]) -> Float[Array, "outputs n"]:
    """Outputs for n columns; ReLU between the layers. Differentiable once."""
    return _call_evaluate(layers, inputs, [layers[-1][1].shape[0]])[0]


@jax.custom_vjp
def evaluate_with_sensitivity(
    layers: Layers, inputs: Float[Array, "channels n"]
) -> tuple[Float[Array, "outputs n"], Float[Array, "channels n"]]:
    """Outputs, and the derivative of the first of them to the inputs, for one hidden layer. Differentiable once."""
    value, sensitivity = _call_evaluate(layers, inputs, [layers[-1][1].shape[0], inputs.shape[0]])
    return value, sensitivity


def _call_evaluate(layers: Layers, inputs: Array, results: list[int]) -> tuple[Array, ...]:
    count = inputs.shape[1]
    return native.call("evaluate", [native.float32(size, count) for size in results], inputs, *_flat(layers))


def _flat(layers: Layers) -> list[Array]:
    return [array for layer in layers for array in layer]


def _call_back(layers: Layers, inputs: Array, *cotangents: Array) -> tuple[Layers, Array]:
    """Gradients of layers and inputs."""
    flat, count = _flat(layers), inputs.shape[1]
    widths = [inputs.shape[0], *(bias.shape[0] for _, bias in layers)]
    shapes = [native.float32(*array.shape) for array in (inputs, *flat)]
    shapes.append(native.float32(max(1, -(-count // CHUNK)), room(widths)))
    gradient, *others, _ = native.call("evaluate_back", shapes, inputs, *flat, *cotangents)
    return tuple(zip(others[::2], others[1::2], strict=True)), gradient


evaluate.defvjp(
    lambda layers, inputs: (evaluate(layers, inputs), (layers, inputs)),
    lambda saved, cotangent: _call_back(*saved, cotangent),
)
evaluate_with_sensitivity.defvjp(
    lambda layers, inputs: (evaluate_with_sensitivity(layers, inputs), (layers, inputs)),
    lambda saved, cotangents: _call_back(*saved, *cotangents),
)
