"""The radiance field: encodings, contraction, networks, appearance."""
