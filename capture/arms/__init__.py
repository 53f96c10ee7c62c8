"""Arms by file: their chain, limits and shape, inverse kinematics, and what they carry."""
