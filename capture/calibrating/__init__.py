"""Calibration sessions that choose their own views: candidates, the loop, the recording that grows, and rehearsals of it."""
