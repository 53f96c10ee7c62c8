"""Reports as one HTML file: the page that all reports share, and the report of a scene."""
