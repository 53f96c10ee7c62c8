"""Where along a ray to look: an occupancy grid with packed samples, or proposal levels."""
