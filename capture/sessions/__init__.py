"""Sessions in which the views follow from what was seen: calibration, chosen views, the live picture."""
