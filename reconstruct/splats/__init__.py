"""Splats of a trained run: flat Gaussians on its surface, with a colour for each direction."""
