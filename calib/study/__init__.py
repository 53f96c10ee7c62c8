"""Studies on simulated sessions: benchmark, comparison of methods, which views help."""
