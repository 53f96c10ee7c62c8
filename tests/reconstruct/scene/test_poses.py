import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from koala3d.datasets import pose
from koala3d.datasets.core.console import progress
from koala3d.datasets.core.errors import DatasetError
from koala3d.datasets.scene import TURNED, Scene, View
from koala3d.reconstruct.config import Config
from koala3d.reconstruct.models import merged_config
from koala3d.reconstruct.output.trained_model import TrainedModel
from koala3d.reconstruct.run import Run
from koala3d.reconstruct.sampling.hull import cells_in_masks
from koala3d.reconstruct.scene import poses
from koala3d.reconstruct.scene.facts import SceneFacts
from koala3d.reconstruct.scene.rays import Normalisation, Pixels, Rays, view_rays
from koala3d.reconstruct.scene.twists import moved
from koala3d.reconstruct.training import batches, objective, optimiser, schedule
from koala3d.reconstruct.training.step import Step, TrainState
from tests import drawn
from tests.reconstruct.two_sessions import SHIFT_M, TURN_RAD, of_two_sessions
from tests.small import Trainable

SIGMA_M, SIGMA_RAD, STEPS = 2e-3, 4e-3, 100
REFINED = {"poses": {"enabled": True, "sigma_m": SIGMA_M, "sigma_rad": SIGMA_RAD}}


@pytest.fixture
def config(small_config: Config, monkeypatch: pytest.MonkeyPatch) -> Config:
    """A training of 40 steps that refines poses, from the first step at a constant rate."""
    monkeypatch.setattr(schedule, "POSES_FROM", 0.0)
    monkeypatch.setattr(schedule, "POSE_RATE", 5.0)
    monkeypatch.setattr(schedule, "LAST_POSE_RATE", 5.0)
    tree = {
        "train": {"steps": 40},
        "sampler": {"rays": 128, "samples": 2048},
        "surface": {"rays": 16, "first_period": 16, "last_period": 4},
    }
    return merged_config(small_config, tree | REFINED)


def perturbed(views: tuple[View, ...], seed: int = 0) -> tuple[View, ...]:
    """Views whose poses are off by one standard deviation along each axis."""
    rng = np.random.default_rng(seed)
    twists = rng.normal(size=(len(views), 6)) * ([SIGMA_M] * 3 + [SIGMA_RAD] * 3)
    return tuple(
        replace(view, world_from_camera=poses.corrected(view.world_from_camera, twist, 1.0))
        for view, twist in zip(views, twists, strict=True)
    )


def test_a_corrected_pose_sees_the_moved_rays(ball_scene: tuple[Scene, Path]) -> None:
    """Poses in float64 and rays in float32 on the device are two ways to one place."""
    scene = ball_scene[0]
    view, normalisation = scene.views[1], Normalisation.of(scene)
    twist = np.array([0.03, -0.02, 0.05, 0.1, -0.2, 0.15])
    origins, directions, radii = view_rays(view, normalisation)
    rays = Rays(*map(drawn.array, (origins, directions, radii)), drawn.array(np.zeros(len(radii)), np.int32))
    found = jax.jit(moved)(rays, np.float32(twist[None]))
    after = replace(view, world_from_camera=poses.corrected(view.world_from_camera, twist, normalisation.scale))
    expected = view_rays(after, normalisation)
    np.testing.assert_allclose(found.origins, expected[0], atol=1e-6)
    np.testing.assert_allclose(found.directions, expected[1], atol=1e-6)
    changed = poses.change(view, after, scene.box)
    assert changed["turned_deg"] == pytest.approx(np.rad2deg(np.linalg.norm(twist[3:])))
    assert changed["moved_mm"] == pytest.approx(
        1e3 * np.linalg.norm(after.world_from_camera[:3, 3] - view.world_from_camera[:3, 3])
    )
    assert changed["moved_px"] > 70 * 0.1, "0.27 rad move the object by more than a tenth of the focal length"


def learned_alone(
    painted: TrainedModel,
    true: tuple[View, ...],
    views: tuple[View, ...],
    config: Config,
    facts: SceneFacts,
    monkeypatch: pytest.MonkeyPatch,
) -> TrainState:
    """After steps in which poses move alone: the field is true, and pictures, taken from `true` poses, are given to `views`."""
    pictures = np.concatenate([np.asarray(painted.picture(view).rgb).reshape(-1, 3) for view in true])
    with progress("reading", len(views)) as shown:
        pixels = Pixels.load(views, facts.normalisation, 1.0, shown)
    colour = np.concatenate([pictures, np.ones_like(pictures[:, :1])], -1)
    pixels = eqx.tree_at(lambda p: p.colour, pixels, jnp.asarray(colour, jnp.float16))
    for name in ("POSE_RATE", "LAST_POSE_RATE"):
        monkeypatch.setattr(schedule, name, 0.05 / 1e-12)
    wide = {
        "sampler": {"rays": 1024, "samples": 8192, "max_per_ray": 12},
        "surface": {"enabled": False},
        "train": {"rate": 1e-12, "final_rate": 1e-12},
    }
    one_step = Step.of(merged_config(config, wide), facts)
    fresh = one_step.initial(jax.random.key(0), None, len(views))
    sampler = replace(fresh.model.sampler, grid=painted.model.sampler.grid)
    model = jax.tree.map(jnp.asarray, replace(fresh.model, field=painted.model.field, sampler=sampler))
    state = replace(fresh, model=model, optimiser=one_step.optimiser.begin(model.split()[0]))
    # white is behind the pictures, which carry no alpha here
    monkeypatch.setattr(objective.jax.random, "uniform", _white(jax.random.uniform))
    trainable = Trainable(one_step, pixels, state, one_step.compiled(state, pixels))
    state, lines = trainable.trained(STEPS, second=lambda _: False, done=lambda i: i / STEPS)
    assert int(state.skipped) == 0 and lines[-1]["mse"] < 1e-3
    return state


def test_perturbed_poses_are_recovered_from_the_pictures(
    painted: TrainedModel, config: Config, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The true field, pictures of it from true poses, and poses that are off: steps of the training itself bring them back.

    What remains is of the gauge (seven of 24 directions, in which the perturbation is kept) and of 40 x 48 pixels.
    """
    true = painted.scene.split("train")
    views, normalisation = perturbed(true), painted.run.normalisation
    state = learned_alone(painted, true, views, config, SceneFacts(normalisation), monkeypatch)
    found = [
        poses.corrected(v.world_from_camera, t, normalisation.scale)
        for v, t in zip(views, np.asarray(state.model.poses), strict=True)
    ]
    box = painted.scene.box
    before = [poses.change(a, b, box)["moved_px"] for a, b in zip(true, views, strict=True)]
    after = [
        poses.change(a, replace(b, world_from_camera=f), box)["moved_px"] for a, b, f in zip(true, views, found, strict=True)
    ]
    assert np.mean(before) > 0.4 and np.mean(after) < 0.5 * np.mean(before), (before, after)


def test_a_second_session_moves_as_one(ball_scene: tuple[Scene, Path], tmp_path: Path) -> None:
    scene = of_two_sessions(ball_scene[0])
    normalisation, stated = Normalisation.of(scene), scene.provenance[TURNED]
    facts = SceneFacts(normalisation, session=poses.session_of(scene, normalisation))
    assert SceneFacts.from_json(json.loads(json.dumps(facts.to_json()))) == facts
    session = facts.free_session
    assert session is not None and not session.twists.any() and not session.spread[:2].any()
    assert poses.session_of(ball_scene[0], normalisation) is None and SceneFacts(normalisation).free_session is None
    session = replace(session, by=jnp.array([3.0, -2, 1, 2, 1, -3]))
    moved_all = poses.refined(scene, normalisation, None, session)
    one_by_one = poses.refined(ball_scene[0], normalisation, session.twists)
    motions = []
    for old, new, other in zip(scene.views, moved_all.views, one_by_one.views, strict=True):
        motion = new.world_from_camera @ pose.inverse(old.world_from_camera)
        if old.name not in stated["views"]:
            assert new is old
            continue
        motions.append(motion)
        if old.split == "train":
            np.testing.assert_allclose(new.world_from_camera, other.world_from_camera, atol=1e-6)
    assert len(motions) == 3 and np.ptp(motions, axis=0).max() < 1e-12  # of a test view too
    poses.write(tmp_path, scene, normalisation, None, session)
    said = poses.read(tmp_path)
    assert said[TURNED]["in_deviations"] == pytest.approx(np.sqrt(28 / 6)) and said[TURNED].keys() == poses.OF_SESSION.keys()
    np.testing.assert_allclose(said[TURNED]["a_from_b"], motions[0], atol=1e-12)
    assert said[TURNED]["moved_mm"] == pytest.approx(1e3 * SHIFT_M * np.sqrt(14)) and "gauge" not in said
    assert said[TURNED]["turned_deg"] == pytest.approx(np.rad2deg(TURN_RAD) * np.sqrt(14))
    assert "the object's motion between both sessions was corrected by 1.87 mm" in poses.summary(tmp_path)


def test_a_second_session_that_is_off_is_pulled_back(
    painted: TrainedModel, config: Config, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each of the six numbers is off by three stated deviations; nothing else moves, and pictures are of the true poses."""
    scene = of_two_sessions(painted.scene)
    normalisation, true = painted.run.normalisation, scene.split("train")
    facts = SceneFacts(normalisation, session=poses.session_of(scene, normalisation))
    off = np.array([3.0, -3, 3, 3, -3, -3])
    session = replace(facts.free_session, by=jnp.asarray(-off, jnp.float32))
    views = poses.refined(scene, normalisation, None, session).split("train")
    settled = merged_config(config, {"poses": {"enabled": False}})
    state = learned_alone(painted, true, views, settled, facts, monkeypatch)
    left = np.asarray(state.model.session.by) - off
    assert np.sqrt(np.mean(left**2)) < 0.15 * 3, left
    assert not np.asarray(state.model.twists)[:2].any()


def _white(uniform: Callable) -> Callable:
    """Random numbers, but ones where colours of backgrounds are drawn."""
    return lambda key, shape=(), *args, **kwargs: (
        jnp.ones(shape) if len(shape) == 2 and shape[-1] == 3 else uniform(key, shape, *args, **kwargs)
    )


def test_a_disabled_refinement_costs_nothing(
    ball_scene: tuple[Scene, Path], config: Config, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without refinement the step is the same program, instruction for instruction, as one that cannot refine."""
    disabled, facts = merged_config(config, {"poses": {"enabled": False}}), SceneFacts(Normalisation.of(ball_scene[0]))
    one_step = Step.of(disabled, facts)
    state = one_step.initial(jax.random.key(0), None, 4)
    assert state.model.poses is None
    with progress("reading", 4) as shown:
        pixels = Pixels.load(ball_scene[0].split("train"), facts.normalisation, 1.0, shown)
    counts = (jnp.asarray(0), jnp.asarray(0.5))

    def stages() -> list[str]:
        begun, part = jax.make_jaxpr(one_step.begun, return_shape=True)(
            state.model, state.step, pixels, *counts, jnp.asarray(True)
        )
        descended = jax.make_jaxpr(one_step.descended)(state, part, pixels.origins, counts[1], counts[0])
        return [str(begun), str(descended)]

    complete = stages()
    monkeypatch.setattr(batches, "moved", lambda rays, twists: rays)
    monkeypatch.setattr(objective, "followed", lambda rays, twists: rays)
    monkeypatch.setattr(optimiser, "without_gauge", None)
    assert stages() == complete


def test_refined_poses_are_written_down(ball_scene: tuple[Scene, Path], tmp_path: Path) -> None:
    scene, normalisation = ball_scene[0], Normalisation.of(ball_scene[0])
    twists = drawn.array(np.random.default_rng(0).normal(size=(4, 6)) * 0.01)
    poses.write(tmp_path, scene, normalisation, twists)
    content, given, better = (
        poses.read(tmp_path),
        scene.split("train"),
        poses.refined(scene, normalisation, twists).split("train"),
    )
    assert [view["name"] for view in content["views"]] == [view.name for view in given]
    for view, old, new in zip(content["views"], given, better, strict=True):
        stored = view["world_from_camera"]
        read = pose.from_quaternion(stored["quaternion_wxyz"], stored["translation_m"])
        np.testing.assert_allclose(read, new.world_from_camera, atol=1e-12)
        distance, angle = pose.difference(old.world_from_camera, new.world_from_camera)
        assert view["moved_mm"] == pytest.approx(1e3 * distance) and view["turned_deg"] == pytest.approx(np.rad2deg(angle))
        assert set(content["definitions"]) == view.keys() - {"name"}
    assert "poses of 4 training views were refined by" in poses.summary(tmp_path)
    for old, new in zip(scene.split("test"), poses.refined(scene, normalisation, twists).split("test"), strict=True):
        assert new is old, "views that nobody trained on keep their poses"
    with pytest.raises(DatasetError, match="scene has changed"):
        poses.refined(scene.with_views(scene.views[2:]), normalisation, twists)


def test_poses_that_were_not_refined_are_those_given(make_run: Callable[..., Run]) -> None:
    trained = TrainedModel.open(make_run().path)
    assert poses.summary(trained.run.path) == "" and poses.read(trained.run.path) is None
    for old, new in zip(trained.run.scene().views, trained.scene.views, strict=True):
        np.testing.assert_array_equal(old.world_from_camera, new.world_from_camera)


def test_masks_rule_out_less_where_cameras_may_have_moved(ball_scene: tuple[Scene, Path], config: Config) -> None:
    """Cameras moved by five standard deviations cut off what the true ones see; with that slack the hull keeps it."""
    scene = ball_scene[0]
    config = merged_config(config, {"poses": {"sigma_m": SIGMA_M / 5, "sigma_rad": SIGMA_RAD / 5}})
    views, normalisation = scene.split("train"), Normalisation.of(scene)
    away = tuple(
        replace(
            view,
            world_from_camera=poses.corrected(view.world_from_camera, sign * np.array([SIGMA_M, 0, 0, 0, SIGMA_RAD, 0]), 1.0),
        )
        for view, sign in zip(views, (1, -1, 1, -1), strict=True)
    )
    with progress("reading", len(views)) as shown:
        pixels = Pixels.load(views, normalisation, 1.0, shown)
    true, cut, kept = (
        cells_in_masks(pixels, those, normalisation, 64, 1.0, slack=slack)
        for those, slack in ((views, None), (away, None), (away, poses.slack(config.poses, normalisation, scene)))
    )
    lost, still_lost = (true & ~cut).sum(), (true & ~kept).sum()
    assert lost > 1000 and still_lost < lost / 10, "the hull ends at whole pixels: some cells at its very edge change sides"
    assert kept.sum() < 0.9 * kept.size, "it still rules out"
    settled = merged_config(config, {"poses": {"enabled": False}}).poses
    assert poses.slack(settled, normalisation, scene) == [(0, 0)] * 4
    away, turned = np.array(poses.slack(settled, normalisation, of_two_sessions(scene), free=True)).T
    assert not turned.any() and not away[:2].any() and (away[2:] > 5 * normalisation.scale * SHIFT_M).all()
