"""Turntables: what a rig file says of one, and its drivers."""
