"""What is measured on a GPU, and how the seconds are shared out."""

from dataclasses import dataclass

from koala3d.reconstruct.bench.suite import COST, QUALITY, Trial

SECONDS = 180.0
"""Of training in all, by default: the rest of ten minutes goes to compiling and evaluating."""
LEGO, LARGE = "lego400", "gold_rings_800"
"""Scenes: pictures of 400x400, read from the data folder; and of 800x800, rendered by Koala."""
SHARES = (
    (QUALITY, LEGO, "fast", (1 / 16, 1 / 8, 1 / 4)),
    (QUALITY, LARGE, "fast", (1 / 16, 1 / 4)),
    (COST, LEGO, "paper", (1 / 8,)),
)
"""Kind of trial, scene, preset, and the shares of the seconds: curves of the fast preset, the rate of the published one."""
ALONE = ((COST, LEGO, "fast", (1 / 16,)), (COST, LEGO, "paper", (1 / 16,)))
"""The same for one of several devices."""
SMALL = (
    "encoding.levels=1", "encoding.log2_size=6", "field.spatial_width=4", "field.spatial_depth=1", "field.view_width=4",
    "field.view_depth=1", "field.view_skip=0", "field.bottleneck=2", "field.ide_degree=1", "sampler.grid=16", "sampler.rays=256",
    "sampler.steps=32", "sampler.samples=1024", "sampler.proposals=[8,8]", "sampler.final=8", "sampler.proposal_finest=[8,16]",
    "sampler.frustum=point", "surface.enabled=false", "surface.rays=32",
)  # fmt: skip
"""Settings for a processor: enough to see that everything runs."""


@dataclass(frozen=True)
class Sizes:
    """How large everything is."""

    seconds: float
    """Of training in all."""
    settings: tuple[str, ...]
    """KEY=VALUE, on top of each preset's."""
    side: int
    """Width and height of the large scene's pictures."""
    views: tuple[int, int]
    """Its training and test views."""
    scale: float
    """Of the pictures that are read."""
    curves: bool
    """Whether a scene is trained on for all of its shares of the seconds, or only for the last."""

    @classmethod
    def on(cls, platform: str, seconds: float | None) -> "Sizes":
        """Full sizes on an accelerator; small ones on a processor."""
        if platform == "cpu":
            return cls(seconds or 1.0, SMALL, 32, (6, 2), 0.125, curves=False)
        return cls(seconds or SECONDS, (), 800, (24, 3), 1.0, curves=True)


def trials(sizes: Sizes, *, alone: bool = False) -> list[Trial]:
    """All trainings; with `alone` those of one of several devices."""
    found = []
    for kind, scene, preset, shares in ALONE if alone else SHARES:
        for share in shares if sizes.curves else shares[-1:]:
            scale = sizes.scale if scene == LEGO else 1.0
            found.append(Trial(kind, scene, scale, 0, "surfnerf", preset, round(share * sizes.seconds, 3), 0))
    return found
