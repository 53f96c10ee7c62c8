"""The ball, whose field is known, as splats."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.imaging import images
from koala3d.reconstruct.cli import main
from koala3d.reconstruct.field.appearance import Material, Shading
from koala3d.reconstruct.field.lit import Lit
from koala3d.reconstruct.numerics.safe import srgb_from_linear
from koala3d.reconstruct.output import commands
from koala3d.reconstruct.output.trained_model import TrainedModel
from koala3d.reconstruct.scene.light import LightFrame
from koala3d.reconstruct.splats import colours, harmonics, splats
from koala3d.reconstruct.splats.surfels import cover
from tests.reconstruct.conftest import CENTRE, DIFFUSE, RADIUS, SPECULAR, Ball

PLAIN = images.srgb_from_linear(DIFFUSE + SPECULAR)


class Turned(Ball):
    """The ball with a colour that changes with the direction, and with no other direction in the same way."""

    def shade(
        self,
        material: Material,
        viewdirs: jax.Array,
        normals: jax.Array | None = None,
        light: Lit | None = None,
        places: jax.Array | None = None,
    ) -> Shading:
        rgb = 0.5 + 0.25 * viewdirs * jnp.array([[1.0], [0.6], [-0.8]])
        return Shading(rgb, 0 * srgb_from_linear(rgb))


@pytest.fixture
def turned(ball: TrainedModel) -> TrainedModel:
    field = ball.model.field
    solid = Turned(**vars(field))
    return replace(ball, model=replace(ball.model, field=solid))


def surface(ball: TrainedModel) -> trimesh.Trimesh:
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=RADIUS)
    sphere.apply_translation(CENTRE)
    return sphere


def test_splats_have_the_models_colour_in_each_direction(turned: TrainedModel) -> None:
    surfels = cover(surface(turned), 300)
    found, seen = colours.coefficients(turned, surfels)
    eye = turned.scene.split("train")[1].world_from_camera[:3, 3]
    towards = surfels.points - eye
    towards /= np.linalg.norm(towards, axis=-1, keepdims=True)
    front = seen & (np.sum(towards * surfels.normals, -1) < -0.3)
    assert front.sum() > 50
    expected = 0.5 + 0.25 * towards * [1.0, 0.6, -0.8]
    assert np.abs(harmonics.colour(found, towards) - expected)[front].max() < 0.05  # a wrong sign is off by 0.2


def test_what_no_camera_sees_has_the_colour_of_its_neighbour(ball: TrainedModel) -> None:
    surfels = cover(surface(ball), 300)
    found, seen = colours.coefficients(ball, surfels)
    assert 0.3 < seen.mean() < 1
    frontal = harmonics.colour(found, -surfels.normals)
    assert np.abs(frontal - PLAIN)[seen].max() < 0.02 and np.abs(frontal - PLAIN)[~seen].max() < 0.05


def test_vantage_points_lie_between_the_cameras(ball: TrainedModel) -> None:
    places = colours.vantage_points(ball.scene)
    cameras = np.stack([view.world_from_camera[:3, 3] for view in ball.scene.split("train")])
    low, high = (limit(np.linalg.norm(cameras - CENTRE, axis=-1)) for limit in (np.min, np.max))
    distances = np.linalg.norm(places - CENTRE, axis=-1)
    assert len(places) == colours.PLACES and low <= distances.min() + 1e-9 and distances.max() - 1e-9 <= high


def test_the_command_writes_them_in_the_base(
    ball: TrainedModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(commands, "opened", lambda run: ball)
    monkeypatch.setattr(splats.extraction, "extract", lambda trained, **_: surface(trained))
    words = ["reconstruct", "splats", str(ball.run.path), "--out", str(tmp_path / "ball.ply"), "--count", "400", "--json"]
    monkeypatch.setattr(sys, "argv", words)
    for code in (0, 2):  # the second time the file is there
        with pytest.raises(SystemExit) as stop:
            main()
        assert int(stop.value.code or 0) == code
        if code == 0:
            said = json.loads(capsys.readouterr().out)
            assert 300 < said["splats"] <= 400 and said["metric"] and said["surroundings"] == "none"
    assert "ball.ply" in capsys.readouterr().err
    points = trimesh.load(tmp_path / "ball.ply").vertices
    assert np.abs(np.linalg.norm(points - CENTRE, axis=-1) - RADIUS).max() < 1e-3


def test_lamps_that_move_are_refused(ball: TrainedModel, monkeypatch: pytest.MonkeyPatch) -> None:
    run = replace(ball.run, facts=replace(ball.run.facts, light=LightFrame("camera", (0.0, 0.0, 1.0), 1.0)))
    with pytest.raises(UsageError, match="lamps move"):
        splats.make(replace(ball, run=run), count=100)
