"""What is wrong with a scene: each finding says what, where, why and how to fix it."""

from collections import Counter
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koala3d.datasets.checks import coverage
from koala3d.datasets.checks.matches import check_matches
from koala3d.datasets.checks.poses import check_poses
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import KoalaError
from koala3d.datasets.core.findings import Finding, from_error
from koala3d.datasets.core.progress import Count, ignore
from koala3d.datasets.formats import load_scene
from koala3d.datasets.imaging import images, reduced
from koala3d.datasets.imaging.downscale import streamed
from koala3d.datasets.imaging.reduced import READERS
from koala3d.datasets.scene import Scene, View
from koala3d.datasets.structure import bounds

ONE_COLOUR = 1.5 / 255
"""Largest difference in the thumbnail of a picture of one colour: roundings."""
THUMBNAIL, ALIKE = 16, 0.4 / 255
"""Pixels per side of a thumbnail, and the mean difference below which two images are the same up to noise."""
SERIOUS = ("missing", "no ray")
"""Words of notes that are findings."""


def check(path: str | Path, *, matches: bool = True, done: Count = ignore, **options: Any) -> list[Finding]:
    """Findings on a scene on disk, the worst first; an empty list means that nothing is wrong.

    Every image, mask and truth map is decoded. With `matches`, features are matched between views and compared with the
    poses, which takes some seconds more. `done` is called with the number of views checked and their total. `options` are
    those of `load_scene`.
    """
    problems: list[KoalaError] = []
    try:
        scene = load_scene(path, problems=problems, **options)
    except KoalaError as error:
        return [*map(from_error, problems), from_error(error)]
    findings = [*map(from_error, problems), *check_poses(scene), *coverage.find(scene)]
    findings += [Finding("warning", "note", scene.name, note) for note in scene.notes if any(word in note for word in SERIOUS)]
    lengths = Counter(view.image.stat().st_size for view in scene.views if view.image.is_file())
    looked: dict[str, _Looked] = {}
    first_by_digest: dict[str, str] = {}
    found = streamed(partial(_look, lengths=lengths), scene.views, workers=READERS)
    for count, (view, one) in enumerate(zip(scene.views, found, strict=True), 1):
        looked[view.name] = one
        findings += one.findings
        if one.digest and (first := first_by_digest.setdefault(one.digest, view.name)) != view.name:
            why, remedy = f"equal to view {first}", "remove one of them"
            findings.append(Finding("warning", "image is the same as another's", f"view {view.name}", why, remedy))
        done(count, len(scene.views))
    findings += _near_duplicates(scene, looked)
    if matches:
        findings += check_matches(scene)
    return sorted(findings, key=lambda finding: finding.level)


@dataclass(frozen=True, eq=False)
class _Looked:
    """What the files of one view hold."""

    findings: list[Finding]
    thumbnail: NDArray[np.float32] | None
    """(THUMBNAIL, THUMBNAIL, 3) sRGB; None where the image cannot be used."""
    digest: str | None
    """Of the image; None where no other has as many bytes."""


def _look(view: View, lengths: Counter[int]) -> _Looked:
    """Decode every file of one view. `lengths` counts the images by their bytes."""
    found, thumbnail = _image(view)
    for key, path in view.truth.items():
        try:
            if not np.isfinite(view.read_truth(key)).all():
                found.append(_not_finite(path))
        except KoalaError as error:
            found.append(from_error(error))
    has_equal = view.image.is_file() and lengths[view.image.stat().st_size] > 1
    return _Looked(found, thumbnail, files.sha256(view.image) if has_equal else None)


def _image(view: View) -> tuple[list[Finding], NDArray[np.float32] | None]:
    """Findings on a view's image and mask, as integers if their files hold these, and the thumbnail."""
    try:
        picture = view.read() if images.steps(view.image) == 1 else view.read_stored()
        has_alpha = picture.shape[-1] in (2, 4)
        alpha = view.read_stored_mask() if view.mask is not None else picture[..., -1] if has_alpha else None
    except KoalaError as error:
        return [from_error(error)], None
    found = []
    colours = reduced.in_colour(reduced.averaged(picture, THUMBNAIL, THUMBNAIL))[..., :3]
    values = picture[..., :-1] if has_alpha else picture
    if not np.ptp(colours) > ONE_COLOUR and values.min() == values.max():
        found.append(Finding("warning", "image has one colour only", str(view.image), remedy="check the exposure"))
    if alpha is not None and not alpha.any():
        remedy = "check the mask, or drop the view"
        found.append(Finding("warning", "mask or alpha is empty", f"view {view.name}", remedy=remedy))
    if picture.dtype == np.float32 and not np.isfinite(picture).all():
        return [*found, _not_finite(view.image)], None
    return found, colours


def _not_finite(path: Path) -> Finding:
    return Finding("error", "image holds values that are not finite", str(path), remedy="write it again")


def _near_duplicates(scene: Scene, looked: dict[str, _Looked]) -> list[Finding]:
    """Test views whose thumbnail equals that of a training view though their files differ."""
    thumbnails = {view.name: one for view in scene.views if (one := looked[view.name].thumbnail) is not None}
    train = [view for view in scene.views if view.split == "train" and view.name in thumbnails]
    if not train:
        return []
    stack = np.stack([thumbnails[view.name] for view in train])
    found = []
    for view in scene.views:
        if view.split != "test" or view.name not in thumbnails or np.ptp(thumbnails[view.name]) < 0.02:
            continue
        differences = np.abs(stack - thumbnails[view.name]).mean((1, 2, 3))
        nearest, digest = train[int(np.argmin(differences))], looked[view.name].digest
        twins = digest is not None and digest == looked[nearest.name].digest
        if differences.min() < ALIKE and not twins:
            why = f"it differs from view {nearest.name} by {255 * differences.min():.2f} of 255"
            remedy = "remove one of the two, else test figures are too good"
            found.append(Finding("warning", "test picture is nearly a training picture", f"view {view.name}", why, remedy))
    return found


def summary(scene: Scene) -> dict[str, Any]:
    """The figures of a scene that `datasets info` shows."""
    matrices = np.stack([view.world_from_camera for view in scene.views])
    distances = np.linalg.norm(matrices[:, :3, 3] - bounds.focus(matrices)[0], axis=1)
    first = scene.views[0]
    return {
        "name": scene.name,
        "format": scene.provenance.get("format", "koala"),
        "views": scene.counts(),
        "sizes": sorted({(view.camera.width, view.camera.height) for view in scene.views}),
        "camera": first.camera.to_json(),
        "distorted": not first.camera.is_pinhole,
        "cameras": len({v.camera for v in scene.views}),
        "channels": images.channels(first.image) if first.image.is_file() else None,
        "masks": sum(view.mask is not None for view in scene.views),
        "truth": dict(sorted(Counter(key for view in scene.views for key in view.truth).items())),
        "background": scene.background,
        "metric": scene.metric,
        "near": scene.near,
        "far": scene.far if np.isfinite(scene.far) else None,
        "box": scene.box.tolist(),
        "bounds_from": scene.bounds_from,
        "points": 0 if scene.points is None else len(scene.points),
        "distance_to_focus": [float(distances.min()), float(distances.max())],
        "notes": list(scene.notes),
    }
