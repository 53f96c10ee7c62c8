"""One command that measures what a GPU is worth: speed and error of both presets, rendering, memory of the published step."""
