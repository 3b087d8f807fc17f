"""Types of the compiled module. Poses are (4, 4) matrices `target_from_source`; SI units throughout.

`threads = 0` uses every core; results do not depend on the number of threads. Wrong input raises ValueError and names
what is wrong. The functions release the interpreter lock while they work.
"""

from typing import Literal, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

class Camera:
    """One camera of a sensor."""

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
        """Pixels (n, 2) = (column, row) of points (n, 3), distortion applied. Integer pixel = pixel centre."""
    def view_rays(self, pixels: ArrayLike) -> NDArray[np.float64]:
        """Directions (n, 3) in the sensor frame, not normalised, seen by pixels (n, 2) = (column, row)."""
    def paper_coordinates(self, pixels: ArrayLike) -> NDArray[np.float64]:
        """(n, 2): p_x along sensor +Y and p_y towards larger range, px from the principal point, undistorted."""

class Sensor:
    """A sensor from its resolved JSON description: SI units, every key present."""

    def __init__(self, json: str) -> None: ...
    def laser_irradiance(self, points_in_sensor: ArrayLike) -> NDArray[np.float64]:
        """Irradiance (n, 1), W/m², at points (n, 3) on elements that face the middle of the laser's source."""
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
        """(4, 2) corners (y, z) of the field that a camera sees in the sheet: near -y, near +y, far +y, far -y, m.

        Dumitrache & Borangiu, Eq. 5, with y corrected. ValueError for a camera that sees to infinity.
        """

class Material:
    """A surface at the laser's wavelength. Everywhere a number stands for the reflectance of a Lambertian surface.

    Parameters
    ----------
    reflectance
        0..1: of the diffuse base (lambert, oren_nayar, rough_dielectric), at normal incidence (rough_conductor), at
        every angle (mirror)
    model
        lambert, oren_nayar, rough_dielectric (GGX coat on a diffuse base), rough_conductor (GGX) or mirror
    roughness
        oren_nayar: 0..1, standard deviation of the slope angle over pi/2; GGX alpha: 0.01..1; otherwise unused
    refractive_index
        of the coat, 1..3; otherwise unused
    """

    @overload
    def __init__(self, reflectance: float) -> None: ...
    @overload
    def __init__(self, reflectance: float, model: str, roughness: float, refractive_index: float) -> None: ...
    @property
    def model(self) -> str: ...
    @property
    def reflectance(self) -> float: ...
    @property
    def roughness(self) -> float: ...
    @property
    def refractive_index(self) -> float: ...
    def diffuse_equivalent(self, a: ArrayLike, b: ArrayLike) -> NDArray[np.float64]:
        """pi times the brdf, (n,), between directions (n, 3) that point away from a surface whose normal is +z."""
    def albedo(self, cosine: ArrayLike) -> NDArray[np.float64]:
        """Share sent back of light that arrives at these cosines, (n,)."""
    def sample(
        self, from_direction: ArrayLike, uniforms: ArrayLike
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Random reflections of light from (n, 3), by uniform numbers (n, 3).

        Directions (n, 3), weights brdf * cosine / density (0: absorbed), densities (1/sr; 0 for the mirror).
        """

class Scene:
    """Bodies made of shapes. Shapes with the same body name move as one. Surfaces are two-sided."""

    def __init__(self) -> None: ...
    def add_mesh(self, name: str, vertices: ArrayLike, faces: ArrayLike, material: Material | float) -> None:
        """Mesh with vertices (n, 3) in the body frame, m, and faces (m, 3) of vertex indices."""
    def add_sphere(self, name: str, centre: ArrayLike, radius: float, material: Material | float) -> None:
        """Exact sphere around a point (3,) of the body frame."""
    def add_box(self, name: str, body_from_box: ArrayLike, size: ArrayLike, material: Material | float) -> None:
        """Exact box with edges `size` (3,), centred in its own frame."""
    def add_cylinder(
        self, name: str, body_from_cylinder: ArrayLike, radius: float, height: float, material: Material | float
    ) -> None:
        """Exact capped cylinder along its own z axis, centred in its own frame."""
    def add_plane(self, name: str, body_from_plane: ArrayLike, size: ArrayLike, material: Material | float) -> None:
        """Exact rectangle with edges `size` (2,) in the xy plane of its own frame, centred."""
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
        """Lamp that moves with the body `name`, in W; areas lie in z = 0 of their frame and shine towards +z.

        `size` (2,): edges of a rectangle, twice the diameter of a disc, m. Either `in_band`, the share of the power
        that passes the band-pass filter, or `spectrum`, wavelength and full width at half maximum, m.
        """
    def remove_shapes(self, name: str) -> None:
        """Take away the shapes of a body, which keeps its place in `bodies`: what is added under its name next
        replaces them, and nothing else is built again. Lamps stay."""
    @property
    def bodies(self) -> list[str]:
        """Names in the order in which `Exposures` and `cast_rays` expect their poses: that of their first mention."""

class Exposures:
    """Poses over a batch of n exposures: k samples each, evenly spaced from start to end (k = 1: still).

    With a rolling shutter `duration` is that of one row, and the poses reach from the start of the first to the end of
    the last row of the camera with the most rows: ``duration + (rows - 1) * row_readout``.

    Parameters
    ----------
    world_from_sensor
        (n, k, 4, 4)
    world_from_body
        (n, bodies, k, 4, 4), bodies in the order of `Scene.bodies`
    duration
        (n,) s
    index
        (n,) frame numbers; they key the noise
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
    def frame(self) -> NDArray[np.int64]: ...
    @property
    def camera(self) -> NDArray[np.int32]: ...
    @property
    def column(self) -> NDArray[np.int32]: ...
    @property
    def row(self) -> NDArray[np.float64]: ...
    @property
    def amplitude(self) -> NDArray[np.float32]: ...
    @property
    def width(self) -> NDArray[np.float32]: ...
    @property
    def row_sigma(self) -> NDArray[np.float32]: ...
    @property
    def asymmetry(self) -> NDArray[np.float32]: ...
    @property
    def residual(self) -> NDArray[np.float32]: ...
    @property
    def flags(self) -> NDArray[np.uint32]: ...
    def __len__(self) -> int: ...

class Profiles:
    """Points in the sensor frame (m) as arrays of equal length."""

    @property
    def points_in_sensor(self) -> NDArray[np.float64]: ...
    @property
    def covariance(self) -> NDArray[np.float64]: ...
    @property
    def sigma(self) -> NDArray[np.float32]: ...
    @property
    def intensity(self) -> NDArray[np.float32]: ...
    @property
    def camera(self) -> NDArray[np.int32]: ...
    @property
    def column(self) -> NDArray[np.int32]: ...
    @property
    def row(self) -> NDArray[np.float64]: ...
    @property
    def frame(self) -> NDArray[np.int64]: ...
    @property
    def flags(self) -> NDArray[np.uint32]: ...
    def __len__(self) -> int: ...

def expose(
    electrons: NDArray[np.float32],
    sensor: Sensor,
    duration: NDArray[np.float64],
    index: NDArray[np.int64],
    threads: int = 0,
) -> NDArray[np.uint16]: ...
def extract(
    images: NDArray[np.uint16],
    sensor: Sensor,
    threads: int = 0,
    all_peaks: bool = False,
    unlit: NDArray[np.uint16] | None = None,
) -> Peaks:
    """Stripe peaks of images (n, cameras, height, width), at most one per column unless `all_peaks` asks for all.

    `unlit` are the same images with the laser off, which are taken away first.
    Those that were not chosen carry the flag ``passed_over``, those that other cameras contradict ``unconfirmed``.
    """

def triangulate(peaks: Peaks, sensor: Sensor, keep_rejected: bool = False) -> Profiles:
    """Points of the peaks, fused between cameras if the sensor's description says so.

    Peaks with a flag of `PEAK_REJECTED` are left out unless kept, points outside the range always.
    """

def triangulate_pixels(
    pixels: NDArray[np.float64], sensor: Sensor, camera: int, form: Literal["exact", "ray", "eq4_as_printed"]
) -> NDArray[np.float64]: ...

class ScanResult:
    """What `scan` made."""

    @property
    def profiles(self) -> Profiles: ...
    @property
    def timings(self) -> dict[str, float]:
        """Seconds per station (cast, render, detect, extract, triangulate), summed over the threads."""
    @property
    def images(self) -> NDArray[np.uint16] | None:
        """(n, cameras, height, width) when they were kept."""
    @property
    def unlit(self) -> NDArray[np.uint16] | None:
        """The same with the laser off, when the sensor takes such images and they were kept."""

def scan(
    scene: Scene,
    sensor: Sensor,
    exposures: Exposures,
    engine: Literal["ray-traced", "geometric"] = "ray-traced",
    threads: int = 0,
    keep_images: bool = False,
    as_built: Sensor | None = None,
) -> ScanResult:
    """Profiles of all exposures.

    `as_built` is the sensor as it truly is: it makes the images, which are read by what is believed of `sensor`.

    ``ray-traced`` renders the images of all cameras, adds the detector's noise, finds the stripe and triangulates.
    ``geometric`` casts the laser's rays at mid-exposure and keeps what a camera sees of their landing points: exact
    points without covariance, intensity = reflectance times cosine of incidence. Where the true sheet is not the
    plane X = 0, or the sensor as built is another, points are triangulated from the pixels that see them.
    """

def render(
    scene: Scene, sensor: Sensor, exposures: Exposures, threads: int = 0, laser_on: bool = True
) -> NDArray[np.uint16]:
    """Images (n, cameras, height, width) in digital numbers. All cameras must be of one size.

    Without the laser they are those that follow at once on the images with it: poses go on as they were going.
    """

def expected_electrons(
    scene: Scene, sensor: Sensor, exposures: Exposures, whole_image: bool = False, threads: int = 0
) -> NDArray[np.float32]:
    """Photo-electrons (n, cameras, height, width) expected before any noise.

    `whole_image` traces every pixel instead of those that the laser can reach: slow, and the same to the last bit.
    """

def tree_builds() -> int:
    """Search trees over triangles that this process has built so far."""

def cast_rays(
    scene: Scene, world_from_body: ArrayLike, origins: ArrayLike, directions: ArrayLike, threads: int = 0
) -> tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.int64]]:
    """Closest hits of rays (n, 3) in the world: distance in m (inf: none), body, face (both -1: none).

    `world_from_body` is (bodies, 4, 4). Directions need not be unit vectors.
    """

def closest_points(
    vertices: ArrayLike, faces: ArrayLike, points: ArrayLike, threads: int = 0
) -> tuple[NDArray[np.float64], NDArray[np.uint32], NDArray[np.float64]]:
    """Closest points (n, 3) of a mesh, their faces (n,) and signed distances (n,), negative inside; exact, in double.

    The sign needs a closed mesh with outward faces.
    """
