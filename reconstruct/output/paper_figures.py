"""The figures of the paper's supplement, drawn from the training code and a trained run.

OUT/sphere.png     A.1: directions, samples on their shells, their polar map, density of each shell
OUT/weights.png    B.1: weights along one ray during a new training, and the first surface
OUT/bias.png       C.1: diffuse and specular colour over the visible hemisphere of surface points, and their constant part
OUT/graph.png      D.1: the directions of one surface point, flipped into the hemisphere, with their nearest neighbours
"""

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from koala3d.datasets import pose
from koala3d.datasets.core import files
from koala3d.datasets.core.console import progress
from koala3d.datasets.imaging import images
from koala3d.datasets.scene import View
from koala3d.reconstruct.config import SurfaceConfig
from koala3d.reconstruct.field.appearance import Material
from koala3d.reconstruct.field.cloud import Cloud
from koala3d.reconstruct.field.field import Field
from koala3d.reconstruct.field.lit import Lit
from koala3d.reconstruct.numerics.volume import volume_weights
from koala3d.reconstruct.output.trained_model import TrainedModel
from koala3d.reconstruct.scene.space import Space
from koala3d.reconstruct.surface.ball import ball_samples, shell_radii, sphere_directions
from koala3d.reconstruct.surface.first_surface import first_surface
from koala3d.reconstruct.surface.regularisers import direction_likeness
from koala3d.reconstruct.surface.second_pass import NEIGHBOURS
from koala3d.reconstruct.training.loop import start

STEPS = 600  # steps of the short training for B.1
STATES = 6  # states of that training that are drawn
SAMPLES = 96  # samples along the ray
HEMISPHERE = 2048  # directions over the sphere for C.1
POINTS = 3  # surface points drawn in C.1


def draw_all(trained: TrainedModel, out: Path, *, steps: int = STEPS) -> dict[str, Any]:
    """Write all figures into the new folder `out`; B.1 trains a new model for `steps` steps in memory."""
    files.refuse_existing(out)
    surface = trained.run.config.surface
    point = surface_points(trained)[0]
    with files.atomic_folder(out) as folder:
        figures = {
            "sphere": draw_sphere(surface.samples),
            "weights": draw_weights(*weights_while_training(trained, steps)),
            "bias": draw_bias(trained),
            "graph": draw_graph(point[1], surface.samples, NEIGHBOURS),
        }
        for name, figure in figures.items():
            figure.savefig(folder / f"{name}.png", dpi=140)
    return {"out": str(out), "figures": [str(out / f"{name}.png") for name in figures]}


def draw_sphere(count: int, kappa: float = 0.0) -> Figure:
    """A.1: the lattice on the sphere, on its shells and as a polar map, and the density of each shell."""
    directions, radii = sphere_directions(count, kappa), shell_radii(count)
    figure = Figure(figsize=(16, 4), layout="constrained")
    for index, (title, points) in enumerate((("directions", directions), ("samples on shells", directions * radii[:, None]))):
        axes: Any = figure.add_subplot(1, 4, index + 1, projection="3d")
        axes.scatter(*points.T, c=radii if index else directions[:, 0], cmap="viridis", s=24)
        axes.set(title=title, xlim=(-1, 1), ylim=(-1, 1), zlim=(-1, 1))
        axes.set_box_aspect((1, 1, 1))
    map_axes = figure.add_subplot(143)
    azimuth, elevation = angles_of(directions)
    map_axes.scatter(azimuth, elevation, c=radii, cmap="viridis", s=24)
    map_axes.set(title="polar map", xlabel="azimuth [deg]", ylabel="elevation [deg]", xlim=(-180, 180), ylim=(-90, 90))
    map_axes.grid(alpha=0.3)
    shells, densities = shell_density(radii)
    bars = figure.add_subplot(144)
    bars.bar([f"{shell:.1f}" for shell in shells], densities, color="#2f6fde")
    bars.set(title="samples per unit volume", xlabel="outer radius of the shell", yscale="log")
    return figure


def angles_of(directions: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Azimuth about z and elevation above the xy plane of (n, 3) unit directions [deg]."""
    x, y, z = directions.T
    return np.rad2deg(np.arctan2(y, x)), np.rad2deg(np.arctan2(z, np.hypot(x, y)))


def shell_density(radii: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Outer radius of each shell, and samples per volume between it and the shell inside it."""
    shells, counts = np.unique(radii, return_counts=True)
    inner = np.concatenate([[0.0], shells[:-1]])
    return shells, counts / (4 / 3 * np.pi * (shells**3 - inner**3))


def surface_points(trained: TrainedModel) -> list[tuple[NDArray[np.float32], NDArray[np.float32]]]:
    """(position, unit normal) [scene unit] of a few points that are opaque in the first test view (or the first view)."""
    view = _some_view(trained)
    camera = trained.camera(view)
    picture = trained.picture(view)
    opaque = (picture.opacity[..., 0] > 0.5) & (np.linalg.norm(picture.normals, axis=-1) > 0.5) & (picture.depth[..., 0] > 0)
    box = np.asarray(trained.scene.box)
    in_camera = camera.directions(camera.pixel_centres()) * picture.depth
    world = in_camera @ view.world_from_camera[:3, :3].T + view.world_from_camera[:3, 3]
    opaque &= ((world > box[0]) & (world < box[1])).all(-1)
    rows = np.flatnonzero(opaque.reshape(-1))
    if not len(rows):  # nothing is opaque yet: use the centre of the box
        return [(np.zeros(3, np.float32), np.array([0, 0, 1], np.float32))] * POINTS
    chosen = rows[np.linspace(0, len(rows) - 1, POINTS + 2).astype(int)[1:-1]]
    normalisation = trained.run.normalisation
    scene = ((world.reshape(-1, 3)[chosen] - normalisation.centre) * normalisation.scale).astype(np.float32)
    return list(zip(scene, picture.normals.reshape(-1, 3)[chosen], strict=True))


def weights_while_training(trained: TrainedModel, steps: int) -> tuple[list[int], NDArray, NDArray, NDArray]:
    """Weights along the ray through the middle surface point at `STATES` states of a new training.

    Returns:
        Steps (states); depths (samples) [scene unit]; weights (states, samples); index of the first surface (states).
    """
    position, _ = surface_points(trained)[POINTS // 2]
    view = _some_view(trained)
    normalisation = trained.run.normalisation
    origin = ((view.world_from_camera[:3, 3] - normalisation.centre) * normalisation.scale).astype(np.float32)
    direction = position - origin
    length = float(np.linalg.norm(direction))
    t = np.linspace(0.5, 1.5, SAMPLES).astype(np.float32)
    points = jnp.asarray(origin[:, None] + direction[:, None] * t)
    evaluate = jax.jit(lambda field: _ray_weights(field, points, (t[1] - t[0]) * length, normalisation.space))
    wanted = np.unique(np.geomspace(max(1, steps // 2 ** (STATES - 1)), steps, STATES).astype(int))
    seen, weights = [], []
    with tempfile.TemporaryDirectory() as folder:
        config = trained.run.config.model_copy(update={"train": trained.run.config.train.model_copy(update={"steps": steps})})
        training = start(trained.scene, Path(trained.run.scene_path), config, Path(folder) / "run")
        training.compile()
        with progress("training for the figure", steps, "steps") as shown:
            for target in wanted:
                while training.clock.step < target:
                    before = training.clock.step
                    training.chunk()
                    shown.advance(training.clock.step - before)
                if seen and training.clock.step == seen[-1]:
                    continue  # steps come in chunks
                seen.append(training.clock.step)
                weights.append(np.asarray(evaluate(training.state.model.field)))
    stacked = np.stack(weights)
    rule = "share" if config.schedule.share_from < 1 else "median"  # as the training finds it at last
    first = np.asarray(first_surface(jnp.asarray(stacked), jnp.ones(stacked.shape, bool), rule))
    return seen, t * length, stacked, first


def _ray_weights(field: Field, points, step: float, space: Space):
    density = field.density(Cloud(points, None, space))
    return volume_weights(density[None], jnp.full((1, points.shape[1]), step))[0]


def draw_weights(steps: Sequence[int], depth: NDArray, weights: NDArray, first: NDArray) -> Figure:
    """B.1: one curve per state, the first surface marked, the median weight dashed."""
    figure = Figure(figsize=(3.2 * len(steps), 3), layout="constrained")
    for index, step in enumerate(steps):
        axes = figure.add_subplot(1, len(steps), index + 1)
        axes.step(depth, weights[index], where="mid", color="#2f6fde")
        axes.axvline(float(depth[first[index]]), color="#d98324", label="first surface")
        axes.axhline(np.median(weights[index]), color="grey", linestyle="--", linewidth=0.8, label="median weight")
        top = max(1.05 * weights[index].max(), 1e-3)
        axes.set(title=f"step {step}", xlabel="distance along the ray [scene unit]", ylim=(0, top))
    figure.axes[-1].legend(fontsize=8)
    figure.axes[0].set_ylabel("weight")
    return figure


def hemisphere_colours(trained: TrainedModel, position: NDArray, normal: NDArray) -> dict[str, NDArray]:
    """Radiance of a surface point over its visible hemisphere.

    Returns:
        outward: (n, 3) unit directions away from the surface; specular: (n, 3) linear; diffuse: (3,) linear.
    """
    outward = sphere_directions(HEMISPHERE)
    outward = outward[outward @ normal > 0.02]
    field, space = trained.model.field, trained.run.normalisation.space
    _, material = field(Cloud(jnp.asarray(position, jnp.float32)[:, None], None, space))
    repeated = Material.unstacked(jnp.repeat(material.stacked(), len(outward), axis=1))
    viewdirs = jnp.asarray(-outward.T, jnp.float32)
    places = jnp.broadcast_to(jnp.asarray(position, jnp.float32)[:, None], viewdirs.shape)
    shading = field.shade(repeated, viewdirs, light=Lit.towards(trained.run.facts.light, viewdirs), places=places)
    return {"outward": outward, "specular": np.asarray(shading.specular.T), "diffuse": np.asarray(material.diffuse[:, 0])}


def draw_bias(trained: TrainedModel) -> Figure:
    """C.1: per surface point, the specular colour over the hemisphere, its minimum over directions, and the diffuse colour."""
    points = surface_points(trained)
    figure = Figure(figsize=(13, 3.4 * len(points)), layout="constrained")
    for row, (position, normal) in enumerate(points):
        light = hemisphere_colours(trained, position, normal)
        across, up = _tangents(normal)
        place = np.stack([light["outward"] @ across, light["outward"] @ up], -1)
        constant = light["specular"].min(0)
        specular, diffuse = light["specular"], np.broadcast_to(light["diffuse"], light["specular"].shape)
        panels = {
            "colour": specular + diffuse,
            "specular": specular,
            "specular less its constant part": specular - constant,
            "diffuse": diffuse,
            "diffuse plus that part": diffuse + constant,
        }
        for column, (title, colour) in enumerate(panels.items()):
            axes = figure.add_subplot(len(points), len(panels), row * len(panels) + column + 1)
            axes.scatter(*place.T, c=np.clip(images.srgb_from_linear(np.maximum(colour, 0)), 0, 1), s=40)
            axes.set(title=title, aspect="equal", xticks=[], yticks=[])
    return figure


def draw_graph(normal: NDArray, count: int, neighbours: int, seed: int = 0) -> Figure:
    """D.1: directions flipped into the visible hemisphere and their graph, as a polar map about the normal and from above."""
    drawn, _ = ball_samples(jax.random.key(seed), 1, SurfaceConfig(samples=count))
    directions = np.asarray(drawn[0], np.float64)
    flipped = (directions @ normal) < 0
    visible = np.where(flipped[:, None], -directions, directions)
    across, up = _tangents(normal)
    local = np.stack([visible @ across, visible @ up, visible @ normal], -1)
    likeness = np.asarray(direction_likeness(jnp.asarray(-visible[None], jnp.float32)))[0] - 4 * np.eye(count)
    nearest = np.argsort(-likeness, axis=1)[:, :neighbours]
    azimuth, elevation = angles_of(local)
    figure = Figure(figsize=(11, 4.6), layout="constrained")
    for index, (title, x, y) in enumerate((("polar map", azimuth, elevation), ("from above", local[:, 0], local[:, 1]))):
        axes = figure.add_subplot(1, 2, index + 1)
        for i, others in enumerate(nearest):
            for j in others:
                if index == 1 or abs(x[i] - x[j]) < 180:  # lines across the map's edge are omitted
                    axes.plot([x[i], x[j]], [y[i], y[j]], color="0.8", linewidth=0.8, zorder=0)
        axes.scatter(x[~flipped], y[~flipped], color="#2f6fde", label="as drawn")
        axes.scatter(x[flipped], y[flipped], color="#d98324", label="flipped")
        axes.set_title(f"{title}, {neighbours} nearest, {form}")
    figure.axes[0].set(xlabel="azimuth about the normal [deg]", ylabel="elevation above the surface [deg]")
    figure.axes[1].set(aspect="equal", xlim=(-1.05, 1.05), ylim=(-1.05, 1.05))
    figure.axes[0].legend(fontsize=8)
    return figure


def _tangents(normal: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Two unit vectors perpendicular to a unit normal."""
    rotation = pose.look_at(-np.asarray(normal, np.float64), np.zeros(3), up=(0, 0, 1) if abs(normal[2]) < 0.9 else (0, 1, 0))
    return rotation[:3, 0], -rotation[:3, 1]


def _some_view(trained: TrainedModel) -> View:
    return next((view for view in trained.scene.views if view.split == "test"), trained.scene.views[0])
