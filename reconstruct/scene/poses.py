"""The views' poses as a training refined them: for its own use, for a person and for other programs.

RUN/poses.json    per training view the refined pose, and by how much it differs from the scene's; and by how much the motion of
                  an object that was turned over differs from the one that the scene states
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import expm

from koala3d.datasets import pose
from koala3d.datasets.core import files
from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.scene import TURNED, Scene, View
from koala3d.datasets.structure.masks.silhouette import Slack
from koala3d.reconstruct.config import PoseConfig
from koala3d.reconstruct.scene.rays import Normalisation, Pixels, pixels_over_white
from koala3d.reconstruct.scene.twists import Session, Twists, moved, together

FORMAT, VERSION = "koala-poses", 1
POSES = "poses.json"
FURTHEST = 5.0
"""Cameras are looked for within so many standard deviations of where they were calibrated: masks rule out nothing nearer."""
DEFINITIONS = {
    "world_from_camera": "refined pose: OpenCV camera axes, quaternion wxyz, translation in world units",
    "moved_mm": "distance between the given and the refined position [mm; 1/1000 world unit if the scene is not metric]",
    "turned_deg": "angle between the given and the refined orientation [deg]",
    "moved_px": "mean movement of the corners of the object's box in the picture [px, at the size of the image on disk]",
}
"""What the entries of a view mean."""
OF_SESSION = {
    "moved_mm": "how far the object's middle was moved from where the stated motion takes it [mm; 1/1000 world unit]",
    "turned_deg": "angle by which its turn was corrected [deg]",
    "in_deviations": "root mean square of the six numbers, in standard deviations of the motion as it was stated",
    "a_from_b": "the corrected motion: takes what the second session calls a place of the object to what the first does",
}
"""What the entries of an object that was turned over mean."""
GAUGE = "corrections together neither move, turn nor scale all cameras (least squares, in standard deviations)"


def corrected(world_from_camera: ArrayLike, twist: ArrayLike, scale: float) -> NDArray[np.float64]:
    """(4, 4) pose after a correction.

    Args:
        twist: (6,) translation [scene unit] and rotation vector [rad] at the camera's centre; see `twists`.
        scale: scene units per world unit.
    """
    x, y, z = np.asarray(twist, np.float64)[3:]
    generator = np.zeros((4, 4))
    generator[:3, :3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
    generator[:3, 3] = np.asarray(twist, np.float64)[:3] / scale
    change, world_from_camera = expm(generator), np.asarray(world_from_camera, np.float64)
    return pose.rigid(change[:3, :3] @ world_from_camera[:3, :3], world_from_camera[:3, 3] + change[:3, 3])


def session_of(scene: Scene, normalisation: Normalisation) -> tuple[tuple[float, ...], ...] | None:
    """`SceneFacts.session` of a scene of an object that was turned over; None of others.

    The object's pose in the second session is known as well as the scene states, so all views of that session move together.
    """
    spread = spread_of(scene, scene.split("train"), normalisation)
    return None if spread is None or not spread.any() else tuple(tuple(row) for row in spread.reshape(-1, 36).tolist())


def spread_of(scene: Scene, views: tuple[View, ...], normalisation: Normalisation) -> NDArray[np.float64] | None:
    """`Session.spread` of some of a scene's views; None where no object was turned over."""
    stated = scene.provenance.get(TURNED)
    if stated is None:
        return None
    spread = _spread(np.stack([view.world_from_camera[:3, 3] for view in views]), stated, normalisation)
    return np.isin([view.name for view in views], stated["views"])[:, None, None] * spread


def _spread(places: NDArray[np.float64], stated: Mapping[str, Any], normalisation: Normalisation) -> NDArray[np.float64]:
    """`Session.spread` of cameras at (n, 3) `places` in the world, all of the second session."""
    units = np.array([normalisation.scale] * 3 + [1.0] * 3)
    local, middle = (normalisation.scale * (np.asarray(x) - normalisation.centre) for x in (places, stated["middle"]))
    return together(local, middle, units[:, None] * np.asarray(stated["covariance"]) * units)


def _with_session(scene: Scene, normalisation: Normalisation, session: Session | None) -> Scene:
    """The scene with all views of the second session moved, those included that nobody trained on."""
    if session is None:
        return scene
    stated = scene.provenance[TURNED]
    motion = _motion(stated, normalisation, session)
    back, names = pose.inverse(motion), set(stated["views"])

    def of(view: View) -> View:
        placed = None if view.base_from_world is None else view.base_from_world @ back
        return replace(view, world_from_camera=motion @ view.world_from_camera, base_from_world=placed)

    return scene.with_views(tuple(of(view) if view.name in names else view for view in scene.views))


def _motion(stated: Mapping[str, Any], normalisation: Normalisation, session: Session) -> NDArray[np.float64]:
    """(4, 4) by which the views of the second session are moved in the world."""
    by = _spread(np.zeros((1, 3)), stated, normalisation)[0] @ np.asarray(session.by, np.float64)
    return corrected(np.eye(4), by, normalisation.scale)


def refined(scene: Scene, normalisation: Normalisation, twists: Twists | None, session: Session | None = None) -> Scene:
    """The scene with its training views' poses corrected, and with those of a second session.

    Raises:
        DatasetError: it has other training views than when it was trained on.
    """
    scene = _with_session(scene, normalisation, session)
    if twists is None:
        return scene
    views = scene.split("train")
    if len(views) != len(twists):
        count = f"{len(views)} training views, then {len(twists)}"
        raise DatasetError("scene has changed since the training", where=scene.name, why=count, remedy="train again")
    better = {
        view.name: replace(view, world_from_camera=corrected(view.world_from_camera, twist, normalisation.scale))
        for view, twist in zip(views, np.asarray(twists, np.float64), strict=True)
    }
    return scene.with_views(tuple(better.get(view.name, view) for view in scene.views))


def change(before: View, after: View, box: NDArray[np.float64]) -> dict[str, float]:
    """By how much a pose was corrected, as `DEFINITIONS` has it. `box` is the object's, (2, 3) in the world."""
    distance, angle = pose.difference(before.world_from_camera, after.world_from_camera)
    corners = np.array(np.meshgrid(*np.asarray(box).T, indexing="ij")).reshape(3, -1).T
    local = [(corners - view.world_from_camera[:3, 3]) @ view.world_from_camera[:3, :3] for view in (before, after)]
    front = np.all([points[:, 2] > 1e-6 for points in local], axis=0)
    pixels = [before.camera.undistorted().project(points[front]) for points in local]
    apart = np.linalg.norm(pixels[0] - pixels[1], axis=-1)
    moved_px = float(apart.mean()) if len(apart) else 0.0
    return {"moved_mm": float(1e3 * distance), "turned_deg": float(np.rad2deg(angle)), "moved_px": moved_px}


def write(run: Path, scene: Scene, normalisation: Normalisation, twists: Twists | None, session: Session | None = None) -> None:
    """Write `poses.json` of a scene as it was given, where its poses were refined."""
    if twists is None and session is None:
        return
    after = refined(scene, normalisation, twists, session).split("train")
    views = []
    for old, new in zip(scene.split("train"), after, strict=True):
        matrix = new.world_from_camera
        stored = {"translation_m": matrix[:3, 3].tolist(), "quaternion_wxyz": pose.quaternion(matrix).tolist()}
        views.append({"name": new.name, "world_from_camera": stored, **change(old, new, scene.box)})
    content = {
        "format": FORMAT,
        "version": VERSION,
        "metric": scene.metric,
        "views": views,
        "definitions": DEFINITIONS,
        **({} if twists is None else {"gauge": GAUGE}),
        **({} if session is None else {TURNED: _moved_session(scene, normalisation, session)}),
    }
    files.write_json(run / POSES, content)


def _moved_session(scene: Scene, normalisation: Normalisation, session: Session) -> dict[str, Any]:
    """By how much the stated motion of the object was corrected, as `OF_SESSION` has it."""
    by = np.asarray(session.by, np.float64)
    stated = scene.provenance[TURNED]
    whole = _spread(np.array([stated["middle"]]), stated, normalisation)[0] @ by
    shift, turn = np.linalg.norm(whole[:3]) / normalisation.scale, np.linalg.norm(whole[3:])
    return {
        "moved_mm": float(1e3 * shift),
        "turned_deg": float(np.rad2deg(turn)),
        "in_deviations": float(np.sqrt(np.mean(by**2))),
        "a_from_b": (_motion(stated, normalisation, session) @ np.asarray(stated["a_from_b"])).tolist(),
    }


def read(run: Path) -> dict[str, Any] | None:
    """The content of `poses.json`; None where poses were not refined."""
    path = run / POSES
    return files.read_json(path, kind=FORMAT, version=VERSION) if path.is_file() else None


def summary(run: Path) -> str:
    """A sentence or two on the corrections of a run; empty where there are none."""
    content = read(run)
    return "" if content is None else "; ".join(filter(None, (_of_session(content), _of_each_view(content))))


def _of_session(content: dict[str, Any]) -> str:
    if (moved := content.get(TURNED)) is None:
        return ""
    unit = "mm" if content["metric"] else "thousandths of a unit"
    return (
        f"the object's motion between both sessions was corrected by {moved['moved_mm']:.2f} {unit} and "
        f"{moved['turned_deg']:.3f}°, {moved['in_deviations']:.1f} of its stated deviations"
    )


def _of_each_view(content: dict[str, Any]) -> str:
    if "gauge" not in content:
        return ""
    size = {name: np.array([view[name] for view in content["views"]]) for name in ("moved_mm", "turned_deg", "moved_px")}
    mean = {name: float(np.sqrt(np.mean(values**2))) for name, values in size.items()}
    unit = "mm" if content["metric"] else "thousandths of a unit"
    most = {name: float(values.max()) for name, values in size.items()}
    return (
        f"poses of {len(content['views'])} training views were refined by {mean['moved_mm']:.2f} {unit} and "
        f"{mean['turned_deg']:.3f}° (root mean square; at most {most['moved_mm']:.2f} {unit}, {most['turned_deg']:.3f}°), "
        f"{mean['moved_px']:.2f} px in the pictures"
    )


def slack(config: PoseConfig, normalisation: Normalisation, scene: Scene, *, free: bool = False) -> list[Slack]:
    """How far each training view's camera may be from where it was calibrated [scene unit], and turned [rad].

    Args:
        free: the motion of an object that was turned over is free: its places are as uncertain before cameras of that session.
    """
    position = angle = more = 0.0
    if config.enabled is True:
        _, _, position, angle, _, _ = config.sigma(normalisation.scale)
    stated = scene.provenance[TURNED] if free else {"views": []}
    if free:
        covariance = np.asarray(stated["covariance"])
        shift, turn = (float(np.sqrt(np.linalg.eigvalsh(part)[-1])) for part in (covariance[:3, :3], covariance[3:, 3:]))
        more = normalisation.scale * (shift + turn * float(np.linalg.norm(np.ptp(scene.box, axis=0))) / 2)
    second = set(stated["views"])
    return [(FURTHEST * (position + more * (view.name in second)), FURTHEST * angle) for view in scene.split("train")]


def over_white(pixels: Pixels, twists: Twists | None) -> tuple[Any, ...]:
    """(origins, directions, radii, light or None, colour over white) of all given pixels, as the corrected cameras see them."""
    rays, colour = pixels.take(jnp.arange(pixels.directions.shape[0]))
    return pixels_over_white(moved(rays, twists), colour)
