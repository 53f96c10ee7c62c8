"""Studies of several trainings: ablations, sweeps, tables."""
