"""What a training step costs: kernels, instructions, the machine's limits."""
