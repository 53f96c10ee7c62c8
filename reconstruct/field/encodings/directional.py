"""Encodings of directions: of views, and the integrated one of reflections (Ref-NeRF, Verbin et al. 2022, equation 8).

Real and imaginary parts of spherical harmonics Y_l^m for l = 1, 2, 4, ..., m = 0..l, each attenuated by
exp(-l (l + 1) roughness / 2), the expectation under a von Mises-Fisher lobe of that roughness.

Legendre functions by the upward recurrence in l at fixed m, whose terms stay of order one (fully normalised
form, Holmes and Featherstone 2002, equation 11), instead of sums of powers of z, which cancel in float32.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float


def ide_channels(degree: int) -> int:
    """Number of outputs of `integrated_directional_encoding` for l up to 2^(degree - 1)."""
    return 2 * sum(2**i + 1 for i in range(degree))


def integrated_directional_encoding(
    directions: Float[Array, "3 n"], roughness: Float[Array, " n"], degree: int
) -> Float[Array, "channels n"]:
    """Encode unit directions blurred by roughness (the inverse concentration of the lobe, >= 0)."""
    x, y, z = directions
    wanted = [2**i for i in range(degree)]
    top = wanted[-1]
    real, imaginary = [jnp.ones_like(x)], [jnp.zeros_like(x)]  # (x + iy)^m
    for _ in range(top):
        real, imaginary = [*real, real[-1] * x - imaginary[-1] * y], [*imaginary, real[-1] * y + imaginary[-1] * x]
    outputs = []
    legendre = _legendre_over_sine(z, wanted)
    for degree_l in wanted:
        attenuation = jnp.exp(-0.5 * degree_l * (degree_l + 1) * roughness)
        for m in range(degree_l + 1):
            radial = legendre[degree_l, m] * attenuation
            outputs += [radial * real[m], radial * imaginary[m]]
    return jnp.stack(outputs)


def _legendre_over_sine(z: Float[Array, " n"], wanted: list[int]) -> dict[tuple[int, int], Float[Array, " n"]]:
    """P(l, m)(z) / sin^m with the normalisation of Y_l^m: polynomials in z, finite at the poles."""
    top, result = max(wanted), {}
    diagonal = np.sqrt(1 / (4 * np.pi))
    for m in range(top + 1):
        if m:
            diagonal *= -np.sqrt((2 * m + 1) / (2 * m))  # Condon-Shortley phase
        before, here = jnp.zeros_like(z), jnp.full_like(z, diagonal)
        for degree_l in range(m, top + 1):
            if degree_l > m:
                a = np.sqrt((4 * degree_l**2 - 1) / (degree_l**2 - m**2))
                b = np.sqrt(((degree_l - 1) ** 2 - m**2) / (4 * (degree_l - 1) ** 2 - 1)) if degree_l > m + 1 else 0.0
                before, here = here, a * (z * here - b * before)
            if degree_l in wanted:
                result[degree_l, m] = here
    return result


def view_channels(degree: int) -> int:
    """Number of outputs of `view_encoding`."""
    return 3 + 6 * degree


def view_encoding(directions: Float[Array, "3 n"], degree: int) -> Float[Array, "channels n"]:
    """Unit directions, then sin(2^i d) and cos(2^i d) for i = 0..degree - 1 (NeRF, equation 4, and the direction)."""
    angles = [directions * 2.0**i for i in range(degree)]
    return jnp.concatenate([directions, *(jnp.sin(angle) for angle in angles), *(jnp.cos(angle) for angle in angles)])
