"""Where the object is: feature matches, triangulated points, visual hull, bounds."""
