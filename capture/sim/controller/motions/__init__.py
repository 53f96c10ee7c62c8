"""Motions as functions of time: each is a profile, which gives the joints at any moment and ends or goes on until it is stopped."""
