"""Several cameras or several targets on one arm, calibrated together."""
