"""Shapes compared with each other and with drawings, and how certain the shape of a trained model is."""
