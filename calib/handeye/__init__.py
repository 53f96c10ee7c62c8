"""Hand-eye calibration: closed forms, joint refinement, uncertainty, outliers and user mistakes."""
