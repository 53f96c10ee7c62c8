"""Photographs as viewers show them: copies of those whose stored pixels are turned, as phones held upright store them."""

from dataclasses import replace
from pathlib import Path

from koala3d.datasets.core import console
from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.imaging import orientation
from koala3d.datasets.imaging.downscale import streamed
from koala3d.datasets.process.pictures.photographs import Photograph, Photographs


def copies(found: Photographs, folder: Path) -> tuple[Photographs, tuple[str, ...]]:
    """The photographs, all of them upright, and notes on what was done. Copies that are in `folder` already are used.

    A picture that is damaged moves to the damaged ones.
    """
    turned = [photograph for photograph in found.photographs if not photograph.is_upright]
    if not turned:
        return found, ()
    folder.mkdir(exist_ok=True)

    def made(photograph: Photograph) -> bool | DatasetError:
        target = folder / photograph.path.name
        try:
            return target.is_file() or orientation.write_upright(photograph.path, target)
        except DatasetError as error:
            return error

    with console.progress("upright", len(turned), "pictures") as shown:
        results = {}
        for photograph, result in zip(turned, streamed(made, turned), strict=True):
            results[photograph.name] = result
            shown.advance()
    errors = {p.path.name: f"{e.what}: {e.why}" for p in turned if isinstance(e := results[p.name], DatasetError)}
    kept = (p if p.is_upright else replace(p, path=folder / p.path.name) for p in found.photographs if p.path.name not in errors)
    note = f"{len(turned) - len(errors)} pictures are turned upright, as their EXIF orientation says"
    again = sum(result is False for result in results.values())
    note += f"; {again} JPEGs are compressed again, since their sizes are no multiples of a block" if again else ""
    return replace(found, photographs=tuple(kept), damaged={**found.damaged, **errors}), (note,)
