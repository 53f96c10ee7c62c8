from pathlib import Path
from typing import Any

import pytest
import yaml

from koala3d.datasets.core.errors import UsageError
from koala3d.reconstruct.config import Config, Kind, LossConfig
from koala3d.reconstruct.models import load_config, merged, names, of_kinds, over_run, overview

PRESETS = ("fast", "paper")
MODELS = names()


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("preset", PRESETS)
def test_every_model_loads_in_every_preset_and_survives_being_written(model: str, preset: str) -> None:
    config = load_config(model, preset)
    assert (config.model, config.preset) == (model, preset)
    assert Config.model_validate(yaml.safe_load(yaml.safe_dump(config.model_dump(mode="json")))) == config


def test_overlays_are_laid_over_for_a_kind_of_scene() -> None:
    config = load_config()
    among = of_kinds(config, ["surroundings"])
    assert (among.field.density_bias, among.field.roughness_bias, among.losses.fog) == (-3.5, -3, 0.01)
    assert among.kinds == ("surroundings",) and not any(among.overlays.model_dump().values())
    again = of_kinds(among, ["blank"])
    assert again.light == among.light, "a decided configuration has no overlays"


@pytest.mark.parametrize("kinds", [("blank",), ("surroundings", "unnamed"), ("blank", "matte")])
def test_what_a_person_sets_holds_in_every_kind_of_scene(kinds: tuple[Kind, ...]) -> None:
    given = ["field.bottleneck=5", "sampler.optical_depth=0.02", "losses.fog=0.3", "train.last_blur=0.004"]
    config = of_kinds(load_config(overrides=given), kinds)
    values = config.field.bottleneck, config.sampler.optical_depth, config.losses.fog, config.train.last_blur
    assert values == (5, 0.02, 0.3, 0.004)
    assert of_kinds(load_config("zip_refnerf_published"), kinds).light.parallax is None, "a model file's values too"


def test_the_paper_preset_has_the_published_sizes() -> None:
    config = load_config("surfnerf", "paper")
    assert (config.field.spatial_width, config.field.spatial_depth, config.field.bottleneck) == (128, 2, 256)
    assert (config.field.view_width, config.field.view_depth, config.field.view_skip, config.field.ide_degree) == (
        256,
        3,
        2,
        5,
    )
    assert (config.sampler.proposals, config.sampler.final, config.sampler.frustum) == ((64, 64), 32, "hexagon")
    surface = config.surface
    assert (surface.density, surface.normal, surface.bias, surface.variation) == (0.1, 0.1, 0.03, 1e-3)
    assert (surface.samples, surface.first_period, surface.last_period) == (32, 512, 4)
    assert (config.train.steps, config.train.rate, config.train.final_rate) == (25_000, 0.01, 0.001)
    assert config.schedule.warmup == 0.1


@pytest.mark.parametrize(
    ("override", "key", "value"),
    [
        ("train.seed=3", "train.seed", 3),
        ("train.rate=1e-3", "train.rate", 1e-3),
        ("scale=0.5", "scale", 0.5),
        ("surface.enabled=false", "surface.enabled", False),
        ("surface.density_form=published", "surface.density_form", "published"),
        ("sampler.proposals=[32, 16]", "sampler.proposals", (32, 16)),
        (" train.steps = 7", "train.steps", 7),
    ],
)
def test_overrides_take_the_setting_s_type(override: str, key: str, value: object) -> None:
    found = load_config(overrides=[override])
    for name in key.split("."):
        found = getattr(found, name)
    assert found == value
    assert type(found) is type(value)


def test_later_overrides_win_and_leave_the_rest_of_the_preset() -> None:
    config = load_config("surfnerf", "paper", ["encoding.levels=3", "encoding.levels=4"])
    assert config.encoding.levels == 4
    assert config.encoding.log2_size == load_config("surfnerf", "paper").encoding.log2_size


@pytest.mark.parametrize(
    ("override", "says"),
    [
        ("train.stesp=3", "did you mean 'steps'"),
        ("surfface.rays=3", "did you mean 'surface'"),
        ("scale.x=1", "key 'scale'"),
        ("model.x=1", "has no keys inside"),
        ("zzz=1", "valid: "),
        ("=1", "is not an override"),
        ("train.seed", "is not an override"),
        ("train.seed=[1", "not valid YAML"),
        ("train.seed=many", "train.seed"),
        ("scale=2", "scale"),
        ("surface.density_form=best", "surface.density_form"),
        ("train=5", "train"),
        ("train.rate=.nan", "train.rate"),
        ("train.rate=.inf", "train.rate"),
    ],
)
def test_wrong_overrides_are_refused_in_one_line(override: str, says: str) -> None:
    with pytest.raises(UsageError) as error:
        load_config(overrides=[override])
    assert says in str(error.value)
    assert "\n" not in str(error.value)


def test_unknown_models_and_presets_name_the_nearest() -> None:
    with pytest.raises(UsageError, match="did you mean 'surfnerf'"):
        load_config("surfnref")
    with pytest.raises(UsageError, match="did you mean 'paper'"):
        load_config("surfnerf", "papr")


def test_a_wrong_key_in_a_model_file_names_the_nearest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "models").mkdir()
    (tmp_path / "models" / "mine.yaml").write_text("about: mine\nfast:\n  encoding: {levles: 3}\n")
    monkeypatch.setattr("importlib.resources.files", lambda package: tmp_path)
    with pytest.raises(
        UsageError, match=r"model mine, preset fast, line 3: unknown key 'encoding.levles'; did you mean 'levels'"
    ):
        load_config("mine")


def test_a_base_must_be_a_model_without_base(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "models").mkdir()
    for name, base in {"one": "", "two": "base: one", "three": "base: two", "four": "base: oen"}.items():
        (tmp_path / "models" / f"{name}.yaml").write_text(f"about: {name}\n{base}\nfast:\n  train: {{seed: 1, steps: 7}}\n")
    (tmp_path / "models" / "two.yaml").write_text("about: two\nbase: one\nfast:\n  train: {seed: 2}\n")
    monkeypatch.setattr("importlib.resources.files", lambda package: tmp_path)
    config = load_config("two")
    assert (config.model, config.train.seed, config.train.steps) == ("two", 2, 7)
    with pytest.raises(UsageError, match="the base of model three has a base itself; write base: one"):
        load_config("three")
    with pytest.raises(UsageError, match="did you mean 'one'"):
        load_config("four")


def test_merging_replaces_values_and_keeps_what_is_not_named() -> None:
    assert merged({"a": {"b": 1, "c": 2}, "d": 3}, {"a": {"b": {"e": 4}}}) == {"a": {"b": {"e": 4}, "c": 2}, "d": 3}


def test_the_rows_of_the_paper_s_table() -> None:
    """Encoding, appearance and whether regularised, as the paper's table has them."""
    rows = {row["name"]: (row["encoding"], row["appearance"], bool(row["regularisers"])) for row in overview("paper")}
    assert rows == {
        "mipnerf": ("frequencies", "view", False),
        "mipnerf_diffuse": ("frequencies", "view_diffuse", False),
        "refnerf": ("frequencies", "reflection", False),
        "surfnerf_pe": ("frequencies", "reflection", True),
        "zipnerf": ("voxels", "view", False),
        "zip_refnerf": ("voxels", "reflection", False),
        "lattice_refnerf": ("lattice", "reflection", False),
        "surfnerf_voxels": ("voxels", "reflection", True),
        "surfnerf": ("lattice", "reflection", True),
        "finetune": ("lattice", "reflection", True),
        "refnerf_published": ("frequencies", "reflection", False),
        "zipnerf_published": ("voxels", "view", False),
        "zip_refnerf_published": ("voxels", "reflection", False),
    }


@pytest.mark.parametrize(
    ("model", "changed"),
    [
        ("refnerf", {"losses.predicted_normals", "losses.density_normals"}),
        ("zipnerf", {"losses.width", "losses.hollowness"}),
        (
            "zip_refnerf",
            {"losses.width", "losses.hollowness", "losses.predicted_normals", "losses.density_normals", "field.bottleneck"}
            | {"losses.last_density_normals", "surface.normal_factor", "skip.reflection"},
        ),
    ],
)
def test_published_baselines_lack_what_is_ours_and_nothing_else(model: str, changed: set[str]) -> None:
    ours, published = flat(load_config(model)), flat(load_config(f"{model}_published"))
    assert {key for key in ours if ours[key] != published[key] and not key.startswith("overlays")} == changed | {"model"}
    assert published["losses.hollowness"] == 0 and published["field.bottleneck"] > 0
    if ours["field.appearance"] == "reflection":
        defaults = LossConfig()
        assert published["losses.predicted_normals"] == defaults.predicted_normals == defaults.density_normals
        assert published["losses.density_normals"] == defaults.density_normals
    large, the_same = flat(load_config(model, "paper")), flat(load_config(f"{model}_published", "paper"))
    assert {key for key in large if large[key] != the_same[key]} == {"model"}


def flat(config: Config) -> dict[str, Any]:
    """Settings by their full names."""
    parts = config.model_dump()
    whole = {name: value for name, value in parts.items() if not isinstance(value, dict)}
    return whole | {
        f"{name}.{key}": value for name, part in parts.items() if isinstance(part, dict) for key, value in part.items()
    }


@pytest.mark.parametrize("model", MODELS)
def test_ipe_models_have_the_published_schedule(model: str) -> None:
    """2^14 rays for 250,000 steps on positional encoding, 2^16 for 25,000 on grids; second passes 2048/16 and 512/4."""
    config = load_config(model, "paper")
    if config.encoding.kind == "frequencies":
        assert (config.sampler.rays, config.train.steps, config.encoding.levels) == (2**14, 250_000, 16)
        assert not config.surface.enabled or (config.surface.first_period, config.surface.last_period) == (2048, 16)
    elif model != "finetune":
        assert (config.sampler.rays, config.train.steps) == (2**16, 25_000)
        assert (config.surface.first_period, config.surface.last_period) == (512, 4)


def test_changes_are_laid_over_a_run_s_own_values() -> None:
    run = load_config("zipnerf", overrides=["encoding.levels=3"])
    tuned = over_run(run, "finetune", ["train.steps=5"])
    assert (tuned.model, tuned.encoding.levels, tuned.field.appearance) == ("zipnerf", 3, "view")
    assert (tuned.train.rate, tuned.train.final_rate, tuned.train.steps) == (3.25e-4, 3.25e-4, 5)
    assert tuned.surface.enabled and not run.surface.enabled
