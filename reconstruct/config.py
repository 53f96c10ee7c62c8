"""What a person may set: one small schema per stage, its defaults and its documentation in one place.

Which model has which values is in `models`; the resolved configuration is written beside each result.
"""

import math
from typing import Literal

from pydantic import Field

from datasets.core.schema import Schema


class EncodingConfig(Schema):
    """What a position is turned into."""

    kind: Literal["lattice", "voxels", "frequencies"] = Field(
        default="lattice", description="Permutohedral lattice, cubic hash grid, or integrated positional encoding."
    )
    levels: int = Field(default=8, ge=1, le=32, description="Number of resolutions.")
    features: int = Field(default=2, ge=1, le=8, description="Features per level; frequencies have none of their own.")
    log2_size: int = Field(default=16, ge=4, le=24, description="Rows of each level's table, as a power of two; grids only.")
    coarsest: float = Field(
        default=8.0,
        gt=0,
        description="Vertices per unit of the normalised scene at the coarsest level; radians per unit for frequencies.",
    )
    finest: float = Field(default=256.0, gt=0, description="The same at the finest level.")
    volume: float | None = Field(
        default=None,
        gt=0,
        description="Volume that can hold anything [scene unit^3], for tables that are no larger than needed; none: as measured "
        "with skip.table_size, else full tables.",
    )


class FieldConfig(Schema):
    """The network behind the encoding."""

    appearance: Literal["reflection", "view", "view_diffuse", "diffuse"] = Field(
        default="reflection",
        description="Colour by reflected direction (Ref-NeRF), by view direction, by that and a diffuse colour, or by none.",
    )
    spatial_width: int = Field(default=64, ge=1, description="Width of the spatial layers.")
    spatial_depth: int = Field(default=1, ge=1, description="Number of spatial layers.")
    spatial_skip: int = Field(default=0, ge=0, description="Spatial layer before which the network's input joins again; 0: none.")
    bottleneck: int = Field(default=12, ge=0, description="Channels handed to the view network.")
    view_width: int = Field(default=64, ge=1, description="Width of the view layers.")
    view_depth: int = Field(default=2, ge=1, description="Number of view layers.")
    view_skip: int = Field(default=0, ge=0, description="The same of the view network.")
    ide_degree: int = Field(
        default=4, ge=1, le=6, description="Harmonics up to l = 2^(degree - 1) encode the reflected direction."
    )
    view_degree: int = Field(
        default=4, ge=0, le=10, description="Octaves of sines that encode the view direction, where it is not reflected."
    )
    shading: Literal["sample", "deferred"] = Field(
        default="deferred", description="Evaluate the view network at each sample, or once per ray on composited features."
    )
    diffuse_bias: float = Field(default=-math.log(3), description="Added to the raw diffuse colour before the sigmoid.")
    specular_bias: float = Field(default=0.0, description="Added to the raw reflected colour before the sigmoid.")
    roughness_bias: float = Field(default=-1.0, description="Added to the raw roughness before the softplus.")
    surroundings_roughness_bias: float = Field(
        default=0.0,
        description="Added to the roughness bias where there are surroundings, among which a blurred start may stay blurred.",
    )
    outward: float = Field(
        default=0.0,
        ge=0,
        description="Predicted normals start as those of a ball about the object: weight of the position in them.",
    )
    towards: tuple[float, float, float] | None = Field(
        default=None,
        description="Added to that position; none: the measured mean direction to the cameras, so that what they see faces them.",
    )
    matte_around: float = Field(
        default=0.0,
        ge=0,
        description="Around the object's box, added to the raw diffuse colour and subtracted from the raw tint at the start.",
    )
    half_box: tuple[float, float, float] | None = Field(
        default=None,
        description="Half the size of that box [scene unit]; none: as measured, where there are surroundings.",
    )
    density_bias: float = Field(default=0.5, description="Added to the raw density before the exponential.")
    surroundings_bias: float = Field(
        default=0.0,
        description="Added to the density bias where there are surroundings: rays are longer, and the first fog must stay thin.",
    )


class SamplerConfig(Schema):
    """Where along a ray the field is evaluated."""

    kind: Literal["occupancy", "proposal"] = Field(default="occupancy", description="Occupancy grid, or two proposal levels.")
    rays: int = Field(default=2048, ge=1, description="Rays drawn per step.")
    samples: int = Field(
        default=8192, ge=1, description="Occupancy: samples per step over all rays, packed; rays beyond are dropped."
    )
    max_per_ray: int = Field(default=32, ge=1, description="Occupancy: largest number of samples on a ray.")
    candidates: int | None = Field(
        default=None,
        ge=1,
        description="Occupancy, among surroundings: rays drawn per ray taken; those that meet the object are preferred. "
        "None: 4 where the scene states the object's box, else 1.",
    )
    steps: int = Field(default=192, ge=32, multiple_of=32, description="Occupancy: steps of a ray through the object's box.")
    grid: int = Field(default=128, ge=8, description="Occupancy: cells per axis over the object's box.")
    outer_grid: int = Field(default=64, ge=8, description="Occupancy: cells per axis over the contracted surroundings.")
    optical_depth: float = Field(
        default=0.01, gt=0, description="Occupancy: a cell counts as empty below this optical depth per step."
    )
    settle: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="Occupancy, among surroundings: share of the training before any cell is ruled out.",
    )
    proposals: tuple[int, ...] = Field(default=(64, 64), description="Proposal: samples of each proposal level.")
    final: int = Field(default=32, ge=2, description="Proposal: samples of the final level.")
    proposal_width: int = Field(default=64, ge=1, description="Proposal: width of each level's network.")
    proposal_depth: int = Field(default=1, ge=1, description="Proposal: depth of each level's network.")
    proposal_finest: tuple[float, ...] = Field(default=(256.0, 1024.0), description="Proposal: finest resolution of each level.")
    frustum: Literal["point", "gaussian", "hexagon"] = Field(
        default="point",
        description="Proposal: what represents a conical frustum: its centre, one Gaussian (Mip-NeRF) or six (Zip-NeRF).",
    )


class SurfaceConfig(Schema):
    """The four surface regularisers and their second pass."""

    enabled: bool = Field(default=True, description="Run the second pass.")
    rays: int = Field(
        default=128,
        ge=1,
        description="Rays per step whose first surface is used, by the regularisers and by the losses of normals.",
    )
    samples: int = Field(default=32, ge=4, description="Points and directions on the sphere.")
    sampling: Literal["lattice", "fibonacci", "random"] = Field(
        default="lattice", description="Lattice directions on shells, the same without shells, or independent random directions."
    )
    kappa: float = Field(default=0.0, ge=0, description="Concentration of the sphere lattice; 0 is uniform.")
    reach: float = Field(
        default=1.0, gt=0, description="Radius of the ball of samples, as a multiple of the half-width of the pixel's footprint."
    )
    density: float = Field(default=0.1, ge=0, description="Weight of density smoothness.")
    normal: float = Field(default=0.1, ge=0, description="Weight of normal consistency.")
    bias: float = Field(default=0.03, ge=0, description="Weight of the Lambertian bias.")
    variation: float = Field(default=1e-3, ge=0, description="Weight of the specular total variation.")
    density_form: Literal["tangent", "published"] = Field(default="tangent", description="Form of the density smoothness.")
    neighbours: int = Field(default=3, ge=1, description="Nearest directions in the total variation's graph.")
    neighbour_form: Literal["angular", "published"] = Field(
        default="angular",
        description="Which directions are near: by angle, or by the cosine of (polar angle, azimuth, length), as published.",
    )
    first_period: int = Field(default=512, ge=1, description="Steps between second passes at the start (power of two).")
    last_period: int = Field(default=4, ge=1, description="The same at the end.")


class LossConfig(Schema):
    """Weights of the losses taken over from Zip-NeRF and Ref-NeRF."""

    charbonnier: float = Field(default=1e-3, gt=0, description="Colour error below which the photometric loss is quadratic.")
    interlevel: float = Field(default=0.01, ge=0, description="Weight: proposal levels follow the final one.")
    distortion: float = Field(default=0.0, ge=0, description="Weight: samples gather along a ray (real scenes: 0.01).")
    hollowness: float = Field(default=0.0, ge=0, description="Weight: solid objects stay dense behind their surface.")
    hollow_from: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="Share of the training before the hollowness counts: early fog must not be made solid.",
    )
    orientation: float = Field(default=0.1, ge=0, description="Weight: visible normals face the camera.")
    predicted_normals: float = Field(default=3e-4, ge=0, description="Weight: predicted normals follow the density's.")
    density_normals: float = Field(default=3e-4, ge=0, description="Weight: the density's normals follow the predicted ones.")
    decay: float = Field(default=0.1, ge=0, description="Weight: mean square of the tables' values, per level.")
    bounded_distortion: float | None = Field(
        default=None, ge=0, description="Weight of the distortion in scenes without surroundings; none: the same."
    )
    bounded_decay: float | None = Field(
        default=None, ge=0, description="Weight of the decay in scenes without surroundings; none: the same."
    )

    def in_scene(self, *, bounded: bool) -> "LossConfig":
        """The weights that count in a scene with surroundings, or without."""
        own = {"distortion": self.bounded_distortion, "decay": self.bounded_decay} if bounded else {}
        return self.model_copy(update={name: weight for name, weight in own.items() if weight is not None})


class TrainConfig(Schema):
    """Optimisation."""

    steps: int = Field(default=10_000, ge=1, description="Steps where no time budget is given.")
    rate: float = Field(default=0.01, gt=0, description="Learning rate after warm-up.")
    network_share: float = Field(default=0.25, gt=0, description="The networks' rate as a share of the tables'.")
    final_rate: float = Field(default=0.001, gt=0, description="Learning rate at the end; log-linear between.")
    warmup: float = Field(default=0.02, ge=0, le=1, description="Share of the training over which the rate rises.")
    seed: int = Field(default=0, ge=0, description="Seed of weights, rays and sphere rotations.")
    first_blur: float = Field(
        default=0.02, ge=0, description="Standard deviation of every sample at the start [scene unit]; 0: none."
    )
    last_blur: float = Field(default=0.001, ge=0, description="The same from `blur_until` on.")
    blur_until: float = Field(default=0.5, gt=0, le=1, description="Share of the training over which the blur shrinks.")
    precision: Literal["float32", "bfloat16"] = Field(
        default="float32", description="Factors of the networks' products while training; sums and everything else are float32."
    )
    accumulate: int = Field(default=1, ge=1, description="Batches whose mean gradient makes one step.")
    per_image: Literal["none", "exposure", "colour"] = Field(
        default="none", description="Learned per training image: nothing, a gain, or a gain per colour."
    )
    patience: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="Stop when held-out training pixels have not improved for this share of the training; 0: never.",
    )
    checkpoint_s: float = Field(default=60.0, gt=0, description="Seconds between checkpoints.")
    tensorboard: bool = Field(default=False, description="Write the log as TensorBoard's event files too (extra 'tensorboard').")


class PoseConfig(Schema):
    """Refinement of the training views' poses; docs/poses.md has its results."""

    enabled: bool = Field(default=False, description="Learn a small correction of each training view's pose.")
    sigma_m: float = Field(
        default=5e-4,
        gt=0,
        description="Standard deviation of a camera's position as it was calibrated [world unit: metres in captures].",
    )
    sigma_rad: float = Field(default=8.7e-4, gt=0, description="The same of its angle about each axis [rad].")
    rate: float = Field(default=0.02, ge=0, description="Learning rate, in these standard deviations.")
    final_rate: float = Field(default=0.001, gt=0, description="The same at the end; log-linear between.")
    start: float = Field(
        default=0.1,
        ge=0,
        le=1,
        description="Share of the training before poses move; over the next tenth their rate rises to its full value.",
    )
    prior: float = Field(default=1e-5, ge=0, description="Weight of the squared corrections, in standard deviations, halved.")

    def sigma(self, scale: float) -> tuple[float, ...]:
        """Standard deviations of a twist's six parts [scene unit, rad], `scale` scene units per world unit."""
        return (self.sigma_m * scale,) * 3 + (self.sigma_rad,) * 3


class SkipConfig(Schema):
    """What may be left out where a scene does not need it. Each is decided on evidence; docs/skipping.md has the costs."""

    surroundings: bool = Field(default=True, description="Contraction and background, where pictures carry an alpha.")
    empty_rays: bool = Field(
        default=True, description="Space that masks or the occupancy grid rule out, and rays that meet only such space."
    )
    fine_levels: bool = Field(default=False, description="Levels finer than the smallest footprint of a pixel at the surface.")
    table_size: bool = Field(default=False, description="Rows that levels with few vertices in the occupied space cannot fill.")
    multisampling: bool = Field(
        default=False, description="Six Gaussians per frustum, where pixels' footprints are alike everywhere."
    )
    reflection: bool = Field(
        default=False, description="The specular branch and its regularisers, where a pilot training gains nothing by them."
    )
    consistent_passes: bool = Field(
        default=False, description="Second passes, while the last one found normals that agree already."
    )
    converged: bool = Field(default=False, description="The rest of the training, once held-out pixels stop improving.")
    distortion: bool = Field(default=True, description="Undistortion of pinhole cameras' pixels.")


class Config(Schema):
    """Everything that decides what a training makes of a scene."""

    model: str = Field(default="surfnerf", description="Name of the model file.")
    preset: Literal["fast", "paper"] = Field(
        default="fast", description="fast: a workstation without GPU. paper: the published sizes."
    )
    scale: float = Field(default=1.0, gt=0, le=1, description="Images are resampled to this share of their size first.")
    encoding: EncodingConfig = EncodingConfig()
    field: FieldConfig = FieldConfig()
    sampler: SamplerConfig = SamplerConfig()
    surface: SurfaceConfig = SurfaceConfig()
    losses: LossConfig = LossConfig()
    train: TrainConfig = TrainConfig()
    skip: SkipConfig = SkipConfig()
    poses: PoseConfig = PoseConfig()

    def with_surroundings(self) -> "Config":
        """The configuration for a scene that is more than its object's box."""
        field = self.field
        biases = {
            "density_bias": field.density_bias + field.surroundings_bias,
            "roughness_bias": field.roughness_bias + field.surroundings_roughness_bias,
        }
        return self.model_copy(update={"field": field.model_copy(update=biases)})
