"""Calibration: intrinsics, hand-eye pose and board pose from a recording of a target, each with its uncertainty.

The unknowns are `flange_from_camera` (X in AX = XB) and `base_from_board`. The poses of a view are `base_from_flange`,
reported by the arm, and `camera_from_board`, seen in the picture. All code is float64 numpy. Nothing under RECORDING/truth is
read.
"""
