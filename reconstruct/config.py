"""What a person may set: one small schema per stage, its defaults and its documentation in one place.

Which model has which values is in `models`; the resolved configuration is written beside each result.
"""

import math
from typing import Annotated, Any, Literal

from pydantic import Field

from koala3d.datasets.core.schema import Schema


def setting(default: Any, description: str, **limits: Any) -> Any:
    """A field with its default, its meaning, and limits such as `ge=1`."""
    return Field(default=default, description=description, **limits)


class EncodingConfig(Schema):
    """What a position is turned into."""

    kind: Literal["lattice", "voxels", "frequencies"] = setting(
        "lattice", "Permutohedral lattice, cubic hash grid, or integrated positional encoding."
    )
    levels: int = setting(8, "Number of resolutions.", ge=1, le=32)
    features: int = setting(2, "Features per level; frequencies have none of their own.", ge=1, le=8)
    log2_size: int | None = setting(
        None, "Rows of each level's table, as a power of two; grids only. None: 16, or more for a long training.", ge=4, le=24
    )
    coarsest: float = setting(
        8.0, "Vertices per unit of the normalised scene at the coarsest level; radians per unit for frequencies.", gt=0
    )
    finest: float = setting(256.0, "The same at the finest level.", gt=0)


class FieldConfig(Schema):
    """The network behind the encoding."""

    appearance: Literal["reflection", "view", "view_diffuse", "diffuse"] = setting(
        "reflection", "Colour by reflected direction (Ref-NeRF), by view direction, by that and a diffuse colour, or by none."
    )
    spatial_width: int = setting(64, "Width of the spatial layers.", ge=1)
    spatial_depth: int = setting(1, "Number of spatial layers.", ge=1)
    spatial_skip: int = setting(0, "Spatial layer before which the network's input joins again; 0: none.", ge=0)
    bottleneck: int = setting(12, "Channels handed to the view network.", ge=0)
    view_width: int = setting(64, "Width of the view layers.", ge=1)
    view_depth: int = setting(2, "Number of view layers.", ge=1)
    view_skip: int = setting(0, "The same of the view network.", ge=0)
    ide_degree: int = setting(4, "Harmonics up to l = 2^(degree - 1) encode the reflected direction.", ge=1, le=6)
    shading: Literal["sample", "deferred"] = setting(
        "deferred", "Evaluate the view network at each sample, or once per ray on composited features."
    )
    diffuse_bias: float = setting(-math.log(3), "Added to the raw diffuse colour before the sigmoid.")
    specular_bias: float = setting(0.0, "Added to the raw reflected colour before the sigmoid.")
    roughness_bias: float = setting(-1.0, "Added to the raw roughness before the softplus.")
    outward: float = setting(
        0.0, "Predicted normals start as those of a ball about the object: weight of the position in them.", ge=0
    )
    matter: Literal["fog", "solid"] = setting(
        "fog",
        "Light is lost along the way through it, or where its density rises; a solid begins as the hull of the masks.",
    )
    density_bias: float = setting(0.5, "Added to the raw density before the exponential, of a density that begins as fog.")


class SamplerConfig(Schema):
    """Where along a ray the field is evaluated."""

    kind: Literal["occupancy", "proposal"] = setting("occupancy", "Occupancy grid, or two proposal levels.")
    rays: int = setting(2048, "Rays drawn per step.", ge=1)
    samples: int = setting(8192, "Occupancy: samples per step over all rays, packed; rays beyond are dropped.", ge=1)
    max_per_ray: int = setting(32, "Occupancy: largest number of samples on a ray.", ge=1)
    steps: int = setting(192, "Occupancy: steps of a ray through the object's box.", ge=32, multiple_of=32)
    grid: int = setting(128, "Occupancy: cells per axis over the object's box.", ge=8)
    optical_depth: float = setting(0.01, "Occupancy: a cell counts as empty below this optical depth per step.", gt=0)
    proposals: tuple[int, ...] = setting((64, 64), "Proposal: samples of each proposal level.")
    final: int = setting(32, "Proposal: samples of the final level.", ge=2)
    proposal_width: int = setting(64, "Proposal: width of each level's network.", ge=1)
    proposal_depth: int = setting(1, "Proposal: depth of each level's network.", ge=1)
    proposal_finest: tuple[float, ...] = setting((256.0, 1024.0), "Proposal: finest resolution of each level.")
    frustum: Literal["point", "gaussian", "hexagon"] = setting(
        "point", "Proposal: what represents a conical frustum: its centre, one Gaussian (Mip-NeRF) or six (Zip-NeRF)."
    )


class SurfaceConfig(Schema):
    """The four surface regularisers and their second pass."""

    enabled: bool = setting(True, "Run the second pass.")
    rays: int = setting(128, "Rays of a second pass, whose first surfaces the regularisers look at.", ge=1)
    normal_factor: int = setting(1, "The losses of normals use this many times as many rays, in every step.", ge=1)
    samples: int = setting(32, "Points and directions on the sphere.", ge=4)
    sampling: Literal["lattice", "fibonacci", "random"] = setting(
        "lattice", "Lattice directions on shells, the same without shells, or independent random directions."
    )
    reach: float = setting(1.0, "Radius of the ball of samples, as a multiple of the half-width of the pixel's footprint.", gt=0)
    density: float = setting(0.1, "Weight of density smoothness.", ge=0)
    normal: float = setting(0.1, "Weight of normal consistency.", ge=0)
    bias: float = setting(0.03, "Weight of the Lambertian bias.", ge=0)
    bias_form: Literal["kinds", "published"] = setting(
        "published", "Form of the Lambertian bias: for two kinds of surface, metals and others, or relative to its own maximum."
    )
    variation: float = setting(1e-3, "Weight of the specular total variation.", ge=0)
    density_form: Literal["tangent", "published"] = setting(
        "tangent", "Form of the density smoothness: density lies in the surface's plane, or as published."
    )
    first_period: int = setting(512, "Steps between second passes at the start (power of two).", ge=1)
    last_period: int = setting(4, "The same at the end.", ge=1)


class LossConfig(Schema):
    """Losses taken over from Zip-NeRF and Ref-NeRF: the width of the photometric one, and weights of the others."""

    width: float = setting(
        1e-3,
        "Colour error below which the photometric loss is quadratic, above which it is linear; poses are learned with 0.001.",
        gt=0,
    )
    distortion: float = setting(0.0, "Weight: samples gather along a ray (real scenes: 0.01).", ge=0)
    hollowness: float = setting(0.0, "Weight: solid objects stay dense behind their surface.", ge=0)
    fog: float = setting(0.0, "Weight: rays lose no light in front of their surface.", ge=0)
    orientation: float = setting(0.1, "Weight: visible normals face the camera.", ge=0)
    predicted_normals: float = setting(3e-4, "Weight: predicted normals follow the density's.", ge=0)
    density_normals: float = setting(3e-4, "Weight: the density's normals follow the predicted ones.", ge=0)
    last_density_normals: float | None = setting(
        None, "What that weight grows to, as normals get right; none: it stays as it is.", ge=0
    )
    decay: float = setting(0.1, "Weight: mean square of the tables' values, per level.", ge=0)


class TrainConfig(Schema):
    """Optimisation."""

    steps: int = setting(10_000, "Steps where no time budget is given.", ge=1)
    rate: float = setting(0.01, "Learning rate of the tables after warm-up.", gt=0)
    network_share: float = setting(0.25, "The networks' rate as a share of the tables'.", gt=0)
    final_rate: float = setting(0.001, "Learning rate of the tables at the end; log-linear between.", gt=0)
    seed: int = setting(0, "Seed of weights, rays and sphere rotations.", ge=0)
    first_blur: float = setting(0.02, "Standard deviation of every sample at the start [scene unit]; 0: none.", ge=0)
    last_blur: float = setting(0.001, "The same from `blur_until` on.", ge=0)
    per_image: Literal["auto", "none", "exposure", "colour"] = setting(
        "auto", "Learned per training image: nothing, a gain, or a gain per colour; auto: what matched points say differs."
    )
    checkpoint_s: float = setting(60.0, "Seconds between checkpoints.", gt=0)
    tensorboard: bool = setting(False, "Write the log as TensorBoard's event files too (extra 'tensorboard').")


class ScheduleConfig(Schema):
    """When each stage of a training begins or ends, as a share of it; `training.schedule` has what else is fixed."""

    warmup: float = setting(0.02, "The learning rate rises until then.", ge=0, le=1)
    grid_from: float = setting(0.0, "Occupancy: no cell is ruled out earlier.", ge=0, le=1)
    share_from: float = setting(
        1.0,
        "From then on, on ever more rays of the object, the first surface is the first sample of at least half the largest "
        "weight; before, the first above the median weight (the paper's rule). 0: on all rays from the start.",
        ge=0,
        le=1,
    )
    bias_from: float = setting(
        0.0, "The Lambertian bias of the object does not count earlier: its reflections are to be found first.", ge=0, le=1
    )
    blur_until: float = setting(0.5, "The blur of samples shrinks until then.", gt=0, le=1)


class PoseConfig(Schema):
    """Refinement of the training views' poses; docs/poses.md has its results."""

    enabled: Literal["auto"] | bool = setting(
        "auto", "Learn a small correction of each training view's pose; auto: where matched points miss one another."
    )
    sigma_m: float = setting(
        5e-4, "Standard deviation of a camera's position as it was calibrated [world unit: metres in captures].", gt=0
    )
    sigma_rad: float = setting(8.7e-4, "The same of its angle about each axis [rad].", gt=0)

    def sigma(self, scale: float) -> tuple[float, ...]:
        """Standard deviations of a twist's six parts [scene unit, rad], `scale` scene units per world unit."""
        return (self.sigma_m * scale,) * 3 + (self.sigma_rad,) * 3


class LightConfig(Schema):
    """Where lamps stand still, for models that reflect; docs/photographs.md has an example."""

    frame: Literal["auto", "world", "camera", "turntable"] = setting(
        "auto",
        "Lamps stand still about the object, ride on the camera, or stand still with the camera before an object that turns; "
        "auto: as the pictures say.",
    )
    axis: tuple[float, float, float] | None = setting(
        None, "Turntable: the axis of rotation, in the scene's axes; none: measured from the cameras."
    )
    parallax: Literal["learned"] | Annotated[float, Field(gt=1)] | None = setting(
        None,
        "Radius of the sphere about the object on which reflected rays end [scene unit]; learned: found by training; none: they "
        "end infinitely far away. Lamps on the camera have no such sphere.",
    )


class SkipConfig(Schema):
    """What may be left out where a scene does not need it. Each is decided on evidence; docs/skipping.md has the costs."""

    surroundings: bool = setting(True, "Contraction and background, where pictures carry an alpha.")
    contraction: bool = setting(
        True, "The contraction, where all cameras look the same way: the frustum that they see takes its place."
    )
    regularisers: bool = setting(
        True, "Regularisers of shape and normals, where neither masks nor the scene's box say what the object is."
    )
    reflection: bool = setting(
        True, "Reflections and predicted normals, where most of the object keeps its colour from view to view."
    )
    empty_rays: bool = setting(True, "Space that masks or the occupancy grid rule out, and rays that meet only such space.")


Kind = Literal["blank", "surroundings", "unnamed", "matte", "painted"]


class Overlays(Schema):
    """Values for kinds of scene, laid over the others; training decides which hold, before its first step."""

    blank: dict[str, Any] = setting({}, "Where pictures show the object alone.")
    surroundings: dict[str, Any] = setting({}, "Where they show what is around it.")
    unnamed: dict[str, Any] = setting({}, "Where neither masks nor the scene's box say what the object is.")
    matte: dict[str, Any] = setting({}, "Where most of the object keeps its colour from view to view.")
    painted: dict[str, Any] = setting({}, "Where it reflects, but views of a place agree on most of its light.")


class Config(Schema):
    """Everything that decides what a training makes of a scene."""

    model: str = setting("surfnerf", "Name of the model file.")
    preset: Literal["fast", "paper"] = setting("fast", "fast: a workstation without GPU. paper: the published sizes.")
    scale: float = setting(1.0, "Images are resampled to this share of their size first.", gt=0, le=1)
    encoding: EncodingConfig = EncodingConfig()
    field: FieldConfig = FieldConfig()
    sampler: SamplerConfig = SamplerConfig()
    surface: SurfaceConfig = SurfaceConfig()
    losses: LossConfig = LossConfig()
    train: TrainConfig = TrainConfig()
    schedule: ScheduleConfig = ScheduleConfig()
    skip: SkipConfig = SkipConfig()
    poses: PoseConfig = PoseConfig()
    light: LightConfig = LightConfig()
    overlays: Overlays = Overlays()
    kinds: tuple[Kind, ...] = setting((), "Kinds of scene whose overlays were laid over it, in this order.")
