"""Intrinsics: projection with derivatives, estimation from views of a flat target, cross-validation."""
