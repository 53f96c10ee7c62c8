"""Masks looked at in the browser, and corrected with a brush."""
