"""A trained model as an asset for other programs: textured mesh, light, bodies for robot simulators."""
