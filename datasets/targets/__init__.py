"""Calibration targets: their layout, and their pattern in print."""
