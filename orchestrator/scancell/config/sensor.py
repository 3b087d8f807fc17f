"""Description of the laser profile sensor: laser, cameras, detector, rendering, extraction; SI data for the library."""

from __future__ import annotations

import json
import re
from collections import Counter
from itertools import pairwise
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import ConfigDict, Field, model_validator

from scancell.arrays import Array
from scancell.config.description import (
    Bandwidth,
    Coordinate,
    Description,
    FileDescription,
    Fraction,
    Size,
    si_value,
    to_si,
)

_SMALLEST_IMAGE = 16  # px
_Pixels = Annotated[int, Field(ge=_SMALLEST_IMAGE, le=16_384)]
_ExposureTime = Annotated[float, Field(ge=1e-6, le=1000.0)]  # ms
_Lean = Annotated[float, Field(ge=-40.0, le=40.0)]
_Coefficient = Annotated[float, Field(ge=-1000.0, le=1000.0)]
_Small = Annotated[float, Field(ge=-10.0, le=10.0)]
_Region = tuple[Annotated[int, Field(ge=0, le=16_384)], _Pixels]
_PrincipalPoint = Annotated[float, Field(ge=-16_384.0, le=32_768.0)]  # px
_Distance = Annotated[float, Field(ge=0.001, le=16_384.0)]  # px
_Electrons = Annotated[float, Field(ge=0.0, le=1e6)]
_DarkCurrent = Annotated[float, Field(ge=0.0, le=1e9)]  # electrons/s
_DigitalNumber = Annotated[float, Field(ge=0.0, le=65_535.0)]
_Limit = Annotated[float, Field(ge=1e-6, le=1e6)]

_FORMAT = 1
_STRAIGHTNESS = 6  # number of coefficients that the library expects
_GAUSSIAN_NODES = 513  # linear interpolation errs by less than 1e-4 of the peak


class LaserDescription(Description):
    """Laser sheet, nominally in the sensor's YZ plane, from a point or line source.

    Images contain the sheet as described, with its curvature, rotation and shift; triangulation assumes the nominal
    plane unless ``extraction.triangulation`` is ``sheet``. The out-of-plane angle of the sheet is a polynomial
    c0 + c1 s + c2 s² + ... of the position s along the line, -1 and 1 at its ends: ``straightness_mrad = [0, 0, 0.5]``
    displaces both ends by 60 µm at 120 mm.
    """

    wavelength_nm: Annotated[float, Field(ge=200.0, le=2000.0)] = Field(description="wavelength of the laser, nm")
    power_mw: Annotated[float, Field(ge=0.0, le=1e6)] = Field(description="optical power of the whole line, mW")
    fan_half_angle_deg: Annotated[float, Field(ge=0.001, lt=80.0)] = Field(
        description="half of the fan angle: the line covers -angle..angle from sensor Z in the YZ plane, deg"
    )
    source_z_mm: Coordinate = Field(
        default=0.0, description="Z of the source, which lies at (0, 0, source_z) in the sensor frame, mm"
    )
    sheet_sigma_mm: Annotated[float, Field(ge=0.001, le=100.0)] = Field(
        description="standard deviation of the irradiance across the sheet at its waist, mm"
    )
    waist_z_mm: Coordinate = Field(description="sensor Z where the sheet is thinnest, mm")
    divergence_mrad: Annotated[float, Field(ge=0.0, le=1000.0)] = Field(
        default=0.0, description="increase of the sheet's standard deviation per distance, far from the waist, mrad"
    )
    source_length_mm: Annotated[float, Field(ge=0.0, le=20.0)] = Field(
        default=0.0, description="length of the source along the line, mm; blurs the edges of shadows along the line"
    )
    profile: Literal["uniform", "gaussian", "table"] = Field(
        default="uniform", description="power per angle along the line; its integral is power_mw"
    )
    profile_half_width_deg: Annotated[float, Field(ge=0.001, lt=180.0)] | None = Field(
        default=None, description="gaussian: angle from the centre where power per angle is 1/e² of its maximum, deg"
    )
    profile_angle_deg: Annotated[tuple[Annotated[float, Field(ge=-180.0, le=180.0)], ...], Field(max_length=1000)] = (
        Field(default=(), description="table: angles from sensor Z in ascending order, deg")
    )
    profile_power: Annotated[tuple[Annotated[float, Field(ge=0.0, le=1e9)], ...], Field(max_length=1000)] = Field(
        default=(), description="table: relative power per angle at these angles; linear between them, 0 outside"
    )
    straightness_mrad: Annotated[tuple[Annotated[float, Field(ge=-100.0, le=100.0)], ...], Field(max_length=6)] = Field(
        default=(),
        description="coefficients c0, c1, ... of the sheet's out-of-plane angle as a polynomial of the position along"
        " the line (-1..1), mrad",
    )
    offset_x_mm: _Small = Field(default=0.0, description="displacement of the sheet along sensor X, mm")
    turn_y_deg: _Small = Field(default=0.0, description="rotation of the sheet about sensor Y through the source, deg")
    turn_z_deg: _Small = Field(
        default=0.0, description="rotation of the sheet about sensor Z through the source, after turn_y_deg, deg"
    )

    @model_validator(mode="after")
    def _profile_is_complete(self) -> Self:
        if (self.profile == "gaussian") != (self.profile_half_width_deg is not None):
            raise ValueError('profile = "gaussian" and profile_half_width_deg must be given together')
        if (self.profile == "table") != bool(self.profile_angle_deg or self.profile_power):
            raise ValueError('profile = "table", profile_angle_deg and profile_power must be given together')
        angles = self.profile_angle_deg
        if len(angles) != len(self.profile_power) or len(angles) == 1:
            counts = f"{len(angles)} and {len(self.profile_power)}"
            raise ValueError(f"profile_angle_deg and profile_power must have equal length, at least two, not {counts}")
        if any(a >= b for a, b in pairwise(angles)):
            raise ValueError(f"profile_angle_deg must be in ascending order: {list(angles)}")
        return self


USUAL_STANDOFF_MM = 80.0


class RangeDescription(Description):
    """Measuring range along sensor Z; points outside it are discarded."""

    near_mm: Size = Field(description="start of the measuring range, sensor Z, mm")
    far_mm: Annotated[float, Field(ge=0.001, le=10_000.0)] = Field(
        description="end of the measuring range, sensor Z, mm"
    )

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.near_mm >= self.far_mm:
            raise ValueError(f"near_mm ({self.near_mm:g}) must be below far_mm ({self.far_mm:g})")
        return self

    def standoff_mm(self, described: float | Literal["sensor"]) -> float:
        """Distance, mm, of a described stand-off; ``sensor`` means 80 mm, or a twentieth of the range beyond its start.

        The latter applies where 80 mm is not in the nearer half of the range.
        """
        if described != "sensor":
            return described
        near, far = self.near_mm, self.far_mm
        return USUAL_STANDOFF_MM if near <= USUAL_STANDOFF_MM <= (near + far) / 2 else near + (far - near) / 20


class CameraDescription(Description):
    """One camera at distance `baseline` (the paper's a) from the sheet and sensor height `height` (b).

    Its optical axis is tilted by `tilt` (phi) from sensor Z towards the sheet; `half_angle` (gamma) is half the
    vertical field of view, so that the focal length is ``height_px / (2 tan gamma)`` pixels. All keys describe the
    whole image sensor in its own pixels; its images are the region of it that is read, see `read_out`.
    """

    name: str = Field(description="unique name of the camera, used in results")
    side: Literal[1, -1] = Field(description="1: at sensor X = +baseline; -1: its mirror image")
    baseline_mm: Size = Field(description="distance of the optical centre from the laser sheet (a), mm")
    height_mm: Coordinate = Field(default=0.0, description="sensor Z of the optical centre (b), mm")
    tilt_deg: Annotated[float, Field(ge=0.001, lt=90.0)] = Field(
        description="angle of the optical axis from sensor Z towards the sheet (phi), deg"
    )
    half_angle_deg: Annotated[float, Field(gt=0.1, lt=60.0)] = Field(
        description="half of the field of view along the image's height (gamma), deg; must be below tilt_deg"
    )
    width_px: _Pixels = Field(description="width of the image sensor: columns along the laser line, px")
    height_px: _Pixels = Field(description="height of the image sensor: rows along the range, px")
    cx_px: _PrincipalPoint | None = Field(
        default=None, description="column of the principal point, px; default: image centre (width_px - 1) / 2"
    )
    cy_px: _PrincipalPoint | None = Field(
        default=None, description="row of the principal point, px; default: image centre (height_px - 1) / 2"
    )
    region_columns_px: _Region | None = Field(
        default=None,
        description="region of interest: first column and number of columns that are read, among them that of the"
        " principal point; default: all",
    )
    region_rows_px: _Region | None = Field(
        default=None,
        description="region of interest: first row and number of rows that are read; fewer rows are read sooner;"
        " default: all",
    )
    distortion: Annotated[tuple[_Coefficient, ...], Field(min_length=5, max_length=5)] = Field(
        default=(0.0, 0.0, 0.0, 0.0, 0.0),
        description="Brown-Conrady coefficients k1, k2, p1, p2, k3 (OpenCV order); the distortion must be invertible in"
        " the whole image",
    )
    f_number: Annotated[float, Field(ge=0.1, le=1000.0)] = Field(
        description="working f-number: image distance over aperture diameter; sets light, defocus and speckle size"
    )
    pixel_pitch_um: Annotated[float, Field(ge=0.1, le=1000.0)] = Field(description="distance between pixel centres, µm")
    transmission: Fraction = Field(description="transmittance of lens and band-pass filter at the laser, 0..1")
    scheimpflug_x_deg: _Lean = Field(
        default=0.0,
        description="tilt of the image sensor about camera x, deg; the whole laser sheet is in focus where its tangent"
        " is -image distance * cos(tilt) / baseline and focus_mm is baseline / sin(tilt)",
    )
    scheimpflug_y_deg: _Lean = Field(
        default=0.0, description="tilt of the image sensor about camera y, after scheimpflug_x_deg, deg"
    )
    focus_mm: Annotated[float, Field(ge=10.0, le=1e6)] | None = Field(
        default=None, description="distance from the lens along its axis that is in focus, mm; default: no defocus"
    )
    psf_sigma_px: Annotated[float, Field(ge=0.0, le=20.0)] | Literal["diffraction"] = Field(
        default=0.0,
        description="standard deviation of the point spread function in focus, px; diffraction: from 0.42 * wavelength"
        " * f_number",
    )
    offset_y_mm: _Small = Field(default=0.0, description="displacement of the optical centre along sensor Y, mm")
    pan_deg: _Small = Field(default=0.0, description="rotation of the camera about its y, deg")
    roll_deg: _Lean = Field(default=0.0, description="rotation of the camera about its z, before pan_deg, deg")

    @model_validator(mode="after")
    def _sees_a_bounded_range(self) -> Self:
        if self.half_angle_deg >= self.tilt_deg:
            raise ValueError(
                f"half_angle_deg ({self.half_angle_deg:g}) must be below tilt_deg ({self.tilt_deg:g}),"
                " otherwise the range has no far end"
            )
        return self

    @model_validator(mode="after")
    def _region_is_on_the_image_sensor(self) -> Self:
        for key, size in (("region_columns_px", self.width_px), ("region_rows_px", self.height_px)):
            first, count = getattr(self, key) or (0, size)
            if first + count > size:
                raise ValueError(f"{key} = [{first}, {count}] must end within the {size} px of the image sensor")
        if self.region_columns_px is not None:
            first, count = self.region_columns_px
            middle = principal_point_px(self)[0]
            # Planning takes the measuring field as symmetric about sensor Z.
            if not first - 0.5 < middle < first + count - 0.5:
                raise ValueError(
                    f"region_columns_px = [{first}, {count}] must contain column {middle:g} of the principal point"
                )
        return self


class DetectorDescription(Description):
    """Image sensor in EMVA 1288 terms, of pixels before binning.

    A rolling shutter exposes row after row, each for `exposure_ms`; as with a global shutter, the middle of the image
    is exposed around the trigger's latch instant.
    """

    model_config = ConfigDict(json_schema_extra=lambda schema: schema["required"].remove("gain_dn_per_e"))

    exposure_ms: _ExposureTime = Field(
        description="exposure time of a pixel, ms; of the first image where section [exposure] asks for others"
    )
    quantum_efficiency: Annotated[float, Field(ge=1e-6, le=1.0)] = Field(
        description="electrons per photon at the laser's wavelength, 0..1"
    )
    full_well_e: Annotated[float, Field(ge=1.0, le=1e9)] = Field(
        description="saturation capacity of a pixel, electrons"
    )
    read_noise_e: _Electrons = Field(description="standard deviation of the temporal dark noise, electrons")
    dark_current_e_per_s: _DarkCurrent = Field(default=0.0, description="dark current of a pixel, electrons/s")
    gain_dn_per_e: Annotated[float, Field(ge=1e-6, le=1e4)] = Field(
        description="system gain, digital numbers per electron; without this key that at which full_well_e fills the"
        " bit depth"
    )
    bit_depth: Annotated[int, Field(ge=8, le=16)] = Field(description="bits per pixel of the digital image")
    black_level_dn: _DigitalNumber = Field(description="digital number without light")
    prnu: Annotated[float, Field(ge=0.0, lt=0.5)] = Field(
        default=0.0,
        description="photo response non-uniformity: relative standard deviation of gain between pixels; part of the"
        " stated standard deviation of every point",
    )
    dsnu_e: _Electrons = Field(
        default=0.0, description="dark signal non-uniformity: standard deviation of offset between pixels, electrons"
    )
    row_noise_e: _Electrons = Field(
        default=0.0,
        description="standard deviation of an offset that all pixels of an image row share, new in every image,"
        " electrons; part of the stated standard deviation of every point",
    )
    hot_pixels_ppm: Annotated[float, Field(ge=0.0, le=10_000.0)] = Field(
        default=0.0, description="hot pixels in a million, the same ones in every image"
    )
    hot_pixel_e_per_s: _DarkCurrent = Field(
        default=0.0,
        description="mean of the additional dark current of hot pixels, distributed exponentially, electrons/s",
    )
    shutter: Literal["global", "rolling"] = Field(
        default="global", description="global: all rows at once; rolling: row after row"
    )
    row_readout_us: Annotated[float, Field(ge=1e-6, le=1000.0)] | None = Field(
        default=None,
        description="time in which a row is read, µs; rolling: the delay between the exposures of neighbouring rows;"
        " global: an image is read while the next one is exposed, and no time is taken unless given",
    )
    binning: Literal[1, 2, 4] = Field(
        default=1, description="width and height, in pixels, of the squares that are read as one pixel of the image"
    )
    binning_mode: Literal["average", "charge"] = Field(
        default="average",
        description="average: the mean of the pixels' signals before conversion; charge: their charges are collected on"
        " one node of the same full well and read once",
    )
    laser_off_frame: bool = Field(
        default=False,
        description="take a second (background) image with the laser off after each exposure and extract from the"
        " difference",
    )

    @model_validator(mode="before")
    @classmethod
    def _bit_depth_sets_full_scale(cls, data: Any) -> Any:
        """Without a gain, the one at which the full well fills the bit depth."""
        if not isinstance(data, dict) or "gain_dn_per_e" in data:
            return data
        keys = ("full_well_e", "black_level_dn", "bit_depth")
        given = [float(data[key]) for key in keys if type(data.get(key)) in (int, float)]
        if len(given) < len(keys) or not (0.0 < given[2] <= 16.0 and given[0] > 0.0):
            return data  # whose keys are refused
        full_well, black, bits = given
        return {**data, "gain_dn_per_e": (2.0**bits - 1.0 - black) / full_well}

    @model_validator(mode="after")
    def _shutter_is_complete(self) -> Self:
        if self.shutter == "rolling" and self.row_readout_us is None:
            raise ValueError('shutter = "rolling" needs row_readout_us')
        return self

    @model_validator(mode="after")
    def _hot_pixels_are_complete(self) -> Self:
        if (self.hot_pixels_ppm > 0.0) != (self.hot_pixel_e_per_s > 0.0):
            raise ValueError("hot_pixels_ppm and hot_pixel_e_per_s must be given together")
        return self


class ExposureDescription(Description):
    """How the exposure time of each profile is chosen.

    ``fixed``: always ``detector.exposure_ms``. ``automatic``: the time of a profile follows from the image `delay`
    profiles before, so that its stripe reaches the share `target` of saturation; the first profiles have
    ``detector.exposure_ms``. ``multiple``: every profile has several exposures, one after another, and each column of a
    camera keeps the point of one of them: of one without saturated pixels, if there is one, the one with the smallest
    standard deviation; none if this peak is rejected. Each point belongs to the time of its own exposure.
    """

    mode: Literal["fixed", "automatic", "multiple"] = Field(
        default="fixed", description="fixed, automatic (from the last images) or multiple (several for each profile)"
    )
    further_ms: Annotated[tuple[_ExposureTime, ...], Field(max_length=7)] = Field(
        default=(), description="multiple: exposure times after the first one, detector.exposure_ms, in this order, ms"
    )
    shortest_ms: _ExposureTime | None = Field(default=None, description="automatic: shortest exposure time, ms")
    longest_ms: _ExposureTime | None = Field(default=None, description="automatic: longest exposure time, ms")
    target: Annotated[float, Field(ge=0.05, le=0.95)] = Field(
        default=0.6, description="automatic: wanted signal of the stripe over that of saturation, 0.05..0.95"
    )
    percentile: Annotated[float, Field(ge=1.0, le=100.0)] = Field(
        default=90.0,
        description="automatic: share of the columns with light, in percent, whose signal is to stay below target",
    )
    delay: Annotated[int, Field(ge=1, le=64)] = Field(
        default=2, description="automatic: number of profiles from an image to the first one that it sets"
    )

    @model_validator(mode="after")
    def _mode_is_complete(self) -> Self:
        if (self.mode == "multiple") != bool(self.further_ms):
            raise ValueError('mode = "multiple" and further_ms must be given together')
        limits = (self.shortest_ms, self.longest_ms)
        if any((self.mode == "automatic") != (limit is not None) for limit in limits):
            raise ValueError('mode = "automatic", shortest_ms and longest_ms must be given together')
        if self.shortest_ms is not None and self.longest_ms is not None and self.shortest_ms > self.longest_ms:
            raise ValueError(f"shortest_ms ({self.shortest_ms:g}) must not exceed longest_ms ({self.longest_ms:g})")
        return self


class AmbientDescription(Description):
    """Uniform external light within the band of the filter."""

    irradiance_w_m2: Annotated[float, Field(ge=0.0, le=1e6)] = Field(
        default=0.0, description="irradiance from all directions that passes the band-pass filter, W/m²"
    )


class BandPassDescription(Description):
    """Gaussian band-pass filter of every camera: its transmittance of external light relative to the laser."""

    centre_nm: Annotated[float, Field(ge=200.0, le=2000.0)] | None = Field(
        default=None, description="centre wavelength, nm; default: the laser's wavelength"
    )
    width_nm: Bandwidth = Field(default=20.0, description="full width at half maximum, nm")


class SpeckleDescription(Description):
    """Speckle of laser light on rough surfaces; its grain size in the image is wavelength times f-number.

    Images contain it, and extraction expects it: it enters the limits of a normal stripe shape and the standard
    deviation of every point.
    """

    contrast: Fraction = Field(
        default=0.0, description="contrast of resolved grains, 0..1; 1: bare metal, 0.5: volume scattering, 0: none"
    )


class RenderDescription(Description):
    """Quality of rendered camera images."""

    mode: Literal["fast", "path"] = Field(
        default="fast",
        description="fast: drawn from the surface that the laser lights; path: path tracing of every pixel, slow",
    )
    samples_per_pixel: Literal[4, 16, 64, 256, 1024] = Field(
        default=16,
        description="paths per pixel (path); points of a line source and of a lens that is not a pinhole (fast)",
    )
    noise: bool = Field(default=True, description="photon, dark, read and fixed-pattern noise of the images")
    rays_across_fan: Annotated[int, Field(ge=64, le=65_536)] = Field(
        default=1440, description="laser rays that sample the lit surface; thinner features can be missed (fast mode)"
    )
    bounces: Annotated[int, Field(ge=0, le=64)] = Field(
        default=0, description="largest number of interreflections between surfaces; 0: direct light only"
    )
    photons: Annotated[int, Field(ge=16, le=67_108_864)] = Field(
        default=65_536, description="light paths from the laser per exposure for interreflections in the fast mode"
    )


class ExtractionDescription(Description):
    """From images to stripe peaks and points."""

    detector: Literal[
        "gaussian",
        "centre_of_gravity",
        "parabola",
        "log_parabola",
        "blais_rioux_4",
        "blais_rioux_8",
        "derivative_of_gaussian",
        "steger",
    ] = Field(default="gaussian", description="method that finds the sub-pixel centre of the stripe in a column")
    peak: Literal["brightest", "first", "last", "continuity", "agreement"] = Field(
        default="brightest",
        description="which of several peaks in a column is used; continuity: nearest to the neighbouring columns;"
        " agreement: confirmed by two cameras or more",
    )
    continuity_px: _Distance = Field(
        default=4.0, description="peak = continuity: row difference between columns that counts as a jump, px"
    )
    agreement_px: _Distance = Field(
        default=0.5, description="peak = agreement: largest row difference between cameras beyond noise, px"
    )
    triangulation: Literal["exact", "sheet", "eq4_as_printed", "eq5_as_printed"] = Field(
        default="exact",
        description="exact: on the nominal plane of the laser sheet; sheet: on the sheet as described in [laser], for"
        " calibrated sensors; eq4_as_printed: the published Eq. 4 of Dumitrache & Borangiu for comparison;"
        " eq5_as_printed: points as exact, the measuring range by their published Eq. 5",
    )
    fusion: Literal["none", "weighted"] = Field(
        default="none", description="weighted: points seen by two cameras become one, weighted by their variances"
    )
    threshold_sigma: _Limit = Field(
        default=6.0, description="detection threshold above the background, in standard deviations of its noise"
    )
    min_amplitude_dn: _DigitalNumber = Field(
        default=4.0, description="smallest height of a peak above the background, digital numbers"
    )
    min_sigma_px: _Distance = Field(default=0.4, description="smallest standard deviation of a stripe, px")
    max_sigma_px: Annotated[float, Field(ge=1e-6, le=8.0)] = Field(
        default=6.0, description="largest standard deviation of a stripe, px"
    )
    max_asymmetry: _Limit = Field(
        default=0.05, description="largest asymmetry (skewness / 6) of a stripe beyond noise; more is rejected"
    )
    max_residual: _Limit = Field(
        default=0.05, description="largest RMS misfit of the stripe model beyond noise, relative to the amplitude"
    )
    max_row_jump_px: _Distance = Field(
        default=0.1, description="largest deviation of a row from the extrapolated neighbours within a run, px"
    )
    max_amplitude_jump: _Limit = Field(
        default=0.3, description="largest relative change of amplitude between columns; more rejects both peaks"
    )
    max_width_jump: _Limit = Field(
        default=0.15, description="largest relative change of width between columns; more rejects both peaks"
    )
    end_columns: Annotated[int, Field(ge=0, le=100)] = Field(
        default=1, description="number of columns rejected at each end of a run of neighbouring peaks"
    )
    min_run_columns: Annotated[int, Field(ge=1, le=1000)] = Field(
        default=8, description="smallest length of a run of neighbouring peaks, columns; shorter ones are rejected"
    )


class GeometricDescription(Description):
    """The geometric engine: laser rays instead of images."""

    rays: Annotated[int, Field(ge=2, le=65_536)] = Field(
        default=1280, description="laser rays per profile, at equal angles across the fan"
    )


IMAGE_ONLY_KEYS = (
    "laser.source_length_mm",
    "detector.hot_pixels_ppm",
    "detector.hot_pixel_e_per_s",
    "render.samples_per_pixel",
    "render.rays_across_fan",
    "render.photons",
    "extraction.peak",
    "extraction.continuity_px",
    "extraction.max_asymmetry",
    "extraction.max_residual",
    "extraction.max_row_jump_px",
    "extraction.max_amplitude_jump",
    "extraction.max_width_jump",
)
"""Keys of a sensor that act on images alone: they change nothing in the geometric engine."""


MOST_CAMERAS = 8


class SensorDescription(FileDescription):
    """A laser profile sensor with one or more cameras.

    Examples
    --------
    >>> sensor = scancell.load_setup(settings={"sensor.laser.power_mw": 5.0}).sensor
    >>> sensor.laser.power_mw
    5.0
    """

    kind: ClassVar[str] = "sensor"
    shipped: ClassVar[str] = "sensors/two_camera_probe.toml"

    name: str = Field(description="name of the sensor")
    laser: LaserDescription = Field(description="laser and shape of its sheet")
    range: RangeDescription = Field(description="measuring range along sensor Z")
    camera: Annotated[tuple[CameraDescription, ...], Field(min_length=1, max_length=MOST_CAMERAS)] = Field(
        description="the cameras, with unique names"
    )
    detector: DetectorDescription = Field(description="image sensor of every camera")
    exposure: ExposureDescription = Field(
        default=ExposureDescription(), description="choice of the exposure time of each profile"
    )
    ambient: AmbientDescription = Field(default=AmbientDescription(), description="uniform external light")
    band_pass: BandPassDescription = Field(default=BandPassDescription(), description="filter of every camera")
    speckle: SpeckleDescription = Field(default=SpeckleDescription(), description="speckle of the laser light")
    render: RenderDescription = Field(default=RenderDescription(), description="quality of rendered camera images")
    extraction: ExtractionDescription = Field(
        default=ExtractionDescription(), description="stripe extraction and triangulation"
    )
    geometric: GeometricDescription = Field(
        default=GeometricDescription(), description="settings of the geometric engine"
    )

    @model_validator(mode="after")
    def _camera_names_are_unique(self) -> Self:
        for name, count in Counter(camera.name for camera in self.camera).items():
            if count > 1:
                raise ValueError(f"camera: {count} cameras have the name '{name}'; names must be unique")
        return self

    @model_validator(mode="after")
    def _images_have_pixels(self) -> Self:
        for number, camera in enumerate(read_out(self).camera, start=1):
            if min(camera.width_px, camera.height_px) < _SMALLEST_IMAGE:
                raise ValueError(
                    f"camera[{number}]: with detector.binning = {self.detector.binning} its images have"
                    f" {camera.width_px} x {camera.height_px} px; expected at least {_SMALLEST_IMAGE} x"
                    f" {_SMALLEST_IMAGE}"
                )
        return self

    @model_validator(mode="after")
    def _first_exposure_is_within_the_limits(self) -> Self:
        low, first, high = self.exposure.shortest_ms, self.detector.exposure_ms, self.exposure.longest_ms
        if low is not None and high is not None and not low <= first <= high:
            raise ValueError(
                f"detector.exposure_ms ({first:g}) must lie between exposure.shortest_ms ({low:g}) and"
                f" exposure.longest_ms ({high:g})"
            )
        return self

    @model_validator(mode="after")
    def _several_exposures_are_not_fused(self) -> Self:
        if self.exposure.mode == "multiple" and self.extraction.fusion != "none":
            raise ValueError(
                'exposure.mode = "multiple" needs extraction.fusion = "none": each column has the time of one exposure'
            )
        return self

    @model_validator(mode="after")
    def _rows_see_direct_light(self) -> Self:
        if self.detector.shutter == "rolling" and self.render.bounces:
            raise ValueError(
                f'detector.shutter = "rolling" supports direct light only: render.bounces must be 0, not'
                f" {self.render.bounces}"
            )
        return self

    @model_validator(mode="after")
    def _lenses_have_an_inverse(self) -> Self:
        if any(any(camera.distortion) for camera in self.camera):
            from scancell.sensor import Sensor  # noqa: PLC0415  (few descriptions need the library)

            try:
                Sensor(json.dumps(sensor_json(self, seed=0)))
            except ValueError as error:
                key = re.sub(r"^sensor\.cameras\[(\d+)\]", lambda found: f"camera[{int(found[1]) + 1}]", str(error))
                raise ValueError(key) from None
        return self


def camera_label(sensor: Any, camera: Any) -> Any:
    """Numbers of cameras among those of all sensors, by numbers of sensors, from 1, and indices of their cameras."""
    return (sensor - 1) * MOST_CAMERAS + camera


def ignored_by_geometric_engine(sensor: SensorDescription) -> list[str]:
    """Keys of `sensor` that differ from their defaults and that the geometric engine has no use for."""
    found = []
    for key in IMAGE_ONLY_KEYS:
        section, name = key.split(".")
        values = getattr(sensor, section)
        if getattr(values, name) != type(values).model_fields[name].default:
            found.append(f"sensor.{key}")
    return found


def sensor_json(sensor: SensorDescription, seed: int) -> dict[str, Any]:
    """SI description of the sensor as the native library reads it; `seed` is the random seed of the images.

    Its cameras are those of `read_out`.
    """
    sensor = read_out(sensor)
    data: dict[str, Any] = to_si(sensor.model_dump(exclude={"camera", "detector", "exposure", "laser"}))
    data["detector"] = _detector_json(sensor.detector)
    data["laser"] = _laser_json(sensor.laser)
    data["cameras"] = [_camera_json(camera, sensor.laser.wavelength_nm) for camera in sensor.camera]
    data["render"]["seed"] = seed
    if sensor.band_pass.centre_nm is None:
        data["band_pass"]["centre"] = data["laser"]["wavelength"]
    return {"format": _FORMAT, **data}


def _detector_json(detector: DetectorDescription) -> dict[str, Any]:
    excluded = {"shutter", "row_readout_us", "hot_pixels_ppm", "binning", "binning_mode"}
    data: dict[str, Any] = to_si(detector.model_dump(exclude=excluded))
    data["hot_pixels"] = 1e-6 * detector.hot_pixels_ppm
    data["row_readout"] = 1e-6 * (detector.row_readout_us or 0.0) if detector.shutter == "rolling" else 0.0
    return data


def _laser_json(laser: LaserDescription) -> dict[str, Any]:
    data: dict[str, Any] = to_si(laser.model_dump(exclude={"profile", "profile_half_width_deg"}))
    if laser.profile_half_width_deg is not None:
        half, width = (to_si({"a_deg": a})["a"] for a in (laser.fan_half_angle_deg, laser.profile_half_width_deg))
        angles = np.linspace(-half, half, _GAUSSIAN_NODES)
        data["profile_angle"] = angles.tolist()
        data["profile_power"] = np.exp(-2.0 * (angles / width) ** 2).tolist()
    shape = data["straightness"]
    data["straightness"] = [*shape, *[0.0] * (_STRAIGHTNESS - len(shape))]
    return data


def _camera_json(camera: CameraDescription, wavelength_nm: float) -> dict[str, Any]:
    excluded = {"half_angle_deg", "cx_px", "cy_px", "region_columns_px", "region_rows_px"}
    data: dict[str, Any] = to_si(camera.model_dump(exclude=excluded))
    data["focal_px"] = focal_length_px(camera)
    data["cx_px"], data["cy_px"] = principal_point_px(camera)
    data["focus"] = data["focus"] or 0.0  # 0: no defocus
    if camera.psf_sigma_px == "diffraction":
        # Gaussian approximation of the Airy disc (Zhang, Zerubia, Olivo-Marin, Applied Optics 46 (2007) 1819).
        spot, pitch = to_si(
            {"spot_nm": 0.42 * wavelength_nm * camera.f_number, "pitch_um": camera.pixel_pitch_um}
        ).values()
        data["psf_sigma_px"] = spot / pitch
    return data


def focal_length_px(camera: CameraDescription) -> float:
    """Focal length from image height and half angle: ``f = H / (2 tan gamma)``."""
    gamma = si_value(camera, "half_angle_deg")
    return float(camera.height_px / (2.0 * np.tan(gamma)))


def principal_point_px(camera: CameraDescription) -> tuple[float, float]:
    """Column and row of the principal point, px."""
    return (
        (camera.width_px - 1) / 2 if camera.cx_px is None else camera.cx_px,
        (camera.height_px - 1) / 2 if camera.cy_px is None else camera.cy_px,
    )


def read_out(sensor: SensorDescription) -> SensorDescription:
    """The sensor whose image sensors are the images that `sensor` reads: of its regions, in binned pixels.

    Columns and rows that are left over by binning are not read. Values may be beyond the bounds of their keys. A binned
    pixel of N = b x b pixels collects the light and dark current of N; relative (PRNU) and absolute (DSNU) deviations
    between pixels are independent, so that they become 1 / b and b times as large; N times as many are hot.

    - ``charge``: the node and what follows are those of one pixel, so that full well, gain, read noise and row noise
      stay.
    - ``average``: in electrons of the binned pixel, the gain is 1 / N and the full well N times as large; read noise of
      N independent pixels adds to b times as much, noise of b independent rows, each in b pixels, to b^(3/2) times.
    """
    is_whole = not any(camera.region_columns_px or camera.region_rows_px for camera in sensor.camera)
    if is_whole and sensor.detector.binning == 1:
        return sensor
    cameras = tuple(_read_camera(camera, sensor.detector.binning) for camera in sensor.camera)
    return sensor.model_copy(update={"camera": cameras, "detector": _binned(sensor.detector)})


def image_sensor_pixels(sensor: SensorDescription, camera: int, pixels: Array) -> Array:
    """Pixels (n, 2), column and row, of the image sensor `sensor.camera[camera]` from those (n, 2) of its images."""
    binning = sensor.detector.binning
    return np.asarray(binning * pixels + _first_pixel(sensor.camera[camera], binning))


def _first_pixel(camera: CameraDescription, binning: int) -> Array:
    """Column and row (2,) of the image sensor of the centre of the image's first pixel, px."""
    first = [region[0] if region else 0 for region in (camera.region_columns_px, camera.region_rows_px)]
    return np.array(first) + (binning - 1) / 2


def _read_camera(camera: CameraDescription, binning: int) -> CameraDescription:
    regions = (camera.region_columns_px, camera.width_px), (camera.region_rows_px, camera.height_px)
    width, height = ((region[1] if region else size) // binning for region, size in regions)
    cx, cy = (np.array(principal_point_px(camera)) - _first_pixel(camera, binning)) / binning
    half_angle = np.degrees(np.arctan(height / (2.0 * focal_length_px(camera) / binning)))
    changes = {
        "width_px": width,
        "height_px": height,
        "half_angle_deg": float(half_angle),
        "cx_px": float(cx),
        "cy_px": float(cy),
        "region_columns_px": None,
        "region_rows_px": None,
        "pixel_pitch_um": binning * camera.pixel_pitch_um,
    }
    if camera.psf_sigma_px != "diffraction":
        changes["psf_sigma_px"] = camera.psf_sigma_px / binning
    return camera.model_copy(update=changes)


def _binned(detector: DetectorDescription) -> DetectorDescription:
    side = detector.binning
    count = side**2
    changes = {
        "binning": 1,
        "dark_current_e_per_s": count * detector.dark_current_e_per_s,
        "prnu": detector.prnu / side,
        "dsnu_e": side * detector.dsnu_e,
        "hot_pixels_ppm": count * detector.hot_pixels_ppm,
    }
    if detector.binning_mode == "average":
        changes |= {
            "full_well_e": count * detector.full_well_e,
            "gain_dn_per_e": detector.gain_dn_per_e / count,
            "read_noise_e": side * detector.read_noise_e,
            "row_noise_e": side**1.5 * detector.row_noise_e,
        }
    return detector.model_copy(update=changes)


def exposure_windows(sensor: SensorDescription) -> Array:
    """Middle of each exposure of a profile, after the middle of all, and its duration (k, 2), s.

    With a rolling shutter these are the times of the middle row.
    """
    durations = _durations(sensor)
    middles = _starts(sensor)[:-1] + durations / 2
    return np.column_stack([middles - exposure_span(sensor) / 2, durations])


def exposure_span(sensor: SensorDescription) -> float:
    """Time (s) from the start of the first exposure of a profile to the end of the last one, in one row."""
    return float(_starts(sensor)[-2] + _durations(sensor)[-1])


def profile_time(sensor: SensorDescription) -> float:
    """Shortest time from a profile to the next one, s; with automatic exposure that of the longest one."""
    return float(_starts(sensor, longest=True)[-1])


def _durations(sensor: SensorDescription, longest: bool = False) -> Array:
    first = sensor.exposure.longest_ms if longest else None
    return 1e-3 * np.array([first or sensor.detector.exposure_ms, *sensor.exposure.further_ms])


def _starts(sensor: SensorDescription, longest: bool = False) -> Array:
    """Earliest starts (k + 1,) of the exposures of a profile, s; the last one is that of the next profile.

    An image with the laser off follows each exposure and takes as long. With a rolling shutter the rows of an image are
    read after one another before the next one begins; with a global shutter an image is read during the next exposure.
    The rows are those of the region that is read; binned ones count once.
    """
    detector = sensor.detector
    rows = max(camera.height_px for camera in read_out(sensor).camera)
    readout = 1e-6 * (detector.row_readout_us or 0.0) * (rows - 1)
    durations = _durations(sensor, longest)
    images = np.repeat(durations, 2 if detector.laser_off_frame else 1)
    times = images + readout if detector.shutter == "rolling" else np.maximum(images, readout)
    return np.concatenate([[0.0], np.cumsum(times.reshape(len(durations), -1).sum(1))])
