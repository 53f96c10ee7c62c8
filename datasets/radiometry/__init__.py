"""From what a sensor reads to light: black level, flat field, white balance, noise, and exposures merged into one picture."""
