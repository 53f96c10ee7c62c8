"""Where the masks of a scene's images are: their folder, and the mask that is named after each image."""

import re
from collections.abc import Sequence
from pathlib import Path

from koala3d.datasets.core import files
from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.formats.finding.pictures import HOMES, Listing

KINDS = ("mask", "alpha", "matte", "silhouette", "segmentation", "foreground")
"""What folders of masks are called, also in the plural, after `images_` or `object_`, and with a number as of smaller images."""
_FOLDER = re.compile(rf"(?:(?:images?|rgb|obj|object)_)?({'|'.join(KINDS)})s?(?:_(\d+))?", re.IGNORECASE)


def find(folder: Path, home: Path, names: Sequence[str]) -> tuple[list[Path | None], str]:
    """Mask of each image in `home`, and a note on how they were found, which is empty where it goes without saying.

    Folders of masks are sought beside `home` and in `folder`, that of the images' size first. A mask is `X.png` or
    `X.JPG.png` for the image `X.JPG`, with any suffix; if no mask is named after an image and there are as many masks as
    images, they correspond by sorted names. The masks may be beside the images, too (`X_mask.png`).

    Raises:
        DatasetError: there is a folder called masks or the like, and none of its files is named after an image.
    """
    listing = Listing()
    offered = [path for path in _folders(folder, home) if path != home and (listing.files(path) or _nested(path, names))]
    chosen: list[Path | None] = [None] * len(names)
    for place in offered:
        found = [listing.named_after(place, name) or listing.named_after(place, _without_home(name)) for name in names]
        if sum(mask is not None for mask in found) > sum(mask is not None for mask in chosen):
            chosen = found
    if any(chosen):
        return chosen, ""
    for place in offered:
        if len(found := listing.files(place)) == len(names):
            order = sorted(range(len(names)), key=lambda number: names[number])
            alike = all(_digits(names[index]) == _digits(mask.name) for index, mask in zip(order, found, strict=True))
            note = f"masks in {place.relative_to(folder)} have names of their own: they are taken in the order of names"
            placed = dict(zip(order, found, strict=True))
            return [placed[index] for index in range(len(names))], "" if alike else note
    offered = [path for path in offered if "mask" in path.name.lower()]  # others may hold something else
    if offered and names:
        found = listing.files(offered[0])
        why = f"it holds {len(found)} such as {found[0].name}" if found else "its folders hold none for them"
        name = Path(names[0])
        remedy = f"name the mask of {name.name} {name.stem}.png or {name.name}.png, or rename the folder to do without masks"
        raise DatasetError("no mask is named after an image", where=offered[0], why=f"{len(names)} images; {why}", remedy=remedy)
    return _beside(listing, home, names), ""


def _folders(folder: Path, home: Path) -> list[Path]:
    """Folders of masks: of the images' size, of full size, of another size; the most usual name first."""
    size = number[0] if (number := re.findall(r"_(\d+)$", home.name)) else None
    found = []
    for root in dict.fromkeys((folder if home == folder else files.within(folder, home.parent), folder)):
        for path in sorted(root.iterdir()) if root.is_dir() else ():
            if (match := _FOLDER.fullmatch(path.name)) and path.is_dir():
                rank = 0 if match[2] == size else int(match[2] or 1)
                found.append((rank, KINDS.index(match[1].lower()), path))
    return [path for _, _, path in sorted(found, key=lambda entry: entry[:2])]


def _nested(place: Path, names: Sequence[str]) -> bool:
    return any((place / parent).is_dir() for parent in {Path(name).parent for name in names} if parent != Path())


def _without_home(name: str) -> str:
    """A name less the folder of images with which it may begin."""
    first, _, rest = name.partition("/")
    return rest if rest and first.lower() in HOMES else name


def _digits(name: str) -> int | None:
    """The last number in a name."""
    found = re.findall(r"\d+", Path(name).stem)
    return int(found[-1][-9:]) if found else None


def _beside(listing: Listing, home: Path, names: Sequence[str]) -> list[Path | None]:
    """Masks in the folder of the images, for all of them; files of other names are none of our business."""
    found = [listing.named_after(home, f"{Path(name).with_suffix('')}_mask") for name in names]
    return found if all(found) else [None] * len(names)
