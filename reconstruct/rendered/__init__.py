"""Rendered benchmark scenes with exact shape, depth and separation of the light."""
