"""From features to the poses of the pictures, in a frame and unit of their own, through pycolmap."""
