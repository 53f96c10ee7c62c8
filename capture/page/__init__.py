"""What a person sees of a capture: the page in the browser and the HTML report."""
