"""Description of the laser profile sensor: laser, cameras, detector, rendering, extraction."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from orchestrator.config.description import Description, Finite, Fraction, NonNegative, Positive

_Pixels = Annotated[int, Field(ge=16, le=16_384)]


_Lean = Annotated[float, Field(ge=-40.0, le=40.0)]
_Small = Annotated[float, Field(ge=-10.0, le=10.0)]


class LaserDescription(Description):
    """Laser sheet, nominally in the sensor's YZ plane, from a point source through a narrow opening.

    A sheet that is bent, turned or shifted is drawn so in the images; points are found as if it were where it should
    be. The shape of the sheet is its out-of-plane angle as a polynomial c0 + c1 s + c2 s² + ... of the place s along
    the line, -1 and 1 at its ends: ``straightness_mrad = [0, 0, 0.5]`` bows both ends by 60 um at 120 mm.
    """

    wavelength_nm: Annotated[float, Field(ge=200.0, le=2000.0)]
    power_mw: NonNegative
    fan_half_angle_deg: Annotated[float, Field(gt=0.0, lt=80.0)]
    source_z_mm: Finite = Field(default=0.0, description="the source lies at (0, 0, source_z) of the sensor frame")
    sheet_sigma_mm: Positive = Field(description="standard deviation of the irradiance across the sheet at its waist")
    waist_z_mm: Finite
    divergence_mrad: NonNegative = Field(default=0.0, description="growth of the sheet's sigma, far from the waist")
    opening_mm: Annotated[float, Field(ge=0.0, le=20.0)] = Field(
        default=0.0, description="length of the source along the line: shadows of what stands in the light blur"
    )
    profile: Literal["uniform", "gaussian", "table"] = Field(
        default="uniform", description="power per angle along the line; power_mw is the whole of it"
    )
    profile_half_width_deg: Annotated[float, Field(gt=0.0, lt=180.0)] | None = Field(
        default=None, description="gaussian: angle from the middle at which power per angle has fallen to 1/e²"
    )
    profile_angle_deg: Annotated[tuple[Finite, ...], Field(max_length=1000)] = Field(
        default=(), description="table: ascending angles"
    )
    profile_power: Annotated[tuple[NonNegative, ...], Field(max_length=1000)] = Field(
        default=(), description="table: power per angle at these angles, of any scale; linear between, 0 beyond"
    )
    straightness_mrad: Annotated[tuple[Annotated[float, Field(ge=-100.0, le=100.0)], ...], Field(max_length=6)] = Field(
        default=(), description="shape of the sheet: out-of-plane angle as a polynomial of the place along the line"
    )
    offset_x_mm: _Small = Field(default=0.0, description="shift of the sheet along sensor X")
    turn_y_deg: _Small = Field(default=0.0, description="turn of the sheet about sensor Y, at the source")
    turn_z_deg: _Small = Field(default=0.0, description="turn of the sheet about sensor Z, at the source, after turn_y")

    @model_validator(mode="after")
    def _profile_is_complete(self) -> Self:
        if (self.profile == "gaussian") != (self.profile_half_width_deg is not None):
            raise ValueError('profile = "gaussian" and profile_half_width_deg belong together')
        if (self.profile == "table") != bool(self.profile_angle_deg or self.profile_power):
            raise ValueError('profile = "table", profile_angle_deg and profile_power belong together')
        angles = self.profile_angle_deg
        if len(angles) != len(self.profile_power) or len(angles) == 1:
            raise ValueError("profile_angle_deg and profile_power need as many numbers each, two at least")
        if any(a >= b for a, b in pairwise(angles)):
            raise ValueError(f"profile_angle_deg must ascend: {list(angles)}")
        return self


class RangeDescription(Description):
    """Measuring range along sensor Z."""

    near_mm: Positive
    far_mm: Positive

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.near_mm >= self.far_mm:
            raise ValueError(f"near_mm ({self.near_mm:g}) must be below far_mm ({self.far_mm:g})")
        return self


class CameraDescription(Description):
    """One camera at distance `baseline` (the paper's a) from the sheet and sensor height `height` (b).

    Its optical axis is tilted by `tilt` (phi) from sensor Z towards the sheet; `half_angle` (gamma) is half the
    vertical field of view, so that the focal length is ``height_px / (2 tan gamma)`` pixels.
    """

    name: str
    side: Literal[1, -1] = Field(description="1: at sensor X = +baseline; -1: its mirror image")
    baseline_mm: Positive
    height_mm: Finite = 0.0
    tilt_deg: Annotated[float, Field(gt=0.0, lt=90.0)]
    half_angle_deg: Annotated[float, Field(gt=0.1, lt=60.0)]
    width_px: _Pixels
    height_px: _Pixels
    cx_px: Finite | None = Field(default=None, description="column of the principal point; default: image centre")
    cy_px: Finite | None = Field(default=None, description="row of the principal point; default: image centre")
    distortion: Annotated[tuple[float, ...], Field(min_length=5, max_length=5)] = (0.0, 0.0, 0.0, 0.0, 0.0)
    f_number: Positive
    pixel_pitch_um: Positive
    transmission: Fraction = Field(description="lens times band-pass filter")
    scheimpflug_x_deg: _Lean = Field(
        default=0.0,
        description="turn of the image sensor about camera x; the laser sheet is sharp all over where its tangent is"
        " -image distance * cos(tilt) / baseline and focus_mm is baseline / sin(tilt)",
    )
    scheimpflug_y_deg: _Lean = Field(default=0.0, description="turn of the image sensor about camera y, after that")
    focus_mm: Annotated[float, Field(ge=10.0, allow_inf_nan=False)] | None = Field(
        default=None, description="distance from the lens, along its axis, of what is sharp; default: everything is"
    )
    psf_sigma_px: Annotated[float, Field(ge=0.0, le=20.0)] | Literal["diffraction"] = Field(
        default=0.0,
        description="standard deviation of the image of a sharp point; diffraction: 0.42 wavelength * f_number",
    )
    offset_y_mm: _Small = Field(default=0.0, description="optical centre off the plane Y = 0")
    pan_deg: _Small = Field(default=0.0, description="turn of the camera about its y")
    roll_deg: _Small = Field(default=0.0, description="turn of the camera about its z, before pan")

    @model_validator(mode="after")
    def _sees_a_bounded_range(self) -> Self:
        if self.half_angle_deg >= self.tilt_deg:
            raise ValueError(
                f"half_angle_deg ({self.half_angle_deg:g}) must be below tilt_deg ({self.tilt_deg:g}),"
                " or the far end of the range is infinite"
            )
        return self


class DetectorDescription(Description):
    """Image sensor in EMVA 1288 terms.

    A rolling shutter exposes row after row, each for `exposure_ms`; the middle of the image is exposed around the
    trigger's latch, as all of it is by a global one.
    """

    exposure_ms: Annotated[float, Field(gt=0.0, le=1000.0)]
    quantum_efficiency: Annotated[float, Field(gt=0.0, le=1.0)]
    full_well_e: Positive
    read_noise_e: NonNegative
    dark_current_e_per_s: NonNegative = 0.0
    gain_dn_per_e: Positive
    bit_depth: Annotated[int, Field(ge=8, le=16)]
    black_level_dn: NonNegative
    prnu: Annotated[float, Field(ge=0.0, lt=0.5)] = Field(default=0.0, description="gain spread between pixels")
    dsnu_e: NonNegative = Field(default=0.0, description="offset spread between pixels")
    shutter: Literal["global", "rolling"] = "global"
    row_readout_us: Annotated[float, Field(gt=0.0, le=1000.0)] | None = Field(
        default=None, description="rolling: time by which each row is exposed later than the row before"
    )

    laser_off_frame: bool = Field(
        default=False,
        description="take a second image with the laser off right after each exposure, and search what the laser added",
    )

    @model_validator(mode="after")
    def _shutter_is_complete(self) -> Self:
        if (self.shutter == "rolling") != (self.row_readout_us is not None):
            raise ValueError('shutter = "rolling" and row_readout_us belong together')
        return self


class AmbientDescription(Description):
    """External light that passes the band-pass filter, from all sides."""

    irradiance_w_m2: NonNegative = 0.0


class BandPassDescription(Description):
    """Filter in front of every camera: what it passes of external lights, against the laser."""

    centre_nm: Annotated[float, Field(ge=200.0, le=2000.0)] | None = Field(
        default=None, description="default: the laser's wavelength"
    )
    width_nm: Positive = Field(default=20.0, description="full width at half maximum")


class SpeckleDescription(Description):
    """Grain of the laser's light on rough surfaces; its size on the image is wavelength times f-number.

    It is drawn into images, and it is the noise of light that the extraction expects: it enters what counts as the
    normal shape of a stripe and the standard deviation of every point.
    """

    contrast: Fraction = Field(
        default=0.0, description="of fully resolved grains; 1: bare metal, 0.5: light from within; 0: no speckle"
    )


class RenderDescription(Description):
    """How finely images are computed."""

    mode: Literal["fast", "path"] = Field(
        default="fast", description="path: every pixel by unbiased path tracing, one path per sample; slow"
    )
    samples_per_pixel: Literal[4, 16, 64, 256, 1024] = 16
    noise: bool = True
    rays_across_fan: Annotated[int, Field(ge=64, le=65_536)] = 2560
    bounces: Annotated[int, Field(ge=0, le=64)] = Field(
        default=0, description="reflections between surfaces that light may take; 0: direct light only"
    )
    photons: Annotated[int, Field(ge=16, le=67_108_864)] = Field(
        default=65_536, description="paths from the laser that find reflected light in the fast mode, per exposure"
    )


class ExtractionDescription(Description):
    """From image to stripe peaks to points."""

    detector: Literal[
        "gaussian",
        "centre_of_gravity",
        "parabola",
        "log_parabola",
        "blais_rioux_4",
        "blais_rioux_8",
        "derivative_of_gaussian",
        "steger",
    ] = Field(default="gaussian", description="how the centre of the stripe is measured in a column")
    peak: Literal["brightest", "first", "last", "continuity", "agreement"] = Field(
        default="brightest",
        description="which of several peaks in a column is taken; agreement: of two cameras or more",
    )
    continuity_px: Positive = Field(default=4.0, description="rows per column that count as a jump; for continuity")
    agreement_px: Positive = Field(default=0.5, description="largest difference between agreeing cameras, noise aside")
    triangulation: Literal["exact", "eq4_as_printed"] = "exact"
    fusion: Literal["none", "weighted"] = Field(
        default="none", description="weighted: points that two cameras saw become one, weighted by their variances"
    )
    threshold_sigma: Positive = Field(default=6.0, description="detection threshold above background noise")
    min_amplitude_dn: NonNegative = 4.0
    min_sigma_px: Positive = 0.4
    max_sigma_px: Annotated[float, Field(gt=0.0, le=8.0)] = 6.0
    max_asymmetry: Positive = 0.05
    max_residual: Positive = 0.05
    max_row_jump_px: Positive = Field(
        default=0.1, description="rows that bend more than this from column to column break a run"
    )
    max_amplitude_jump: Positive = Field(default=0.3, description="relative change from column to column")
    max_width_jump: Positive = Field(default=0.15, description="relative change from column to column")
    end_columns: Annotated[int, Field(ge=0, le=100)] = Field(default=1, description="distrusted at the ends of a run")
    min_run_columns: Annotated[int, Field(ge=1, le=1000)] = Field(default=8, description="shorter runs are distrusted")


class GeometricDescription(Description):
    """The fast mode: laser rays instead of images."""

    rays: Annotated[int, Field(ge=2, le=65_536)] = 1280


class SensorDescription(Description):
    """A laser profile sensor with one or more cameras."""

    name: str
    laser: LaserDescription
    range: RangeDescription
    camera: Annotated[tuple[CameraDescription, ...], Field(min_length=1, max_length=8)]
    detector: DetectorDescription
    ambient: AmbientDescription = AmbientDescription()
    band_pass: BandPassDescription = BandPassDescription()
    speckle: SpeckleDescription = SpeckleDescription()
    render: RenderDescription = RenderDescription()
    extraction: ExtractionDescription = ExtractionDescription()
    geometric: GeometricDescription = GeometricDescription()

    @model_validator(mode="after")
    def _rows_see_direct_light(self) -> Self:
        if self.detector.shutter == "rolling" and self.render.bounces:
            raise ValueError(
                f'detector.shutter = "rolling" goes with direct light only: render.bounces must be 0, not'
                f" {self.render.bounces}"
            )
        return self
