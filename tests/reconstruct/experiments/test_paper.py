"""The paper's ablations, each with one change."""

from koala3d.reconstruct.experiments import paper, sweep
from koala3d.reconstruct.models import load_config


def test_each_ablation_changes_one_thing() -> None:
    found = paper.ablations(load_config())
    assert "sampling lattice" not in found and "every 512/4" in found
    forms = {"sampling fibonacci", "sampling random", "every 2048/16", "tangent density", "with variation"}
    without = {"published density", "without hollowness", "without normal", "without bias",
               "no second pass", "no regulariser"}  # fmt: skip
    assert forms | without <= set(found)
    assert found["without bias"] == ("surface.bias=0",)
    off = paper.ablations(load_config(overrides=["surface.bias=0"]))
    assert off["with bias"] == ("surface.bias=0.03",), "what is off is tried with its published weight"
    base = load_config()
    for name, changes in found.items():
        changed = load_config(overrides=list(changes))
        assert changed.surface != base.surface or changed.losses != base.losses, name


def test_their_folders_are_different() -> None:
    folders = {sweep.folder_name(name, None) for name in paper.ablations(load_config())}
    assert len(folders) == len(paper.ablations(load_config())) and not any("/" in folder for folder in folders)
