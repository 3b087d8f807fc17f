"""Pictures of results: configuration maps, camera images with their stripe, and values on the surface of a part."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scancell import sensor as sensor_rt
from scancell.arrays import Array
from scancell.geometry.mesh import Mesh, clustered
from scancell.geometry.mesh_files import weld
from scancell.output.sheet import SOFT, TITLE_SIZE, Axes, Pixels, Sheet, resized
from scancell.planning.path_map.configuration_map import CAUSES, ConfigurationMap
from scancell.planning.path_map.table_motion import TableMotion

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

_FOUND = "#ff5a36"
_FRAME = "#38c6f4"
_PAPER = "#15181d"
_TEXT = "#e8eaee"
_STRIPE_WIDTH = 720  # px per camera
_GAP = 18  # px between pictures and around them
_HEAD = 92  # px above the images
_BETWEEN = 46  # px between image and close-up
_ZOOM_PX = (64, 26)  # width and height of the close-up
_CLOSE_UP_FINE = 3  # pixels drawn along each side of a pixel of the close-up, which smooths the marks
_GAMMA = 0.55  # lifts the flanks of the stripe and the ambient light out of the dark

Index = NDArray[np.int64]

_INK = (34, 40, 49)
_FINE = 2  # pixels of the drawing along each side of a pixel of the image, which smooths outlines
_ROWS = 32  # of pixels that are cast at a time
_MOST_POINTS = 150_000
_MANY_FACES = 150_000  # from which on the surface is drawn from a coarser mesh
_CELLS = 250  # of that mesh along the largest extent
_SHARP = np.cos(np.radians(25.0))  # angle between two faces from which their edge is drawn
_MOST_EDGES = 50_000  # a scanned or noisy mesh has no meaningful edges
_LIFT = 30e-6  # m off the surface where lines of sight start; clouds lie that close to it
_RIM_PX = 4  # of the image, around the part
_REACH = 2 * _FINE  # px by which marks reach beyond their middle at most
_FACING = 0.05  # least cosine between line of sight and normal at which points are drawn


def map_picture(map_: ConfigurationMap, name: str, branch: str, duration: float, motion: TableMotion | None) -> Sheet:
    """Picture of a map: quality of the free cells in green, forbidden ones by constraint, the motion as a line.

    The plane map is also shown as a cylinder, whose axis is the time and where the table angle closes, from two sides;
    that of another axis is not.
    Cells that were not evaluated are grey; evaluate the whole map first for a complete picture.
    """
    sheet = Sheet(_WIDTH, _HEIGHT)
    cost = f"cost of the motion {motion.cost:.3f}" if motion is not None else "no motion chosen in this branch"
    sheet.text(_LEFT, 48, f"{map_.columns} x {map_.rows} cells, {cost}", colour=SOFT)
    drive = map_.drive
    low, height = drive.low / drive.per_unit, drive.span / drive.per_unit
    closes, shown = not np.isfinite(drive.high), drive.in_words
    highest = low + height if closes else drive.high / drive.per_unit
    angles = [(float(at), f"{at:.0f}") for at in np.linspace(low, highest, 5)]
    box, labels = (
        (_LEFT, _TOP, _LEFT + _PLOT_WIDTH, _TOP + _PLOT_HEIGHT),
        ("time along the path (s)", f"{shown} ({drive.unit})"),
    )
    title = f"{name}: {shown} along the path, branch {branch}"
    axes = Axes(sheet, box, (0.0, duration), (low, low + height), labels, title, y_ticks=angles)
    pixels = map_pixels(map_)
    sheet.image(resized(pixels, _PLOT_WIDTH, _PLOT_HEIGHT, sharp=True), _LEFT, _TOP)
    for number, middle in enumerate((90.0, 270.0) if closes else ()):
        _cylinder(sheet, pixels, _LEFT + number * (_PLOT_WIDTH - _LENGTH - 2 * _DEPTH), middle, motion)
    if motion is not None:
        for line in motion_lines(motion.angle - drive.low, drive.span):
            axes.line([(duration * x, low + height * (1 - y)) for x, y in line], _MOTION, 4)
    sheet.legend(_LEFT, _HEIGHT - 26, [*map_legend(map_), *([("motion", _MOTION)] if motion is not None else [])])
    return sheet


def map_pixels(map_: ConfigurationMap) -> Pixels:
    """Colours of the cells (rows, columns, 3), the largest table angle first."""
    quality = np.nan_to_num(map_.quality)[..., None]
    pixels = np.where(quality > 0, _LOW + quality * (_HIGH - _LOW), _COLOURS[map_.cause]).astype(np.uint8)
    pixels[np.isnan(map_.quality)] = _UNKNOWN
    return np.ascontiguousarray(pixels.transpose(1, 0, 2)[::-1])


def motion_lines(angle: NDArray[np.float64], span: float = 2 * np.pi) -> list[list[tuple[float, float]]]:
    """Lines along a motion of table angles (n,), rad, in a map of height and width 1 whose origin is above on the left.

    The map is as high as `span`: a turn, or that of the positions of another axis above the first row.

    A line leaves the map at one edge, and the next one comes back at the other.
    """
    turn = np.mod(angle, span) / span
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


def exposure_picture(
    images: NDArray[np.uint16], sensor: sensor_rt.Sensor, title: str, background: NDArray[np.uint16] | None = None
) -> Sheet:
    """Picture of the images (cameras, H, W) of an exposure with the stripe that the sensor's extraction finds.

    `background` are laser-off images of the same shape to subtract before extraction.
    """
    peaks = sensor_rt.extract(images[None], sensor, background=None if background is None else background[None])
    found = [
        (np.asarray(peaks.column)[peaks.camera == k], np.asarray(peaks.row)[peaks.camera == k])
        for k in range(len(sensor.cameras))
    ]
    return stripe_picture(list(images), found, names=[camera.name for camera in sensor.cameras], title=title)


def stripe_picture(
    images: Sequence[NDArray[np.integer]],
    peaks: Sequence[tuple[Array, Array]],
    *,
    names: Sequence[str],
    title: str = "",
) -> Sheet:
    """Per camera its whole image with the found stripe as a line, and below a close-up with every single peak.

    Parameters
    ----------
    images
        (H, W) digital numbers, one per camera.
    peaks
        Columns and rows (px, an integer is a pixel's centre) of the peaks found, one pair of arrays per camera.
    names
        Name of each camera.
    """
    height = max(round(image.shape[0] / image.shape[1] * _STRIPE_WIDTH) for image in images)
    close_height = round(_ZOOM_PX[1] / _ZOOM_PX[0] * _STRIPE_WIDTH)
    close_top = _HEAD + height + _BETWEEN
    sheet = Sheet((_STRIPE_WIDTH + _GAP) * len(images) + _GAP, close_top + close_height + _GAP, _PAPER)
    sheet.text(_GAP, 38, title, TITLE_SIZE, _TEXT, bold=True)
    for number, (image, (columns, rows), name) in enumerate(zip(images, peaks, names, strict=True)):
        left = _GAP + number * (_STRIPE_WIDTH + _GAP)
        grey = _grey(image)
        size = f"{image.shape[1]} × {image.shape[0]} px"
        caption = f"camera {name}   {size}, brightest {int(image.max())} DN, {len(columns)} peaks"
        sheet.text(left, _HEAD - 10, caption, colour=_TEXT)
        sheet.image(_whole(grey, columns, rows), left, _HEAD)
        sheet.legend(left + _STRIPE_WIDTH - 116, _HEAD - 15, [("found stripe", _FOUND)], _TEXT)
        if not len(columns):
            continue
        corner = _close_up(columns, rows, image.shape)
        scale = _STRIPE_WIDTH / image.shape[1]
        x, y = left + (corner[0] + 0.5) * scale, _HEAD + (corner[1] + 0.5) * scale
        sheet.rectangle(x, y, x + _ZOOM_PX[0] * scale, y + _ZOOM_PX[1] * scale, outline=_FRAME, width=2)
        sheet.text(left, close_top - 9, f"close-up, {_ZOOM_PX[0]} × {_ZOOM_PX[1]} px", colour=_FRAME)
        sheet.image(_close(grey, columns, rows, corner, close_height), left, close_top)
        sheet.rectangle(
            left, close_top, left + _STRIPE_WIDTH - 1, close_top + close_height - 1, outline=_FRAME, width=2
        )
        sheet.legend(left + _STRIPE_WIDTH - 116, close_top - 14, [("peak", _FOUND)], _TEXT)
    return sheet


def _whole(grey: Pixels, columns: Array, rows: Array) -> Pixels:
    """The image (height, `_STRIPE_WIDTH`, 3) with a line along the stripe, broken where it is torn."""
    height, width = grey.shape[:2]
    shown = (_STRIPE_WIDTH, round(height / width * _STRIPE_WIDTH))
    small = width <= _STRIPE_WIDTH
    # Drawn in the finer of both sizes: making it smaller smooths the line.
    sheet = Sheet.of(resized(grey, *shown, sharp=True) if small else grey)
    scale = _STRIPE_WIDTH / width if small else 1.0
    order = np.argsort(columns, kind="stable")
    x, y = columns[order].astype(float), rows[order].astype(float)
    torn = np.flatnonzero((np.diff(x) > 1.5) | (np.abs(np.diff(y)) > 4.0)) + 1
    points = np.stack([(x + 0.5) * scale, (y + 0.5) * scale], 1)
    for piece in np.split(points, torn):
        if len(piece) > 1:
            sheet.line([(px, py) for px, py in piece.tolist()], _FOUND, 2)
    return sheet.pixels if small else resized(sheet.pixels, *shown)


def _close(grey: Pixels, columns: Array, rows: Array, corner: tuple[float, float], height: int) -> Pixels:
    """The pixels from `corner` on, each of them visible, with a dot at each peak."""
    x0, y0 = corner
    left, top = round(x0 + 0.5), round(y0 + 0.5)
    cut = np.zeros((_ZOOM_PX[1], _ZOOM_PX[0], 3), np.uint8)  # images may be smaller
    inside = grey[top : top + _ZOOM_PX[1], left : left + _ZOOM_PX[0]]
    cut[: inside.shape[0], : inside.shape[1]] = inside
    sheet = Sheet.of(resized(cut, _STRIPE_WIDTH * _CLOSE_UP_FINE, height * _CLOSE_UP_FINE, sharp=True))
    scale = _STRIPE_WIDTH * _CLOSE_UP_FINE / _ZOOM_PX[0]
    near = (columns > x0) & (columns < x0 + _ZOOM_PX[0]) & (rows > y0) & (rows < y0 + _ZOOM_PX[1])
    for x, y in zip(columns[near], rows[near], strict=True):
        sheet.dot((x - x0) * scale, (y - y0) * scale, 3.0 * _CLOSE_UP_FINE, _FOUND)
    return resized(sheet.pixels, _STRIPE_WIDTH, height)


def _grey(image: NDArray[np.integer]) -> Pixels:
    """Greys (H, W, 3): black is the image's own background, white the brightest ten-thousandth."""
    count = np.cumsum(np.bincount(image.ravel()))
    black, white = np.searchsorted(count, np.array([0.01, 0.9999]) * image.size)
    value = np.clip((np.arange(len(count)) - black) / max(white - black, 1), 0, 1)
    grey = (255 * value**_GAMMA).astype(np.uint8)[image]
    return np.repeat(grey[:, :, None], 3, axis=2)


def _close_up(columns: Array, rows: Array, shape: tuple[int, ...]) -> tuple[float, float]:
    """Upper left corner of the close-up, around the middle peak, moved inside the image."""
    middle = np.argsort(columns, kind="stable")[len(columns) // 2]
    x = np.clip(np.round(columns[middle]) - _ZOOM_PX[0] / 2, 0, max(shape[1] - _ZOOM_PX[0], 0))
    y = np.clip(np.round(rows[middle]) - _ZOOM_PX[1] / 2, 0, max(shape[0] - _ZOOM_PX[1], 0))
    return float(x) - 0.5, float(y) - 0.5


def view_axes(azimuth_deg: float, elevation_deg: float) -> Array:
    """Rows (3, 3): right, up and towards the viewer, who stands at `azimuth_deg` from x and `elevation_deg` up."""
    azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
    towards = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    return np.stack([right, np.cross(towards, right), towards])


class SurfaceView:
    """Draws points (n, 3) with a value each and the mesh face (n,) they lie on, from any side.

    `colours` turns values (k,) into colours (k, 3), 0 to 255.
    """

    def __init__(
        self,
        mesh: Mesh,
        points: Array,
        values: Array,
        face: NDArray[np.integer[Any]],
        colours: Callable[[Array], Array],
    ) -> None:
        self._mesh, self._colours = mesh, colours
        self._points, self._values, self._face = points, values, face
        extent = np.ptp(mesh.bounds, axis=0)
        self._far = 2.0 * float(np.linalg.norm(extent))
        coarse = clustered(mesh, float(extent.max()) / _CELLS) if len(mesh.faces) > _MANY_FACES else mesh
        self._surface = coarse
        self._lift = _LIFT if coarse is mesh else 2.0 * float(extent.max()) / _CELLS
        self._scene = sensor_rt.Scene()
        self._scene.add_mesh("part", coarse.vertices, coarse.faces.astype(np.uint32), sensor_rt.Material(0.5))
        # A mesh made coarser has edges of its own.
        none = np.zeros((0, 2, 3)), np.zeros((0, 3))
        self._edges, self._edge_normals = sharp_edges(mesh) if coarse is mesh else none

    def draw(self, axes_in_part: Array, width_px: int, height_px: int) -> tuple[Pixels, float]:
        """Orthographic view along the rows of `axes_in_part`, as large as fits: image (h, w, 3) and px per metre."""
        canvas = _Canvas(self._surface, axes_in_part, width_px, height_px)
        self._draw_surface(canvas)
        self._draw_points(canvas)
        self._draw_edges(canvas)
        return canvas.image(), canvas.scale / _FINE

    def _draw_surface(self, canvas: _Canvas) -> None:
        light = np.abs(self._surface.normals @ canvas.axes[2])
        grey = np.append(255 * (0.5 + 0.3 * light), 255).astype(np.uint8)  # the last one is the background, face -1
        for first in range(0, len(canvas.colour), _ROWS):
            pixels = canvas.colour[first : first + _ROWS]
            start = canvas.pixel_positions(first, len(pixels)) + self._far * canvas.axes[2]
            face = self._cast(start.reshape(-1, 3), -canvas.axes[2])
            pixels[:] = grey[face].reshape(pixels.shape[:2])[..., None]

    def _draw_points(self, canvas: _Canvas) -> None:
        light_of_face = self._mesh.normals @ canvas.axes[2]
        # Most points may be hidden: more are looked at than drawn.
        rows = _thinned(np.arange(len(self._points)), 6 * _MOST_POINTS)
        rows = _thinned(rows[light_of_face[self._face[rows]] > _FACING], 2 * _MOST_POINTS)
        rows = rows[self._in_view(self._points[rows], self._mesh.normals[self._face[rows]], canvas.axes)]
        rows = _thinned(rows, _MOST_POINTS)
        if not len(rows):
            return
        # Shading enough to show the shape, too little to shift a reading.
        shade = 0.8 + 0.2 * light_of_face[self._face[rows]]
        paint = (self._colours(self._values[rows]) * shade[:, None]).astype(np.uint8)
        radius = np.sqrt(canvas.area / len(rows) / np.pi)  # so that neighbouring marks touch
        canvas.mark(self._points[rows], paint, float(np.clip(radius, 1.0 * _FINE, 1.6 * _FINE)))

    def _draw_edges(self, canvas: _Canvas) -> None:
        along = self._edges[:, 1] - self._edges[:, 0]
        count = np.ceil(np.linalg.norm(along, axis=1) * canvas.scale).astype(int) + 1
        edge = np.repeat(np.arange(len(count)), count)
        share = (np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count)) / count[edge]
        places = self._edges[edge, 0] + share[:, None] * along[edge]
        seen = self._in_view(places, self._edge_normals[edge], canvas.axes)
        canvas.darken(places[seen], np.array(_INK), 0.75)

    def _in_view(self, points: Array, normals: Array, axes_in_part: Array) -> NDArray[np.bool_]:
        return self._cast(points + self._lift * normals, axes_in_part[2]) < 0

    def _cast(self, start: Array, direction: Array) -> Index:
        """Face (n,) that rays from `start` (n, 3) meet first, -1 for none."""
        if not len(start):
            return np.zeros(0, np.int64)
        directions = np.tile(direction, (len(start), 1))
        return np.asarray(sensor_rt.cast_rays(self._scene, np.eye(4)[None], start, directions)[2])


class _Canvas:
    """An image finer by `_FINE` than wanted, and where points of the part lie in it; `scale` is its pixels per metre.

    Rows grow downwards, as in the image.
    """

    def __init__(self, mesh: Mesh, axes: Array, width_px: int, height_px: int) -> None:
        self.axes = axes
        seen = mesh.vertices @ axes.T
        low, high = seen.min(0)[:2], seen.max(0)[:2]
        room = np.array([width_px, height_px]) - 2 * _RIM_PX
        self.scale = float((room / (high - low)).min()) * _FINE
        self.area = float(np.prod((high - low) * self.scale))
        width, height = np.ceil((high - low) * self.scale / _FINE).astype(int) + 2 * _RIM_PX
        self.colour = np.empty((height * _FINE, width * _FINE, 3), np.uint8)
        self._corner = np.array([low[0], high[1], seen[:, 2].mean()])  # upper left corner of the part
        self._rim = _RIM_PX * _FINE

    def pixel_positions(self, first: int, rows: int) -> Array:
        """(rows, width, 3) middles of the pixels of rows, counted from the top, on a plane through the part."""
        x = self._corner[0] + (np.arange(self.colour.shape[1]) + 0.5 - self._rim) / self.scale
        y = self._corner[1] - (np.arange(first, first + rows) + 0.5 - self._rim) / self.scale
        middle = self._corner[2] * self.axes[2]
        return np.asarray(y[:, None, None] * self.axes[1] + middle + x[:, None] * self.axes[0])

    def mark(self, points: Array, paint: Pixels, radius: float) -> None:
        """Draw discs of `radius` px at points (n, 3) in colours (n, 3), the nearest to the viewer last."""
        order = np.argsort(points @ self.axes[2])
        reach = int(np.ceil(radius))
        steps = range(-reach, reach + 1)
        disc = [i * self.colour.shape[1] + j for i in steps for j in steps if i * i + j * j <= radius * radius]
        place = self._pixels(points[order])[:, None] + np.array(disc)
        self.colour.reshape(-1, 3)[place] = paint[order][:, None]

    def darken(self, points: Array, colour: Array, opacity: float) -> None:
        """Blend `_FINE` × `_FINE` pixels at each of the points (n, 3), all of them once, with a colour (3,)."""
        block = [i * self.colour.shape[1] + j for i in range(_FINE) for j in range(_FINE)]
        place = np.unique(self._pixels(points)[:, None] + np.array(block))
        flat = self.colour.reshape(-1, 3)
        flat[place] = (1 - opacity) * flat[place] + opacity * colour

    def _pixels(self, points: Array) -> Index:
        """Number (n,) of the pixel that each point lies in."""
        height, width = self.colour.shape[:2]
        x = ((points @ self.axes[0] - self._corner[0]) * self.scale).astype(np.int64) + self._rim
        y = ((self._corner[1] - points @ self.axes[1]) * self.scale).astype(np.int64) + self._rim
        # Marks reach a few pixels beyond their middle, wild points anywhere.
        y, x = np.clip(y, _REACH, height - 1 - _REACH), np.clip(x, _REACH, width - 1 - _REACH)
        return np.asarray(y * width + x)

    def image(self) -> Pixels:
        """(height, width, 3) at the resolution that was wanted."""
        height, width = self.colour.shape[:2]
        return resized(self.colour, width // _FINE, height // _FINE)


def _thinned(rows: Index, most: int) -> Index:
    """At most `most` rows, evenly chosen."""
    return rows[:: max(1, -(-len(rows) // most))]


def sharp_edges(mesh: Mesh) -> tuple[Array, Array]:
    """Edges (k, 2, 3) where two faces meet at more than 25°, and the sum (k, 3) of the normals there.

    None for a mesh with too many of them.
    """
    first, number = weld(mesh.vertices)
    faces = number[mesh.faces]
    tail, head = faces.ravel(), faces[:, [1, 2, 0]].ravel()
    key = np.minimum(tail, head) * len(first) + np.maximum(tail, head)
    order = np.argsort(key)
    same = np.flatnonzero(key[order[1:]] == key[order[:-1]])
    one, other = order[same] // 3, order[same + 1] // 3
    sharp = np.einsum("ki,ki->k", mesh.normals[one], mesh.normals[other]) < _SHARP
    if sharp.sum() > _MOST_EDGES:
        return np.zeros((0, 2, 3)), np.zeros((0, 3))
    corner = order[same[sharp]]
    ends = mesh.vertices[first[np.stack([tail[corner], head[corner]], 1)]]
    return ends, mesh.normals[one[sharp]] + mesh.normals[other[sharp]]
