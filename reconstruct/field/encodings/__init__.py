"""Encodings of position (lattice) and of direction (integrated directional encoding)."""
