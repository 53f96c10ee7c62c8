"""Studies: benchmark, comparison of methods, good sessions, the next views to take."""
