"""Files of an asset: glTF, OBJ, USD."""
