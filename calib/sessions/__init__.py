"""Target sessions: the corners and arm poses of all views, from recordings or from folders that other programs wrote."""
