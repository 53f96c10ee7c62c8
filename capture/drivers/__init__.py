"""Drivers of robots, cameras and turntables; the protocols, values, limits and errors that they share."""
