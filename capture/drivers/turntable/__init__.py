"""Turntables: the driver of Grbl controllers."""
