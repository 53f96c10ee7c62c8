"""Scenes made from scenes: subset, merge, crop, resize."""
