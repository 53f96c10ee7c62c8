"""What is wrong with a scene: each finding says what, where, why and how to mend it."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from datasets import bounds, files, images
from datasets.errors import KoalaError
from datasets.formats import load_scene
from datasets.scene import Scene, View


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong ("error") or looks wrong ("warning")."""

    level: str
    what: str
    where: str
    why: str = ""
    remedy: str = ""

    @property
    def line(self) -> str:
        """All of it in one line."""
        return f"{self.level}: {KoalaError(self.what, where=self.where, why=self.why, remedy=self.remedy)}"


def check(path: str | Path, *, done: Callable[[int, int], None] = lambda count, total: None, **options: object) -> list[Finding]:
    """Findings on a scene on disk, the worst first; an empty list means that nothing is wrong.

    Every image, mask and truth map is decoded. `done` is called with the number of views checked and of all. `options`
    are those of `load_scene`.
    """
    problems: list[KoalaError] = []
    try:
        scene = load_scene(path, problems=problems, **options)  # type: ignore[arg-type]
    except KoalaError as error:
        return [*map(_from_error, problems), _from_error(error)]
    findings = [*map(_from_error, problems), *_splits(scene), *_poses(scene)]
    findings += [Finding("warning", "note", scene.name, note) for note in scene.notes if "missing" in note]
    seen: dict[str, str] = {}
    for count, view in enumerate(scene.views, 1):
        findings += _pictures(view) + _duplicate(view, seen)
        done(count, len(scene.views))
    return sorted(findings, key=lambda finding: finding.level)


def _from_error(error: KoalaError) -> Finding:
    return Finding("error", error.what, error.where, error.why, error.remedy)


def _splits(scene: Scene) -> list[Finding]:
    present = {view.split for view in scene.views}
    names = [view.name for view in scene.views]
    found = [Finding("error" if split == "train" else "warning", f"there are no {split} views", scene.name,
                     remedy="set the split of some views") for split in ("train", "test") if split not in present]  # fmt: skip
    twice = sorted({name for name in names if names.count(name) > 1})
    return found + [
        Finding("error", "name is used twice", f"view {name}", remedy="give each view its own name") for name in twice
    ]


def _poses(scene: Scene) -> list[Finding]:
    """Cameras that stand on one spot, look away from the box, or are far from all others."""
    matrices = np.stack([view.world_from_camera for view in scene.views])
    positions = matrices[:, :3, 3]
    found = []
    if len(scene.views) > 1 and np.ptp(positions, axis=0).max() < 1e-9:
        found.append(Finding("error", "all cameras stand on one spot", scene.name, remedy="check the translations of the poses"))
    distances = np.linalg.norm(positions - np.median(positions, axis=0), axis=1)
    limit = 20 * max(float(np.median(distances)), 1e-12)
    for view, distance in zip(scene.views, distances, strict=True):
        where = f"view {view.name}"
        if distance > limit:
            why = f"{distance:.3g} from the middle of all cameras, half of them are within {np.median(distances):.3g}"
            found.append(Finding("warning", "camera is far from all others", where, why, "check its pose and unit"))
        if not _sees(view, scene.box):
            found.append(Finding("warning", "camera looks away from the object's box", where,
                                 f"box {scene.box.round(3).tolist()}", "check its pose, its axis convention and the box"))  # fmt: skip
    return found


def _sees(view: View, box: np.ndarray) -> bool:
    """True where the picture can show a part of the box: a point of a grid in it is in front and within the picture."""
    steps = np.linspace(0, 1, 5)
    grid = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    points = box[0] + grid * (box[1] - box[0])
    local = (points - view.world_from_camera[:3, 3]) @ view.world_from_camera[:3, :3]
    local = local[local[:, 2] > 0]
    if not len(local):
        return False
    pixels = view.camera.undistorted().project(local)
    return bool(((pixels >= 0) & (pixels <= [view.camera.width, view.camera.height])).all(1).any())


def _pictures(view: View) -> list[Finding]:
    """Every file of one view decoded."""
    readers: list[tuple[Path, Callable[[], np.ndarray]]] = [(view.image, view.read)]
    readers += [(path, lambda key=key: view.read_truth(key)) for key, path in view.truth.items()]  # type: ignore[misc]
    found = []
    for path, read in readers:
        try:
            values = read()
        except KoalaError as error:
            found.append(_from_error(error))
            continue
        if path is view.image and np.ptp(values[..., :3]) == 0:
            found.append(Finding("warning", "image has one colour only", str(path), remedy="check the exposure"))
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


def summary(scene: Scene) -> dict[str, object]:
    """What a person wants to know of a scene at a glance."""
    sizes = sorted({(view.camera.width, view.camera.height) for view in scene.views})
    counts = {split: sum(view.split == split for view in scene.views) for split in ("train", "val", "test")}
    matrices = np.stack([view.world_from_camera for view in scene.views])
    distances = np.linalg.norm(matrices[:, :3, 3] - bounds.focus(matrices)[0], axis=1)
    first = scene.views[0]
    return {
        "name": scene.name, "format": scene.provenance.get("format", "koala"), "views": counts, "sizes": sizes,
        "camera": first.camera.to_json(), "distorted": not first.camera.is_pinhole, "cameras": len({v.camera for v in scene.views}),
        "channels": images.channels(first.image) if first.image.is_file() else None,
        "masks": sum(view.mask is not None for view in scene.views),
        "truth": {key: sum(key in view.truth for view in scene.views) for key in sorted({k for v in scene.views for k in v.truth})},
        "background": scene.background, "metric": scene.metric, "near": scene.near,
        "far": scene.far if np.isfinite(scene.far) else None, "box": scene.box.tolist(),
        "bounds_from": scene.bounds_from, "points": 0 if scene.points is None else len(scene.points),
        "distance_to_focus": [float(distances.min()), float(distances.max())], "notes": list(scene.notes),
    }  # fmt: skip
