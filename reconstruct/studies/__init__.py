"""Many trainings side by side: ablations, sweeps, tables, the cost of each skip."""
