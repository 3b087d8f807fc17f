"""Measurable surface of parts in the default cell, and its cache."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from cells import block, mesh_of

from scancell.config.loading import load_setup
from scancell.config.sensor import SensorDescription
from scancell.errors import CancelledError
from scancell.geometry import pose
from scancell.geometry.mesh import Mesh, box_mesh, joined
from scancell.nominal.cell import NominalCell, nominal_cell
from scancell.nominal.parts import Body
from scancell.progress import CallbackProgress
from scancell.visibility import (
    POSITION_STEP,
    MeasurableSurface,
    SensorField,
    cache_folder,
    measurable_surface,
)

SENSOR = load_setup().sensor
BLOCK = block(0.06, 0.04, 0.02)


def cell_of(part: Mesh, *words: str) -> NominalCell:
    return nominal_cell(load_setup(settings=words).cell, part)


def on_table(nominal: NominalCell, surface: MeasurableSurface) -> tuple[np.ndarray, np.ndarray]:
    """Samples and normals in the frame of the table."""
    place = nominal.table_from_part
    return pose.transform_points(place, surface.samples), surface.normals @ place[:3, :3].T


def changed(*words: str) -> SensorDescription:
    return load_setup(settings=words).sensor


def test_only_underside_of_block_is_not_measurable() -> None:
    nominal = cell_of(BLOCK)
    surface = measurable_surface(nominal, SENSOR, 2000)
    _, normals = on_table(nominal, surface)
    assert np.array_equal(surface.measurable, normals[:, 2] > -0.5)
    under = 0.06 * 0.04
    assert surface.measurable_fraction == pytest.approx(1 - under / surface.area, abs=2e-3)
    assert surface.area == pytest.approx(2 * (under + 0.06 * 0.02 + 0.04 * 0.02))


def test_depth_of_measurable_hole_is_limited_by_triangulation_angle() -> None:
    """The triangulation angle is at least 19 deg: both rays to the centre of the floor pass the mouth if L < 2.9 D."""
    diameter = 0.008
    found = {}
    for ratio in (1.75, 3.3):
        drill = trimesh.creation.cylinder(diameter / 2, 2 * ratio * diameter, sections=64).apply_translation(
            [0, 0, 0.04]
        )
        part = mesh_of(trimesh.boolean.difference([block_solid(0.04), drill], engine="manifold"))
        nominal = cell_of(part)
        surface = measurable_surface(nominal, SENSOR, 8000)
        points, normals = on_table(nominal, surface)
        floor = (np.hypot(points[:, 0], points[:, 1]) < diameter / 4) & (normals[:, 2] > 0.9)
        assert floor.sum() >= 5
        found[ratio] = surface.measurable[floor]
        assert surface.measurable[np.abs(points[:, 2] - 0.04) < 1e-9].all(), "the top"
    assert found[1.75].all() and not found[3.3].any()


def block_solid(height: float) -> trimesh.Trimesh:
    return trimesh.creation.box((0.04, 0.04, height), pose.translation((0, 0, height / 2)))


def test_unreachable_surface_is_not_measurable() -> None:
    assert not measurable_surface(cell_of(BLOCK, "cell.table.pose.x_mm=3000"), SENSOR, 4).measurable.any()
    # The table rotates every side of the part into the narrow sector of joint 1.
    nominal = cell_of(BLOCK)
    joints = [replace(joint, min=0.3, max=0.9) if i == 0 else joint for i, joint in enumerate(nominal.arm.joints)]
    sector = replace(nominal, arm=replace(nominal.arm, joints=joints))
    found = [measurable_surface(cell, SENSOR, 300).measurable for cell in (nominal, sector)]
    assert np.array_equal(*found)


def test_surface_that_no_arm_of_this_length_reaches_is_not_searched() -> None:
    """A block 100 m above another one: each of its samples had been searched for at all poses around it."""
    far = BLOCK.transformed(pose.translation((0.0, 0.0, 100.0)))
    nominal = cell_of(joined([BLOCK, far], "two blocks"))
    stages: list[int] = []
    surface = measurable_surface(
        nominal, SENSOR, 400, CallbackProgress(lambda _stage, _done, total: stages.append(total))
    )
    points, normals = on_table(nominal, surface)
    is_far = points[:, 2] > 1.0
    assert set(stages) == {int((~is_far).sum())}
    assert np.array_equal(surface.measurable, ~is_far & (normals[:, 2] > -0.5))


@pytest.mark.parametrize("frame", ["world", "table"])
def test_roof_occludes_top(frame: str) -> None:
    nominal = cell_of(BLOCK)
    height = 0.1 + 0.02 + 0.004 if frame == "world" else 0.02 + 0.004
    at = (0.45, 0.0, height) if frame == "world" else (0.0, 0.0, height)
    roof = box_mesh((0.2, 0.2, 0.002)).transformed(pose.translation(at))
    covered = replace(nominal, bodies=(*nominal.bodies, Body("roof", frame, roof, nominal.bodies[0].material)))
    free, hidden = (measurable_surface(cell, SENSOR, 200) for cell in (nominal, covered))
    _, normals = on_table(nominal, free)
    top = normals[:, 2] > 0.5
    assert free.measurable[top].all() and not hidden.measurable[top].any()
    assert not (hidden.measurable & ~free.measurable).any()


def test_result_is_invariant_under_azimuth_step() -> None:
    found = [measurable_surface(cell_of(BLOCK, f"cell.part.rz_deg={angle}"), SENSOR, 600) for angle in (0, 90)]
    assert np.array_equal(found[0].samples, found[1].samples)
    assert np.array_equal(found[0].measurable, found[1].measurable)
    assert found[0].digest != found[1].digest


def test_both_sides_of_open_mesh_are_measurable() -> None:
    """An upright open sheet is measurable from both sides for any winding of its faces."""
    corners = np.array([[-0.03, 0, 0], [0.03, 0, 0], [0.03, 0, 0.03], [-0.03, 0, 0.03]], float)
    screen = np.array([[-0.03, 0.01, 0], [0.03, 0.01, 0], [0.03, 0.01, 0.2], [-0.03, 0.01, 0.2]], float)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    for order in (faces, faces[:, ::-1]):
        part = Mesh(np.concatenate([corners, screen]), np.concatenate([order, faces + 4]))
        surface = measurable_surface(cell_of(part), SENSOR, 500)
        assert np.isnan(surface.normals).all()
        assert surface.measurable[surface.samples[:, 1] < 0.005].mean() > 0.9


def test_result_does_not_depend_on_threads_and_thinning_keeps_fraction() -> None:
    nominal = cell_of(mesh_of(trimesh.creation.icosphere(3, 0.02)))
    one, two = (measurable_surface(nominal, SENSOR, 4000, threads=threads) for threads in (1, 2))
    assert np.array_equal(one.measurable, two.measurable) and one.digest == two.digest
    few = one.thinned(500)
    assert len(few.samples) == len(few.normals) == len(few.measurable) == 500
    assert few.measurable_fraction == pytest.approx(one.measurable_fraction, abs=0.02)
    assert one.thinned(4000) is one


def test_field_is_limited_by_range_fan_and_image() -> None:
    field = SensorField.of(SENSOR)
    y, z = field.points.T
    assert z.min() == pytest.approx(0.080) and z.max() == pytest.approx(0.165)
    assert np.abs(field.points / POSITION_STEP - np.round(field.points / POSITION_STEP)).max() < 1e-9
    assert (np.abs(y) <= z * np.tan(np.radians(16.0))).all() and field.seen.any(1).all()
    assert len(np.unique(field.points, axis=0)) == len(y)
    assert np.array_equal(z[y == 0], np.unique(z))  # every range is seen in the middle of the sheet
    narrow = SensorField.of(changed("sensor.laser.fan_half_angle_deg=4"))
    assert (np.abs(narrow.points[:, 0]) <= narrow.points[:, 1] * np.tan(np.radians(4.0))).all()
    assert set(map(tuple, narrow.points)) < set(map(tuple, field.points))
    # Half the columns: the distance along the camera axis to a point in the sheet limits the image width.
    half = SensorField.of(changed(*(f"sensor.camera[{i}].width_px=640" for i in (1, 2))))
    y, z = half.points.T
    tilt, focal = np.radians(29.3), 512 / np.tan(np.radians(9.34))
    limit = 320 / focal * (0.06 * np.sin(tilt) + z * np.cos(tilt))
    assert (np.abs(y) <= limit).all()
    widest = np.array([np.abs(y[z == at]).max() for at in np.unique(z)])
    assert (widest + POSITION_STEP > np.array([limit[z == at][0] for at in np.unique(z)])).all()


def test_shallow_range_has_field_points() -> None:
    field = SensorField.of(changed("sensor.range.near_mm=121", "sensor.range.far_mm=123"))
    assert (field.points[:, 1] == pytest.approx(0.122)) and len(field.points) > 3


class Stages(CallbackProgress):
    """Records the reported progress."""

    def __init__(self) -> None:
        self.seen: list[tuple[str, float, float]] = []
        super().__init__(lambda *state: self.seen.append(state))


def test_second_call_reads_cache(tmp_path: Path) -> None:
    nominal, folder = cell_of(BLOCK), tmp_path / "deep" / "cache"
    progress = Stages()
    first = measurable_surface(nominal, SENSOR, 2500, progress, folder)
    assert {name for name, _, _ in progress.seen} == {"measurable surface"}
    assert progress.seen[-1][1:] == (2500, 2500)
    assert [file.name for file in folder.iterdir()] == [f"{first.digest}.npz"]
    progress = Stages()
    second = measurable_surface(nominal, SENSOR, 2500, progress, folder)
    assert progress.seen == []
    for name in ("samples", "normals", "measurable", "area", "digest"):
        assert np.array_equal(getattr(first, name), getattr(second, name))
    with np.load(folder / f"{first.digest}.npz") as kept:  # modify the file to show that it is read
        turned = ~kept["measurable"]
    np.savez(folder / f"{first.digest}.npz", measurable=turned)
    assert np.array_equal(measurable_surface(nominal, SENSOR, 2500, None, folder).measurable, turned)


@pytest.mark.parametrize("damage", ["empty", "cut", "garbage", "other name", "other size", "object"])
def test_damaged_cache_file_is_recomputed(tmp_path: Path, damage: str) -> None:
    nominal = cell_of(BLOCK)
    expected = measurable_surface(nominal, SENSOR, 200, None, tmp_path)
    file = tmp_path / f"{expected.digest}.npz"
    content = file.read_bytes()
    if damage in ("empty", "cut", "garbage"):
        half = len(content) // 2
        file.write_bytes({"empty": b"", "cut": content[:half], "garbage": content[:half] + b"\x5a" * half}[damage])
    else:
        arrays = {
            "other name": {"visible": np.ones(200, bool)},
            "other size": {"measurable": np.ones(199, bool)},
            "object": {"measurable": np.array([None] * 200, object)},
        }
        np.savez(file, **arrays[damage])
    assert np.array_equal(measurable_surface(nominal, SENSOR, 200, None, tmp_path).measurable, expected.measurable)
    with np.load(file, allow_pickle=False) as kept:
        assert np.array_equal(kept["measurable"], expected.measurable)


def test_digest_depends_only_on_part_placement_cell_and_sensor() -> None:
    def digest(part: Mesh = BLOCK, sensor: SensorDescription = SENSOR, samples: int = 10, *words: str) -> str:
        return measurable_surface(cell_of(part, *words), sensor, samples).digest

    base = digest()
    others = [
        digest(block(0.06, 0.04, 0.021)),
        digest(sensor=changed("sensor.range.far_mm=160")),
        digest(sensor=changed("sensor.camera[2].baseline_mm=61")),
        digest(BLOCK, SENSOR, 11),
        *(digest(BLOCK, SENSOR, 10, word) for word in ("cell.part.x_mm=1", "cell.table.pose.z_mm=101")),
        digest(BLOCK, SENSOR, 10, "cell.tool.fixture.reach_mm=71"),
    ]
    assert len({base, *others}) == len(others) + 1
    same = changed("sensor.laser.power_mw=1", "sensor.detector.exposure_ms=1")
    assert digest(sensor=same) == digest(BLOCK, SENSOR, 10, "cell.part.reflectance=0.3") == base


def test_cache_folder_from_environment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("SCANCELL_CACHE", str(tmp_path / "own"))
    assert cache_folder() == tmp_path / "own"
    monkeypatch.delenv("SCANCELL_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder() == tmp_path / "scancell" / "measurable"
    monkeypatch.setenv("XDG_CACHE_HOME", "")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert cache_folder() == tmp_path / "home" / ".cache" / "scancell" / "measurable"


def test_unwritable_cache_folder_is_ignored(tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("a file where the folder should be")
    surface = measurable_surface(cell_of(BLOCK), SENSOR, 200, None, tmp_path / "taken" / "cache")
    assert surface.measurable.any()


def test_cancellation_leaves_no_file(tmp_path: Path) -> None:
    with pytest.raises(CancelledError):
        measurable_surface(cell_of(BLOCK), SENSOR, 3000, CallbackProgress(lambda *_: False), tmp_path)
    assert not list(tmp_path.iterdir())
