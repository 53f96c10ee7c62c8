"""The steps from pictures to a scene. What each has finished stays in the work folder until the scene is complete."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from koala3d.datasets.core import console, files
from koala3d.datasets.core.errors import DatasetError, UsageError
from koala3d.datasets.formats import colmap, koala
from koala3d.datasets.formats.links import link
from koala3d.datasets.imaging.downscale import streamed
from koala3d.datasets.imaging.reduced import READERS
from koala3d.datasets.process.pictures import features, frames, photographs, upright, videos
from koala3d.datasets.process.pictures.features import PictureFeatures
from koala3d.datasets.process.pictures.markers import Marker
from koala3d.datasets.process.pictures.photographs import Photographs
from koala3d.datasets.process.poses import database, mapping, pairs, reasons
from koala3d.datasets.process.poses.database import Picture
from koala3d.datasets.process.work import Work, state
from koala3d.datasets.process.world import alignment
from koala3d.datasets.process.world.alignment import Aligned, Wishes
from koala3d.datasets.scene import Scene, with_test_views
from koala3d.datasets.structure.reprojection import errors_px


@dataclass(frozen=True)
class Request:
    """How poses are to be found."""

    frames: int = 100
    """Most frames that are taken from a video."""
    match: str = "auto"
    """One of `pairs.KINDS`."""
    vocabulary: Path | None = None
    """File of a vocabulary tree, which chooses the pairs instead."""
    cameras: str = "auto"
    """One of `photographs.SHARING`."""


@dataclass(frozen=True, eq=False)
class Processed:
    """A finished scene, and what to tell about it."""

    aligned: Aligned
    given: int
    """Number of pictures."""
    left_out: dict[str, str]
    """Why a picture has no pose, by file name."""
    groups: tuple[int, ...]
    """Number of pictures of each group that mapping found, the largest first."""
    error_px: float
    """Median distance between the points and where pictures show them [px of the scene's pictures]."""
    resumed: bool
    """True where it continued an interrupted call."""


def process(source: Path, out: Path, request: Request, wishes: Wishes) -> Processed:
    """Write the Koala scene of a folder of photographs, or of a video, to `out`, all or nothing.

    An interrupted call leaves the folder OUT.work; the same call continues from there.

    Raises:
        UsageError: there are too few pictures, `out` holds something, or the pictures do not show what `wishes` says.
        DatasetError: the video cannot be read, or the pictures do not overlap.
    """
    database.require_library()
    files.refuse_existing(out)
    work = Work(out)
    found, resumed = _pictures(source, work, request)
    if resumed:
        console.hint(f"continuing in {work.folder}")
    found, turned = upright.copies(found, work.upright)
    pictures, damaged = _searched(found, work, request)
    _matched(pictures, work, request, in_order=videos.is_video(source))
    groups = _mapped(pictures, work, source)
    left_out = {**found.damaged, **damaged}
    links = database.links(work.database)
    left_out |= {p.photograph.path.name: reasons.of(p, links, groups) for p in pictures if p.file not in groups[0]}
    given = len(found.photographs) + len(found.damaged)
    scene, seen = _loaded(pictures, work, out.resolve().name)
    aligned = alignment.align(scene, seen, wishes)
    known: dict[str, Any] = {"format": "photographs", "source": str(source.absolute()), "left_out": left_out}
    known |= {"scale_from": aligned.scale_from, "up_from": aligned.up_from, "groups": [len(group) for group in groups]}
    scene = replace(aligned.scene, provenance=known, notes=_notes(left_out, given, groups, found.ignored) + turned)
    koala.save(scene, out)
    work.remove()
    sizes = tuple(len(group) for group in groups)
    return Processed(replace(aligned, scene=scene), given, left_out, sizes, float(np.median(errors_px(scene))), resumed)


def _pictures(source: Path, work: Work, request: Request) -> tuple[Photographs, bool]:
    """The photographs, or the frames of the video, and whether earlier work goes on."""
    choices = [request.match, request.cameras, None if request.vocabulary is None else state(request.vocabulary)]
    if not videos.is_video(source):
        found = photographs.find(source)
        files_of = [state(photograph.path) for photograph in found.photographs]
        return found, work.start([str(source.absolute()), *files_of], choices)
    resumed = work.start([str(source.absolute()), state(source), request.frames], choices)
    if not work.frames.is_dir():
        with console.progress("frames", 1, "frames") as shown:
            frames.extract(source, request.frames, work.frames, done=shown.show)
    return photographs.find(work.frames), resumed


def _searched(found: Photographs, work: Work, request: Request) -> tuple[list[Picture], dict[str, str]]:
    """The pictures with their features, and why others cannot be read, by file name."""
    work.features.mkdir(exist_ok=True)

    def features_of(index: int) -> PictureFeatures | DatasetError:
        kept = work.features / f"{index + 1:06d}.npz"
        try:
            if kept.is_file():
                return PictureFeatures.load(kept)
            new = features.detect(found.photographs[index].path)
        except DatasetError as error:
            return error
        new.save(kept)
        return new

    chosen, damaged = [], {}
    cameras = photographs.cameras(found.photographs, request.cameras)
    with console.progress("features", len(cameras), "pictures") as shown:
        results = streamed(features_of, range(len(cameras)), workers=READERS)
        for photograph, camera, result in zip(found.photographs, cameras, results, strict=True):
            if isinstance(result, DatasetError):
                damaged[photograph.path.name] = f"{result.what}: {result.why}"
            else:
                number = len(chosen) + 1
                chosen.append(Picture(number, f"{number:06d}{photograph.path.suffix}", photograph, camera, result))
            shown.advance()
    if len(chosen) < photographs.FEWEST:
        why = f"{len(damaged)} of {len(cameras)} are damaged, such as {next(iter(damaged))}"
        raise UsageError(
            "too few pictures can be read", where=found.photographs[0].path.parent, why=why, remedy="copy them again"
        )
    return chosen, damaged


def _matched(pictures: list[Picture], work: Work, request: Request, *, in_order: bool) -> None:
    """Fill the database with features and matches."""
    if not work.database.is_file():
        database.write(work.database, pictures)
    if request.vocabulary is not None:
        chosen = database.by_vocabulary(work.database, request.vocabulary)
    else:
        with console.progress("pairs", len(pictures), "pictures") as shown:
            found = [picture.features for picture in pictures]
            chosen = pairs.choose(found, request.match, in_order=in_order, done=shown.advance)
    with console.progress("matches", len(chosen), "pairs") as shown:
        database.match(work.database, pictures, chosen, done=shown.show)


def _mapped(pictures: list[Picture], work: Work, source: Path) -> mapping.Groups:
    """Groups of pictures; the model of the largest is in the work folder. Raises DatasetError where there is none."""
    groups = mapping.read_groups(work.model)
    if groups is None:
        work.images.mkdir(exist_ok=True)
        for picture in pictures:
            if not (work.images / picture.file).exists():
                link(picture.photograph.path.resolve(), work.images, picture.file)
        colours = {picture.file: picture.features.colours for picture in pictures}
        with console.progress("poses", len(pictures), "pictures") as shown:
            groups = mapping.build(work.database, work.images, work.model, colours, done=shown.advance)
    if not groups:
        links = database.links(work.database)
        why = f"{len(links)} pairs of {len(pictures)} pictures have matches, no pair enough of them at an angle"
        remedy = "take more pictures with smaller steps, of something textured that fills them; 'photographs.md' says how"
        raise DatasetError("pictures do not overlap enough for poses", where=source, why=why, remedy=remedy)
    return groups


def _loaded(pictures: list[Picture], work: Work, name: str) -> tuple[Scene, Mapping[str, tuple[Marker, ...]]]:
    """The model as a scene with the pictures' own names and every eighth view for testing; and the markers in each view."""
    scene = colmap.load(work.folder)
    names = {Path(picture.file).stem: picture.photograph.name for picture in pictures}
    views = with_test_views((replace(view, name=names[view.name]) for view in scene.views), 8)
    sightings = scene.sightings and replace(scene.sightings, names=tuple(names[n] for n in scene.sightings.names))
    seen = {picture.photograph.name: _at_full_size(picture) for picture in pictures}
    return replace(scene, name=name, views=views, sightings=sightings), seen


def _at_full_size(picture: Picture) -> tuple[Marker, ...]:
    """The markers of a picture in its own pixels."""
    ratio = np.array([picture.photograph.width / picture.features.width, picture.photograph.height / picture.features.height])
    return tuple(replace(marker, corners=marker.corners * ratio) for marker in picture.features.markers)


def _notes(left_out: Mapping[str, str], given: int, groups: mapping.Groups, ignored: tuple[str, ...]) -> tuple[str, ...]:
    """What was left out, for everyone who uses the scene."""
    notes = []
    if left_out:
        reasons_given = "; ".join(f"{name}: {why}" for name, why in left_out.items())
        notes.append(f"{len(left_out)} of {given} pictures are left out: {reasons_given}")
    if len(groups) > 1:
        sizes = ", ".join(str(len(group)) for group in groups)
        notes.append(f"mapping gave {len(groups)} models, of {sizes} pictures; the largest is the scene")
    if ignored:
        more = f" and {len(ignored) - 5} more" if len(ignored) > 5 else ""
        notes.append(f"files of other kinds are not read: {', '.join(ignored[:5])}{more}")
    return tuple(notes)
