"""Calibration sessions that choose their own views: candidates, the loop, the rig with its adviser, and rehearsals of it."""
