"""From that frame to the world: metres, z up, the origin below the object."""
