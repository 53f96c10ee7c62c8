"""Measurements that pages quote and users do not need: `python -m tests.bench.NAME --help`, in the root of the repository."""
