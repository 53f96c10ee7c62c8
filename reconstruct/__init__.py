"""Train Surf-NeRF on a scene, measure it, and take geometry and appearance out of it."""
