"""Calibration targets: their geometry, detection of their corners, printing."""
