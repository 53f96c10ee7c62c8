"""Intrinsics from views of a flat target: projection with derivatives, estimation, cross-validation."""
