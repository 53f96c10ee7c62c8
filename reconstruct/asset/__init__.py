"""A trained model as an asset for other programs: a textured mesh, and the light it was seen in."""
