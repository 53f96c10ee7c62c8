"""Configurations that come with Koala: models, trajectories, rigs and scenes, a YAML file each."""
