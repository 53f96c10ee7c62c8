"""Inverse kinematics: the solver for an arm, the two that need no library, and that of an arm with links of its own."""
