"""Surface of a trained model: extraction, refinement, files, and distance from the true surface."""
