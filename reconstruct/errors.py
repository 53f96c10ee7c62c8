"""Errors of reconstruction."""

from datasets.core.errors import KoalaError


class ReconstructError(KoalaError):
    """Training or evaluation cannot continue."""
