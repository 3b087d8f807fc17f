"""The world of a scan: a part in the cell with its sensors, as it is known, and as it is."""

from __future__ import annotations

import hashlib
import json
from collections import deque
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.arrays import Array
from scancell.cell.fmu_file import cell_json, mesh_json
from scancell.cell.recording import ExposureTruth, Recording
from scancell.config.cell import (
    PrismaticAxisDescription,
    RevoluteAxisDescription,
    TableDescription,
    sensor_frame,
)
from scancell.config.choices import Engine
from scancell.config.description import si_value, split_unit
from scancell.config.loading import Setup, as_built_delay, as_built_sensor, require_sensors
from scancell.config.material import Material
from scancell.config.robot import JointDescription
from scancell.config.sensor import SensorDescription, exposure_windows, read_out, sensor_json
from scancell.errors import DescriptionError, SensorError
from scancell.geometry.cad import CadMesh
from scancell.geometry.shapes import Box, Cone, Cylinder, PartSurface, PlacedShape, Plane, Ring, ShapeMesh, Sphere
from scancell.nominal.cell import Lamp, NominalCell, as_estimated, fmu_frame
from scancell.nominal.parts import Body, Patch
from scancell.progress import Progress
from scancell.scanning.sense import OnImages, SensedProfiles, expose

_SEED_BYTES = 7  # the library takes seeds below 2^63

_LARGEST_STEP = 4.0  # of the exposure time, from one image to the profile that it sets
_IN_THE_DARK = 2.0  # factor without any light of the stripe
_NEAR_ENOUGH = 0.05  # relative change that is not worth it

# Exposures per call: enough to use all cores, few enough for responsive interrupts and progress.
_FIRST_TRIGGER = 1
_BATCH = 64

Encoder = JointDescription | TableDescription | RevoluteAxisDescription | PrismaticAxisDescription


def visible_bodies(cell: NominalCell, number: int = 1) -> tuple[Body | Lamp, ...]:
    """Bodies that reflect or block light, then lamps, in the order of the scene of a sensor, by its number.

    The housing of a sensor blocks neither its own light nor its view.
    """
    own = sensor_frame(number)
    return (*(body for body in cell.bodies if body.moves_with != own), *cell.lamps)


def build_scene(bodies: Sequence[Body | Lamp]) -> sensor_rt.Scene:
    """Ray-tracing scene of bodies, with one mesh per material, and lamps."""
    scene = sensor_rt.Scene()
    for shape, arguments in _shapes_of(bodies):
        material = {"material": native_material(arguments["material"])} if "material" in arguments else {}
        getattr(scene, f"add_{shape}")(**arguments | material)
    return scene


def scene_json(bodies: Sequence[Body | Lamp]) -> list[dict[str, Any]]:
    """The shapes and lamps of `build_scene` as the FMU of a sensor reads them, SI units, poses row by row."""
    return [{"shape": shape, **_plain(arguments)} for shape, arguments in _shapes_of(bodies)]


def _plain(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Arguments of a function of a scene as JSON takes them."""
    values = {name: value.ravel().tolist() if isinstance(value, np.ndarray) else value
              for name, value in arguments.items() if name not in ("vertices", "faces", "curved")}  # fmt: skip
    if "faces" in arguments:
        names = ("kind", "body_from_face", "radius", "second")
        values |= mesh_json(arguments["vertices"], arguments["faces"])
        values["curved"] = [_plain(dict(zip(names, face, strict=True))) for face in arguments["curved"]]
    if "material" in arguments:
        values["material"] = _plain(_material_arguments(arguments["material"]))
    return values


def _shapes_of(bodies: Sequence[Body | Lamp]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Shapes and lamps: ``mesh`` and the arguments of `Scene.add_mesh`, and so on; the material as it is described.

    All shapes of a body have its name, so that they move together.
    """
    for body in bodies:
        if isinstance(body, Lamp):
            power = {"power": body.power, "in_band": body.in_band, "spectrum": body.spectrum}
            where = {"body_from_light": np.asarray(body.frame_from_lamp), "size": np.asarray(body.size)}
            yield "light", {"name": body.name, "kind": body.kind, **where, **power}
        elif isinstance(body.mesh, ShapeMesh):
            for placed in body.mesh.shapes.shapes:
                shape, arguments = _exact_shape(body.name, placed)
                yield shape, {"name": body.name, **arguments, "material": body.material}
        else:
            yield from (("mesh", mesh) for mesh in _meshes_of(body))


def _meshes_of(body: Body) -> Iterator[dict[str, Any]]:
    """One mesh per material."""
    patched = np.zeros(len(body.mesh.faces), bool)
    for patch in body.patches:
        patched[patch.faces] = True
    for patch in (Patch(np.flatnonzero(~patched), body.material), *body.patches):
        if len(patch.faces) == 0:
            continue
        vertices, faces = body.mesh.vertices, body.mesh.faces
        if len(patch.faces) < len(patched):
            used, faces = np.unique(faces[patch.faces], return_inverse=True)
            vertices, faces = vertices[used], faces.reshape(-1, 3)
        curved, numbers = (
            body.mesh.curved_surfaces(patch.faces) if isinstance(body.mesh, CadMesh) else ([], np.zeros(0, np.int32))
        )
        mesh = {"name": body.name, "vertices": vertices, "faces": faces}
        yield {**mesh, "material": patch.material, "curved": curved, "curved_of_face": numbers}


def _exact_shape(name: str, placed: PlacedShape) -> tuple[str, dict[str, Any]]:
    shape, pose = placed.shape, placed.frame_from_shape
    match shape:
        case Sphere():
            return "sphere", {"centre": pose[:3, 3], "radius": shape.radius}
        case Plane():
            return "plane", {"body_from_plane": pose, "size": np.array([shape.size_x, shape.size_y])}
        case Box():
            return "box", {"body_from_box": pose, "size": np.asarray(shape.size)}
        case Cylinder():
            return "cylinder", {"body_from_cylinder": pose, "radius": shape.radius, "height": shape.height}
        case Cone():
            radii = {"bottom_radius": shape.bottom_radius, "top_radius": shape.top_radius}
            return "cone", {"body_from_cone": pose, **radii, "height": shape.height}
        case Ring():
            radii = {"inner_radius": shape.inner_radius, "outer_radius": shape.outer_radius}
            return "ring", {"body_from_ring": pose, **radii, "height": shape.height}
        case _:
            raise TypeError(f"{name}: the ray tracer has no {type(shape).__name__}")


def native_material(m: Material) -> sensor_rt.Material:
    """The material as the ray tracer takes it."""
    return sensor_rt.Material(**_material_arguments(m))


def _material_arguments(m: Material) -> dict[str, Any]:
    return {
        "reflectance": m.reflectance,
        "model": m.model,
        "roughness": m.roughness,
        "refractive_index": m.refractive_index,
        "roughness_along": m.roughness_along or 0.0,
        "groove_axis": m.groove_axis,
        "groove_centre": None if m.groove_centre_mm is None else 1e-3 * np.array(m.groove_centre_mm),
        "scattering": 1e3 * (m.scattering_per_mm or 0.0),
    }


def exposures_from_truth(
    truth: ExposureTruth,
    index: NDArray[np.int64],
    bodies: Sequence[Body | Lamp],
    rows: slice = slice(None),
    sensor: str = "sensor",
) -> sensor_rt.Exposures:
    """Exposures with the true poses of a sensor and of bodies at start and end of each.

    Parameters
    ----------
    truth
        Recorded truth; with a rolling shutter `Recording.truth_for_rows` of the sensor's `readout_time`.
    index
        (n,) trigger indices, which select the random numbers of each exposure.
    bodies
        Bodies and lamps in the order of the scene.
    rows
        Rows of the recording to convert.
    sensor
        Frame of the sensor.

    Raises `DescriptionError` if the recording does not state the pose of the sensor or of a body.
    """
    needed = [sensor, *(fmu_frame(body.moves_with) for body in bodies if body.moves_with != "world")]
    for frame in needed:
        if frame not in truth.world_from_frame:
            expected = f"trigger.truth.{frame}.position[1] …"
            raise DescriptionError(f"states no true pose of {frame}", key="recording", expected=expected)
    world_from_sensor = truth.world_from_frame[sensor][rows]
    identity = np.broadcast_to(np.eye(4), world_from_sensor.shape)
    poses = [
        identity if body.moves_with == "world" else truth.world_from_frame[fmu_frame(body.moves_with)][rows]
        for body in bodies
    ]
    return sensor_rt.Exposures(world_from_sensor, np.stack(poses, 1), truth.duration[rows], index[rows])


def true_poses(recording: Recording, frames: Sequence[str]) -> list[Array]:
    """True ``world_from_frame`` (n, 4, 4) at the middle of every exposure, for each of `frames` (`Body.moves_with`)."""
    identity = np.broadcast_to(np.eye(4), (len(recording), 4, 4))
    return [identity if frame == "world" else recording.truth_at_middle(fmu_frame(frame)) for frame in frames]


def readout_time(sensor: sensor_rt.Sensor) -> float:
    """Time (s) between the exposures of the first and the last image row; 0 with a global shutter."""
    return float(sensor.row_readout * (max(camera.height_px for camera in sensor.cameras) - 1))


def still_exposures(
    frames: Mapping[str, Array],
    bodies: Sequence[Body | Lamp],
    index: NDArray[np.int64],
    durations: Array,
    sensor: str = "sensor",
) -> sensor_rt.Exposures:
    """Exposures of `durations` (k,), s, at each pose (n, 4, 4) of the frames, without motion.

    `index` (n,), the `bodies` and the frame of the `sensor` are as of `exposures_from_truth`.
    """
    count = len(durations)
    world_from_body = np.stack([frames[body.moves_with] for body in bodies], 1)
    return sensor_rt.Exposures(
        np.repeat(frames[sensor][:, None], count, 0),
        np.repeat(world_from_body[:, :, None], count, 0),
        np.tile(durations, len(index)),
        sub_indices(index, count),
    )


def sub_indices(index: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Indices (n count,) of `count` exposures for each trigger index (n,), which select their random numbers."""
    return (index[:, None] * count + np.arange(count)).ravel()


class ExposureControl(Protocol):
    """Exposure times of the profiles of one recording, in their order.

    `next` chooses them for at most `most` profiles: their windows (n, k, 2), n from 1 to `most`, see
    `Recording.truth_for_rows`, or None for all of them as recorded. Then `learn` is called with the brightest digital
    number (m,) of every column of each of these profiles, if the control `looks` at images. `first` is the exposure
    time of the next profile, s; None for one that never changes.
    """

    @property
    def looks(self) -> bool: ...
    @property
    def first(self) -> float | None: ...
    def next(self, most: int) -> Array | None: ...
    def learn(self, signals: Sequence[Array]) -> None: ...


class SameExposures:
    """The same windows (k, 2) for every profile; None: as recorded."""

    looks = False
    first = None

    def __init__(self, windows: Array | None) -> None:
        self._windows = windows

    def next(self, most: int) -> Array | None:
        """Windows (n, k, 2) of the next exposures, the same for all, see `ExposureControl`."""
        return None if self._windows is None else np.broadcast_to(self._windows, (most, *self._windows.shape))

    def learn(self, signals: Sequence[Array]) -> None:
        """Nothing: there is no choice."""


class AutomaticExposure:
    """Scales the exposure time of a profile by the light in the image `delay` profiles before.

    The new time is the old one times the wanted signal over the measured one: a percentile, over the columns with
    light, of the brightest pixel of each. As a saturated image does not tell by how much, several profiles may pass
    until none is. Times change by at least 5 % and at most a factor of 4. The exposures of `delay` profiles do not
    depend on each other's images, so that they are computed at the same time.
    """

    looks = True

    def __init__(self, description: SensorDescription) -> None:
        detector, options = description.detector, description.exposure
        if options.shortest_ms is None or options.longest_ms is None:
            raise ValueError("the description has no automatic exposure")
        self._black = detector.black_level_dn
        highest = min(2.0**detector.bit_depth - 1, self._black + detector.full_well_e * detector.gain_dn_per_e)
        self._range = highest - self._black
        self._least = description.extraction.min_amplitude_dn
        self._target, self._percentile = options.target, options.percentile
        self._limits = si_value(options, "shortest_ms"), si_value(options, "longest_ms")
        self._next = deque([si_value(detector, "exposure_ms")] * options.delay)
        self._taken: deque[float] = deque()

    @property
    def first(self) -> float:
        """Exposure time of the next profile, s."""
        return self._next[0]

    def next(self, most: int) -> Array:
        """Windows of as many profiles as are known, see `ExposureControl`."""
        durations = [self._next.popleft() for _ in range(min(most, len(self._next)))]
        self._taken.extend(durations)
        return np.array([[[0.0, duration]] for duration in durations])

    def learn(self, signals: Sequence[Array]) -> None:
        """Choose the times of as many later profiles, see `ExposureControl`."""
        for signal in signals:
            duration = self._taken.popleft() * self._factor(signal - self._black)
            self._next.append(float(np.clip(duration, *self._limits)))

    def _factor(self, light: Array) -> float:
        lit = light[light >= self._least]
        if not len(lit):
            return _IN_THE_DARK
        wanted = float(self._target * self._range / np.percentile(lit, self._percentile))
        return 1.0 if abs(wanted - 1) < _NEAR_ENOUGH else float(np.clip(wanted, 1 / _LARGEST_STEP, _LARGEST_STEP))


def encoder_sigma(one: Encoder) -> float:
    """Standard deviation of a measured position, rad, or m of a prismatic axis."""
    if isinstance(one, PrismaticAxisDescription):
        return 1e-3 * float(np.hypot(one.encoder_noise_mm, one.encoder_resolution_mm / np.sqrt(12)))
    return float(np.radians(np.hypot(one.encoder_noise_deg, one.encoder_resolution_deg / np.sqrt(12))))


def make_sensor(description: SensorDescription, seed: int) -> sensor_rt.Sensor:
    """Native sensor model of a description.

    Raises `SensorError` if the library rejects the description.
    """
    try:
        return sensor_rt.Sensor(json.dumps(sensor_json(description, seed)))
    except (ValueError, RuntimeError) as error:
        raise SensorError(f"sensor '{description.name}': {error}") from error


def _require_same_images(nominal: SensorDescription, estimated: SensorDescription) -> None:
    sizes, expected = (
        [f"{one.width_px} x {one.height_px}" for one in read_out(each).camera] for each in (estimated, nominal)
    )
    if sizes != expected:
        raise DescriptionError(
            f"cameras of {', '.join(sizes)} px cannot interpret the images of '{nominal.name}'",
            key="estimated_sensor",
            value=estimated.name,
            expected=f"{', '.join(expected)} px",
        )


SensorScene = tuple[tuple[Body | Lamp, ...], sensor_rt.Scene]
"""Bodies and lamps that the light of a sensor can meet, and their ray-tracing scene."""


def scenes_of(cell: NominalCell) -> tuple[SensorScene, ...]:
    """Bodies and scenes of the sensors of a cell, in the order of their numbers."""
    visible = [visible_bodies(cell, number) for number in range(1, len(cell.further_sensors) + 2)]
    return tuple((bodies, build_scene(bodies)) for bodies in visible)


@dataclass(frozen=True, eq=False)
class World:
    """A part in the cell, and one of its sensors, which exposes; it can be pickled.

    Attributes
    ----------
    nominal, true
        The nominal cell, and the one with the obstacles that planning and reconstruction do not know.
    bodies, scene
        What light can meet, in the order of the ray-tracing scene.
    part_surface
        The surface of the part, prepared for distance queries.
    as_built
        Perturbations of cell and sensor as ``key=value`` words.
    part_file, recording_file
        Files of the part and of a recording, where these are from files.
    unit
        Unit of the part's file.
    estimated_sensor
        Calibrated sensor that interprets the images in place of the nominal one.
    number
        Number of the sensor, from 1: that of the tool. `setup` holds its description.
    beside
        What `bodies` and `scene` are for each further sensor.
    """

    setup: Setup
    nominal: NominalCell
    true: NominalCell
    bodies: tuple[Body | Lamp, ...]
    scene: sensor_rt.Scene = field(compare=False)
    part_surface: PartSurface = field(compare=False)
    as_built: tuple[str, ...] = ()
    seed: int = 0
    part_file: Path | None = None
    unit: str = "mm"
    recording_file: Path | None = None
    estimated_sensor: SensorDescription | None = None
    number: int = 1
    beside: tuple[SensorScene, ...] = field(default=(), compare=False)

    @cached_property
    def sensors(self) -> tuple[World, ...]:
        """The worlds of all sensors that expose at a trigger: this one, and of the main sensor those of the others.

        Raises `DescriptionError` if a perturbation is of none of them.
        """
        if self.number == 1:
            require_sensors(self.as_built, len(self.beside))
        return (self, *(self._seen_by(number, *seen) for number, seen in enumerate(self.beside, 2)))

    def _seen_by(self, number: int, bodies: tuple[Body | Lamp, ...], scene: sensor_rt.Scene) -> World:
        setup = self.setup.seen_by(number)
        return replace(self, setup=setup, bodies=bodies, scene=scene, estimated_sensor=None, number=number, beside=())

    @property
    def frame(self) -> str:
        """Frame of the sensor."""
        return sensor_frame(self.number)

    @property
    def name(self) -> str:
        """Name of the sensor."""
        names = self.setup.sensor_names
        return names[self.number - 1] if self.number > 1 else self.setup.sensor.name

    def __getstate__(self) -> dict[str, Any]:
        scenes = {"scene": None, "beside": [bodies for bodies, _ in self.beside]}
        return {one.name: scenes.get(one.name, getattr(self, one.name)) for one in fields(self)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        beside = tuple((bodies, build_scene(bodies)) for bodies in state["beside"])
        self.__dict__.update({**state, "scene": build_scene(state["bodies"]), "beside": beside})

    def with_axes_at(self, position: Array, seed: int | None = None) -> World:
        """The world in which the further axes start at positions (k,), rad or m; with a seed of its own where given."""
        cell = self.setup.cell
        keys = {
            f"axis[{i}].start{described.unit}": value / split_unit(described.unit)[1]
            for i, (described, value) in enumerate(zip(cell.axis, position.tolist(), strict=True), 1)
        }

        def moved(of: NominalCell) -> NominalCell:
            axes = zip(of.further_axes, position.tolist(), strict=True)
            return replace(of, further_axes=tuple(replace(axis, start=value) for axis, value in axes))

        if not keys:
            return self if seed is None else replace(self, seed=seed)
        setup = replace(self.setup, cell=cell.replace(keys))
        seed = self.seed if seed is None else seed
        return replace(self, setup=setup, nominal=moved(self.nominal), true=moved(self.true), seed=seed)

    @cached_property
    def estimated(self) -> NominalCell:
        """The nominal cell with what calibration found, which reconstruction assumes."""
        return as_estimated(self.nominal, self.setup.cell)

    @cached_property
    def sensor(self) -> sensor_rt.Sensor:
        """The nominal or calibrated sensor, which interprets the images.

        Raises `DescriptionError` if the images of the calibrated sensor are of other sizes; `SensorError` if the
        library rejects the description.
        """
        nominal, estimated = self.setup.sensor, self.estimated_sensor
        if estimated is not None:
            _require_same_images(nominal, estimated)
        return make_sensor(estimated or nominal, self._noise_seed)

    @property
    def _noise_seed(self) -> int:
        """Seed of the images: the noise of different sensors is independent."""
        if self.number == 1:
            return self.seed
        digest = hashlib.blake2b(f"{self.seed} {self.frame}".encode(), digest_size=_SEED_BYTES)
        return int.from_bytes(digest.digest(), "little")

    @cached_property
    def sensor_true(self) -> sensor_rt.Sensor:
        """The sensor as built, which makes the images; the object `sensor` if they are equal. Errors as of `sensor`."""
        true = self.sensor_true_description
        same = true is self.setup.sensor and self.estimated_sensor is None
        return self.sensor if same else make_sensor(true, self._noise_seed)

    @cached_property
    def sensor_true_description(self) -> SensorDescription:
        """Description of the sensor as built, which chooses its exposures.

        Raises `DescriptionError` if a perturbation is invalid.
        """
        return as_built_sensor(self.setup.sensor, self.as_built, self.number)

    @property
    def part(self) -> str:
        """Name of the part: its file, or the name of its mesh."""
        return self.part_file.name if self.part_file else self.nominal.part.source

    def for_fmu(self, collision_outputs: bool = False) -> dict[str, Any]:
        """The cell as the FMU reads it; collision outputs cost most of a run, and no scan reads them."""
        return cell_json(self.setup.cell, self.true, self.seed, collision_outputs=collision_outputs)

    def for_sensor_fmu(self) -> dict[str, Any]:
        """The sensor and what it sees as its FMU reads them.

        Raises `DescriptionError` for exposure times that images choose, and several exposures of a profile.
        """
        described = self.sensor_true_description
        if described.exposure.mode != "fixed":
            raise DescriptionError(
                key="sensor.exposure.mode", value=described.exposure.mode, expected="fixed in the FMU of a sensor"
            )
        windows = self.control().next(1)
        frames = [None if body.moves_with == "world" else fmu_frame(body.moves_with) for body in self.bodies]
        cell = self.setup.cell
        return {
            "format": 1,
            "name": self.name,
            "frame": self.frame,
            "every": 1 if self.number == 1 else cell.further_sensor[self.number - 2].every,
            "delay": self.delays[1],
            "exposure": None if windows is None else float(windows[0, 0, 1]),
            "step": cell.world.controller_cycle,
            "sensor": sensor_json(self.estimated_sensor or self.setup.sensor, self._noise_seed),
            "as_built": None if self.sensor_true is self.sensor else sensor_json(described, self._noise_seed),
            "bodies": [{"name": body.name, "frame": frame} for body, frame in zip(self.bodies, frames, strict=True)],
            "shapes": scene_json(self.bodies),
        }

    @property
    def windows(self) -> Array:
        """Middle (s after that of all) and duration (s) of the exposures of a profile (k, 2); of automatic ones, of the
        first."""
        return exposure_windows(self.sensor_true_description)

    def control(self) -> ExposureControl:
        """A new choice of the exposure times of the profiles of a recording."""
        described = self.sensor_true_description
        if described.exposure.mode == "automatic":
            return AutomaticExposure(described)
        as_recorded = self.number == 1 and np.array_equal(self.windows, exposure_windows(self.setup.sensor))
        return SameExposures(None if as_recorded and described.exposure.mode == "fixed" else self.windows)

    def controls(self) -> tuple[ExposureControl, ...]:
        """`control` of each of the `sensors`."""
        return tuple(world.control() for world in self.sensors)

    @property
    def delays(self) -> tuple[float, float]:
        """Nominal and true time from the recorded middle of exposures to that of its own, s."""
        if self.number == 1:
            return 0.0, 0.0
        described = self.setup.cell.further_sensor[self.number - 2]
        return si_value(described, "delay_ms"), as_built_delay(described, self.as_built, self.number)

    def exposed_at(self, index: NDArray[np.int64]) -> NDArray[np.intp]:
        """Rows (k,) of trigger indices (n,) at which the sensor exposes."""
        every = 1 if self.number == 1 else self.setup.cell.further_sensor[self.number - 2].every
        return np.flatnonzero((index - _FIRST_TRIGGER) % every == 0)

    def sense(
        self,
        recording: Recording,
        engine: Engine,
        progress: Progress,
        *,
        on_images: OnImages | None = None,
        kept: Collection[int] = (),
        controls: Sequence[ExposureControl] | None = None,
        alone: bool = False,
        threads: int = 0,
    ) -> SensedProfiles:
        """Profiles of a recording, with the images of those in the rows `kept`; no images with the geometric engine.

        All `sensors` expose, each at its own triggers, see `exposed_at`, and lit by its own laser.

        Raises `SensorError` if the library reports an error.

        Parameters
        ----------
        on_images
            Called with the images of each profile, in order.
        controls
            Choose the exposure times, one for each of the `sensors`. Recordings of one scan that are sensed one after
            another share them; by default new ones.
        alone
            Whether this sensor alone exposes.
        """
        worlds, kept = (self,) if alone else self.sensors, () if engine == "geometric" else kept
        exposing = [
            partial(world._sense_batch, recording, engine, control=control, on_images=on_images, kept=kept,
                    threads=threads)
            for world, control in zip(worlds, controls or [world.control() for world in worlds], strict=True)
        ]  # fmt: skip
        index = recording.measured.index
        progress.stage("sensing", len(recording), "profiles")

        def advanced(sensors: int, some: SensedProfiles) -> SensedProfiles:
            progress.advance(some.count / sensors)
            return some

        def sensed() -> Iterator[SensedProfiles]:
            for batch, wanted in _batches(len(recording), kept, on_images is not None):
                chosen = [
                    (expose_batch, own)
                    for world, expose_batch in zip(worlds, exposing, strict=True)
                    if len(own := world.exposed_at(index[batch]))
                ]
                parts = [map(partial(advanced, len(chosen)), one(batch, own, wanted)) for one, own in chosen]
                if len(parts) == 1:
                    yield from parts[0]
                else:
                    yield SensedProfiles.beside([SensedProfiles.joined(part) for part in parts])

        return SensedProfiles.joined(sensed())

    def _sense_batch(
        self,
        recording: Recording,
        engine: Engine,
        batch: slice,
        own: NDArray[np.intp],
        wanted: bool,
        *,
        control: ExposureControl,
        on_images: OnImages | None,
        kept: Collection[int],
        threads: int,
    ) -> Iterator[SensedProfiles]:
        """Profiles of a batch of rows by this sensor, see `sense`; images are rendered if `wanted`.

        It exposes at the rows `own` (k,) of the batch; profiles of the others are empty.
        """
        rows = recording[batch][own]
        begin, done = 0, 0
        while done < len(own):
            some = self.expose(rows[done:], engine, control=control, images=wanted, threads=threads)
            if on_images is not None:
                for images in some.images:
                    on_images(images)
            taken = own[done : done + some.count]
            done += some.count
            end = int(taken[-1]) + 1 if done < len(own) else batch.stop - batch.start
            rendered = zip(taken + batch.start, some.images, strict=False)  # none where images are not wanted
            yield replace(
                some,
                points=replace(some.points, frame=(taken[some.points.frame] - begin).astype(np.int32)),
                count=end - begin,
                images=tuple(image for row, image in rendered if row in kept),
            )
            begin = end

    def expose(
        self,
        recording: Recording,
        engine: Engine,
        *,
        control: ExposureControl | None = None,
        images: bool = False,
        threads: int = 0,
    ) -> SensedProfiles:
        """The first profiles of a recording by this sensor: as many as `control` knows the exposure times of."""
        control = control or self.control()
        windows = control.next(len(recording))
        windows = recording.windows if windows is None else windows
        recording, detector = recording[: len(windows)], self.sensor_true_description.detector
        index = recording.measured.index
        nominal, true = self.delays
        truth = recording.truth_for_rows(readout_time(self.sensor_true), windows + np.array([true, 0.0]))
        exposures = exposures_from_truth(truth, sub_indices(index, windows.shape[1]), self.bodies, sensor=self.frame)
        found = self._expose(
            exposures, index, windows[0] + np.array([nominal, 0.0]), engine, images or control.looks, threads
        )
        if control.looks:
            control.learn(found.signals(detector.black_level_dn))
        return found if images else replace(found, images=())

    def expose_at_rest(
        self,
        frames: Mapping[str, Array],
        index: NDArray[np.int64],
        windows: Array,
        engine: Engine,
        *,
        images: bool = False,
        threads: int = 0,
    ) -> SensedProfiles:
        """Profiles (n,) of trigger indices `index` with the frames at poses (n, 4, 4), each of exposures (k, 2).

        `windows` are as the property. Raises `SensorError` if the library reports an error.
        """
        exposures = still_exposures(frames, self.bodies, index, windows[:, 1], self.frame)
        return self._expose(exposures, index, windows, engine, images, threads)

    def _expose(
        self,
        exposures: sensor_rt.Exposures,
        index: NDArray[np.int64],
        windows: Array,
        engine: Engine,
        images: bool,
        threads: int,
    ) -> SensedProfiles:
        depth = self.sensor_true_description.detector.bit_depth if images else None
        sensors = self.sensor, self.sensor_true
        found = expose(
            self.scene, *sensors, exposures, index, engine, offsets=windows[:, 0], bit_depth=depth, threads=threads
        )
        return found if self.number == 1 else found.of_sensor(self.number)


def _batches(count: int, kept: Collection[int], all_images: bool) -> Iterator[tuple[slice, bool]]:
    """Batches of exposures and whether to keep their images; without `all_images` each row `kept` is one by itself."""
    start = 0
    for stop, single in [*((row, True) for row in (() if all_images else sorted(kept))), (count, False)]:
        for first in range(start, stop, _BATCH):
            yield slice(first, min(first + _BATCH, stop)), all_images
        if single:
            yield slice(stop, stop + 1), True
        start = stop + single
