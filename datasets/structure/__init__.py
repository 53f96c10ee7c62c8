"""Geometry measured in a scene: feature matches, triangulated points, visual hull, bounds."""
