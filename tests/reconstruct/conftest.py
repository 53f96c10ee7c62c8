"""A ball whose field, pictures, surface and truth are known exactly, and a run on disk that nobody has trained."""

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

from koala3d.datasets import pose
from koala3d.datasets.camera_model import Camera
from koala3d.datasets.formats import koala, load_scene
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import Scene, View
from koala3d.reconstruct import checkpoint
from koala3d.reconstruct.config import Config
from koala3d.reconstruct.field.appearance import Material, Shading
from koala3d.reconstruct.field.cloud import Cloud
from koala3d.reconstruct.field.field import Field
from koala3d.reconstruct.field.lit import Lit
from koala3d.reconstruct.kernels import native
from koala3d.reconstruct.models import load_config
from koala3d.reconstruct.numerics.safe import srgb_from_linear
from koala3d.reconstruct.output import evaluate
from koala3d.reconstruct.output.trained_model import TrainedModel
from koala3d.reconstruct.rendering.model import Model
from koala3d.reconstruct.rendering.pictures import Renderer
from koala3d.reconstruct.run import CHECKPOINTS, Run
from koala3d.reconstruct.sampling.occupancy import Occupancy
from koala3d.reconstruct.scene.facts import SceneFacts
from koala3d.reconstruct.scene.rays import Normalisation
from koala3d.reconstruct.scene.space import BOX
from koala3d.reconstruct.training.step import Step
from tests.reconstruct import glossy_ball
from tests.small import Trainable
from tests.unoptimised import unoptimised as unoptimised

SHIPPED = ("training", "kernels", "rendered", "experiments")
"""Folders whose programs are compiled as they ship, with optimisation."""
CAMERA = Camera(48, 40, 70.0, 70.0, 24.0, 20.0)
CENTRE, RADIUS = np.array([0.4, 0.0, 0.15]), 0.08
"""Of the ball [m]."""
DIFFUSE, SPECULAR = np.array([0.1, 0.2, 0.3]), np.array([0.2, 0.1, 0.05])
"""Linear light that the ball sends everywhere."""


@pytest.fixture(autouse=True, scope="module")
def quickly_compiled(request: pytest.FixtureRequest) -> None:
    """All folders but `SHIPPED` compile without optimisation."""
    if request.path.relative_to(Path(__file__).parent).parts[0] not in SHIPPED:
        request.getfixturevalue("unoptimised")


class Ball(Field):
    """A field that is solid inside a sphere around the origin of the normalised scene, and one colour all over."""

    radius: float = 0.0

    def density(self, cloud: Cloud) -> jax.Array:
        """Rises from nothing to opaque over a hundredth of the scene."""
        return 2000 * jax.nn.sigmoid((self.radius - jnp.linalg.norm(cloud.points, axis=0)) / 0.002)

    def __call__(self, cloud: Cloud) -> tuple[jax.Array, Material]:
        count = cloud.points.shape[1]
        plain = lambda values: jnp.broadcast_to(jnp.asarray(values, jnp.float32)[:, None], (len(values), count))  # noqa: E731
        outward = cloud.points / jnp.linalg.norm(cloud.points, axis=0)
        return self.density(cloud), Material(plain(DIFFUSE), plain([1.0] * 3), plain([0.25]), outward, jnp.zeros((0, count)))

    def with_normals(self, cloud: Cloud) -> tuple[jax.Array, Material, jax.Array]:
        """As `Field.with_normals`."""
        density, material = self(cloud)
        return density, material, material.normals_pred

    def shade(
        self,
        material: Material,
        viewdirs: jax.Array,
        normals: jax.Array | None = None,
        light: Lit | None = None,
        places: jax.Array | None = None,
    ) -> Shading:
        """As `Field.shade`: the same light in all directions."""
        specular = jnp.broadcast_to(jnp.asarray(SPECULAR, jnp.float32)[:, None], viewdirs.shape)
        return Shading(srgb_from_linear(material.diffuse + specular), specular)


def ball_truth(camera: Camera, world_from_camera: np.ndarray) -> dict[str, np.ndarray]:
    """Exact maps at pixel centres by intersecting each ray with the sphere."""
    directions = camera.directions(camera.pixel_centres()) @ world_from_camera[:3, :3].T
    offset = world_from_camera[:3, 3] - CENTRE
    a, b, c = (directions**2).sum(-1), (directions * offset).sum(-1), (offset**2).sum() - RADIUS**2
    inside = b * b - a * c
    hit = (inside > 0)[..., None]
    depth = np.where(hit, (-b - np.sqrt(np.maximum(inside, 0)))[..., None] / a[..., None], 0)
    normals = np.where(hit, (offset + depth * directions) / RADIUS, 0)
    return {"alpha": hit.astype(float), "depth": depth, "normals": normals}


@pytest.fixture(scope="session")
def ball_scene(tmp_path_factory: pytest.TempPathFactory) -> tuple[Scene, Path]:
    """Six views around the ball, two of them for testing, with all truth; and the folder that holds it as a Koala scene."""
    root = tmp_path_factory.mktemp("ball")
    views = []
    for index in range(6):
        angle, name = np.pi * index / 3, f"{index:03d}"
        matrix = pose.look_at(CENTRE + np.array([0.3 * np.cos(angle), 0.3 * np.sin(angle), 0.05 + 0.04 * index]), CENTRE)
        truth = ball_truth(CAMERA, matrix)
        fine = ball_truth(CAMERA.scaled(8 * CAMERA.width, 8 * CAMERA.height), matrix)["alpha"]
        truth["alpha"] = fine.reshape(CAMERA.height, 8, CAMERA.width, 8, 1).mean((1, 3))
        truth |= {"diffuse": DIFFUSE * truth["alpha"], "specular": SPECULAR * truth["alpha"]}
        rgb = images.srgb_from_linear(np.broadcast_to(DIFFUSE + SPECULAR, (*truth["alpha"].shape[:2], 3)))
        images.write(root / "source" / f"{name}.png", np.concatenate([rgb, truth["alpha"]], -1))
        maps = {}
        for key, values in truth.items() if index % 3 == 0 else ():
            maps[key] = root / "source" / f"{name}_{key}.exr"
            images.write(maps[key], values.astype(np.float32))
        split = "test" if index % 3 == 0 else "train"
        views.append(View(name, CAMERA, matrix, split, root / "source" / f"{name}.png", None, maps))
    box = np.stack([CENTRE - 0.1, CENTRE + 0.1])
    scene = Scene("ball", tuple(views), 0.05, np.inf, box, "white", metric=True)
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=RADIUS)
    mesh.apply_translation(CENTRE)
    mesh.export(root / "object.ply")
    koala.save(scene, root / "koala" / "ball", extra={"truth/object.ply": root / "object.ply"})
    return koala.load(root / "koala" / "ball"), root / "koala" / "ball"


@pytest.fixture(scope="session")
def small_config() -> Config:
    """The fast preset with a small model, and as many samples on a ray as ever."""
    return load_config(
        overrides=[
            "encoding.levels=2",
            "encoding.log2_size=8",
            "field.spatial_width=8",
            "field.view_width=8",
            "sampler.grid=32",
            "field.density_bias=0.5",
        ]
    )


@pytest.fixture(scope="session")
def glossy_scene(tmp_path_factory: pytest.TempPathFactory) -> tuple[Scene, Path]:
    """The glossy ball, and the folder that holds it as a Koala scene."""
    folder = glossy_ball.save(tmp_path_factory.mktemp("glossy"))
    return load_scene(folder), folder


@pytest.fixture(scope="session")
def trainable(glossy_scene: tuple[Scene, Path], tmp_path_factory: pytest.TempPathFactory) -> Trainable:
    """The default model on the glossy ball, prepared and compiled as for a training."""
    config = load_config(overrides=glossy_ball.SETTINGS)
    return Trainable.prepared(*glossy_scene, config, tmp_path_factory.mktemp("trainable") / "run")


class Painted(Ball):
    """The ball with waves of colour all over, so that a picture tells where it was taken from."""

    def __call__(self, cloud: Cloud) -> tuple[jax.Array, Material]:
        density, material = super().__call__(cloud)
        waves = 0.3 + 0.15 * jnp.sin(jnp.array([[9.0], [11.0], [13.0]]) * cloud.points) + 0.1 * jnp.cos(7 * cloud.points[::-1])
        return density, eqx.tree_at(lambda m: m.diffuse, material, waves)


@pytest.fixture
def make_run(ball_scene: tuple[Scene, Path], small_config: Config, tmp_path: Path) -> Callable[..., Run]:
    """Factory of runs on disk as a training leaves them, with fresh weights."""

    def make(config: Config = small_config, *, checkpointed: bool = True) -> Run:
        scene, folder = ball_scene
        facts = SceneFacts(Normalisation.of(scene))
        run = Run.create(
            tmp_path / "run", config, folder, facts, {"budget_s": 10.0, "device": "cpu", "notes": ["made for a test"]}
        )
        for step in range(3):
            run.append_log(
                {
                    "step": step,
                    "seconds": 1.0 * step,
                    "progress": step / 2,
                    "psnr_train": 10.0 + step,
                    "psnr_unseen": 9.0 + step,
                    "skipped": 0,
                    "occupied": 0.1,
                    "terms": {},
                }
            )
        if checkpointed:
            possible = np.random.default_rng(0).random(config.sampler.grid**3) < 0.3
            state = Step.of(config, run.facts).initial(jax.random.key(0), possible)
            checkpoint.save(run.path / CHECKPOINTS, state, {"seconds": 2.0, "step": 0.0})
        return run

    return make


@pytest.fixture
def painted(ball: TrainedModel) -> TrainedModel:
    """The ball with a painted surface."""
    field = ball.model.field
    solid = Painted(**vars(field))
    return replace(ball, model=replace(ball.model, field=solid))


@pytest.fixture(scope="session")
def renderer(ball_scene: tuple[Scene, Path]) -> Renderer:
    """One for all models of the ball, which is compiled once."""
    return Renderer(Normalisation.of(ball_scene[0]))


@pytest.fixture
def without_mesh(monkeypatch: pytest.MonkeyPatch) -> None:
    """Evaluations measure no mesh, which takes most of their time."""
    monkeypatch.setattr(evaluate, "compare_surface", lambda *_, **__: None)


@pytest.fixture
def ball(ball_scene: tuple[Scene, Path], make_run: Callable[..., Run], renderer: Renderer) -> TrainedModel:
    """The ball in place of a trained model, its occupancy grid holding the cells near the surface."""
    run = make_run(checkpointed=False)
    model = Model.create(jax.random.key(0), run.config, run.facts)
    grid = run.config.sampler.grid
    axis = (np.arange(grid) + 0.5) / grid * 2 - 1
    distance = np.linalg.norm(np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1), axis=-1).reshape(-1)
    radius = RADIUS * run.normalisation.scale
    occupancy = Occupancy.create(0, grid=grid, outer_grid=8, space=BOX, steps=32, possible=np.abs(distance - radius) < 3 / grid)
    field = model.field
    solid = Ball(**vars(field), radius=radius)
    model = replace(model, field=solid, sampler=replace(model.sampler, grid=occupancy))
    assert run.normalisation.bounded and run.normalisation == renderer.normalisation
    return TrainedModel(run, ball_scene[0], model, 0, renderer)


@pytest.fixture
def kernels_run() -> None:
    """For tests of compiled kernels: nothing to test if they are switched off or on a GPU; else they have to run."""
    if os.environ.get(native.SWITCH) == "off" or jax.default_backend() != "cpu":
        pytest.skip(f"no compiled kernels: {native.why_not()}")
    assert native.why_not() is None
