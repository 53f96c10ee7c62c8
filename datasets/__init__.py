"""The base package: everything on disk, and the vocabulary for it.

Poses, cameras, recordings, calibrations and scenes, with every file format that Koala reads or writes. No JAX, no hardware and
no rendering. `capture`, `calib` and `reconstruct` build on this package and never import one another.
"""
