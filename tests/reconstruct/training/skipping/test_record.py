from pathlib import Path

import pytest

from koala3d.datasets.core import files
from koala3d.datasets.core.errors import UsageError
from koala3d.reconstruct.config import SkipConfig
from koala3d.reconstruct.models import load_config
from koala3d.reconstruct.training.skipping import outcome, record
from koala3d.reconstruct.training.skipping.record import Skip

SKIPS = [
    Skip.of("empty_rays", True, "masks", "much"),
    Skip.of("contraction", False, "cameras look different ways", "space"),
    Skip.of("multisampling", True, "footprints are alike", "five of six places"),
]


def test_decisions_survive_the_file_as_a_plain_list(tmp_path: Path) -> None:
    assert record.read(tmp_path) == []
    record.write(tmp_path, SKIPS)
    assert record.read(tmp_path) == SKIPS
    (entry, *_) = files.read_json(tmp_path / "skips.json")
    assert list(entry) == ["name", "skipped", "evidence", "saving", "cost"]


def test_names_are_forced_by_overrides_that_the_configuration_knows() -> None:
    config = load_config(overrides=record.forced([*record.NAMES, *record.LEARNED]))
    assert not any(config.skip.model_dump().values()) and config.train.per_image == "colour"
    assert set(record.COSTS) == {*SkipConfig.model_fields, *record.LEARNED, *record.ELSEWHERE}


@pytest.mark.parametrize(("name", "answer"), [("multisample", "multisampling"), ("structure_from_motion", "--refine-poses")])
def test_an_unknown_name_is_answered_with_the_nearest(name: str, answer: str) -> None:
    with pytest.raises(UsageError, match=answer):
        record.forced([name])


def test_a_person_reads_what_was_left_out_why_and_what_it_saved_and_nothing_else() -> None:
    beside = Skip.of("multisampling", True, "this model takes one place per sample", record.NOTHING_MORE)
    elsewhere = Skip.of("structure_from_motion", True, "poses from the scene", "matching the views")
    assert record.left_out([*SKIPS, beside, elsewhere]) == [
        "empty space: masks; saves much",
        "several samples at one place: footprints are alike; saves five of six places",
    ]
    assert not any(name in line for line in record.left_out(SKIPS) for name in record.NAMES), "words, and no names of settings"


def test_a_person_reads_what_is_learned_beside_the_model() -> None:
    on, off = (Skip.of("exposure", skipped, "3 of 9 views are brighter", record.NOTHING_MORE) for skipped in (False, True))
    assert record.learned([*SKIPS, on]) == ["a gain of each picture's light: 3 of 9 views are brighter"]
    assert record.learned([*SKIPS, off]) == [] and record.left_out([on, off]) == []


def test_every_skip_has_words_for_everybody() -> None:
    assert set(record.PLAIN) == set(record.NAMES)


def test_the_end_tells_what_came_of_it() -> None:
    found = outcome.with_outcome(SKIPS, {"progress": 0.6, "occupied": 0.1})
    assert found[0].evidence == "masks; in the end 90% of it was empty"
    assert found[1:] == SKIPS[1:]
