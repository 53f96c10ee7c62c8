"""Where images and masks are in a foreign folder, and what a folder that is almost a scene lacks."""
