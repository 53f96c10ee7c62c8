"""The listings name every setting, in the form that `--set` takes."""

import pytest

from koala3d.reconstruct import listing
from koala3d.reconstruct.models import load_config


def test_every_listed_default_is_accepted_by_set_and_changes_nothing() -> None:
    config = load_config("zip_refnerf", "paper")
    rows = listing.settings(config)
    lines = listing.settings_text(rows).splitlines()
    assert len(lines) == len(rows) + 1 > 80 and all(row["meaning"] for row in rows)
    again = load_config("zip_refnerf", "paper", [f"{row['key']}={listing._shown(row['default'])}" for row in rows])
    for row, same in zip(rows, listing.settings(again), strict=True):
        assert same["default"] == (
            pytest.approx(row["default"], rel=1e-5) if isinstance(row["default"], float) else row["default"]
        )


@pytest.mark.parametrize(
    ("key", "kind", "default"),
    [
        ("encoding.kind", "lattice|voxels|frequencies", "lattice"),
        ("encoding.levels", "int >= 1, <= 32", 8),
        ("light.parallax", "learned|float > 1|null", None),
        ("sampler.steps", "int >= 32, multiple of 32", 192),
        ("sampler.proposals", "[int, ...]", (64, 64)),
        ("skip.contraction", "true|false", True),
    ],
)
def test_types_and_defaults(key: str, kind: str, default: object) -> None:
    (row,) = [row for row in listing.settings(load_config()) if row["key"] == key]
    assert (row["type"], row["default"]) == (kind, default)


def test_columns_are_aligned() -> None:
    assert listing.aligned([("a", "bb", "c"), ("ddd", "e", "long text")]) == "a    bb  c\nddd  e   long text"
