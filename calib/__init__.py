"""Intrinsics and hand-eye pose from a recording of a target, with their uncertainty."""
