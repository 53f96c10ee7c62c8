"""Arms by file: the Denavit-Hartenberg chain of each model, and which model an arm is by what it reports.

arm = load_arm("ur10e")
identify(joints, base_from_flange).name  # "UR10e"
"""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

import configs
from datasets import pose
from datasets.core.schema import Schema, load_yaml
from datasets.kinematics import Links, forward

Six = tuple[float, float, float, float, float, float]
BUILT_M = 0.05
"""Farther from where its nominal links put it, the flange belongs to another arm; real arms differ by up to centimetres [m]."""


class ArmModel(Schema):
    """One model of arm, as a file in `configs/arms` describes it."""

    format: Literal["koala-arm"] = Field(description="kind of file")
    version: Literal[1] = Field(description="version of the format")
    name: str = Field(min_length=1, description="as its maker writes it")
    family: Literal["ur"] = Field(description="which closed form of the inverse kinematics it has")
    d: Six = Field(description="lengths along the joint axes [m]")
    a: Six = Field(description="lengths across the joint axes [m]")
    alpha_deg: Six = Field(description="twists from one joint axis to the next")

    @property
    def links(self) -> Links:
        """The nominal chain."""
        return Links(np.array(self.d), np.array(self.a), np.radians(self.alpha_deg), np.zeros(6))


@dataclass(frozen=True)
class Identified:
    """The model that fits best, and how far its nominal flange is from the reported one [m]."""

    model: ArmModel
    distance_m: float

    @property
    def certain(self) -> bool:
        """Whether it can be that model at all."""
        return self.distance_m < BUILT_M


def load_arm(name: Path | str) -> ArmModel:
    """A shipped model by its name, or one from a file; raises UsageError with the file, the line and the key."""
    return load_yaml(configs.find("arms", name), ArmModel)


@lru_cache(1)
def shipped_arms() -> tuple[ArmModel, ...]:
    """Every model that is installed."""
    return tuple(load_arm(name) for name in configs.shipped("arms"))


def identify(joints: ArrayLike, base_from_flange: ArrayLike) -> Identified:
    """The shipped model whose nominal links bring the flange nearest to the reported (4, 4) pose [m] at these angles [rad].

    Lengths of the models differ by decimetres, and builds of one model by millimetres. Orientations are equal in a family.
    """
    reached = ((model, pose.difference(forward(joints, model.links), base_from_flange)[0]) for model in shipped_arms())
    model, distance = min(reached, key=lambda one: float(one[1]))
    return Identified(model, float(distance))
