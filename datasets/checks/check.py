"""What is wrong with a scene: each finding says what, where, why and how to mend it."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from datasets.checks.matches import check_matches
from datasets.checks.poses import check_poses
from datasets.core import files
from datasets.core.errors import KoalaError
from datasets.core.findings import Finding, from_error
from datasets.formats import load_scene
from datasets.imaging import images
from datasets.scene import Scene, View
from datasets.structure import bounds

THUMBNAIL, ALIKE = 16, 0.4 / 255
"""Pixels per side of a thumbnail, and the mean difference below which two pictures are one: noise averages to less."""


def check(
    path: str | Path, *, matches: bool = True, done: Callable[[int, int], None] = lambda count, total: None, **options: object
) -> list[Finding]:
    """Findings on a scene on disk, the worst first; an empty list means that nothing is wrong.

    Every image, mask and truth map is decoded. With `matches`, features are matched between views and held against the
    poses, which takes some seconds more. `done` is called with the number of views checked and of all. `options` are those
    of `load_scene`.
    """
    problems: list[KoalaError] = []
    try:
        scene = load_scene(path, problems=problems, **options)  # type: ignore[arg-type]
    except KoalaError as error:
        return [*map(from_error, problems), from_error(error)]
    findings = [*map(from_error, problems), *check_poses(scene)]
    findings += [Finding("warning", "note", scene.name, note) for note in scene.notes if "missing" in note]
    seen: dict[str, str] = {}
    thumbnails: dict[str, NDArray[np.float32]] = {}
    for count, view in enumerate(scene.views, 1):
        findings += _pictures(view, thumbnails) + _duplicate(view, seen)
        done(count, len(scene.views))
    findings += _near_duplicates(scene, thumbnails)
    if matches:
        findings += check_matches(scene)
    return sorted(findings, key=lambda finding: finding.level)


def _pictures(view: View, thumbnails: dict[str, NDArray[np.float32]]) -> list[Finding]:
    """Every file of one view decoded; its thumbnail is put down under its name."""
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
            found.append(
                Finding("warning", "mask or alpha is empty", f"view {view.name}", remedy="check the mask, or drop the view")
            )
        if not np.isfinite(values).all():
            found.append(Finding("error", "image holds values that are not finite", str(path), remedy="write it again"))
    return found


def _duplicate(view: View, seen: dict[str, str]) -> list[Finding]:
    """A finding where another view's image has the same bytes."""
    if not view.image.is_file():
        return []
    first = seen.setdefault(files.sha256(view.image), view.name)
    if first == view.name:
        return []
    return [
        Finding("warning", "image is the same as another's", f"view {view.name}", f"equal to view {first}", "remove one of them")
    ]


def _near_duplicates(scene: Scene, thumbnails: dict[str, NDArray[np.float32]]) -> list[Finding]:
    """Test views whose thumbnail is that of a training view, pixel by pixel, though their files differ."""
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
        twins = view.image.is_file() and train[nearest].image.is_file() and _same_bytes(view.image, train[nearest].image)
        if differences[nearest] < ALIKE and not twins:
            why = f"it differs from view {train[nearest].name} by {255 * differences[nearest]:.2f} of 255"
            found.append(
                Finding(
                    "warning",
                    "test picture is nearly a training picture",
                    f"view {view.name}",
                    why,
                    "take one of the two out, else figures flatter",
                )
            )
    return found


def _same_bytes(one: Path, other: Path) -> bool:
    return files.sha256(one) == files.sha256(other)


def summary(scene: Scene) -> dict[str, object]:
    """What a person wants to know of a scene at a glance."""
    sizes = sorted({(view.camera.width, view.camera.height) for view in scene.views})
    counts = {split: sum(view.split == split for view in scene.views) for split in ("train", "val", "test")}
    matrices = np.stack([view.world_from_camera for view in scene.views])
    distances = np.linalg.norm(matrices[:, :3, 3] - bounds.focus(matrices)[0], axis=1)
    first = scene.views[0]
    return {
        "name": scene.name,
        "format": scene.provenance.get("format", "koala"),
        "views": counts,
        "sizes": sizes,
        "camera": first.camera.to_json(),
        "distorted": not first.camera.is_pinhole,
        "cameras": len({v.camera for v in scene.views}),
        "channels": images.channels(first.image) if first.image.is_file() else None,
        "masks": sum(view.mask is not None for view in scene.views),
        "truth": {
            key: sum(key in view.truth for view in scene.views) for key in sorted({k for v in scene.views for k in v.truth})
        },
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
