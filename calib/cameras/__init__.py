"""Several cameras on one arm, calibrated together."""
