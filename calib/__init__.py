"""Calibration: intrinsics, hand-eye pose and board pose from a recording of a target, each with its uncertainty.

The unknowns are `flange_from_camera` (X in AX = XB) and `base_from_board`; poses of a view are `base_from_flange`
(the arm's word) and `camera_from_board` (the picture's). Float64 numpy throughout; nothing under RECORDING/truth is read.
"""
