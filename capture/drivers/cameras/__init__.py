"""Cameras: one module per maker."""
