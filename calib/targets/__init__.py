"""Calibration targets: detection, corners to a few thousandths of a pixel, screening, printing."""
