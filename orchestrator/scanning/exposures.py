"""Turns recorded truth into what the ray tracer needs: a scene and the poses of everything in it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

import sensor_rt
from orchestrator.cell.nominal import Body, Lamp, NominalCell
from orchestrator.cell.patches import Patch
from orchestrator.cell.recording import ExposureTruth, Recording

Array = NDArray[np.float64]

# The sensor's own housing neither blocks its light nor its view.
_UNSEEN = frozenset({"sensor"})
# The FMU counts its parts; a cell description has one.
_RECORDED_NAME = {"part": "part[1]"}


def visible_bodies(cell: NominalCell) -> tuple[Body | Lamp, ...]:
    """Bodies that light can meet, and lamps, in the order of the scene."""
    return (*(body for body in cell.bodies if body.name not in _UNSEEN), *cell.lamps)


def build_scene(bodies: Sequence[Body | Lamp]) -> sensor_rt.Scene:
    """Scene of `bodies`, one mesh for each of their materials, and lamps."""
    scene = sensor_rt.Scene()
    for body in bodies:
        if isinstance(body, Lamp):
            power = (body.power, body.in_band, body.spectrum)
            scene.add_light(body.name, body.kind, body.frame_from_lamp, body.size, *power)
            continue
        _add_body(scene, body)
    return scene


def _add_body(scene: sensor_rt.Scene, body: Body) -> None:
    """Shapes with one name move as one; a body has one for each of its materials, with the vertices that it uses."""
    patched = np.zeros(len(body.mesh.faces), bool)
    for patch in body.patches:
        patched[patch.faces] = True
    for patch in (Patch(np.flatnonzero(~patched), body.material), *body.patches):
        if len(patch.faces) == 0:
            continue
        m = patch.material
        material = sensor_rt.Material(m.reflectance, m.model, m.roughness, m.refractive_index)
        if len(patch.faces) == len(patched):
            scene.add_mesh(body.name, body.mesh.vertices, body.mesh.faces, material)
        else:
            used, faces = np.unique(body.mesh.faces[patch.faces], return_inverse=True)
            scene.add_mesh(body.name, body.mesh.vertices[used], faces.reshape(-1, 3), material)


def exposures_from_truth(
    truth: ExposureTruth, index: NDArray[np.int64], bodies: Sequence[Body | Lamp], rows: slice = slice(None)
) -> sensor_rt.Exposures:
    """Exposures with the true poses of sensor and bodies at start and end; `index` (n,) keys the noise.

    A sensor whose shutter rolls needs the truth of all its rows, `Recording.truth_for_rows` of its `readout_time`.
    """
    world_from_sensor = truth.world_from_frame["sensor"][rows]
    still = np.broadcast_to(np.eye(4), world_from_sensor.shape)
    poses = [
        still if body.moves_with == "world" else truth.world_from_frame[_recorded(body.moves_with)][rows]
        for body in bodies
    ]
    return sensor_rt.Exposures(world_from_sensor, np.stack(poses, 1), truth.duration[rows], index[rows])


def true_poses(recording: Recording, frames: Sequence[str]) -> list[Array]:
    """``world_from_frame`` (n, 4, 4) in the middle of every exposure, for each of `frames` as bodies name them."""
    still = np.broadcast_to(np.eye(4), (len(recording), 4, 4))
    return [still if frame == "world" else recording.truth_at_middle(_recorded(frame)) for frame in frames]


def readout_time(sensor: sensor_rt.Sensor) -> float:
    """Seconds from the exposure of the first to that of the last row; 0 with a global shutter."""
    return float(sensor.row_readout * (max(camera.height_px for camera in sensor.cameras) - 1))


def still_exposure(world_from_sensor: Array, world_from_body: Array, duration: float) -> sensor_rt.Exposures:
    """One exposure of a world that stands still: sensor pose (4, 4), body poses (bodies, 4, 4), seconds."""
    return sensor_rt.Exposures(
        world_from_sensor[None, None], world_from_body[None, :, None], np.array([duration]), np.array([1], np.int64)
    )


def _recorded(frame: str) -> str:
    return _RECORDED_NAME.get(frame, frame)
