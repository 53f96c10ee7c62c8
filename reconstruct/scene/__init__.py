"""From a scene's views to rays: normalisation, pixels, camera poses and their corrections."""
