"""Studies of several trainings: ablations, sweeps, tables, the cost of each skip."""
