"""Simple bodies in space: distances of line segments from them, and those that a rig file lists."""
