"""The page of a calibration in the browser, its HTML report, figures and summary."""
