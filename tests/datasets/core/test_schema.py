"""Every mistake in a YAML file becomes one line that names the place and the way out."""

from typing import Annotated, Literal

import pytest
from pydantic import Field

from koala3d.datasets.core.errors import UsageError
from koala3d.datasets.core.schema import Schema, load_yaml


class _Orbit(Schema):
    kind: Literal["orbit"]
    radius: float = Field(gt=0, description="distance to the middle [m]")


class _Grid(Schema):
    kind: Literal["grid"]
    spacing: float = 0.1


class _Plan(Schema):
    speed: float = 1.0
    views: list[Annotated[_Orbit | _Grid, Field(discriminator="kind")]] = Field(default_factory=list)
    camera: _Grid | None = None


def _load(tmp_path, text, **options):
    path = tmp_path / "plan.yaml"
    path.write_text(text)
    return load_yaml(path, _Plan, **options)


def test_a_good_file_is_read_with_defaults(tmp_path):
    plan = _load(tmp_path, "views:\n - kind: orbit\n   radius: 1e-1\n")
    assert plan.speed == 1.0 and plan.views == [_Orbit(kind="orbit", radius=0.1)]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("speed: 1\nspede: 2\n", ["line 2", "unknown key 'spede'", "did you mean 'speed'?"]),
        ("speed: 1\n\nspeed: 2\n", ["line 3", "key 'speed' is given twice", "first in line 1"]),
        ("views:\n - kind: orbit\n   radus: 1\n", ["line 3", "unknown key 'views.0.radus'", "'radius'"]),
        ("views:\n - kind: orbit\n   radius: 1\n   spacing: 1\n", ["line 4", "views.0.spacing", "valid: kind, radius"]),
        ("views:\n - kind: orbit\n", ["line 2", "key 'views.0.radius' is missing", "distance to the middle [m]"]),
        ("views:\n - kind: orbit\n   radius: -1\n", ["line 3", "views.0.radius", "greater than 0", "given: -1"]),
        ("views:\n - kind: obit\n", ["line 2", "views.0", "'obit'"]),
        ("speed: fast\n", ["line 1", "'speed'", "given: 'fast'"]),
        ("speed: .nan\n", ["line 1", "finite"]),
        ("a: [1\nb: 2\n", ["not valid YAML", "line 2"]),
        ("- 1\n", ["holds no keys"]),
        ("", ["holds no keys"]),
        ("speed: !!python/object/apply:os.system [ls]\n", ["not valid YAML"]),
    ],
)
def test_mistakes(tmp_path, text, expected):
    with pytest.raises(UsageError) as caught:
        _load(tmp_path, text)
    message = str(caught.value)
    assert "\n" not in message and "plan.yaml" in message and caught.value.exit_code == 2
    assert [part for part in expected if part not in message] == []


def test_a_missing_file_names_its_neighbour(tmp_path):
    (tmp_path / "plan.yaml").write_text("speed: 1\n")
    with pytest.raises(UsageError, match=r"did you mean 'plan.yaml'"):
        load_yaml(tmp_path / "plans.yaml", _Plan)


def test_overrides_and_their_mistakes(tmp_path):
    assert _load(tmp_path, "speed: 1\n", overrides=["speed=2", "camera.kind=grid", "speed=3"]).speed == 3
    assert _load(tmp_path, "speed: 1\n", overrides=["camera={kind: grid, spacing: 2}"]).camera.spacing == 2
    for override in ("speed", "spede=1", "speed.x=1", "speed=[1"):
        with pytest.raises(UsageError):
            _load(tmp_path, "speed: 1\n", overrides=[override])


def test_overrides_reach_into_lists_by_number(tmp_path):
    text = "views:\n - kind: orbit\n   radius: 1\n - kind: grid\n"
    plan = _load(tmp_path, text, overrides=["views.1.spacing=3", "views.0={kind: grid}", "views.0.spacing=2"])
    assert [view.spacing for view in plan.views] == [2, 3]
    for override in ("views.2.spacing=1", "views.-1.spacing=1", "views.first.spacing=1"):
        with pytest.raises(UsageError, match=r"no such item \('(2|-1|first)' in a list of 2\); items are numbered from 0 to 1"):
            _load(tmp_path, text, overrides=[override])
    with pytest.raises(UsageError, match=r"in a list of 0\); write the whole list"):
        _load(tmp_path, "views: []\n", overrides=["views.0.spacing=1"])
