"""The browser page of a run."""
