"""Inputs of the ray tracer from the nominal cell and the recorded truth: scene and poses of its bodies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.cell.recording import ExposureTruth, Recording
from scancell.config.material import Material
from scancell.geometry.shapes import Box, Cone, Cylinder, PlacedShape, Plane, Ring, ShapeMesh, Sphere
from scancell.nominal.cell import Body, Lamp, NominalCell, fmu_frame
from scancell.nominal.patches import Patch

Array = NDArray[np.float64]

# The housing of the sensor blocks neither its light nor its view.
_INVISIBLE = frozenset({"sensor"})


def visible_bodies(cell: NominalCell) -> tuple[Body | Lamp, ...]:
    """Bodies that reflect or block light, then lamps, in the order of the scene."""
    return (*(body for body in cell.bodies if body.name not in _INVISIBLE), *cell.lamps)


def build_scene(bodies: Sequence[Body | Lamp]) -> sensor_rt.Scene:
    """Ray-tracing scene of bodies, with one mesh per material, and lamps."""
    scene = sensor_rt.Scene()
    for body in bodies:
        if isinstance(body, Lamp):
            power = (body.power, body.in_band, body.spectrum)
            scene.add_light(body.name, body.kind, body.frame_from_lamp, body.size, *power)
            continue
        _add_body(scene, body)
    return scene


def _add_body(scene: sensor_rt.Scene, body: Body) -> None:
    """Add the exact shapes of the body, or one mesh per material, all under its name, so that they move together."""
    if isinstance(body.mesh, ShapeMesh):
        for placed in body.mesh.shapes.shapes:
            _add_shape(scene, body.name, placed, native_material(body.material))
        return
    patched = np.zeros(len(body.mesh.faces), bool)
    for patch in body.patches:
        patched[patch.faces] = True
    for patch in (Patch(np.flatnonzero(~patched), body.material), *body.patches):
        if len(patch.faces) == 0:
            continue
        material = native_material(patch.material)
        if len(patch.faces) == len(patched):
            scene.add_mesh(body.name, body.mesh.vertices, body.mesh.faces, material)
        else:
            used, faces = np.unique(body.mesh.faces[patch.faces], return_inverse=True)
            scene.add_mesh(body.name, body.mesh.vertices[used], faces.reshape(-1, 3), material)


def _add_shape(scene: sensor_rt.Scene, name: str, placed: PlacedShape, material: sensor_rt.Material) -> None:
    shape, pose = placed.shape, placed.frame_from_shape
    match shape:
        case Sphere():
            scene.add_sphere(name, pose[:3, 3], shape.radius, material)
        case Plane():
            scene.add_plane(name, pose, (shape.size_x, shape.size_y), material)
        case Box():
            scene.add_box(name, pose, shape.size, material)
        case Cylinder():
            scene.add_cylinder(name, pose, shape.radius, shape.height, material)
        case Cone():
            scene.add_cone(name, pose, shape.bottom_radius, shape.top_radius, shape.height, material)
        case Ring():
            scene.add_ring(name, pose, shape.inner_radius, shape.outer_radius, shape.height, material)
        case _:
            raise TypeError(f"{name}: the ray tracer has no {type(shape).__name__}")


def native_material(m: Material) -> sensor_rt.Material:
    """The material as the ray tracer takes it."""
    centre = None if m.groove_centre_mm is None else 1e-3 * np.array(m.groove_centre_mm)
    along, scattering = m.roughness_along or 0.0, 1e3 * (m.scattering_per_mm or 0.0)
    return sensor_rt.Material(
        m.reflectance, m.model, m.roughness, m.refractive_index, along, m.groove_axis, centre, scattering
    )


def exposures_from_truth(
    truth: ExposureTruth, index: NDArray[np.int64], bodies: Sequence[Body | Lamp], rows: slice = slice(None)
) -> sensor_rt.Exposures:
    """Exposures with the true poses of sensor and bodies at start and end of each.

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
    """
    world_from_sensor = truth.world_from_frame["sensor"][rows]
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
    frames: Mapping[str, Array], bodies: Sequence[Body | Lamp], index: NDArray[np.int64], durations: Array
) -> sensor_rt.Exposures:
    """Exposures of `durations` (k,), s, at each pose (n, 4, 4) of the frames, without motion.

    `index` (n,) and the `bodies` are as of `exposures_from_truth`.
    """
    count = len(durations)
    world_from_body = np.stack([frames[body.moves_with] for body in bodies], 1)
    return sensor_rt.Exposures(
        np.repeat(frames["sensor"][:, None], count, 0),
        np.repeat(world_from_body[:, :, None], count, 0),
        np.tile(durations, len(index)),
        sub_indices(index, count),
    )


def sub_indices(index: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Indices (n count,) of `count` exposures for each trigger index (n,), which select their random numbers."""
    return (index[:, None] * count + np.arange(count)).ravel()
