from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np
import pytest

from koala3d.datasets.core.errors import UsageError
from koala3d.reconstruct.errors import ReconstructError
from koala3d.reconstruct.models import load_config
from koala3d.reconstruct.output.trained_model import TrainedModel
from koala3d.reconstruct.rendering.model import Model
from koala3d.reconstruct.run import CHECKPOINTS, Run


def test_a_run_opens_although_its_masks_are_not_read_again(make_run: Callable[..., Run]) -> None:
    """The list of cells that can be occupied is as the masks left it; the state comes back bit for bit."""
    run = make_run()
    trained = TrainedModel.open(run.path)
    occupancy = trained.model.sampler.grid
    possible = np.unique(occupancy.visits)
    assert 0 < len(possible) < run.config.sampler.grid**3
    assert int(occupancy.occupied.sum()) == len(possible)
    fresh = Model.create(jax.random.key(0), run.config, run.facts)
    pairs = zip(jax.tree.leaves(fresh.split()[0]), jax.tree.leaves(trained.model.split()[0]), strict=True)
    assert all(np.array_equal(a, b) for a, b in pairs)


def test_pictures_have_the_size_of_the_training_and_warming_up_compiles_what_they_need(
    make_run: Callable[..., Run], small_config
) -> None:
    trained = TrainedModel.open(make_run(small_config.model_copy(update={"scale": 0.5})).path)
    view = trained.scene.split("test")[0]
    trained.warm_up(view)
    compiled = set(trained.renderer._compiled)
    picture = trained.picture(view)
    assert set(trained.renderer._compiled) == compiled != set()
    assert picture.rgb.shape == (20, 24, 3) and picture.depth.shape == (20, 24, 1)
    assert all(np.isfinite(values).all() for values in vars(picture).values())


def test_what_is_not_a_run_is_said_so(make_run: Callable[..., Run], tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="is not a run"):
        TrainedModel.open(tmp_path)
    with pytest.raises(ReconstructError, match="no checkpoint"):
        TrainedModel.open(make_run(checkpointed=False).path)


def test_another_configuration_does_not_fit(make_run: Callable[..., Run]) -> None:
    run = make_run()
    text = (run.path / "run.json").read_text().replace('"log2_size": 8', '"log2_size": 9')
    (run.path / "run.json").write_text(text)
    with pytest.raises(ReconstructError, match="does not fit the configuration"):
        TrainedModel.open(run.path)
    assert (run.path / CHECKPOINTS).is_dir() and load_config().encoding.log2_size != 8
