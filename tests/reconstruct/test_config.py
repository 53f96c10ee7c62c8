from pathlib import Path

import pytest
import yaml

from datasets.errors import Misuse
from reconstruct.config import Config, SurfaceConfig, load_config

PRESETS = ("fast", "paper")
MODELS = sorted(path.stem for path in (Path(__file__).parent.parent.parent / "configs" / "models").glob("*.yaml"))


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("preset", PRESETS)
def test_every_model_loads_in_every_preset_and_survives_being_written(model: str, preset: str) -> None:
    config = load_config(model, preset)
    assert (config.model, config.preset) == (model, preset)
    assert Config.model_validate(yaml.safe_load(yaml.safe_dump(config.model_dump(mode="json")))) == config


def test_the_paper_preset_has_the_published_sizes() -> None:
    config = load_config("surfnerf", "paper")
    assert (config.field.spatial_width, config.field.spatial_depth, config.field.bottleneck) == (128, 2, 256)
    assert (config.field.view_width, config.field.view_depth, config.field.view_skip, config.field.ide_degree) == (
        256,
        3,
        True,
        5,
    )
    assert (config.sampler.proposals, config.sampler.final, config.sampler.multisamples) == ((64, 64), 32, 6)
    surface = config.surface
    assert (surface.density, surface.normal, surface.bias, surface.variation) == (0.1, 0.1, 0.03, 1e-3)
    assert (surface.samples, surface.neighbours, surface.first_period, surface.last_period) == (32, 3, 512, 4)
    assert (config.train.steps, config.train.rate, config.train.final_rate, config.train.warmup) == (25_000, 0.01, 0.001, 0.1)


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
        ("scale.x=1", "no setting 'scale.x'"),
        ("model.x=1", "no setting 'model.x'"),
        ("zzz=1", "valid: "),
        ("=1", "no setting ''"),
        ("train.seed", "not key=value"),
        ("train.seed=[1", "cannot read the value"),
        ("train.seed=many", "train.seed"),
        ("scale=2", "scale"),
        ("surface.density_form=best", "surface.density_form"),
        ("train=5", "train"),
        ("train.rate=.nan", "train.rate"),
        ("train.rate=.inf", "train.rate"),
    ],
)
def test_wrong_overrides_are_refused_in_one_line(override: str, says: str) -> None:
    with pytest.raises(Misuse) as error:
        load_config(overrides=[override])
    assert says in str(error.value)
    assert "\n" not in str(error.value)


def test_a_section_that_was_given_a_number_does_not_break_its_keys() -> None:
    assert load_config(overrides=["train=5", "train.seed=2"]).train.seed == 2


def test_unknown_models_and_presets_name_the_nearest() -> None:
    with pytest.raises(Misuse, match="did you mean 'surfnerf'"):
        load_config("surfnref")
    with pytest.raises(Misuse, match="did you mean 'paper'"):
        load_config("surfnerf", "papr")


def test_a_wrong_key_in_a_model_file_names_the_nearest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "models").mkdir()
    (tmp_path / "models" / "mine.yaml").write_text("fast:\n  encoding: {levles: 3}\n")
    monkeypatch.setattr("importlib.resources.files", lambda package: tmp_path)
    with pytest.raises(Misuse, match=r"model mine, preset fast: there is no setting 'encoding.levles'; did you mean 'levels'"):
        load_config("mine")


def test_every_setting_is_described() -> None:
    for section in Config.model_fields.values():
        for name, field in getattr(section.annotation, "model_fields", {}).items():
            assert field.description, name
    assert SurfaceConfig.model_fields["neighbours"].description
