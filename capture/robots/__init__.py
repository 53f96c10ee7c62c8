"""Arms, each behind the `Robot` protocol of `capture.rig.protocols`."""
