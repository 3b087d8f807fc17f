"""Plausibility of descriptions that are valid one by one: meshes, camera views, exposure timing."""

from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path

import numpy as np

from scancell.arrays import Array
from scancell.config.cell import CellDescription, PartDescription, TableDescription
from scancell.config.description import si_value
from scancell.config.devices import FurtherPartDescription
from scancell.config.loading import Setup
from scancell.config.robot import JointDescription, RobotDescription
from scancell.config.sensor import (
    CameraDescription,
    SensorDescription,
    principal_point_px,
    read_out,
    sensor_json,
)
from scancell.errors import DescriptionError
from scancell.geometry import pose
from scancell.geometry.arm import Arm, Joint
from scancell.geometry.mesh import Mesh, load_mesh, mass_properties
from scancell.nominal.cell import NominalCell
from scancell.nominal.parts import flange_loads
from scancell.sensor import Camera, Sensor

_PLATTER_SHARE = 0.02  # of the radius: by which the platter's mesh may differ from its dimensions
_GAP_MM = 10.0  # links of real arms meet closer than this at their joints
_DH_TOLERANCE = {"a_mm": 1.0, "d_mm": 1.0, "alpha_deg": 0.5}
_MIN_SHARE = 0.5
_DEPTHS, _ANGLES = 200, 41  # samples of the laser sheet


def setup_warnings(setup: Setup) -> list[str]:
    """Sentences about descriptions that are valid but unlikely to be meant, each naming the keys to check.

    Raises `DescriptionError` if a camera cannot see the laser line anywhere in the measuring range; `MeshError` if the
    mesh of a link or of the platter cannot be read.
    """
    cell = setup.cell
    return [
        *_link_warnings(cell.robot),
        *_table_warnings(cell.table),
        *_camera_warnings(setup.sensor, "sensor"),
        *(
            warning
            for number, further in enumerate(setup.cell.further_sensor, 1)
            if further.sensor is not None
            for warning in _camera_warnings(further.sensor, f"cell.further_sensor[{number}].sensor")
        ),
        *_motion_warnings(setup),
    ]


def payload_warnings(cell: CellDescription, nominal: NominalCell) -> list[str]:
    """Sentence on loads of the flange beyond the arm's rated payload: always, or with a part that the gripper may hold.

    None where the description of the arm states no payload. Raises `MeshError` if the mesh of a load cannot be used.
    """
    rated = cell.robot.payload_kg
    if rated is None:
        return []
    loads = {name: load.mass for name, load in flange_loads(cell, nominal.scanned_part).items()}
    loose = []
    if cell.gripper is not None:
        parts: list[tuple[PartDescription | FurtherPartDescription, str, Mesh | None]] = [
            (cell.part, "part", nominal.scanned_part)
        ]
        parts += [(part.description, part.description.name, part.mesh) for part in nominal.further_parts]
        loose = [
            (mass_properties(mesh, part.density_kg_m3).mass, name)
            for part, name, mesh in parts
            if mesh is not None and part.fixture == "free"
        ]
    carried = sum(loads.values())
    held, part_name = max(loose, default=(0.0, ""))
    if carried + held <= rated:
        return []
    named = ", ".join(f"{name} {mass:.3g} kg" for name, mass in loads.items() if mass > 0.0)
    if carried <= rated:
        named += f", and {part_name} {held:.3g} kg if the gripper holds it"
        carried += held
    return [f"cell.robot.payload_kg = {rated:g}: the flange carries {carried:.3g} kg ({named})"]


def _table_warnings(table: TableDescription) -> list[str]:
    """The platter's mesh, if it was made for other dimensions."""
    if table.platter_mesh is None:
        return []
    mesh = load_mesh(Path(table.platter_mesh))
    radius, top = 1e3 * np.hypot(*mesh.vertices[:, :2].T).max(), 1e3 * mesh.bounds[1, 2]
    name = f"cell.table.platter_mesh = {Path(table.platter_mesh).name}"
    warnings = []
    if abs(radius - table.radius_mm) > _PLATTER_SHARE * table.radius_mm:
        warnings.append(
            f"{name}: reaches {radius:.1f} mm from the axis, but cell.table.radius_mm = {table.radius_mm:g}"
        )
    if abs(top) > _PLATTER_SHARE * table.radius_mm:
        warnings.append(f"{name}: its top is at z = {top:.1f} mm, but the part stands at z = 0")
    return warnings


def _link_warnings(robot: RobotDescription) -> list[str]:
    """Links whose mesh was made for other Denavit-Hartenberg parameters."""
    warnings = []
    previous = None if robot.base_mesh is None else load_mesh(Path(robot.base_mesh))
    for number, joint in enumerate(robot.joint, start=1):
        mesh = None if joint.mesh is None else load_mesh(Path(joint.mesh))
        reason = (
            "" if mesh is None else _other_parameters(joint) or _misfit(joint, number, len(robot.joint), mesh, previous)
        )
        if reason:
            name = f"cell.robot.joint[{number}]: mesh {Path(joint.mesh or '').name} does not fit the link"
            warnings.append(f"{name}: {reason}; give another mesh, or none")
        previous = mesh
    return warnings


def _other_parameters(joint: JointDescription) -> str:
    """Difference from the robot file beside the mesh's folder (``six_axis.toml`` for ``six_axis/link2.stl``)."""
    file = Path(joint.mesh or "").parent.with_suffix(".toml")
    owners: list[JointDescription] = []
    with suppress(DescriptionError):  # not a robot file
        owners = [other for other in RobotDescription.from_toml(file).joint if other.mesh == joint.mesh]
    for owner in owners:
        for key, tolerance in _DH_TOLERANCE.items():
            here, there = getattr(joint, key), getattr(owner, key)
            if abs(here - there) > tolerance:
                return f"{key} is {here:g}, the mesh was made for {there:g} ({file.name})"
    return ""


def _misfit(joint: JointDescription, number: int, joints: int, mesh: Mesh, previous: Mesh | None) -> str:
    """Text that states how far the link is from its joint axes or from the link before it; empty if it is not."""
    keys = ("a_mm", "d_mm", "alpha_deg", "beta_deg")
    si = {key.partition("_")[0]: si_value(joint, key) for key in keys}
    previous_from_link = Arm([Joint(**si)]).fk([0.0])
    link_from_previous = pose.inverse(previous_from_link)
    # Joint i turns about z of frame i - 1; the next joint, or the flange, lies on z of the link's own frame.
    own = _distance_from_axis(mesh.bounds, link_from_previous[:3, 3], link_from_previous[:3, 2])
    if own > _GAP_MM:
        return f"it ends {own:.0f} mm from the axis of joint {number}"
    following = f"joint {number + 1}" if number < joints else "the flange"
    further = _distance_from_axis(mesh.bounds, np.zeros(3), np.array([0.0, 0.0, 1.0]))
    if further > _GAP_MM:
        return f"it ends {further:.0f} mm from the axis of {following}"
    if previous is not None:
        low, high = mesh.transformed(previous_from_link).bounds[:, 2]
        gap = 1e3 * max(low - previous.bounds[1, 2], previous.bounds[0, 2] - high)
        if gap > _GAP_MM:
            before = f"link {number - 1}" if number > 1 else "the base"
            return f"there is a gap of {gap:.0f} mm between it and {before} along the axis of joint {number}"
    return ""


def _distance_from_axis(bounds: Array, point: Array, direction: Array) -> float:
    """Millimetres between a box (2, 3) and the infinite line through `point`; the distance is convex along it."""
    centre = (bounds[0] + bounds[1]) / 2 - point
    reach = float(np.linalg.norm(bounds[1] - bounds[0]))
    low, high = centre @ direction - reach, centre @ direction + reach

    def distance(at: float) -> float:
        position = point + at * direction
        return float(np.linalg.norm(np.maximum(0.0, np.maximum(bounds[0] - position, position - bounds[1]))))

    for _ in range(60):
        third = (high - low) / 3
        if distance(low + third) < distance(high - third):
            high -= third
        else:
            low += third
    return 1e3 * distance((low + high) / 2)


def _camera_warnings(sensor: SensorDescription, key: str) -> list[str]:
    """Cameras that see the laser line in less than half of the measuring range; `key` is that of the description."""
    native = Sensor(json.dumps(sensor_json(sensor, seed=0)))
    warnings = []
    images = zip(native.cameras, sensor.camera, read_out(sensor).camera, strict=True)
    for number, (camera, described, read) in enumerate(images, start=1):
        share = _share_of_range(sensor, camera)
        if share >= _MIN_SHARE:
            continue
        near, far = (f"{value:g}" for value in (sensor.range.near_mm, sensor.range.far_mm))
        seen = f"of the measuring range from {near} to {far} mm (its image centre column sees {_view(camera, read)})"
        hint = "check its tilt_deg, half_angle_deg, baseline_mm and height_mm, and sensor.range"
        if described.region_rows_px is not None:
            hint = "its region_rows_px and sensor.range must match"
        name = f"{key}.camera[{number}] '{described.name}'"
        if share == 0.0:
            raise DescriptionError(f"sees the laser line nowhere {seen}; {hint}", key=name)
        warnings.append(f"{name}: sees the laser line in {share:.0%} {seen}; {hint}")
    return warnings


def _share_of_range(sensor: SensorDescription, camera: Camera) -> float:
    """Share of depths in the measuring range at which the camera sees any point of the laser line."""
    z = np.linspace(si_value(sensor.range, "near_mm"), si_value(sensor.range, "far_mm"), _DEPTHS)
    half = si_value(sensor.laser, "fan_half_angle_deg")
    beyond_source = z - si_value(sensor.laser, "source_z_mm")
    y = beyond_source[:, None] * np.tan(np.linspace(-half, half, _ANGLES))
    points = np.stack([np.zeros_like(y), y, np.broadcast_to(z[:, None], y.shape)], -1).reshape(-1, 3)
    ahead = pose.transform_points(pose.inverse(camera.sensor_from_camera), points)[:, 2] > 0
    ahead &= np.repeat(beyond_source > 0, _ANGLES)
    seen = np.zeros(len(points), bool)
    pixels = camera.project(points[ahead])
    inside = ((pixels > -0.5) & (pixels < np.array([camera.width_px, camera.height_px]) - 0.5)).all(1)
    # Distortion may fold points from far outside into the image: the ray of the pixel tells.
    rays = camera.view_rays(pixels[inside])
    towards = points[ahead][inside] - camera.sensor_from_camera[:3, 3]
    cosine = (rays * towards).sum(1) / (np.linalg.norm(rays, axis=1) * np.linalg.norm(towards, axis=1))
    seen[np.flatnonzero(ahead)[inside]] = cosine > np.cos(1e-3)
    return float(seen.reshape(y.shape).any(1).mean())


def _view(camera: Camera, read: CameraDescription) -> str:
    """Range of sensor Z on the laser sheet between the first and last row of the image."""
    column, _ = principal_point_px(read)
    rays = camera.view_rays(np.array([[column, -0.5], [column, camera.height_px - 0.5]]))
    origin = camera.sensor_from_camera[:3, 3]
    with np.errstate(divide="ignore"):
        along = -origin[0] / rays[:, 0]
    z = [
        f"{1e3 * (origin[2] + t * ray[2]):.1f} mm" if np.isfinite(t) and t > 0 else "infinity"
        for t, ray in zip(along, rays, strict=True)
    ]
    return " to ".join(z)


def _motion_warnings(setup: Setup) -> list[str]:
    """Exposures that overlap, speeds beyond the table's and a standoff outside the measuring range."""
    scan, sensor, table = setup.scan, setup.sensor, setup.cell.table
    if scan.pose:
        return []
    needed = 1e3 * setup.profile_time
    if scan.belt is not None:
        period = 1e3 * scan.belt.pitch_mm / abs(scan.belt.speed_mm_s)
        return _rate_warning("belt", "pitch_mm", "speed_mm_s", period, needed)
    warnings = []
    standoff = sensor.range.standoff_mm(scan.sweep.standoff_mm)
    near, far = sensor.range.near_mm, sensor.range.far_mm
    if not near <= standoff <= far:
        where = f"the measuring range of the sensor ({near:g} to {far:g} mm)"
        warnings.append(f"scan.sweep.standoff_mm = {standoff:g}: outside {where}, the nearest surface is not measured")
    if scan.mode != "dynamic":
        return warnings
    sweep, raster = scan.sweep, scan.raster
    if sweep.enabled and sweep.speed_deg_s > table.max_speed_deg_s:
        limit = f"cell.table.max_speed_deg_s = {table.max_speed_deg_s:g}"
        warnings.append(f"scan.sweep.speed_deg_s = {sweep.speed_deg_s:g}: sweeps are slower, limited by {limit}")
    speed = min(sweep.speed_deg_s, table.max_speed_deg_s)
    views = [
        (sweep.enabled, "sweep", "angle_step_deg", sweep.angle_step_deg, "speed_deg_s", speed),
        (raster.enabled, "raster", "pitch_mm", raster.pitch_mm, "speed_mm_s", raster.speed_mm_s),
        *(
            (True, f"path[{number}]", "pitch_mm", path.pitch_mm, "speed_mm_s", path.speed_mm_s)
            for number, path in enumerate(scan.path, start=1)
        ),
    ]
    for enabled, name, step, spacing, key, rate in views:
        if not enabled or spacing == "sensor":
            continue
        warnings += _rate_warning(name, step, key, 1e3 * spacing / rate, needed)
    return warnings


def _rate_warning(name: str, step: str, key: str, period: float, needed: float) -> list[str]:
    """Warning about exposures of `needed` milliseconds that are wanted every `period` milliseconds."""
    if needed <= period:
        return []
    asked = f"scan.{name}.{step} and {key} ask for an exposure every {period:.3g} ms"
    return [f"{asked}, but one takes {needed:.3g} ms: reduce scan.{name}.{key} or the exposure time"]
