"""Colours as functions of the direction: real spherical harmonics, as files of splats have them.

Order and signs are those of 3D Gaussian Splatting (Kerbl et al. 2023) and of glTF's KHR_gaussian_splatting: by degree, then by
order from -l to l, with the Condon-Shortley phase. A direction leads from the camera to the splat. The colour is sRGB:
0.5 plus the sum.
"""

import numpy as np
from jaxtyping import Float

DEGREE = 3
"""Highest that the formats have in common."""
BIAS = 0.5
"""Of a splat whose coefficients are all zero."""
FIRST = 0.28209479177387814
"""The first function, which is the same in all directions."""


def basis(directions: Float[np.ndarray, "*n 3"], degree: int = DEGREE) -> Float[np.ndarray, "*n functions"]:
    """The (degree + 1)^2 functions at unit directions."""
    x, y, z = np.moveaxis(np.asarray(directions), -1, 0)
    xx, yy, zz = x * x, y * y, z * z
    values = [
        FIRST + 0 * x,
        -0.4886025119029199 * y,
        0.4886025119029199 * z,
        -0.4886025119029199 * x,
        1.0925484305920792 * x * y,
        -1.0925484305920792 * y * z,
        0.31539156525252005 * (2 * zz - xx - yy),
        -1.0925484305920792 * x * z,
        0.5462742152960396 * (xx - yy),
        -0.5900435899266435 * y * (3 * xx - yy),
        2.890611442640554 * x * y * z,
        -0.4570457994644658 * y * (4 * zz - xx - yy),
        0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy),
        -0.4570457994644658 * x * (4 * zz - xx - yy),
        1.445305721320277 * z * (xx - yy),
        -0.5900435899266435 * x * (xx - 3 * yy),
    ]
    return np.stack(values[: (degree + 1) ** 2], -1)


def degrees(degree: int = DEGREE) -> np.ndarray:
    """(functions,) degree of each function."""
    return np.repeat(np.arange(degree + 1), 2 * np.arange(degree + 1) + 1)


def sums(
    directions: Float[np.ndarray, "n m 3"], colours: Float[np.ndarray, "n m 3"], weights: Float[np.ndarray, "n m"]
) -> tuple[Float[np.ndarray, "n functions functions"], Float[np.ndarray, "n functions 3"]]:
    """The two sides of the normal equations of n splats, of m weighted sRGB colours along unit directions each."""
    functions = basis(directions).astype(np.float32)
    weighted = (functions * weights[..., None]).swapaxes(1, 2)
    return weighted @ functions, weighted @ (colours - np.float32(BIAS))


def solved(
    left: Float[np.ndarray, "n functions functions"], right: Float[np.ndarray, "n functions 3"], *, stiffness: float
) -> Float[np.ndarray, "n functions 3"]:
    """Coefficients with the least squared error and a price on what bends.

    The price is the mean square of the Laplacian over the sphere, (l (l + 1))^2 times the square of a coefficient (the functions
    are orthonormal). Directions without weight get a continuation that bends little.

    Args:
        left: of `sums`, as `right`; both may be added over splats.
        stiffness: the price per unit of weight.
    """
    level = degrees() * (degrees() + 1)
    total = np.maximum(left[:, 0, 0] / FIRST**2, 1e-6)
    matrix = left.astype(np.float64)
    matrix[:, np.arange(len(level)), np.arange(len(level))] += total[:, None] * (stiffness * level**2 + 1e-9)
    return np.linalg.solve(matrix, right.astype(np.float64)).astype(np.float32)


def even(coefficients: Float[np.ndarray, "n functions 3"]) -> Float[np.ndarray, "n 3"]:
    """sRGB of n splats in the mean of all directions, for programs that show one colour."""
    return np.clip(coefficients[:, 0] * FIRST + BIAS, 0, 1)


def colour(coefficients: Float[np.ndarray, "n functions 3"], directions: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """sRGB of n splats, each seen along its own direction, as viewers show it."""
    return np.clip(np.einsum("nf,nfc->nc", basis(directions), coefficients) + BIAS, 0, 1)
