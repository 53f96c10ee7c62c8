"""Inverse kinematics: the solver for an arm, and the two that need no library."""
