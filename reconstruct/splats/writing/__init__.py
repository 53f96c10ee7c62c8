"""Files of splats: PLY, SPZ, glTF, USD."""
