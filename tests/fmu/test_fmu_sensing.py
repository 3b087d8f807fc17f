"""Presence sensors, distance sensors and collision outputs against closed forms."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import fcl
import numpy as np
import pytest
from cell_fixture import CYCLE_US, Array, Build, CellFmu, all_reals, box_hull, cell_description, pose, rejection
from cell_fixture import collision as watched

from mesh_json import read_mesh_json
from scancell.cell.fmu_file import mesh_json

X, Y, Z = 0.06, 0.04, 0.05  # the box of the test cell
OFFSET = 0.05  # m: from the table's axis
TABLE = np.array([0.45, 0.0, 0.1])
QUARTER = np.sqrt(0.5)
ALONG_X = [QUARTER, 0, QUARTER, 0]  # turns z into x


def beside_table(x: float, y: float, z: float) -> Array:
    """Transform a point from the world to the table frame."""
    return np.asarray(TABLE + np.array([x, y, z]))


def body(name: str, frame: str, mesh: dict[str, Any]) -> dict[str, Any]:
    return {"name": name, "frame": frame, "mesh": mesh}


def placed_box(size: tuple[float, float, float], centre: Any) -> dict[str, Any]:
    """A box mesh in its frame, with a given centre."""
    vertices, faces = read_mesh_json(box_hull(*size))
    return mesh_json(vertices + np.asarray(centre) - [0, 0, size[2] / 2], faces)


def sensing_cell(offset: float = OFFSET, **keys: Any) -> dict[str, Any]:
    """The test cell with its box at (offset, 0) on the table, visible to sensors."""
    cell = cell_description(support_from_part=pose([offset, 0, 0]))
    cell["bodies"] = [body("part", "part[1]", box_hull(X, Y, Z))]
    return {**cell, **keys}


def presence(position: Any, size: Any, **keys: Any) -> dict[str, Any]:
    where = {"frame": "world", "frame_from_sensor": pose(position)}
    edges = {f"{axis}_size": float(edge) for axis, edge in zip("xyz", size, strict=True)}
    return {"name": "presence", **where, **edges, "period_us": 1000, **keys}


def distance(position: Any, quaternion: Any = (1, 0, 0, 0), **keys: Any) -> dict[str, Any]:
    return {
        "name": "distance", "frame": "world", "frame_from_sensor": pose(position, quaternion),
        "lens_x": 0.02, "nearest": 0.01, "farthest": 0.5, "noise": 0.0, "resolution": 0.0, "period_us": 1000,
        **keys,
    }  # fmt: skip


def rotate_table(cell: CellFmu, until_us: int, rate: float = 2.0, step_us: int = CYCLE_US) -> None:
    """Stream set-points of a table rotating at `rate` rad/s."""
    while cell.time_us < until_us:
        cell.command(table=rate * (cell.time_us - cell.time_us % CYCLE_US + CYCLE_US) * 1e-6)
        cell.step(step_us)


def rectangles_overlap(centre: Any, angle: float, size: Any, other: Any, other_size: Any) -> bool:
    """Overlap of a rotated and an axis-aligned rectangle (separating axes)."""
    across = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    between = np.asarray(other) - np.asarray(centre)
    for axis in (*across, *np.eye(2)):
        reach = np.abs(across @ axis) @ np.asarray(size) / 2 + np.abs(axis) @ np.asarray(other_size) / 2
        if abs(between @ axis) > reach:
            return False
    return True


def test_presence_is_overlap_of_part_and_volume(build: Build) -> None:
    volume, size = beside_table(-0.01, 0.055, 0)[:2], (0.05, 0.02)
    cell = build(3, sensing_cell(presence_sensors=[presence([*volume, 0.13], (*size, 0.02))]))
    changes = 0
    before = False
    for k in range(1, 200):
        rotate_table(cell, k * CYCLE_US)
        angle = float(cell.get("truth.table")[0])
        centre = TABLE[:2] + OFFSET * np.array([np.cos(angle), np.sin(angle)])
        expected = rectangles_overlap(centre, angle, (X, Y), volume, size)
        assert bool(cell.get_int("presence[1].detected")) == expected, angle
        changes += expected != before
        before = expected
    assert changes >= 2


@pytest.mark.parametrize(("height", "expected"), [(0.1 + Z + 0.009, True), (0.1 + Z + 0.011, False), (0.125, True)])
def test_presence_depends_on_height_and_detects_larger_parts(build: Build, height: float, expected: bool) -> None:
    volume = presence([TABLE[0] + OFFSET, 0, height], (0.02, 0.02, 0.02))
    cell = build(2, sensing_cell(presence_sensors=[volume]))
    assert not cell.get_int("presence[1].detected")  # no reading yet
    cell.step(CYCLE_US)
    assert bool(cell.get_int("presence[1].detected")) == expected


def test_presence_sees_bodies_of_every_kind_but_those_of_its_own_frame(build: Build) -> None:
    """A small box on a link, on the flange, on the table and in the world, each in the middle of a volume."""
    cell = sensing_cell()
    frames = ["link[3]", "link[6]", "table", "world", "sensor"]
    at = [0.3, 0.1, 0.7]
    small = placed_box((0.01, 0.01, 0.01), at)
    cell["bodies"] = [body(f"on {frame}", frame, small) for frame in frames]
    poses = build(3, cell)
    sensors = [presence(at, (0.03, 0.03, 0.03), name=f"own {frame}", frame=frame) for frame in frames]
    for frame in frames:
        where = np.eye(4) if frame == "world" else poses.body(frame)
        sensors.append(presence((where @ [*at, 1])[:3].tolist(), (0.03, 0.03, 0.03), name=f"at {frame}"))
    instance = build(3, {**cell, "presence_sensors": sensors})
    instance.step(CYCLE_US)
    seen = [bool(instance.get_int(f"presence[{i + 1}].detected")) for i in range(2 * len(frames))]
    assert seen == [frame == "world" for frame in frames] + [True] * len(frames)


@pytest.mark.parametrize("version", [2, 3])
def test_light_curtain_counts_beams_through_rotating_box(build: Build, version: int) -> None:
    """Beams along the world's x axis, one above the other, at y = 40 mm from the table's axis."""
    spacing, first, width, y = 0.004, -0.009, 0.3, 0.04
    up_and_along = [0.5, 0.5, 0.5, 0.5]  # turns z into x and x into y
    upright = [QUARTER, 0, -QUARTER, 0]  # turns x into z and z into -x
    mount = {"frame": "world", "frame_from_sensor": pose(beside_table(width / 2, y, first), upright)}
    curtain = {"name": "gate", **mount, "width": width, "height": 0.1, "beam_spacing": spacing, "period_us": 1000}
    level = {**curtain, "frame_from_sensor": pose(beside_table(-width / 2, -0.05, Z / 2), up_and_along)}
    cell = build(version, sensing_cell(light_curtains=[curtain, level]))
    assert not cell.get_int("light_curtain[1].interrupted")  # no reading yet
    heights = first + spacing * np.arange(26)
    through = int(np.sum((heights > 0) & (heights < Z)))
    counts = []
    for k in range(1, 120):
        rotate_table(cell, k * CYCLE_US)
        angle = float(cell.get("truth.table")[0])
        corners = np.array([[sx * X / 2 + OFFSET, sy * Y / 2] for sx in (-1, 1) for sy in (-1, 1)])
        across = corners @ [np.sin(angle), np.cos(angle)]
        expected = through if across.min() < y < across.max() else 0
        assert cell.get_int("light_curtain[1].beams") == expected, angle
        assert cell.get_int("light_curtain[1].interrupted") == (expected > 0)
        rows = -0.05 + spacing * np.arange(26)
        assert cell.get_int("light_curtain[2].beams") == np.sum((rows > across.min()) & (rows < across.max()))
        counts.append(expected)
    assert {0, through} == set(counts)


def test_distance_to_rotating_face(build: Build) -> None:
    """A ray towards the axis hits the face at x = -X/2 of a box rotating about it: D - (X/2) / cos(angle)."""
    away = 0.2
    sensor = distance(beside_table(-away, 0, 0.02), ALONG_X)
    cell = build(3, sensing_cell(0.0, distance_sensors=[sensor]))
    seen = 0
    for k in range(1, 30):
        rotate_table(cell, k * CYCLE_US, rate=1.0)
        angle = float(cell.get("truth.table")[0])
        if abs(np.tan(angle)) * X > Y:
            break  # the ray has left the face
        value, time = cell.get("distance[1].value", "distance[1].time")
        assert cell.get_int("distance[1].valid")
        assert value == pytest.approx(away - X / 2 / np.cos(angle), abs=1e-12)
        assert time == pytest.approx(cell.time_us * 1e-6, abs=1e-12)
        seen += 1
    assert seen > 20


def test_blocked_return_path_invalidates_measurement(build: Build) -> None:
    """The lens stands 20 mm beside the ray, along the sensor's x axis (here: up); a bar at half way shades it.

    Sensors side by side, each with a bar of its own, narrower than they are apart, at another height.
    """
    away, apart = 0.2, 3e-4
    path = away - X / 2
    shades = np.linspace(-0.02, 0.05, 101)
    sensors, bars = [], []
    for k, shade in enumerate(shades):
        y = (k - 50) * apart
        sensors.append(distance(beside_table(-away, y, 0.02), ALONG_X, name=f"distance {k}", lens_x=-0.02))
        bar = placed_box((0.004, 0.9 * apart, 0.004), beside_table(-away + path / 2, y, 0.02 + shade))
        bars.append(body(f"bar {k}", "world", bar))
    cell = sensing_cell(0.0, distance_sensors=sensors)
    cell["bodies"] += bars
    instance = build(3, cell)
    instance.step(CYCLE_US)
    valid = [bool(instance.get_int(f"distance[{k}].valid")) for k in range(1, len(shades) + 1)]
    rise = 0.002 * 0.02 / path  # of the return path over half the bar's width
    for k, shade in enumerate(shades):
        # The ray is at height 0, the middle of the return path at +10 mm.
        in_ray, in_return_path = abs(shade) < 0.002, abs(shade - 0.01) < 0.002 + rise
        if in_ray:
            assert instance.get(f"distance[{k + 1}].value")[0] == pytest.approx(path / 2 - 0.002, abs=1e-9)
        assert valid[k] == (not in_return_path), shade
    assert valid.count(False) > 4


def test_distance_out_of_range_is_invalid(build: Build) -> None:
    away = 0.2
    truth = away - X / 2
    for nearest, farthest, valid in ((0.0, truth + 1e-6, 1), (0.0, truth - 1e-6, 0), (truth + 1e-6, 0.5, 0)):
        sensor = distance(beside_table(-away, 0, 0.02), ALONG_X, nearest=nearest, farthest=farthest)
        cell = build(2, sensing_cell(0.0, distance_sensors=[sensor]))
        cell.step(CYCLE_US)
        assert cell.get_int("distance[1].valid") == valid


def test_distance_sensor_noise_resolution_and_period(build: Build) -> None:
    noise, period = 2e-4, 5000
    sensor = distance(beside_table(-0.2, 0, 0.02), ALONG_X, noise=noise, period_us=period)
    coarse = {**sensor, "noise": 0.0, "resolution": 1e-3}
    description = sensing_cell(0.0, distance_sensors=[sensor, coarse])
    cell, again, other = build(3, description), build(3, description), build(3, description, {"seed": 5})
    values, others = [], []
    for k in range(1, 1501):
        for instance in (cell, again, other):
            instance.step(1000)
        value, time = cell.get("distance[1].value", "distance[1].time")
        assert time == pytest.approx((k - k % 5) * 1e-3, abs=1e-12)
        assert value == again.get("distance[1].value")[0]
        if k % 5 == 0:
            values.append(value)
            others.append(other.get("distance[1].value")[0])
    error = np.array(values) - 0.17
    assert abs(error.mean()) < 4 * noise / np.sqrt(len(error))
    assert error.std() == pytest.approx(noise, rel=4 / np.sqrt(2 * len(error)))
    assert abs(np.corrcoef(error, np.array(others))[0, 1]) < 4 / np.sqrt(len(error))
    assert cell.get("distance[2].value")[0] == pytest.approx(0.17, abs=1e-12)


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("start", [-3.0, 5.0])
def test_times_of_readings_and_records_include_the_start_time(build: Build, version: int, start: float) -> None:
    sensor = distance(beside_table(-0.2, 0, 0.02), ALONG_X, period_us=4000)
    cell = build(version, sensing_cell(0.0, distance_sensors=[sensor]))
    cell.slave.reset()
    cell.initialize(start_time=start)
    assert cell.get("distance[1].time", "trigger.time").tolist() == [0.0, 0.0]
    cell.trigger(1, 1.0)
    cell.slave.doStep(start, 0.002)
    assert cell.get("distance[1].time", "trigger.time") == pytest.approx([0.0, start], abs=1e-12)  # no reading yet
    cell.slave.doStep(start + 0.002, 0.008)
    assert cell.get("distance[1].time", "trigger.time") == pytest.approx([start + 0.008, start], abs=1e-12)


def collision_cell(**collision: Any) -> dict[str, Any]:
    """A cell with a post in the path of the box."""
    cell = sensing_cell()
    cell["bodies"].append(
        body("post", "world", placed_box((0.02, 0.02, POST_TOP - POST_FOOT), [*POST, (POST_TOP + POST_FOOT) / 2]))
    )
    return {**cell, "collision": watched(("part", "post"), **collision)}


POST = beside_table(0, 0.06, 0)[:2]
POST_FOOT, POST_TOP = 0.085, 0.2  # m: no face lies in the plane of one of the box's


def independent_distance(angle: float) -> float:
    """Distance from another library and the closed form of the box pose."""
    shapes = [fcl.Box(X, Y, Z), fcl.Box(0.02, 0.02, POST_TOP - POST_FOOT)]
    c, s = np.cos(angle), np.sin(angle)
    rotation = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    poses = [
        fcl.Transform(rotation, beside_table(OFFSET * c, OFFSET * s, Z / 2)),
        fcl.Transform(np.eye(3), np.array([*POST, (POST_TOP + POST_FOOT) / 2])),
    ]
    bodies = [fcl.CollisionObject(shape, pose) for shape, pose in zip(shapes, poses, strict=True)]
    return float(fcl.distance(*bodies, fcl.DistanceRequest(enable_signed_distance=True), fcl.DistanceResult()))


def test_clearance_and_collision_at_controller_cycle(build: Build) -> None:
    cell = build(3, collision_cell())
    met = shallow = 0
    for k in range(1, 60):
        rotate_table(cell, k * CYCLE_US)
        expected = independent_distance(float(cell.get("truth.table")[0]))
        clearance, depth = cell.get("truth.clearance.distance", "truth.collision.depth")
        pairs = cell.get_int("truth.collision.pairs")
        bodies = [cell.get_int(f"truth.{group}.body_{x}") for group in ("clearance", "collision") for x in "ab"]
        if expected > 0.05:
            assert (clearance, pairs, bodies) == (0.05, 0, [0, 0, 0, 0])
        elif expected > 0:
            assert clearance == pytest.approx(expected, abs=1e-6)  # its solver stops there
            assert (pairs, depth, bodies) == (0, 0, [1, 2, 0, 0])
        else:
            met += 1
            assert (clearance, pairs, bodies) == (0, 1, [1, 2, 1, 2])
            if -expected < 0.008:  # an edge of one in a face of the other: what must be moved to part them
                shallow += 1
                assert depth == pytest.approx(-expected, abs=1e-5)  # its solver stops there
            assert 0 < depth <= -expected + 1e-5
            point = cell.vector("truth.collision.point", 3)
            assert np.abs(point[:2] - POST).max() < 0.05
    assert met > 5
    assert shallow > 2


FIN = (0.06, 0.001)  # m: a plate that stands on the platter, its length along the radius and its thickness
FIN_RADIUS, FIN_POST = 0.08, (0.001, 0.03)


def fin_cell(**collision: Any) -> dict[str, Any]:
    """A thin plate on the platter, and a thin plate of the world in its path at 90 degrees."""
    cell = sensing_cell()
    fin = placed_box((*FIN, 0.05), [FIN_RADIUS, 0, 0.08])
    post = placed_box((*FIN_POST, 0.05), beside_table(0, FIN_RADIUS, 0.09))
    cell["bodies"] = [body("fin", "table", fin), body("post", "world", post)]
    return {**cell, "collision": watched(("fin", "post"), **collision)}


def fins_overlap(angle: float) -> bool:
    centre = FIN_RADIUS * np.array([np.cos(angle), np.sin(angle)])
    return rectangles_overlap(centre, angle, FIN, [0, FIN_RADIUS], FIN_POST)


def test_collision_of_thin_bodies_between_two_cycles_is_reported(build: Build) -> None:
    """At 0.64 m/s the plates overlap for 3 ms of a cycle of 16 ms."""
    swept, sampled = build(3, fin_cell()), build(3, fin_cell(swept=False))
    before, unseen = 0.0, 0
    for k in range(1, 260):
        for cell in (swept, sampled):
            rotate_table(cell, k * CYCLE_US, rate=8.0)
        angle = float(swept.get("truth.table")[0])
        is_near = np.sin(angle) > 0.8  # elsewhere the plates are centimetres apart
        now = fins_overlap(angle)
        met = is_near and any(fins_overlap(passed) for passed in np.linspace(before, angle, 400))
        assert sampled.get_int("truth.collision.pairs") == now, angle
        assert swept.get_int("truth.collision.pairs") == (met and not fins_overlap(before)) or now, angle
        if met and not now and not fins_overlap(before):
            unseen += 1
            assert swept.get("truth.clearance.distance")[0] == 0
            assert [swept.get_int(f"truth.collision.body_{x}") for x in "ab"] == [1, 2]
            assert 0 < swept.get("truth.collision.depth")[0] <= 0.5e-3 + 1e-9  # half of a thickness
            point = swept.vector("truth.collision.point", 3) - beside_table(0, FIN_RADIUS, 0.09)
            assert np.all(np.abs(point) < [0.003, 0.035, 0.036])
        before = angle
    assert unseen >= 3


@pytest.mark.parametrize("step_us", [CYCLE_US, 700])
def test_swept_collisions_continue_exactly_from_states_within_a_cycle(build: Build, step_us: int) -> None:
    """Run once; then again from instants within a cycle of a crossing, in an instance that jumps back each time."""
    cell = build(3, fin_cell())
    seen, states = [], []
    while cell.time_us < 60 * CYCLE_US:
        rotate_table(cell, cell.time_us + 1, rate=8.0, step_us=step_us)
        seen.append((cell.time_us, cell.get_int("truth.collision.pairs"), *all_reals(cell)[1:]))
        state = cell.save()
        states.append(cell.serialize(state))
        cell.free_state(state)
    crossing = next(i for i, values in enumerate(seen) if values[1])
    other = build(3, fin_cell())
    for first in range(crossing - CYCLE_US // step_us, crossing + 2):
        other.restore(other.deserialize(states[first]), seen[first][0])
        for values in seen[first + 1 : crossing + 3]:
            rotate_table(other, other.time_us + 1, rate=8.0, step_us=step_us)
            assert (other.time_us, other.get_int("truth.collision.pairs"), *all_reals(other)[1:]) == values


@pytest.mark.parametrize("swept", [True, False])
def test_enclosed_body_collides(build: Build, swept: bool) -> None:
    """A box on the table inside a larger one; open at the top it encloses nothing."""
    around = placed_box((0.4, 0.4, 0.2), beside_table(0, 0, 0.05))
    vertices, faces = read_mesh_json(around)
    open_top = [face for face in faces if not np.all(vertices[face][:, 2] > TABLE[2] + 0.1)]
    assert len(open_top) == len(faces) - 2
    for mesh, pairs, depth in ((around, 1, 0.1), (mesh_json(vertices, open_top), 0, 0.0)):
        description = collision_cell(pairs=[["part", "around"]], range=1.0, swept=swept)
        description["bodies"].append(body("around", "world", mesh))
        cell = build(3, description)
        cell.step(CYCLE_US)
        for _ in range(3):
            assert cell.get_int("truth.collision.pairs") == pairs
            assert cell.get("truth.collision.depth")[0] == pytest.approx(depth, abs=1e-6)
            rotate_table(cell, cell.time_us + 5 * CYCLE_US)


def test_reset_reloads_meshes_of_changed_file(build: Build, tmp_path: Path) -> None:
    """The file has changed since the last reset, and shares some meshes with its former content."""
    file = tmp_path / "other.json"
    cell = build(3, collision_cell())

    def clearance(cell: CellFmu) -> float:
        cell.step(CYCLE_US)
        return float(cell.get("truth.clearance.distance")[0])

    def clearance_after_reset(description: dict[str, Any] | None) -> float:
        parameters = {}
        if description is not None:
            file.write_text(json.dumps(description))
            parameters["cell.file"] = str(file)
        cell.slave.reset()
        cell.initialize(parameters)
        return clearance(cell)

    smaller, larger = collision_cell(), collision_cell()
    smaller["bodies"][0]["mesh"] = box_hull(X / 2, Y, Z)
    larger["bodies"][0]["mesh"] = box_hull(X * 1.2, Y, Z)
    first = clearance(cell)
    found = [clearance_after_reset(description) for description in (smaller, larger, larger, None, smaller)]
    expected = [clearance(build(3, description)) for description in (smaller, larger)]
    assert len({first, *expected}) == 3
    assert found == [expected[0], expected[1], expected[1], first, expected[0]]


def full_sensing_cell(**collision: Any) -> dict[str, Any]:
    sensor = distance(beside_table(-0.2, 0, 0.02), ALONG_X, noise=1e-4, period_us=3000)
    cell = collision_cell(**collision)
    volume = presence(beside_table(0, 0.05, 0.03), (0.02, 0.02, 0.02), period_us=2000)
    return {**cell, "distance_sensors": [sensor], "presence_sensors": [volume]}


def readings(cell: CellFmu) -> list[float]:
    """All readings but the time, which the importer accumulates."""
    return [*all_reals(cell)[1:], cell.get_int("presence[1].detected"), cell.get_int("truth.collision.pairs")]


def test_readings_are_independent_of_communication_step(build: Build) -> None:
    cells = [build(3, full_sensing_cell()) for _ in range(3)]
    for k in range(1, 40):
        for cell, step_us in zip(cells, (CYCLE_US, 1000, 500), strict=True):
            rotate_table(cell, k * CYCLE_US, step_us=step_us)
        assert readings(cells[0]) == readings(cells[1]) == readings(cells[2])


@pytest.mark.parametrize("version", [2, 3])
def test_states_contain_sensor_readings(build: Build, version: int) -> None:
    cell = build(version, full_sensing_cell())
    rotate_table(cell, 20 * CYCLE_US)
    state, time = cell.save(), cell.time_us
    held = cell.serialize(state)
    here = readings(cell)
    rotate_table(cell, 50 * CYCLE_US)
    later = readings(cell)
    other = build(version, full_sensing_cell())
    for instance in (cell, other):
        instance.restore(instance.deserialize(held), time)
        assert readings(instance) == here
        rotate_table(instance, 50 * CYCLE_US)
        assert readings(instance) == later
    cell.free_state(state)


def test_sensors_apply_no_force(build: Build) -> None:
    free = {"fixture": "free"}
    with_sensors, without = full_sensing_cell(), full_sensing_cell(outputs=False)
    without["presence_sensors"] = without["distance_sensors"] = []
    cells = []
    for description in (with_sensors, without):
        description["parts"][0] |= free
        cells.append(build(3, description))
        rotate_table(cells[-1], 40 * CYCLE_US)
    assert np.array_equal(cells[0].body("part[1]"), cells[1].body("part[1]"))


def part_of(**mesh: Any) -> dict[str, Any]:
    """The box as a body with some mesh keys replaced."""
    return body("part", "part[1]", {**box_hull(X, Y, Z), **mesh})


def faces_json(faces: list[list[int]]) -> str:
    return mesh_json([], faces)["faces"]


def mesh_of(vertices: Array) -> dict[str, Any]:
    return body("part", "part[1]", mesh_json(vertices, [[0, 1, 2]]))


# A vertex out of range of the collision engine, and one that is not a number.
OUTLIERS = [np.vstack([np.eye(3), [0, worst, 0]]) for worst in (1001.0, np.nan)]


TOO_DENSE = {
    "name": "gate", "frame": "world", "frame_from_sensor": pose([0, 0, 0]), "period_us": 1000,
    "width": 1.0, "height": 1.0, "beam_spacing": 1e-3,
}  # fmt: skip


NO_COORDINATE = "bodies[0].mesh.vertices: vertex 3: expected coordinates from -1000 to 1000"
NO_VERTEX = "bodies[0].mesh.faces: face 1: expected vertex indices"


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("presence_sensors", presence([0, 0, 0], (0.1, 0.0, 0.1)), "presence_sensors[0].y_size"),
        ("presence_sensors", presence([0, 0, 0], (1, 1, 1), frame="part[2]"), "presence_sensors[0].frame"),
        ("distance_sensors", distance([0, 0, 0], period_us=1500), "distance_sensors[0].period_us"),
        ("light_curtains", TOO_DENSE, "light_curtains[0].beam_spacing: expected at most 1000 beams"),
        ("bodies", body("part", "part[1]", mesh_json(np.zeros((1, 3)), [])), "mesh.faces: expected at least"),
        ("bodies", part_of(vertices=3), "mesh.vertices: expected base64 text of three little-endian"),
        ("bodies", part_of(vertices="AAAA"), "mesh.vertices: expected base64 text of three little-endian"),
        ("bodies", part_of(vertices="ab-c"), "mesh.vertices: expected base64 text"),
        ("bodies", part_of(vertices="A==="), "mesh.vertices: expected base64 text"),
        ("bodies", mesh_of(OUTLIERS[0]), NO_COORDINATE),
        ("bodies", mesh_of(OUTLIERS[1]), NO_COORDINATE),
        ("bodies", part_of(faces=faces_json([[0, 1, 2], [0, 1, 8]])), NO_VERTEX),
        ("bodies", part_of(faces=faces_json([[0, 1, 2], [0, -1, 2]])), NO_VERTEX),
        ("bodies", part_of(faces="AAAAAAAA"), "mesh.faces: expected base64 text of three little-endian 32-bit"),
    ],
)
def test_invalid_sensors_are_rejected_by_key(key: str, value: Any, message: str) -> None:
    found = rejection(sensing_cell(**{key: [value]}))
    assert message in found
    assert f"{key}[0]." in found


@pytest.mark.parametrize(
    ("pairs", "message"), [([("part", "nobody")], "collision.pairs[0][1]"), ([], "collision.pairs")]
)
def test_invalid_collision_pairs_are_rejected_by_key(pairs: list[tuple[str, str]], message: str) -> None:
    assert message in rejection(sensing_cell(collision=watched(*pairs)))
