"""Recording along a trajectory, checking the recording, replaying it."""
