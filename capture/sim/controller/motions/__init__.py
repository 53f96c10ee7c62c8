"""The simulated arm and its motions. A motion is a profile: the joints at any moment, to an end or until it is stopped."""
