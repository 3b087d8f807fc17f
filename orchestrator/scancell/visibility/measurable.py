"""The measurable surface of a part: measurable from at least one pose that the arm reaches, independent of the plan.

Definition. A surface sample is measurable when the pose grid below holds a pose from which

- the sample lies in the laser sheet, within the range, the fan of the laser and the image of a camera;
- the laser ray and the ray to that camera meet the surface within the incidence limit, and no surface of the part, of
  a body on the table or of a body fixed in the world lies in between;
- the arm has a solution of its inverse kinematics within the joint limits, at one of 24 table angles 15° apart;
- the whole housing of the sensor is above the plane of the table top.

Pose grid. Orientations in steps of 15°: elevation of the viewing direction from -90° to 90°, azimuth (turned by the
table), heading of the laser sheet about the viewing direction. For each of them the sample is placed at all points of
the sheet, 5 mm apart along the laser line and in range, that the sensor sees; across the sheet the position follows
from the sample, as a scan sweeps the sheet over the part. Reach is evaluated at the nearest point of a grid of 5 mm
that is fixed in the frame of the table; where three poses tried in a cube of 40 mm are all out of reach, the cube is.
Bodies fixed in the world are considered at the first table angle found; where one occludes a pose, directions nearby
(10°) are not tried any more.

Not part of it: collisions of arm or housing with the part or with anything but the table, occlusion by arm, gripper
and the sensor itself, and deviations of the sensor as built. The sensor is that of the geometric engine with its laser
in the plane X = 0. Numerically, rays are looked up in a grid of directions of 2.5° before they are cast exactly: a
sample that is only visible through a gap narrower than that may be missed, one that is found is certain.
"""

from __future__ import annotations

import os
import zipfile
import zlib
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scancell.config.sensor import SensorDescription
from scancell.errors import OutputError
from scancell.files import atomic_write
from scancell.nominal.cell import NominalCell
from scancell.progress import NullProgress, Progress
from scancell.values import Value
from scancell.visibility.surface_search import SensorField, SurfaceSearch

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

COVERAGE_SAMPLES = 20_000


@dataclass(frozen=True, eq=False, repr=False)
class MeasurableSurface(Value):
    """Surface samples of a part and which of them the sensor could measure (see the module).

    Attributes
    ----------
    samples, normals
        (n, 3) in the part frame, m; each sample represents the same share of the surface. The unit normals look
        outwards; they are NaN for a mesh that is not closed: what is measured from either side counts there.
    measurable
        (n,)
    area
        Area of the whole surface, m².
    digest
        SHA-256 of everything that decides the result.
    """

    samples: Array
    normals: Array
    measurable: Flags
    area: float
    digest: str

    @property
    def measurable_fraction(self) -> float:
        """Measurable share of the whole surface, 0 … 1."""
        return float(self.measurable.mean())

    def thinned(self, count: int) -> MeasurableSurface:
        """The same surface with at most `count` of the samples, evenly chosen."""
        if count >= len(self.samples):
            return self
        rows = (np.arange(count) + 0.5) * len(self.samples) / count
        chosen = rows.astype(np.int64)
        return MeasurableSurface(
            self.samples[chosen], self.normals[chosen], self.measurable[chosen], self.area, self.digest
        )


def cache_folder() -> Path:
    """Folder of the cached results: ``$SCANCELL_CACHE``, or ``scancell/measurable`` in the user's cache folder."""
    chosen = os.environ.get("SCANCELL_CACHE")
    if chosen:
        return Path(chosen)
    user = os.environ.get("XDG_CACHE_HOME")
    return (Path(user) if user else Path.home() / ".cache") / "scancell" / "measurable"


def measurable_surface(
    nominal: NominalCell,
    sensor: SensorDescription,
    samples: int = COVERAGE_SAMPLES,
    progress: Progress | None = None,
    cache: Path | None = None,
    threads: int = 0,
) -> MeasurableSurface:
    """Find the measurable surface of the part in a cell, or read it from the cache.

    Parameters
    ----------
    samples
        Number of surface samples.
    progress
        Gets the stage ``measurable surface``, unless the result is cached.
    cache
        Folder of the cache, see `cache_folder`; None: nothing is read or kept.
    threads
        0: all cores. The result does not depend on it.
    """
    search = SurfaceSearch(nominal, SensorField.of(sensor), samples, threads)
    digest = search.digest()
    file = None if cache is None else cache / f"{digest}.npz"
    measurable = None if file is None else _read(file, samples)
    if measurable is None:
        measurable = search.run(progress or NullProgress())
        if file is not None:
            _write(file, measurable)
    normals = search.normals if nominal.part.is_closed else np.full_like(search.normals, np.nan)
    return MeasurableSurface(search.samples, normals, measurable, float(nominal.part.areas.sum()), digest)


def unknown_surface(
    nominal: NominalCell, sensor: SensorDescription, samples: int = COVERAGE_SAMPLES, threads: int = 0
) -> MeasurableSurface:
    """The samples of `measurable_surface` where it is unknown which are measurable: none counts as such."""
    search = SurfaceSearch(nominal, SensorField.of(sensor), samples, threads)
    normals = search.normals if nominal.part.is_closed else np.full_like(search.normals, np.nan)
    return MeasurableSurface(search.samples, normals, np.zeros(samples, bool), float(nominal.part.areas.sum()), "")


def _read(file: Path, samples: int) -> Flags | None:
    """Which samples are measurable (n,), from a cache file; None when it is missing, damaged or of another size."""
    try:
        with np.load(file, allow_pickle=False) as data:
            measurable = data["measurable"]
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error):
        return None
    return measurable if measurable.shape == (samples,) and measurable.dtype == np.bool_ else None


def _write(file: Path, measurable: Flags) -> None:
    """Keep the result. Where the folder cannot be written, the next scan computes it again."""
    with suppress(OutputError), atomic_write(file) as temporary:
        np.savez_compressed(temporary, measurable=measurable)
