"""Numbers of the hashed permutohedral lattice, for its reference in JAX and its compiled kernels alike."""

import numpy as np

LIFT = np.array([[1, 1, 1], [-1, 1, 1], [0, -2, 1], [0, 0, -3]]) / np.sqrt([2.0, 6.0, 12.0]) / 4
"""(4, 3): e = LIFT @ (x, y, z), a quarter of an isometry (Adams 2010, figure 3)."""
PRIMES = (2531011, 3674653429, 2097192037)
"""Factors of the three coordinates in the hash."""
MIXER = np.uint32(2654435769)
"""Factor of the hash's mixing step."""
