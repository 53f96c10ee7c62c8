"""Numerics that know nothing of a scene: safe elementary functions, step functions."""
