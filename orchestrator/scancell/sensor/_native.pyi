"""Types of the compiled module. Poses are (4, 4) matrices `target_from_source`; SI units throughout.

`threads = 0` uses all cores; results do not depend on the number of threads. Invalid input raises ValueError with a
message that names the argument. The functions release the GIL.
"""

from collections.abc import Sequence
from typing import Literal, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

class Camera:
    """Camera of a sensor."""

    @property
    def name(self) -> str: ...
    @property
    def side(self) -> int:
        """+1: at sensor X = +baseline; -1: its mirror image."""
    @property
    def width_px(self) -> int: ...
    @property
    def height_px(self) -> int: ...
    @property
    def focal_px(self) -> float: ...
    @property
    def sensor_from_camera(self) -> NDArray[np.float64]:
        """(4, 4) pose; camera axes: +z forward, x along columns, y along rows."""
    def project(self, points_in_sensor: ArrayLike) -> NDArray[np.float64]:
        """Return pixels (n, 2) = (column, row) of points (n, 3), distortion applied. Integer pixel = pixel centre."""
    def view_rays(self, pixels: ArrayLike) -> NDArray[np.float64]:
        """Return viewing directions (n, 3) of pixels (n, 2) = (column, row) in the sensor frame, not normalised."""
    def paper_coordinates(self, pixels: ArrayLike) -> NDArray[np.float64]:
        """Return (n, 2): p_x along sensor +Y, p_y towards larger range, px from the principal point, undistorted."""

class Sensor:
    """Sensor from its resolved JSON description: SI units, all keys present."""

    def __init__(self, json: str) -> None: ...
    def laser_irradiance(self, points_in_sensor: ArrayLike) -> NDArray[np.float64]:
        """Return the irradiance (n, 1), W/m², at points (n, 3) on elements normal to light from the source centre."""
    @property
    def name(self) -> str: ...
    @property
    def cameras(self) -> list[Camera]: ...
    @property
    def exposure(self) -> float:
        """Default exposure, s."""
    @property
    def row_readout(self) -> float:
        """Time from the exposure of one row to that of the next, s; 0: global shutter."""
    @property
    def laser_off_frame(self) -> bool:
        """Whether `scan` takes a second image with the laser off and extracts from the difference."""
    @property
    def range(self) -> tuple[float, float]:
        """Nearest and farthest sensor z of measured points, m."""
    def trapezoid(self, camera: int = 0) -> NDArray[np.float64]:
        """Return the corners (4, 2) = (y, z) of a camera's field in the sheet: near -y, near +y, far +y, far -y, m.

        Dumitrache & Borangiu, Eq. 5, with y corrected unless triangulation is ``eq5_as_printed``. ValueError for an
        unbounded field of view.
        """

class Material:
    """Surface material at the laser wavelength. A number in its place is the reflectance of a Lambertian surface.

    Parameters
    ----------
    reflectance
        0..1: of the diffuse base (lambert, oren_nayar, rough_dielectric), at normal incidence (rough_conductor), at
        every angle (mirror)
    model
        lambert, oren_nayar, rough_dielectric (GGX coat on a diffuse base), rough_conductor (GGX), grooved_conductor
        (GGX with two widths), mirror or retro_reflective
    roughness
        oren_nayar: 0..1, standard deviation of the slope angle over pi/2; GGX alpha: 0.01..1; otherwise unused
    refractive_index
        of the coat, 1..3; otherwise unused
    roughness_along
        grooved_conductor: GGX alpha along the grooves, 0.01..1; `roughness` is that across them
    groove_axis
        (3,) in the body frame: direction of straight grooves, or axis of circular ones; only its part in the surface
        counts
    groove_centre
        (3,) m, point of the axis of circular grooves; None: straight ones
    scattering
        rough_dielectric: reduced scattering coefficient of the medium below the surface, 50..1e6 1/m, whose light
        leaves beside the point where it enters; 0: an opaque base
    """

    @overload
    def __init__(self, reflectance: float) -> None: ...
    @overload
    def __init__(
        self,
        reflectance: float,
        model: str,
        roughness: float,
        refractive_index: float,
        roughness_along: float = 0.0,
        groove_axis: ArrayLike | None = None,
        groove_centre: ArrayLike | None = None,
        scattering: float = 0.0,
    ) -> None: ...
    @property
    def model(self) -> str: ...
    @property
    def reflectance(self) -> float: ...
    @property
    def roughness(self) -> float: ...
    @property
    def refractive_index(self) -> float: ...
    @property
    def roughness_along(self) -> float: ...
    @property
    def scattering(self) -> float: ...
    @property
    def scattering_albedo(self) -> float | None:
        """Share of light that an event of scattering below the surface leaves; None: an opaque base."""
    def pi_brdf(self, a: ArrayLike, b: ArrayLike) -> NDArray[np.float64]:
        """Return pi times the BRDF, (n,), for directions (n, 3) that point away from a surface with normal +z.

        The surface is at the origin of the body frame.
        """
    def albedo(self, cosine: ArrayLike) -> NDArray[np.float64]:
        """Return the directional albedo (n,) at these cosines of incidence."""
    def sample(
        self, from_direction: ArrayLike, uniforms: ArrayLike
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Sample directions of reflection for light from (n, 3), using uniform numbers (n, 3).

        Returns directions (n, 3), weights BRDF * cosine / pdf (0: absorbed) and pdfs (1/sr; 0 for the mirror).
        """

class Scene:
    """Scene of rigid bodies made of shapes. Shapes with the same body name move together. Surfaces are two-sided."""

    def __init__(self) -> None: ...
    def add_mesh(
        self,
        name: str,
        vertices: ArrayLike,
        faces: ArrayLike,
        material: Material | float,
        curved: Sequence[tuple[str, ArrayLike, float, float]] = (),
        curved_of_face: ArrayLike = (),
    ) -> None:
        """Add a mesh with vertices (n, 3) in the body frame, m, and faces (m, 3) of vertex indices.

        `curved` are the exact surfaces of its faces: ``cylinder``, ``cone``, ``sphere`` or ``torus``, the pose
        ``body_from_face`` (4, 4), the radius (of a cone where z = 0, of the centre line of a torus), m, and the half
        angle of the cone, rad, or the radius of the tube, m. `curved_of_face` (m,) is the number in it of each face,
        -1 for a flat one. Rays that meet a triangle hit the exact surface of its face.
        """
    def add_sphere(self, name: str, centre: ArrayLike, radius: float, material: Material | float) -> None:
        """Add an exact sphere around a point (3,) of the body frame."""
    def add_box(self, name: str, body_from_box: ArrayLike, size: ArrayLike, material: Material | float) -> None:
        """Add an exact box with edges `size` (3,), centred in its own frame."""
    def add_cylinder(
        self, name: str, body_from_cylinder: ArrayLike, radius: float, height: float, material: Material | float
    ) -> None:
        """Add an exact capped cylinder along its own z axis, centred in its own frame."""
    def add_cone(
        self,
        name: str,
        body_from_cone: ArrayLike,
        bottom_radius: float,
        top_radius: float,
        height: float,
        material: Material | float,
    ) -> None:
        """Add an exact capped cone frustum along its own z axis, centred in its own frame; one radius may be 0."""
    def add_ring(
        self,
        name: str,
        body_from_ring: ArrayLike,
        inner_radius: float,
        outer_radius: float,
        height: float,
        material: Material | float,
    ) -> None:
        """Add an exact cylinder along its own z axis with a concentric bore, centred in its own frame."""
    def add_plane(self, name: str, body_from_plane: ArrayLike, size: ArrayLike, material: Material | float) -> None:
        """Add an exact rectangle with edges `size` (2,) in the xy plane of its own frame, centred."""
    def add_light(
        self,
        name: str,
        kind: Literal["point", "rectangle", "disc"],
        body_from_light: ArrayLike,
        size: ArrayLike,
        power: float,
        in_band: float | None = None,
        spectrum: tuple[float, float] | None = None,
    ) -> None:
        """Add a lamp that moves with the body `name`; area lights lie in z = 0 of their frame and emit towards +z.

        `size` (2,): edges of a rectangle, or the diameter of a disc given twice, m. `power` in W. Either `in_band`, the
        fraction of the power that passes the band-pass filter, or `spectrum`: wavelength and full width at half
        maximum, m.
        """
    def remove_shapes(self, name: str) -> None:
        """Remove the shapes of a body, which keeps its position in `bodies`.

        Shapes added under its name later replace them; no other shape is rebuilt. Lamps are kept.
        """
    @property
    def bodies(self) -> list[str]:
        """Body names in the order of the poses of `Exposures` and `cast_rays`: the order of first use."""

class Exposures:
    """Poses of a batch of n exposures: k samples each, evenly spaced from start to end (k = 1: no motion).

    With a rolling shutter `duration` is that of one row, and the poses cover the time from the start of the first to
    the end of the last row of the camera with the most rows: ``duration + (rows - 1) * row_readout``.

    Parameters
    ----------
    world_from_sensor
        (n, k, 4, 4)
    world_from_body
        (n, bodies, k, 4, 4), bodies in the order of `Scene.bodies`
    duration
        (n,) s
    index
        (n,) frame numbers; the noise depends on them and the seed
    """

    def __init__(
        self, world_from_sensor: ArrayLike, world_from_body: ArrayLike, duration: ArrayLike, index: NDArray[np.int64]
    ) -> None: ...
    @property
    def samples(self) -> int: ...
    @property
    def bodies(self) -> int: ...
    def __len__(self) -> int: ...

PEAK_FLAGS: dict[str, int]
PEAK_REJECTED: int

class Peaks:
    """Stripe peaks as arrays of equal length, in the order frame, camera, column."""

    @property
    def frame(self) -> NDArray[np.int64]:
        """Number of the frame within the batch."""
    @property
    def camera(self) -> NDArray[np.int32]: ...
    @property
    def column(self) -> NDArray[np.int32]: ...
    @property
    def row(self) -> NDArray[np.float64]:
        """Row in the image, px; integer = pixel centre."""
    @property
    def amplitude(self) -> NDArray[np.float32]:
        """DN above the background."""
    @property
    def width(self) -> NDArray[np.float32]:
        """Standard deviation of the stripe, px."""
    @property
    def row_sigma(self) -> NDArray[np.float32]:
        """Standard deviation of `row` from noise, px."""
    @property
    def asymmetry(self) -> NDArray[np.float32]:
        """> 0 when the tail lies at larger rows."""
    @property
    def residual(self) -> NDArray[np.float32]:
        """Misfit beyond noise, relative to `amplitude`."""
    @property
    def flags(self) -> NDArray[np.uint32]:
        """Bits of `PEAK_FLAGS`."""
    def __len__(self) -> int: ...

class Profiles:
    """Points in the sensor frame (m) as arrays of equal length."""

    @property
    def points_in_sensor(self) -> NDArray[np.float64]: ...
    @property
    def covariance(self) -> NDArray[np.float64]:
        """Covariance (n, 3, 3), m²."""
    @property
    def sigma(self) -> NDArray[np.float32]:
        """Largest standard deviation over directions, m."""
    @property
    def intensity(self) -> NDArray[np.float32]:
        """Amplitude of the peak, DN."""
    @property
    def camera(self) -> NDArray[np.int32]: ...
    @property
    def column(self) -> NDArray[np.int32]: ...
    @property
    def row(self) -> NDArray[np.float64]:
        """Row in the image, px."""
    @property
    def frame(self) -> NDArray[np.int64]: ...
    @property
    def flags(self) -> NDArray[np.uint32]:
        """Bits of `PEAK_FLAGS`."""
    def __len__(self) -> int: ...

def expose(
    electrons: NDArray[np.float32],
    sensor: Sensor,
    duration: NDArray[np.float64],
    index: NDArray[np.int64],
    threads: int = 0,
) -> NDArray[np.uint16]:
    """Return digital images of expected photo-electrons (n, cameras, height, width), in the terms of EMVA 1288.

    `duration` (n,) is in seconds, for the dark current, which is added here; `index` (n,) are frame numbers, on which
    the noise depends.

    Raises
    ------
    ValueError
        If an array has the wrong type or shape.
    """

def extract(
    images: NDArray[np.uint16],
    sensor: Sensor,
    threads: int = 0,
    all_peaks: bool = False,
    background: NDArray[np.uint16] | None = None,
) -> Peaks:
    """Extract the stripe peaks of images (n, cameras, height, width), one per column unless `all_peaks`.

    `background`: images of the same shape with the laser off, subtracted first. With `all_peaks`, peaks that were not
    chosen carry the flag ``passed_over``; peaks contradicted by other cameras carry ``unconfirmed``.
    """

def triangulate(peaks: Peaks, sensor: Sensor, keep_rejected: bool = False) -> Profiles:
    """Triangulate peaks; points of several cameras are fused if the sensor description enables it.

    Peaks with a flag of `PEAK_REJECTED` are skipped unless `keep_rejected`, points outside the range always.
    """

def triangulate_pixels(
    pixels: NDArray[np.float64],
    sensor: Sensor,
    camera: int,
    form: Literal["exact", "sheet", "ray", "eq4_as_printed", "eq5_as_printed"],
) -> NDArray[np.float64]:
    """Return the points (n, 3) on the laser sheet, m, that a camera sees at pixels (n, 2) = (column, row).

    exact: on the plane X = 0; sheet: on the sheet as described, NaN where the ray misses it; ray: exact, without the
    closed form; eq4_as_printed: the published formula; eq5_as_printed: exact, it is about the measuring range.
    """

class ScanResult:
    """Result of `scan`."""

    @property
    def profiles(self) -> Profiles: ...
    @property
    def timings(self) -> dict[str, float]:
        """Seconds per stage (cast, render, detect, extract, triangulate), summed over the threads."""
    @property
    def images(self) -> NDArray[np.uint16] | None:
        """(n, cameras, height, width) if images were kept."""
    @property
    def background(self) -> NDArray[np.uint16] | None:
        """Background frames (laser off), if the sensor takes them and images were kept."""

def scan(
    scene: Scene,
    sensor: Sensor,
    exposures: Exposures,
    engine: Literal["ray-traced", "geometric"] = "ray-traced",
    threads: int = 0,
    keep_images: bool = False,
    as_built: Sensor | None = None,
    keep_rejected: bool = False,
) -> ScanResult:
    """Simulate the profiles of all exposures.

    `as_built` is the true sensor, which generates the images; `sensor` is the nominal sensor used to evaluate them.
    `keep_rejected`: also return the points of peaks with one of the flags ``PEAK_REJECTED``; not with ``geometric``,
    which rejects none, and not where points of several cameras are fused.

    ``ray-traced`` renders the images of all cameras, adds detector noise, extracts the stripe and triangulates.
    ``geometric`` casts the laser rays at mid-exposure without rendering images. With ``render.noise`` of the sensor as
    built, the row of every hit point gets a random error with the standard deviation of the extraction for a stripe of
    this brightness and width, stripes below the detection limit are discarded, and points are triangulated with
    `sensor`; ``sigma``, ``covariance`` and ``intensity`` match those of images. Without noise, points are exact:
    ``sigma`` is 0 and ``intensity`` is reflectance times cosine of incidence. If the true sheet is not the plane X = 0,
    or the sensor as built differs, points are triangulated from their pixels.

    Raises
    ------
    ValueError
        If exposures, scene and sensors do not match, or the engine does not support an option (see `check_engine`).
    """

def check_engine(sensor: Sensor, engine: Literal["ray-traced", "geometric"]) -> None:
    """Check that an engine supports a sensor.

    Raises
    ------
    ValueError
        If the engine is geometric and the sensor has a rolling shutter, light between surfaces (``render.bounces``) or
        path tracing (``render.mode``); the message names the key.
    """

def render(
    scene: Scene, sensor: Sensor, exposures: Exposures, threads: int = 0, laser_on: bool = True
) -> NDArray[np.uint16]:
    """Render images (n, cameras, height, width) in digital numbers. All cameras must have the same size.

    With `laser_on` false, these are the background frames directly after the laser frames; motion is extrapolated.
    """

def expected_electrons(scene: Scene, sensor: Sensor, exposures: Exposures, threads: int = 0) -> NDArray[np.float32]:
    """Return the expected photo-electrons (n, cameras, height, width) without noise."""

def tree_builds() -> int:
    """Return the number of triangle search trees that this process has built."""

def cast_rays(
    scene: Scene, world_from_body: ArrayLike, origins: ArrayLike, directions: ArrayLike, threads: int = 0
) -> tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.int64]]:
    """Return the closest hits of rays (n, 3) in the world: distance in m (inf: none), body, face (both -1: none).

    `world_from_body` is (bodies, 4, 4). Directions need not be unit vectors.
    """

def occluded(
    scene: Scene, world_from_body: ArrayLike, starts: ArrayLike, ends: ArrayLike, threads: int = 0
) -> NDArray[np.bool_]:
    """Return whether segments (n,) from `starts` (n, 3) to `ends` (n, 3), m, in the world are occluded.

    `world_from_body` is (bodies, 4, 4). A surface within single precision of an end point may count or not.
    """

class MeshSurface:
    """Triangle mesh preprocessed for distance queries.

    The sign of distances needs a closed mesh with outward faces.
    """

    def __init__(self, vertices: ArrayLike, faces: ArrayLike) -> None: ...
    def signed_distances(self, points: ArrayLike, threads: int = 0) -> tuple[NDArray[np.float64], NDArray[np.uint32]]:
        """Return distances (n,) of points (n, 3), m, negative inside, and closest faces (n,); double precision."""
    def triangle_distances(
        self, triangles: ArrayLike, is_signed: bool, threads: int = 0
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return distances (n,) of the centres of triangles (n, 3, 3), m, and upper bounds (n,) for all their points.

        The bound is the smaller of the centre's distance plus the radius about it, and the largest distance of the
        corners from the face nearest to the centre. `is_signed`: negative inside.
        """

def estimate_normals(
    points: ArrayLike, frame: ArrayLike, camera: ArrayLike, column: ArrayLike, light: ArrayLike, threads: int = 0
) -> NDArray[np.float64]:
    """Estimate unit normals (m, 3) of a scanned surface at points (m, 3), towards the light; NaN where unknown.

    `frame`, `camera` and `column` are (m,), `light` is (frames, 3), all in one frame of reference, m. Of several points
    of one camera, frame and column the grid holds the last one. Three methods in order, until one faces the light:

    1. Grid of frames and columns. Along the profile: the slope of a line fit over up to six columns on either side.
       Across: the steps to the previous and next frame in the same column. Neighbours are connected by steps shorter
       than 10 mm and than four times the median step in a block of 400 frames.
    2. Plane fit to the twelve nearest points if they lie within 10 mm and are not collinear; otherwise to those among
       every 4th, 16th or 64th point, because points are much denser along a profile than across.
    3. The direction perpendicular to the profile that is nearest to the incident light.
    """

def closest_points(
    vertices: ArrayLike, faces: ArrayLike, points: ArrayLike, threads: int = 0
) -> tuple[NDArray[np.float64], NDArray[np.uint32], NDArray[np.float64]]:
    """Return closest points (n, 3) on a mesh, faces (n,) and signed distances (n,), negative inside; double precision.

    The sign needs a closed mesh with outward faces.
    """

class PoseSearch:
    """Search for sensor poses that measure surface samples; all in one frame, in which z = 0 is the table top.

    A pose measures a sample when its laser ray and the ray to one camera are unobstructed and hit the surface within
    the incidence limit, and the housing is above z = 0. Rays are looked up in a grid of directions (2.5 degrees for
    `azimuths` = 24) and cast exactly for the poses that pass.

    Parameters
    ----------
    vertices, faces
        Mesh of everything that can occlude, the sampled surface included.
    samples, normals
        (n, 3) positions, m, and unit normals
    orientations
        (k, 3, 3) ``frame_from_sensor`` at azimuth 0
    lowest
        (k,) z of the lowest point of the housing over the sensor's origin, m
    azimuths
        number of rotations about z, evenly spaced over a full turn; even
    field_points
        (m, 2) y and z in the laser sheet at which a sample may lie, m
    field_seen
        (m, cameras) whether the camera's image holds the point
    cameras
        (cameras, 3) centres of projection in the sensor frame, m
    source_z
        the laser's source is at (0, 0, source_z) of the sensor frame, m
    incidence_limit
        rad
    position_step
        grid of the sensor positions in the keys of `next`, m
    """

    def __init__(
        self,
        vertices: ArrayLike,
        faces: ArrayLike,
        samples: ArrayLike,
        normals: ArrayLike,
        orientations: ArrayLike,
        lowest: ArrayLike,
        azimuths: int,
        field_points: ArrayLike,
        field_seen: ArrayLike,
        cameras: ArrayLike,
        source_z: float,
        incidence_limit: float,
        position_step: float,
    ) -> None: ...
    def next(
        self, samples: NDArray[np.int64], threads: int = 0
    ) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.float64]]:
        """Return the next pose of each sample (by index, each at most once) that has another one.

        Returns sample indices (f,), keys (f, 4) of the poses at azimuth 0: orientation and sensor origin in
        `position_step`, and positions (f, 3, 3) of sample, laser source and camera, rotated to azimuth 0.
        """
    def skip_directions(self, samples: NDArray[np.int64]) -> None:
        """Continue these samples with other directions of the laser ray (about 10 degrees away)."""
    def record_reachability(self, keys: NDArray[np.int32], reached: NDArray[np.bool_]) -> None:
        """Record whether the robot reaches the poses with these keys (k, 4).

        Unreachable poses are no longer returned. With 3 unreachable poses and no reachable one in a cube of positions,
        all poses of the same orientation in it are excluded; its edge is 8 steps, or 1/32 of the range if larger.
        """

def covered_samples(
    samples: ArrayLike,
    normals: ArrayLike,
    points: ArrayLike,
    point_normals: ArrayLike | None,
    tolerance: float,
    min_cosine: float,
) -> NDArray[np.bool_]:
    """Return whether each sample (n, 3) has a point (m, 3) within `tolerance` (m) on the same side.

    Same side: the cosine between the normals (n, 3) and (m, 3) is at least `min_cosine`. Points whose normal is NaN,
    and all points when `point_normals` is None, match either side.
    """
