"""Nonlinear least squares in which each view has six unknowns of its own beside the global ones."""
