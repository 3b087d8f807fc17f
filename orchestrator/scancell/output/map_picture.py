"""Picture of a configuration map with the motion of the table that was chosen on it, as a plane and as a cylinder."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scancell.output.sheet import SOFT, Axes, Sheet, resized
from scancell.planning.path_map.configuration_map import CAUSES, ConfigurationMap
from scancell.planning.path_map.table_motion import TableMotion

Pixels = NDArray[np.uint8]

_WIDTH, _HEIGHT = 1120, 890
_LEFT, _TOP, _PLOT_WIDTH, _PLOT_HEIGHT = 84, 64, 1000, 440
_RADIUS, _LENGTH, _DEPTH = 105, 440, 26  # px: cylinder, and half the width of its ends as they are seen
_CYLINDER_TOP = 600
# By number of the constraint: reach, joint range, singularity, joint speed, clearance, user.
_COLOURS = np.array(
    [[255, 255, 255], [38, 38, 43], [88, 98, 140], [120, 74, 138], [196, 120, 40], [178, 48, 48], [96, 96, 96]],
    np.uint8,
)
_UNKNOWN = np.array([226, 228, 232], np.uint8)
_MOTION = "#1f6fff"  # unlike every cause, and unlike the greens of the free cells
_LOW, _HIGH = np.array([232, 245, 220]), np.array([46, 139, 87])


def map_picture(map_: ConfigurationMap, name: str, branch: str, duration: float, motion: TableMotion | None) -> Sheet:
    """Picture of a map: quality of the free cells in green, forbidden ones by constraint, the motion as a line.

    The plane map is also shown as a cylinder, whose axis is the time and where the table angle closes, from two sides.
    Cells that were not evaluated are grey; evaluate the whole map first for a complete picture.
    """
    sheet = Sheet(_WIDTH, _HEIGHT)
    cost = f"cost of the motion {motion.cost:.3f}" if motion is not None else "no motion chosen in this branch"
    sheet.text(_LEFT, 48, f"{map_.columns} x {map_.rows} cells, {cost}", colour=SOFT)
    angles = [(float(degrees), f"{degrees}") for degrees in (0, 90, 180, 270, 360)]
    box, labels = (
        (_LEFT, _TOP, _LEFT + _PLOT_WIDTH, _TOP + _PLOT_HEIGHT),
        ("time along the path (s)", "table angle (deg)"),
    )
    title = f"{name}: table angle along the path, branch {branch}"
    axes = Axes(sheet, box, (0.0, duration), (0.0, 360.0), labels, title, y_ticks=angles)
    pixels = map_pixels(map_)
    sheet.image(resized(pixels, _PLOT_WIDTH, _PLOT_HEIGHT, sharp=True), _LEFT, _TOP)
    for number, middle in enumerate((90.0, 270.0)):
        _cylinder(sheet, pixels, _LEFT + number * (_PLOT_WIDTH - _LENGTH - 2 * _DEPTH), middle, motion)
    if motion is not None:
        for line in motion_lines(motion.angle):
            axes.line([(duration * x, 360 * (1 - y)) for x, y in line], _MOTION, 4)
    sheet.legend(_LEFT, _HEIGHT - 26, [*map_legend(map_), *([("motion", _MOTION)] if motion is not None else [])])
    return sheet


def map_pixels(map_: ConfigurationMap) -> Pixels:
    """Colours of the cells (rows, columns, 3), the largest table angle first."""
    quality = np.nan_to_num(map_.quality)[..., None]
    pixels = np.where(quality > 0, _LOW + quality * (_HIGH - _LOW), _COLOURS[map_.cause]).astype(np.uint8)
    pixels[np.isnan(map_.quality)] = _UNKNOWN
    return np.ascontiguousarray(pixels.transpose(1, 0, 2)[::-1])


def motion_lines(angle: NDArray[np.float64]) -> list[list[tuple[float, float]]]:
    """Lines along a motion of table angles (n,), rad, in a map of height and width 1 whose origin is above on the left.

    A line leaves the map at one edge, and the next one comes back at the other.
    """
    turn = np.mod(angle, 2 * np.pi) / (2 * np.pi)
    points = np.column_stack([np.linspace(0.0, 1.0, len(angle)), 1 - turn])
    pieces = np.split(points, np.flatnonzero(np.abs(np.diff(turn)) > 0.5) + 1)
    return [[(float(x), float(y)) for x, y in piece] for piece in pieces if len(piece) > 1]


def _cylinder(sheet: Sheet, pixels: Pixels, left: int, middle: float, motion: TableMotion | None) -> None:
    """The half of the cylinder around a table angle (deg), seen from there; its far end shows as an ellipse."""
    y, x = np.mgrid[-_RADIUS + 0.5 : _RADIUS, 0.5 : _LENGTH + 2 * _DEPTH]
    lift = np.sqrt(1 - (y / _RADIUS) ** 2)  # towards the viewer
    along = (x - _DEPTH * (1 - lift)) / _LENGTH
    angle = np.radians(middle) - np.arcsin(y / _RADIUS)
    rows, columns = pixels.shape[:2]
    row = rows - 1 - (np.mod(angle / (2 * np.pi), 1.0) * rows).astype(int) % rows
    shaded = pixels[row, np.clip((along * columns).astype(int), 0, columns - 1)] * (0.55 + 0.45 * lift)[..., None]
    end = np.abs(x - _LENGTH - _DEPTH * 1.0) <= _DEPTH * lift
    shown = np.where(end[..., None] & (along > 1)[..., None], 236, 255) * np.ones(3)
    shown = np.where(((along >= 0) & (along < 1))[..., None], shaded, shown)
    top = _CYLINDER_TOP
    sheet.image(np.ascontiguousarray(shown.astype(np.uint8)), left, top)
    sheet.text(left + _LENGTH / 2, top - 14, f"seen from table angle {middle:.0f}\N{DEGREE SIGN}", anchor="ms")
    if motion is None:
        return
    from_middle = np.mod(motion.angle - np.radians(middle) + np.pi, 2 * np.pi) - np.pi
    at = np.linspace(0.0, _LENGTH, len(from_middle)) + _DEPTH * (1 - np.cos(from_middle))
    height = top + _RADIUS * (1 - np.sin(from_middle))
    seen = np.flatnonzero(np.abs(from_middle) < np.pi / 2)
    for piece in np.split(seen, np.flatnonzero(np.diff(seen) > 1) + 1):
        if len(piece) > 1:
            sheet.line([(left + float(at[i]), float(height[i])) for i in piece], _MOTION, 4)


def map_legend(map_: ConfigurationMap) -> list[tuple[str, str]]:
    """Meanings of the colours, and their codes in HTML."""
    shown = [("quality 0", _LOW), ("1", _HIGH)]
    shown += [(CAUSES[i], _COLOURS[i]) for i in range(1, len(CAUSES)) if (map_.cause == i).any()]
    if map_.evaluated < map_.quality.size:
        shown.append(("not evaluated", _UNKNOWN))
    return [(name, "#" + "".join(f"{int(c):02x}" for c in colour)) for name, colour in shown]
