"""Least squares with six unknowns per view beside the global ones."""
