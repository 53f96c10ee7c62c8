"""Training: objective, step, loop, checkpoints, faults, logs, several devices."""
