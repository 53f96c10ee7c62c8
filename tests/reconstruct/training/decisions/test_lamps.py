"""Where the lamps of a painted matte ball stand, from its pictures; what a training keeps of it; and that pictures use it."""

import json
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.formats import koala
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import Scene, View
from koala3d.reconstruct.config import Config
from koala3d.reconstruct.field.appearance import Reflection
from koala3d.reconstruct.field.lit import Lit
from koala3d.reconstruct.models import merged_config
from koala3d.reconstruct.output.trained_model import TrainedModel
from koala3d.reconstruct.run import Run
from koala3d.reconstruct.sampling.create import sampler_type
from koala3d.reconstruct.scene.light import STILL, LightFrame, stated
from koala3d.reconstruct.scene.rays import Normalisation, Pixels
from koala3d.reconstruct.training.decisions.evidence.explained import monomials
from koala3d.reconstruct.training.decisions.lamps import decided_light
from koala3d.reconstruct.training.loop import train
from koala3d.reconstruct.training.preparation import prepare

CAMERA = Camera(24, 24, 60.0, 60.0, 12.0, 12.0)
LAMP = np.array([0.48, 0.6, 0.64])
PER_RING, HEIGHTS = 12, (0.2, 1.6)


class Quiet:
    def advance(self) -> None:
        """Nothing to show."""


def ball_under(kind: str, folder: Path) -> Scene:
    """A ball of radius 0.3 under one lamp, at the direction `LAMP` of the world, of a turntable's room, or of the camera."""
    views = []
    for index in range(PER_RING * len(HEIGHTS)):
        angle = 2 * np.pi * index / PER_RING
        matrix = pose.look_at(2 * np.array([np.cos(angle), np.sin(angle), HEIGHTS[index // PER_RING]]) / 1.2, (0, 0, 0))
        if kind == "camera":  # held by hand: no camera could have stood before a turntable
            matrix[:3, :3] = matrix[:3, :3] @ Rotation.from_rotvec([0, 0, 0.7 * index]).as_matrix()
        rays = CAMERA.directions(CAMERA.pixel_centres()) @ matrix[:3, :3].T
        a, b, c = (rays**2).sum(-1), rays @ matrix[:3, 3], (matrix[:3, 3] ** 2).sum() - 0.09
        hit = b * b > a * c
        points = matrix[:3, 3] + ((-b - np.sqrt(np.where(hit, b * b - a * c, 0))) / a)[..., None] * rays
        room = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        before_lens = matrix[:3, :3] @ [0.5, -0.5, -0.7]
        lamp = {"world": LAMP, "turntable": room @ LAMP, "camera": before_lens}[kind]
        light = 0.15 + 0.5 * np.maximum(points @ lamp / 0.3, 0)
        paint = 0.6 + 0.3 * np.sin(9 * points)
        rgba = np.concatenate([images.srgb_from_linear(light[..., None] * paint), hit[..., None].astype(float)], -1)
        images.write(folder / f"{index:02d}.png", rgba)
        views.append(View(f"{index:02d}", CAMERA, matrix, "test" if index % 7 == 6 else "train", folder / f"{index:02d}.png"))
    box = np.array([[-0.32] * 3, [0.32] * 3])
    scene = Scene("ball", tuple(views), 1.0, 3.0, box, "white")
    koala.save(scene, folder / "ball")
    return koala.load(folder / "ball")


def decided(scene: Scene, config: Config):
    views, normalisation = scene.split("train"), Normalisation.of(scene)
    pixels = Pixels.load(views, normalisation, 1.0, Quiet())
    possible = sampler_type(config.sampler).possible_cells(config, pixels, views, normalisation, None)
    return decided_light(views, pixels, normalisation, possible, config, stated(scene))


@pytest.fixture(scope="module")
def turntable(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return ball_under("turntable", tmp_path_factory.mktemp("turntable"))


@pytest.mark.parametrize("kind", ["world", "camera"])
def test_lamps_are_found_where_they_stand(kind: str, small_config: Config, tmp_path: Path) -> None:
    found, skip = decided(ball_under(kind, tmp_path), small_config)
    assert found.kind == kind and skip.skipped == (kind == "world") and "dB" in skip.evidence


def test_a_turntable_is_found_with_its_axis(turntable: Scene, small_config: Config) -> None:
    found, skip = decided(turntable, small_config)
    assert found.kind == "turntable" and not skip.skipped
    np.testing.assert_allclose(found.axis, [0, 0, 1], atol=1e-6)
    # the cube [-1, 1]^3 has a half side of 0.32; cameras are at 2 |(1, height)| / 1.2
    distances = [2 * np.hypot(1, height) / 1.2 / 0.32 for height in HEIGHTS]
    assert min(distances) - 1e-3 < found.distance < max(distances) + 1e-3


def test_what_a_person_says_counts(turntable: Scene, small_config: Config) -> None:
    assert decided(turntable, merged_config(small_config, {"light": {"frame": "world"}}))[0] == STILL
    said = merged_config(small_config, {"light": {"frame": "turntable", "axis": [0, 0, -2]}})
    found, skip = decided(turntable, said)
    assert found.kind == "turntable" and found.axis == (0.0, 0.0, -1.0) and "forced" in skip.evidence
    with pytest.raises(UsageError, match="axis"):
        decided(turntable.with_views(turntable.views[:1]), merged_config(small_config, {"light": {"frame": "turntable"}}))


def test_what_the_scene_says_counts_less_than_a_person_and_more_than_pictures(turntable: Scene, small_config: Config) -> None:
    known = placed(turntable, lambda index: Rotation.from_rotvec([0, 0, 0.4 - 2 * np.pi * index / PER_RING]))
    found, skip = decided(known, small_config)
    assert found.kind == "turntable" and skip.evidence == "stated by the scene: turntable"
    np.testing.assert_allclose(found.axis, [0, 0, 1], atol=1e-9)
    found, skip = decided(replace(known, background="scene"), small_config)  # without masks too
    assert found.kind == "turntable"
    for still in (replace(turntable, lamps="object"), placed(turntable, lambda index: Rotation.identity())):
        found, skip = decided(still, small_config)
        assert found == STILL and skip.evidence == "stated by the scene"
    assert decided(known, merged_config(small_config, {"light": {"frame": "world"}}))[0] == STILL
    said = merged_config(small_config, {"light": {"axis": [0, 0.6, 0.8]}})
    assert decided(known, said)[0].axis == (0.0, 0.6, 0.8)


def placed(scene: Scene, turned: Callable[[int], Rotation]) -> Scene:
    """The scene in a room, with the object turned so in view `index`."""
    poses = [pose.rigid(turned(index).as_matrix(), np.ones(3)) for index in range(len(scene.views))]
    views = tuple(replace(view, base_from_world=one) for view, one in zip(scene.views, poses, strict=True))
    return replace(scene.with_views(views), lamps="room")


def test_an_object_that_was_turned_over_is_in_a_room(turntable: Scene, small_config: Config) -> None:
    """Two ways to lie, before cameras all around: no turntable. Each view has its own light, any other camera its neighbour's."""
    over = Rotation.from_rotvec([2.9, 0.4, 0])
    known = placed(turntable, lambda index: Rotation.identity() if index < PER_RING else over)
    found, skip = decided(known, small_config)
    assert found.kind == "room" and found.moves and not found.near and skip.evidence == "stated by the scene: room"
    assert LightFrame.from_json(json.loads(json.dumps(asdict(found)))) == found
    turned = found.of_views(known.split("train"))
    other = found.of_views(tuple(replace(view, base_from_world=None) for view in known.split("test")))
    assert turned is not None and other is not None
    lower, upper = (np.broadcast_to(one.as_matrix(), (3, 3)) for one in (Rotation.identity(), over))
    for rotation, view in zip([*turned, *other], [*known.split("train"), *known.split("test")], strict=True):
        np.testing.assert_allclose(rotation, lower if int(view.name) < PER_RING else upper, atol=1e-6)
    lit = Lit.towards(found, jnp.asarray(np.stack([view.world_from_camera[:3, 2] for view in known.views], 1), jnp.float32))
    assert lit is not None
    np.testing.assert_allclose(lit.rotation[0], lower, atol=1e-6)
    np.testing.assert_allclose(lit.rotation[-1], upper, atol=1e-6)


def test_nothing_is_claimed_without_evidence(turntable: Scene, small_config: Config) -> None:
    few = turntable.with_views(turntable.split("train")[:6])
    assert decided(few, small_config)[0] == STILL
    assert decided(replace(turntable, background="scene"), small_config)[0] == STILL
    matte = merged_config(small_config, {"field": {"appearance": "diffuse"}})
    assert decided(turntable, matte)[0] == STILL


def test_monomials_span_the_harmonics() -> None:
    directions = np.random.default_rng(0).normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    both = np.concatenate([monomials(directions, 2), monomials(directions, 3)], -1)
    assert np.linalg.matrix_rank(both) == 16  # 1 + 3 + 5 + 7 harmonics up to the third degree
    assert both.shape[1] == 16


@pytest.fixture(params=["without steps", pytest.param("with steps", marks=pytest.mark.slow)])
def perhaps_without_steps(request: pytest.FixtureRequest) -> None:
    """Steps take half a minute to compile."""
    if request.param == "without steps":
        request.getfixturevalue("two_steps_at_once")


@pytest.mark.usefixtures("perhaps_without_steps")
def test_training_keeps_the_frame_and_pictures_use_it(turntable: Scene, small_config: Config, tmp_path: Path) -> None:
    """Two cameras whose rotation takes the room along are lit alike: their rays carry the azimuth, which is all that differs."""
    config = merged_config(small_config, {"train": {"steps": 2}, "surface": {"first_period": 1, "last_period": 1}})
    folder = Path(turntable.views[0].image).parents[1]
    train(turntable, folder, config, tmp_path / "run")
    run = Run.open(tmp_path / "run")
    assert run.facts.light.kind == "turntable" and run.content["facts"]["light"]["kind"] == "turntable"
    trained = TrainedModel.open(tmp_path / "run")
    appearance = trained.model.field.appearance
    assert isinstance(appearance, Reflection) and appearance.moving is not None and trained.renderer.light == run.facts.light
    unseen = turntable.split("test")[0]
    rotation = trained.renderer.rays_of(unseen, CAMERA)[3]
    assert rotation is not None
    towards = unseen.world_from_camera[:3, 3] * [1, 1, 0]
    np.testing.assert_allclose(rotation[7] @ towards / np.linalg.norm(towards), [1, 0, 0], atol=1e-6)
    assert np.isfinite(trained.picture(unseen).rgb).all()
    again = prepare(turntable, run.config, run.normalisation, run.facts, fresh=False)
    assert again.pixels.light is not None and again.probe is not None and again.probe[3] is not None


def test_pixels_have_their_views_lamps(turntable: Scene) -> None:
    views, normalisation = turntable.split("train"), Normalisation.of(turntable)
    pixels = Pixels.load(views, normalisation, 1.0, Quiet())
    assert pixels.under(STILL, views) is pixels and pixels.take(jnp.array([0]))[0].light is None
    frame = LightFrame("camera")
    lit = pixels.under(frame, views)
    rays, _ = lit.take(jnp.arange(3))
    expected = frame.of_views(views)
    assert expected is not None and rays.light is not None
    np.testing.assert_array_equal(rays.light, expected[np.asarray(rays.view)])
    assert lit.over_white(np.arange(3))[3].shape == (3, 3, 3)
