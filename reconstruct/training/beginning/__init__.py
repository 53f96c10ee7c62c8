"""How a training begins: with fresh weights, with those of another run, or from its own newest checkpoint."""
