"""What was left out of a training and why, as a person reads it and as RUN/skips.json keeps it."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from koala3d.datasets.core import files
from koala3d.datasets.core.errors import UsageError, nearest
from koala3d.reconstruct.config import SkipConfig
from koala3d.reconstruct.run import SKIPS

NAMES = tuple(SkipConfig.model_fields)
"""What can be forced."""
NOTHING_MORE = "nothing more"
"""Saving of what the model would not have done anyway."""
ELSEWHERE = {
    "structure_from_motion": "poses are taken as the scene has them; 'datasets edit --refine-poses' moves them",
    "moving_lamps": "where lamps stand still is set by light.frame: world, camera or turntable",
}
"""What is on the list although no setting of `skip` decides it, and where it is decided."""

COSTS = {
    "surroundings": "none: 1.9 and 2.2 dB better on two scenes",
    "contraction": "none: 1.0 dB better on one scene",
    "regularisers": "none: 0.4 to 2.4 dB better on three scenes; normals are worse",
    "empty_rays": "none: 1.5 and 2.8 dB better on two scenes",
    "multisampling": "not measured; aliasing where footprints differ",
    "reflection": "not measured; without any regulariser 1.6 and 2.7 dB better on two scenes; no predicted normals",
    "distortion": "none: the same figures",
    "moving_lamps": "none where lamps stand still; where one rides beside the camera 6 deg and 7 dB on one scene",
    "structure_from_motion": "none in training",
    "exposure": "0.2 dB better without on the one scene measured, whose light moves",
    "poses": "not measured",
}
"""Price of each skip; docs/skipping.md has the figures."""
PLAIN = {
    "surroundings": "what is around the object",
    "contraction": "space where no camera looks",
    "regularisers": "regularisers of a surface that nobody names",
    "empty_rays": "empty space",
    "multisampling": "several samples at one place",
    "reflection": "reflections of a matte object",
    "distortion": "straightening pictures that are straight",
}
"""What is left out, in words for everybody; what a training does not decide is not among it."""


LEARNED = {
    "exposure": ("a gain of each picture's light", "train.per_image=colour"),
    "poses": ("a correction of each picture's pose", "poses.enabled=true"),
}
"""What is learned beside the model where a scene needs it: in words for everybody, and the setting that forces it."""


@dataclass(frozen=True)
class Skip:
    """One decision."""

    name: str
    skipped: bool
    evidence: str
    """What the decision rests on, with figures."""
    saving: str
    """What it saves, or would."""
    cost: str
    """What it costs in error, or would."""

    @classmethod
    def of(cls, name: str, skipped: bool, evidence: str, saving: str) -> "Skip":
        """A decision with the price that is known of its kind."""
        return cls(name, skipped, evidence, saving, COSTS[name])


def in_words(name: str) -> str:
    """What a skip leaves out, in words for everybody."""
    return PLAIN.get(name, name.replace("_", " "))


def left_out(skips: Sequence[Skip]) -> list[str]:
    """A line for each thing that was left out and saved something: what, why, what that saved."""
    listed = [skip for skip in skips if skip.skipped and skip.name in PLAIN and skip.saving != NOTHING_MORE]
    return [f"{PLAIN[skip.name]}: {skip.evidence}; saves {skip.saving}" for skip in listed]


def learned(skips: Sequence[Skip]) -> list[str]:
    """A line for each thing that is learned beside the model: what and why."""
    return [f"{LEARNED[skip.name][0]}: {skip.evidence}" for skip in skips if skip.name in LEARNED and not skip.skipped]


def forced(names: Sequence[str]) -> list[str]:
    """Overrides of the configuration that keep the named things from being skipped.

    Raises:
        UsageError: there is no such skip, or it is decided elsewhere.
    """
    for name in names:
        if name in ELSEWHERE:
            raise UsageError(f"{name} is decided elsewhere", where="--no-skip", why=ELSEWHERE[name])
        if name not in (*NAMES, *LEARNED):
            raise UsageError(f"there is no skip '{name}'", where="--no-skip", remedy=nearest(name, (*NAMES, *LEARNED)))
    return [LEARNED[name][1] if name in LEARNED else f"skip.{name}=false" for name in names]


def write(run: Path, skips: Sequence[Skip]) -> None:
    """Put the decisions into a run's folder, in place of those that are there."""
    files.write_json(run / SKIPS, [asdict(skip) for skip in skips])


def read(run: Path) -> list[Skip]:
    """The decisions of a run; none where it has no list."""
    path = run / SKIPS
    return [Skip(**entry) for entry in files.read_json(path)] if path.is_file() else []


def replaced(skips: Sequence[Skip], new: Skip) -> list[Skip]:
    """The list with one decision in place of the former of its name."""
    return [new if skip.name == new.name else skip for skip in skips]
