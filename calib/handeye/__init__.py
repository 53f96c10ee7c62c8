"""Hand-eye calibration: closed forms, joint refinement, uncertainty, outliers, verification."""
