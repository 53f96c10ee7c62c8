"""Parts of a training step as compiled loops for the CPU, each behind the same function as its twin in plain JAX."""
