"""Many objects: from recordings to figures, meshes and assets by the commands that a person would type, into one page."""
