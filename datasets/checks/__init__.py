"""Checks of a scene: cameras, poses, and feature matches against the poses."""
