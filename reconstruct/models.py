"""The models by name: `configs/models/NAME.yaml`, read into a `Config`.

    about: what it is, in one line
    base: another model, whose presets this one changes (one level deep)
    fast: {values that differ from the defaults, or from the base; overlays: values for kinds of scene}
    paper: {...}

`--set section.key=value` overrides. A value that a person or a model based on another gives holds in every kind of scene. The
same changes may be laid over the configuration of a run (`over_run`). `of_kinds` resolves the overlays.
"""

import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pydantic import Field

from koala3d.datasets.core.errors import UsageError, nearest
from koala3d.datasets.core.schema import Schema, read_yaml, validate
from koala3d.reconstruct.config import Config, Kind, Overlays

PRESETS = ("fast", "paper")
Tree = dict[str, Any]


class ModelFile(Schema):
    """One file of `configs/models`."""

    about: str = Field(description="line that says what the model is")
    base: str | None = Field(default=None, description="Model whose presets this one changes; itself without a base.")
    fast: dict[str, Any] = Field(default={}, description="Changes for a workstation without GPU.")
    paper: dict[str, Any] = Field(default={}, description="Changes for the published sizes.")


def load_config(model: str = "surfnerf", preset: str = "fast", overrides: list[str] | None = None) -> Config:
    """Defaults, then the base's preset, then the model file's, then `key=value` overrides.

    Raises:
        UsageError: unknown model, preset or key (with the nearest valid one), or a value out of range.
    """
    if preset not in PRESETS:
        raise UsageError(f"model {model} has no preset '{preset}'", remedy=nearest(preset, PRESETS))
    changes, content = _read(model, preset)
    if content.base is not None:
        base, below = _read(content.base, preset)
        if below.base is not None:
            raise UsageError(
                f"the base of model {model} has a base itself", where=_path(model), remedy=f"write base: {below.base}"
            )
        changes = laid_over(base, changes)
    return _validated({**changes, "model": model, "preset": preset}, overrides)


def over_run(config: Config, model: str, overrides: list[str] | None = None) -> Config:
    """A run's configuration with the changes of a model file laid over it."""
    changes, _ = _read(model, config.preset)
    return _validated(laid_over(config.model_dump(mode="json"), changes), overrides)


def changed(config: Config, overrides: list[str]) -> Config:
    """A run's configuration with `key=value` overrides."""
    return _validated(config.model_dump(mode="json"), overrides)


def finetuned(config: Config, overrides: list[str] | None = None) -> Config:
    """A run's configuration for going on with the surface regularisers (supplement F), as `configs/models/finetune.yaml` says.

    The encoding keeps the blur that the run ended with, and rays are drawn anew.
    """
    train = config.train
    blur = train.last_blur if train.first_blur else 0.0
    kept = {"seed": train.seed + 1, "first_blur": blur, "last_blur": blur}
    return over_run(merged_config(config, {"train": kept}), "finetune", overrides)


def merged_config(config: Config, changes: Tree) -> Config:
    """A configuration with the values of `changes`, in every kind of scene."""
    return Config.model_validate(laid_over(config.model_dump(), changes))


def of_kinds(config: Config, kinds: Sequence[Kind]) -> Config:
    """The configuration for a scene of these kinds: plain values, and no overlays any more."""
    tree = config.model_dump()
    for kind in kinds:
        tree = merged(tree, tree["overlays"][kind])
    return Config.model_validate({**tree, "overlays": {}, "kinds": tuple(kinds)})


def names() -> list[str]:
    """Names of all models."""
    return sorted(path.stem for path in _folder().glob("*.yaml"))


def overview(preset: str = "fast") -> list[dict[str, Any]]:
    """Per model: name, encoding, appearance, regularisers (names of those with a weight in this preset), about."""
    rows = []
    for name in names():
        config, content = load_config(name, preset), _read(name, preset)[1]
        surface = config.surface
        used = [term for term in ("density", "normal", "bias", "variation") if surface.enabled and getattr(surface, term)]
        row = {"name": name, "encoding": config.encoding.kind, "appearance": config.field.appearance}
        rows.append({**row, "regularisers": used, "about": content.about})
    return rows


def merged(below: Tree, changes: Tree) -> Tree:
    """A tree in which the values of `changes` take the place of those of `below`, section by section."""
    both = {k: merged(below[k], v) if isinstance(v, dict) and isinstance(below.get(k), dict) else v for k, v in changes.items()}
    return {**below, **both}


def laid_over(below: Tree, changes: Tree) -> Tree:
    """`merged`, and what `changes` say of all scenes takes the place of what the overlays of `below` say of some."""
    return merged(_in_all_kinds(below, changes), changes)


def _in_all_kinds(tree: Tree, named: Tree) -> Tree:
    """A configuration whose overlays leave the values that are in `named` alone."""
    return {**tree, "overlays": {kind: _without(overlay, named) for kind, overlay in tree.get("overlays", {}).items()}}


def _without(tree: Tree, named: Any) -> Tree:
    """A tree without the values that are in another."""
    if not isinstance(named, dict):
        return {}
    return {
        k: _without(v, named.get(k, {})) if isinstance(v, dict) else v
        for k, v in tree.items()
        if k not in named or isinstance(v, dict)
    }


def _folder() -> Path:
    from importlib.resources import files

    return Path(str(files("koala3d.configs"))) / "models"


def _path(model: str) -> Path:
    return _folder() / f"{model}.yaml"


def _read(model: str, preset: str) -> tuple[Tree, ModelFile]:
    """The changes of one preset as they are written, and the whole file; each key is known to be a setting."""
    if model not in names():
        raise UsageError(f"there is no model '{model}'", remedy=nearest(model, names()))
    content, lines = read_yaml(_path(model))
    file = validate(content, ModelFile, where=_path(model), lines=lines)
    changes = getattr(file, preset)
    inside = {place[1:]: line for place, line in lines.items() if place[:1] == (preset,)}
    valid = validate(changes, Config, where=f"model {model}, preset {preset}", lines=inside)
    for kind in Overlays.model_fields:
        validate(getattr(valid.overlays, kind), Config, where=f"model {model}, preset {preset}, overlay {kind}")
    return changes, file


def _validated(tree: Tree, overrides: list[str] | None) -> Config:
    named: Tree = {}
    for override in overrides or ():
        keys = override.partition("=")[0].strip().split(".")
        named = merged(named, functools.reduce(lambda inner, key: {key: inner}, reversed(keys[:-1]), {keys[-1]: None}))
    where = "--set" if overrides else f"model {tree['model']}"
    return validate(_in_all_kinds(tree, named), Config, where=where, overrides=overrides or ())
