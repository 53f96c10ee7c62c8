"""Editing of scenes: subset, split, merge, downscale, undistort, crop."""
