"""Kernels as compiled loops: what Numba makes machine code of. Nothing here is imported where Numba is missing."""
