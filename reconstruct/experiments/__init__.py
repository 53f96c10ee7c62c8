"""Many trainings: scenes x models x settings x seeds, run here or on a cluster, their results, tables and comparisons."""
