"""Cells of a campaign, nominal (for the guard) and true, and parts that extend beyond the table."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scancell.cell.sensing import SENSOR_KEYS
from scancell.config.cell import CellDescription
from scancell.config.files import assets_dir
from scancell.config.loading import load_setup
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh, box_mesh, joined
from scancell.geometry.reduction import ReducedMesh, reduced
from scancell.guard.guard import Guard
from scancell.guard.settings import GuardSettings
from scancell.nominal.cell import Body, NominalCell, nominal_cell
from scancell.proximity.scene import ProximityScene, arm_chain, cell_scene
from scancell.scanning.guard import settings_of, with_finger_travel

Array = NDArray[np.float64]

_FOOT = (0.32, 0.05, 0.006)  # m: bounding boxes are centred on the table's axis
_SEGMENTS = 14  # of the ring

_MAX_FACES = 400  # of the guard's meshes
_MOTORS = "default with motors"
_MARGIN = 0.5e-3  # m between the guard's clearances and those of a start
_TRUE = 0.25  # share of the worlds that are as described


def standing_parts() -> dict[str, Mesh]:
    """Parts by name, m, each on a foot that is longer than the table: a vertical plate, a post, a segment of a ring."""
    plate = _box((0.004, 0.16, 0.15), (0.155, 0.0, 0.075))
    post = _box((0.01, 0.01, 0.22), (0.15, 0.0, 0.11))
    angles = np.radians(np.linspace(-30.0, 210.0, _SEGMENTS))
    ring = [
        _box((0.012, 0.035, 0.012), (0.06, 0.07 * np.cos(angle), 0.09 + 0.07 * np.sin(angle)), float(angle))
        for angle in angles
    ]
    # The ring's plane is across the foot: the table moves it along its axis and across.
    legs = [_box((0.012, 0.012, 0.06), (0.06, side * 0.0606, 0.03)) for side in (-1, 1)]
    found = {"plate": [plate], "post": [post], "ring": [*ring, *legs]}
    return {name: joined([box_mesh(_FOOT), *boxes], name) for name, boxes in found.items()}


def _box(size: tuple[float, float, float], centre: tuple[float, float, float], angle: float = 0.0) -> Mesh:
    """A box at `centre`, m, turned about x by `angle`, rad."""
    return box_mesh(size).transformed(pose.from_rotation(pose.rotation_about(0, angle), centre))


@dataclass(frozen=True)
class KnownWorld:
    """The nominal cell that a guard uses.

    Attributes
    ----------
    described
        Description; the encoders are as accurate as the settings state.
    nominal
        Geometry with the part on the table.
    settings
        Of the guard.
    ignored
        Pairs of bodies that may touch.
    """

    described: CellDescription
    nominal: NominalCell
    settings: GuardSettings
    ignored: tuple[tuple[str, str], ...] = ()

    @cached_property
    def meshes(self) -> dict[str, ReducedMesh]:
        """Meshes that the guard compares."""
        bodies = self.nominal.bodies
        return {body.name: reduced(body.mesh, _MAX_FACES, self.settings.mesh_error) for body in bodies}

    @cached_property
    def _scene(self) -> ProximityScene:
        scene = cell_scene(self.nominal, {name: found.mesh for name, found in self.meshes.items()})
        return scene.without([frozenset(pair) for pair in self.ignored])

    def is_clear(self, axes: Array) -> bool:
        """Whether all pairs keep the guard's clearances and a margin at axes (joints + 1,), rad."""
        scene, errors = self._scene, {name: found.error for name, found in self.meshes.items()}
        least = 2 * self.settings.position_error + np.array([errors[a] + errors[b] for a, b in scene.pairs]) + _MARGIN
        poses = self.nominal.body_poses(axes[None, :-1], axes[None, -1])
        return bool((scene.distances(poses, least, 1)[0] >= least).all())

    def guard(self, kind: type[Guard] = Guard, settings: GuardSettings | None = None) -> Guard:
        """A guard of this cell."""
        nominal = with_finger_travel(self.nominal, self.described)
        return kind(nominal, self.described.robot, settings or self.settings, self.ignored)


def known_world(described: CellDescription, part: Mesh) -> KnownWorld:
    """A described cell with a part clamped on its table, without sensors."""
    clamped = described.part.model_copy(update={"fixture": "clamped", "arrival": None})
    described = described.model_copy(update={"part": clamped, **dict.fromkeys(SENSOR_KEYS, ())})
    nominal = nominal_cell(described, part)
    fingers, parts = (
        [body.name for body in nominal.bodies if body.moves_with.startswith(frame)] for frame in ("finger[", "part")
    )
    ignored = tuple((finger, part) for finger in fingers for part in parts)
    return KnownWorld(described, nominal, settings_of(described), ignored)


def shipped_cells() -> dict[str, CellDescription]:
    """All shipped cells by name, and one whose arm has motors and gears."""
    found = {path.stem: load_setup(path).cell for path in sorted((assets_dir() / "cells").glob("*.toml"))}
    return {**found, _MOTORS: with_motors(found["default"])}


def described_cells(cell: str | None) -> dict[str, CellDescription]:
    """The cell of a file, or all shipped ones."""
    return shipped_cells() if cell is None else {Path(cell).stem: load_setup(cell).cell}


def with_motors(described: CellDescription) -> CellDescription:
    """The cell with an arm of motors, gears and inertia.

    Nothing pushes the arm: contact shapes are convex hulls, which meet before the surfaces that guard and judge know.
    """
    return described.replace({"robot.drive": "dynamic", "contact.cell_bodies": False})


def with_encoders(described: CellDescription, rng: np.random.Generator) -> CellDescription:
    """The cell with encoders whose noise and steps together are those of the guard's settings, or as described."""
    if rng.random() < _TRUE:
        return described
    sigma = float(np.degrees(settings_of(described).noise))
    steps = float(rng.choice([0.0, 0.5, 0.9]))
    # Just below: the settings that follow from it stay.
    keys = {
        "encoder_noise_deg": 0.9999 * sigma * float(np.sqrt(1 - steps**2)),
        "encoder_resolution_deg": 0.9999 * sigma * steps * float(np.sqrt(12)),
    }
    joints = tuple(joint.model_copy(update=keys) for joint in described.robot.joint)
    robot = described.robot.model_copy(update={"joint": joints})
    return described.model_copy(update={"robot": robot, "table": described.table.model_copy(update=keys)})


def true_world(known: KnownWorld, rng: np.random.Generator) -> NominalCell:
    """A world with the errors that the guard assumes: bodies displaced, surfaces outside the guard's meshes.

    Either the bodies around the arm are displaced by up to `position_error`, or all by half of it, so that no two
    bodies are nearer by more. Surfaces reach beyond the meshes that the guard compares by their known error.
    One world in four is as described.
    """
    if rng.random() < _TRUE:
        return known.nominal
    chain = set(arm_chain(known.nominal)) if rng.random() < 0.5 else set()
    farthest = known.settings.position_error * (1.0 if chain else 0.5)
    bodies = []
    for body in known.nominal.bodies:
        found = known.meshes[body.name]
        mesh = _inflated(found.mesh, found.error)
        size = 0.0 if body.name in chain else farthest * rng.choice([1.0, rng.random()])
        direction = rng.normal(size=3)
        bodies.append(_displaced(body, mesh, size * direction / np.linalg.norm(direction)))
    return replace(known.nominal, bodies=tuple(bodies))


def _displaced(body: Body, mesh: Mesh, by: Array) -> Body:
    return replace(body, mesh=Mesh(mesh.vertices + by, mesh.faces, mesh.source), patches=())


def _inflated(mesh: Mesh, by: float) -> Mesh:
    """The mesh with its vertices displaced by `by`, m, outwards."""
    if by <= 0.0:
        return mesh
    _, same = np.unique(mesh.vertices.round(9), axis=0, return_inverse=True)
    normals = np.zeros((int(same.max()) + 1, 3))
    for corner in range(3):
        np.add.at(normals, same[mesh.faces[:, corner]], mesh.normals * mesh.areas[:, None])
    size = np.linalg.norm(normals, axis=1, keepdims=True)
    normals /= np.where(size > 0, size, 1.0)
    return Mesh(mesh.vertices + by * normals[same], mesh.faces, mesh.source)


def world_of(known: KnownWorld, rng: np.random.Generator) -> tuple[CellDescription, NominalCell]:
    """The cell as it is: with its encoders, and true bodies."""
    return with_encoders(known.described, rng), true_world(known, rng)
