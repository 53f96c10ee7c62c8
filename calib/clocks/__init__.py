"""Clocks of pictures and poses: how late one is beside the other."""
