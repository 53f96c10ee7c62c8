"""Measuring what the camera's sensor does to light: flat field, black level, hot pixels, white balance, noise."""
