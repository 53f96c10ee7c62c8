"""Errors of reconstruction."""

from koala3d.datasets.core.errors import KoalaError


class ReconstructError(KoalaError):
    """Training or evaluation cannot continue."""
