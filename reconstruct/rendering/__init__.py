"""Volume rendering: weights and compositing, the model, whole pictures."""
