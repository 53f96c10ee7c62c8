"""How often the second pass runs (supplement H)."""

import math


def second_pass_period(progress: float, *, first: int, last: int) -> int:
    """Steps between second passes: log-linear in progress, rounded to a power of two ("512/4")."""
    exponent = math.log2(first) + min(max(progress, 0.0), 1.0) * (math.log2(last) - math.log2(first))
    return 2 ** round(exponent)
