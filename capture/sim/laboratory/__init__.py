"""The simulated laboratory: scenes, materials, lens and sensor, renderer."""
