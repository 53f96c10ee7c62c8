"""What a person sees of a calibration: the page in the browser, the HTML report, figures and words."""
