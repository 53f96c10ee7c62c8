"""The simulated laboratory: objects, materials, light, lens, and the renderer."""
