"""Calibrations in the files of other programs."""
