"""Errors of reconstruction."""

from datasets.errors import KoalaError


class ReconstructError(KoalaError):
    """Training or evaluation cannot go on."""
