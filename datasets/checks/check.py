"""What is wrong with a scene: each finding says what, where, why and how to fix it."""

from collections import Counter
from collections.abc import Callable
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
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import Scene, View
from koala3d.datasets.structure import bounds

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
    first_by_hash: dict[str, str] = {}
    thumbnails: dict[str, NDArray[np.float32]] = {}
    for count, view in enumerate(scene.views, 1):
        findings += _pictures(view, thumbnails) + _duplicate(view, first_by_hash)
        done(count, len(scene.views))
    findings += _near_duplicates(scene, thumbnails)
    if matches:
        findings += check_matches(scene)
    return sorted(findings, key=lambda finding: finding.level)


def _pictures(view: View, thumbnails: dict[str, NDArray[np.float32]]) -> list[Finding]:
    """Decode every file of one view; its thumbnail is added to `thumbnails`."""
    readers: list[tuple[Path, Callable[[], np.ndarray]]] = [(view.image, view.read)]
    readers += [(path, lambda key=key: view.read_truth(key)) for key, path in view.truth.items()]  # type: ignore[misc]
    found = []
    for path, read in readers:
        try:
            values = read()
        except KoalaError as error:
            found.append(from_error(error))
            continue
        if path is view.image and np.isfinite(values).all():
            thumbnails[view.name] = images.resize(values[..., :3], THUMBNAIL, THUMBNAIL, srgb=False)
        if path is view.image and np.ptp(values[..., :3]) == 0:
            found.append(Finding("warning", "image has one colour only", str(path), remedy="check the exposure"))
        if path is view.image and values.shape[-1] == 4 and not values[..., 3].any():
            remedy = "check the mask, or drop the view"
            found.append(Finding("warning", "mask or alpha is empty", f"view {view.name}", remedy=remedy))
        if not np.isfinite(values).all():
            found.append(Finding("error", "image holds values that are not finite", str(path), remedy="write it again"))
    return found


def _duplicate(view: View, first_by_hash: dict[str, str]) -> list[Finding]:
    """A finding where an earlier view's image has the same bytes."""
    if (digest := _digest(view)) is None:
        return []
    first = first_by_hash.setdefault(digest, view.name)
    if first == view.name:
        return []
    why, remedy = f"equal to view {first}", "remove one of them"
    return [Finding("warning", "image is the same as another's", f"view {view.name}", why, remedy)]


def _near_duplicates(scene: Scene, thumbnails: dict[str, NDArray[np.float32]]) -> list[Finding]:
    """Test views whose thumbnail equals that of a training view though their files differ."""
    train = [view for view in scene.views if view.split == "train" and view.name in thumbnails]
    if not train:
        return []
    stack = np.stack([thumbnails[view.name] for view in train])
    found = []
    for view in scene.views:
        if view.split != "test" or view.name not in thumbnails or np.ptp(thumbnails[view.name]) < 0.02:
            continue
        differences = np.abs(stack - thumbnails[view.name]).mean((1, 2, 3))
        nearest = int(np.argmin(differences))
        twins = _digest(view) is not None and _digest(view) == _digest(train[nearest])
        if differences[nearest] < ALIKE and not twins:
            why = f"it differs from view {train[nearest].name} by {255 * differences[nearest]:.2f} of 255"
            remedy = "remove one of the two, else test figures are too good"
            found.append(Finding("warning", "test picture is nearly a training picture", f"view {view.name}", why, remedy))
    return found


def _digest(view: View) -> str | None:
    return files.sha256(view.image) if view.image.is_file() else None


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
