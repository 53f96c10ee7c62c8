"""The ground floor: what lies on disk, and the words for it.

Poses, cameras, recordings, calibrations and scenes, with every file format that Koala reads or writes.
No JAX, no hardware and no rendering here; `capture`, `calib` and `reconstruct` stand on this package
side by side and never import one another.
"""
