from pathlib import Path

import pytest

from koala3d.datasets.core import files
from koala3d.datasets.core.errors import UsageError
from koala3d.reconstruct.models import load_config
from koala3d.reconstruct.training.decisions import empty_space, record
from koala3d.reconstruct.training.decisions.skip import Skip

SKIPS = [
    Skip("empty_rays", "empty space", True, "masks", "much"),
    Skip("contraction", "space where no camera looks", False, "cameras look different ways", "space"),
    Skip("moving_lamps", "light that moves", True, "lamps stand still", "a rotation"),
]


def test_decisions_survive_the_file_as_a_plain_list(tmp_path: Path) -> None:
    assert record.read(tmp_path) == []
    record.write(tmp_path, SKIPS)
    assert record.read(tmp_path) == SKIPS
    (entry, *_) = files.read_json(tmp_path / "skips.json")
    assert list(entry) == ["name", "what", "skipped", "evidence", "saving"]


def test_names_are_forced_by_overrides_that_the_configuration_knows() -> None:
    config = load_config(overrides=record.forced(record.NAMES))
    assert not any(config.skip.model_dump().values()) and config.train.per_image == "colour" and config.poses.enabled is True


@pytest.mark.parametrize(("name", "answer"), [("contracting", "contraction"), ("moving_lamps", "light.frame")])
def test_an_unknown_name_is_answered_with_the_nearest(name: str, answer: str) -> None:
    with pytest.raises(UsageError, match=answer):
        record.forced([name])


def test_a_person_reads_what_was_left_out_why_and_what_it_saved_and_nothing_else() -> None:
    assert record.left_out(SKIPS) == ["empty space: masks; saves much"]


def test_a_person_reads_what_is_learned_beside_the_model() -> None:
    on, off = (Skip("exposure", "a gain of each picture's light", skipped, "3 of 9 are brighter") for skipped in (False, True))
    assert record.learned([*SKIPS, on]) == ["a gain of each picture's light: 3 of 9 are brighter"]
    assert record.learned([*SKIPS, off]) == [] and record.left_out([on, off]) == []


def test_the_end_tells_what_came_of_it() -> None:
    found = empty_space.with_outcome(SKIPS, {"progress": 0.6, "occupied": 0.1})
    assert found[0].evidence == "masks; in the end 90% of it was empty"
    assert found[1:] == SKIPS[1:] and empty_space.with_outcome(found, {"occupied": 0.1}) == found
