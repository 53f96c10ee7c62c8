"""Why a picture has no pose: the first of the steps at which it stayed behind."""

from collections.abc import Mapping, Sequence

from koala3d.datasets.process.poses.database import FEWEST_MATCHES, Picture

FEWEST_FEATURES = 100
"""A picture with fewer features shows too little that can be found again."""


def of(picture: Picture, links: Mapping[tuple[int, int], int], groups: Sequence[Sequence[str]]) -> str:
    """The reason, for a person.

    Args:
        picture: one that is not in the first of `groups`.
        links: matches between pairs of pictures, as of `database.links`.
        groups: files of the pictures of each group.
    """
    count = len(picture.features.pixels)
    matched = [matches for pair, matches in links.items() if picture.number in pair]
    if count < FEWEST_FEATURES:
        return f"too few features ({count}): it is blurred, dark or without texture"
    if not matched:
        return f"too few matches: fewer than {FEWEST_MATCHES} with every other picture"
    for group in groups[1:]:
        if picture.file in group:
            return f"in a group of {len(group)} pictures that does not connect to the others"
    return f"did not fit: up to {max(matched)} matches with {len(matched)} pictures, but no pose explains enough of them"
