"""Motions as functions of time: a profile gives the joints at any moment. It has an end, or goes on until it is stopped."""
