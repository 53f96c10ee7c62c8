"""Points, poses and bodies around an arm, and how far apart they are."""
