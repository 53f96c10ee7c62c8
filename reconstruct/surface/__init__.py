"""Surf-NeRF's own part: first surface, sphere samples, regularisers."""
