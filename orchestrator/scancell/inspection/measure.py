"""Values of characteristics from measured features, with their uncertainty by the noise of the points.

There are two ways of evaluation. *Elements*: sizes, axes and centres follow from the parameters of least-squares
elements, whose covariance follows from the noise of the points. *Zones*: form, profile, run-out, and orientation and
location of surfaces are the least width of a zone about the nominal surface, in the motions that the datums leave free
(minimax, ISO 1101). Zones are evaluated on points after a Gaussian filter (ISO 16610). Noise widens zones, and makes
the location of an axis seem worse: the mean effect of simulated noise is subtracted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import cKDTree

from scancell.arrays import Array
from scancell.config.inspection import CharacteristicDescription, Criterion
from scancell.errors import FitError
from scancell.geometry import pose
from scancell.geometry.fits import least_squares, minimum_zone
from scancell.inspection.features import UNFELT, DatumSystem, Feature, Placed, all_motions
from scancell.values import Value

_DRAWS, _LEAST_DRAWS = 400, 40  # of simulated noise
_MOST_NOISE = 8_000_000  # simulated numbers of one zone
_CELLS = 4  # along the nesting index, in which points are averaged before the filter
_ALPHA = (np.log(2) / np.pi) ** 0.5  # of the Gaussian filter (ISO 16610-21)
LEAST_POINTS = 12  # of a feature, and of a section
_SECTIONS, _MEAN_IN_SECTION = 50, 40  # of a feature at most, and mean number of points
_SMALL = 1e-4  # m: first limit of steps to circumscribed and inscribed elements, which are local optima
_FREE = 1e-6  # part of a constant that the motions of a zone leave, below which they contain it
_SURE = 2.0  # standard deviations of the power of noise

_NONE, _SHIFTS = np.zeros((0, 6)), np.eye(6)[3:]  # motions: turns, then shifts
_SIDES: dict[Criterion, tuple[int, ...]] = {
    "minimum zone": (1, -1),
    "minimum circumscribed": (1,),
    "maximum inscribed": (-1,),
}


@dataclass(frozen=True, eq=False, repr=False)
class Measured(Value):
    """Value of a characteristic, m or rad.

    Attributes
    ----------
    value
        Evaluated value without the mean effect of noise; below 0 where less than noise is left of a zone.
    raw
        Evaluated value.
    random
        Standard uncertainty by the noise of the points.
    nominal
        Nominal value of the CAD part, 0 of zones.
    points
        Number of points used.
    method
        Association, filter and datums.
    """

    value: float
    raw: float
    random: float
    nominal: float
    points: int
    method: str


def measure(
    one: CharacteristicDescription, feature: Feature, other: Feature | None, datums: DatumSystem | None, nesting: float
) -> Measured:
    """Value of a characteristic of a feature, or of two.

    Raises `FitError` if the kind does not suit the surface, or the points do not determine it.

    Parameters
    ----------
    nesting
        Nesting index of the filter of zones, m; 0: none.
    """
    for each in (feature, *((other,) if other else ())):
        if len(each.points) < LEAST_POINTS:
            raise FitError(f"'{each.name}' has {len(each.points)} points; at least {LEAST_POINTS} are needed")
    match one.kind:
        case "diameter" | "radius":
            found = _size(feature, 2.0 if one.kind == "diameter" else 1.0, one.criterion, nesting)
        case "distance" | "angle":
            assert other is not None
            found = _between(feature, other, one.kind)
        case "flatness" | "cylindricity":
            _require(feature, one.kind, "plane" if one.kind == "flatness" else "cylinder")
            found = _zone(feature, all_motions(feature), None, nesting, is_offset=feature.kind == "cylinder")
        case "roundness":
            _require(feature, one.kind, "cylinder", "cone", "sphere")
            across = feature.frame[:3, :2].T
            found = _zone(feature, np.hstack([0 * across, across]), None, nesting, is_offset=True, axis=feature.frame)
        case "straightness":
            _require(feature, one.kind, "cylinder")
            found = _straightness(feature)
        case "surface_profile" if datums is None:
            found = _zone(feature, all_motions(feature), None, nesting)
        case _:
            assert datums is not None
            found = _with_datums(one.kind, feature, other, datums, nesting)
    return found


def _with_datums(kind: str, feature: Feature, other: Feature | None, datums: DatumSystem, nesting: float) -> Measured:
    has_axis = feature.kind in ("cylinder", "cone")
    match kind:
        case "circular_run_out" | "total_run_out":
            _require(feature, kind, "plane", "cylinder", "cone", "sphere")
            _require(datums.features[0], f"the first datum of {kind}", "cylinder", "cone")
            about = datums.features[0].frame if kind == "circular_run_out" else None
            found = _zone(feature, _NONE, datums, nesting, is_offset=True, axis=about)
        case "symmetry":
            assert other is not None
            _require(feature, kind, "plane")
            _require(other, kind, "plane")
            found = _location([feature, other], datums, _NONE)
        case "coaxiality":
            _require(feature, kind, "cylinder", "cone")
            found = _location([feature], datums, _NONE)
        case "position" if has_axis or feature.kind == "sphere":
            found = _location([feature], datums, _NONE)
        case "position" | "surface_profile":
            found = _zone(feature, _NONE, datums, nesting)
        case _ if has_axis:
            found = _location([feature], datums, _SHIFTS)
        case _:
            _require(feature, kind, "plane", "cylinder", "cone")
            found = _zone(feature, _SHIFTS, datums, nesting)
    return found


def _require(feature: Feature, what: str, *kinds: str) -> None:
    if feature.kind not in kinds:
        raise FitError(f"{what} needs a {' or '.join(kinds)}; '{feature.name}' is a {feature.kind}")


@dataclass(frozen=True, eq=False)
class _Filtered:
    """Points (k, 3) of a feature after a filter, weights (k, c) of the cells in which points are averaged before.

    `deviation` (c,) is the standard deviation of the cells by noise of their own, `shared` (c, p) that by each profile.
    """

    points: Array
    weights: sparse.csr_array
    deviation: Array
    shared: sparse.csr_array
    text: str

    @classmethod
    def of(cls, feature: Feature, nesting: float) -> _Filtered:
        """Points after a Gaussian filter of their distances from the least-squares surface."""
        points, noise = feature.points, feature.noise
        if nesting <= 0:
            one = sparse.eye_array(len(points), format="csr")
            return cls(points, one, noise.deviation, noise.shared(np.arange(len(points))), "no filter")
        moved, offset = feature.placed.moved_points, feature.placed.offset
        cells = np.column_stack([feature.face, np.floor(points / (nesting / _CELLS)).astype(np.int64)])
        _, first, cell = np.unique(cells, axis=0, return_index=True, return_inverse=True)
        cell, face = cell.ravel(), feature.face[first]
        count = np.bincount(cell)
        deviation = np.sqrt(np.bincount(cell, noise.deviation**2)) / count
        averaged = np.bincount(cell, feature.placed.linearised(points)[0]) / count
        # Their mean lies beside a curved surface.
        mean = np.stack([np.bincount(cell, column) / count for column in pose.transform_points(moved, points).T], 1)
        beside, normal = feature.distances(mean)
        feet = pose.transform_points(pose.inverse(moved), mean - (beside - offset)[:, None] * normal)
        normal = normal @ moved[:3, :3]
        tree = cKDTree(feet)
        # Cells weigh as much as their area, not as the number of their points.
        apart = tree.sparse_distance_matrix(tree, nesting, output_type="coo_matrix")
        same = face[apart.row] == face[apart.col]
        weights = sparse.csr_array((apart.data[same], (apart.row[same], apart.col[same])), shape=apart.shape)
        weights.data = np.exp(-np.pi * (weights.data / (_ALPHA * nesting)) ** 2)
        weights = sparse.csr_array(sparse.diags_array(1 / np.asarray(weights.sum(axis=1)).ravel()) @ weights)
        filtered = feet + (weights @ averaged)[:, None] * normal
        return cls(filtered, weights, deviation, noise.shared(cell), f"Gaussian filter {1e3 * nesting:g} mm")

    def noise(self) -> Array:
        """Simulated noise (m, k) of the distances."""
        count = int(np.clip(_MOST_NOISE // len(self.points), _LEAST_DRAWS, _DRAWS))
        random = np.random.default_rng(0)
        drawn = random.standard_normal((len(self.deviation), count)) * self.deviation[:, None]
        drawn += self.shared @ random.standard_normal((self.shared.shape[1], count))
        return np.asarray((self.weights @ drawn).T)


def _zone(
    feature: Feature,
    motions: Array,
    datums: DatumSystem | None,
    nesting: float,
    *,
    is_offset: bool = False,
    axis: Array | None = None,
) -> Measured:
    """Least width of a zone about the surface.

    Parameters
    ----------
    motions
        (f, 6) motions that are free beside those that the datums leave, of about equal effect.
    is_offset
        Whether the zone may lie beside the nominal surface.
    axis
        Pose (4, 4) whose z axis cuts the feature into sections, each with a zone of its own; None: one zone.
    """
    moved, drawn = feature.placed.moved_points, None
    if datums is not None:
        moved, left, drawn = _datum_motions(datums)
        motions = np.concatenate([motions, left])
    surface = _Filtered.of(feature, nesting)
    start = Placed.of(feature, motions, is_offset, moved)
    simulated = surface.noise()
    sections = _sections(feature, surface.points, axis, nesting, moved)
    parts, widths = [], []
    for rows in sections:
        points = surface.points[rows]
        found = minimum_zone(least_squares(start, points), points)
        distance, jacobian = found.linearised(points)
        noise = simulated[:, rows]
        if drawn is not None:
            noise = noise + drawn[: len(noise)] @ found.by_motion(points)[1].T
        u, one = _range(jacobian), np.ones(len(rows))
        is_centred = np.abs(one - u @ (u.T @ one)).max() < _FREE
        widths.append(_width if is_centred else _twice_largest)
        parts.append((distance, distance - u @ (u.T @ distance), noise - noise @ u @ u.T))
    ends = np.cumsum([len(rows) for rows in sections])[:-1]

    def size(distances: Array) -> Array:
        """Width of the widest section, of distances (..., k)."""
        found = [width(own) for width, own in zip(widths, np.split(distances, ends, axis=-1), strict=True)]
        return np.asarray(np.max(found, axis=0))

    distance, rest, noise = (np.concatenate(each, axis=-1) for each in zip(*parts, strict=True))
    text = "minimum zone, " + surface.text + ("" if axis is None else f", {len(sections)} sections")
    return _corrected(size, distance, rest, noise, len(feature.points), text + _datum_text(datums))


def _corrected(
    size: Callable[[Array], Array], found: Array, rest: Array, noise: Array, points: int, method: str
) -> Measured:
    """Value `size` of distances (k,) without the mean effect of noise (m, k) on it.

    The effect is that on `rest` (k,), the distances without free motions, reduced by the power of the noise that they
    hold: where noise alone explains them, nothing remains.
    """
    powers, held = np.square(noise).mean(1), float(np.square(rest).mean())
    power = float(powers.mean()) + _SURE * float(powers.std())
    rest = rest * np.sqrt(max(0.0, 1 - power / max(held, 1e-300)))
    raw, draws = float(size(found)), size(rest + noise)
    return Measured(raw - float(draws.mean() - size(rest)), raw, float(draws.std()), 0.0, points, method)


def _width(values: Array) -> Array:
    return np.asarray(np.ptp(values, axis=-1))


def _twice_largest(values: Array) -> Array:
    return np.asarray(2 * np.abs(values).max(-1))


def _range(jacobian: Array) -> Array:
    """Orthogonal columns that span those of derivatives (k, p) by scaled motions, without motions of no effect."""
    u, values, _ = np.linalg.svd(jacobian, full_matrices=False)
    return np.asarray(u[:, values > UNFELT * len(jacobian) ** 0.5])


def _sections(
    feature: Feature, points: Array, axis: Array | None, nesting: float, moved: Array
) -> list[NDArray[np.intp]]:
    """Rows of the points (k, 3) of each section: slices across the axis, of a plane rings about it."""
    if axis is None:
        return [np.arange(len(points))]
    local = pose.transform_points(pose.inverse(axis) @ moved, points)
    along = np.hypot(local[:, 0], local[:, 1]) if feature.kind == "plane" else local[:, 2]
    count = np.clip(len(points) // _MEAN_IN_SECTION, 1, _SECTIONS)
    width = max(nesting, float(np.ptp(along)) / count, 1e-9)
    number = np.floor((along - along.min()) / width).astype(np.int64)
    count = np.bincount(number)
    found = [np.flatnonzero(number == one) for one in np.flatnonzero(count >= LEAST_POINTS)]
    if not found:
        raise FitError(f"'{feature.name}': no section has {LEAST_POINTS} points")
    return found


def _datum_motions(datums: DatumSystem) -> tuple[Array, Array, Array]:
    """Pose (4, 4) onto the datums, motions (f, 6) that they leave, and motions (m, 6) by simulated noise of them."""
    moved, left = datums.pose(datums.parameters)
    columns = []
    for number, feature in enumerate(datums.features):
        for column in feature.spread.T:
            shifted = list(datums.parameters)
            shifted[number] = shifted[number] + column
            away = datums.pose(shifted)[0] @ pose.inverse(moved)
            columns.append(np.concatenate([pose.log_rotation(away[:3, :3]), away[:3, 3]]))
    by_noise = np.array(columns).reshape(-1, 6)
    return moved, left, np.random.default_rng(1).standard_normal((_DRAWS, len(by_noise))) @ by_noise


def _datum_text(datums: DatumSystem | None) -> str:
    return "" if datums is None else f", datums {' | '.join(one.name for one in datums.features)} (least squares)"


def _size(feature: Feature, times: float, criterion: Criterion, nesting: float) -> Measured:
    """Diameter (`times` 2) or radius (1) by one of four criteria."""
    _require(feature, "a diameter or radius", "cylinder", "sphere")
    assert feature.nominal is not None
    nominal, points = times * feature.nominal.radius, len(feature.points)
    if criterion == "least squares":
        value = times * float(feature.fit.parameters[-1])
        random = times * float(np.linalg.norm(feature.spread[-1]))
        return Measured(value, value, random, nominal, points, criterion)
    sides, surface = _SIDES[criterion], _Filtered.of(feature, nesting)
    start = replace(feature.placed, is_offset=len(sides) > 1)
    found = minimum_zone(start, surface.points, sides, _SMALL)
    distance, jacobian = replace(found, offset=0.0).linearised(surface.points)

    def size(distances: Array) -> Array:
        """Size beyond the nominal one, of distances (..., k) from the nominal surface about the axis found."""
        ends = [distances.max(-1) if side > 0 else distances.min(-1) for side in sides]
        return np.asarray(times * np.mean(ends, axis=0))

    u, noise = _range(jacobian[:, : len(found.motions)]), surface.noise()
    rest, noise = distance - float(distance.mean()), noise - noise @ u @ u.T
    beyond = _corrected(size, distance, rest, noise, points, f"{criterion}, {surface.text}")
    return replace(beyond, value=nominal + beyond.value, raw=nominal + beyond.raw, nominal=nominal)


def _straightness(feature: Feature) -> Measured:
    """Diameter of a cylinder about the least-squares line through the centres of sections (ISO 17450, median line)."""
    placed = feature.placed
    across, height = feature.frame[:3, :2].T, feature.points @ feature.frame[:3, 2]
    section = replace(placed, motions=np.hstack([0 * across, across]))
    centres, noises, heights, simulated = [], [], [], _Filtered.of(feature, 0.0).noise()
    for rows in _sections(feature, feature.points, feature.frame, 0.0, placed.moved_points):
        distance, jacobian = section.linearised(feature.points[rows])
        inverse = np.linalg.pinv(jacobian)[:2]
        centres.append(inverse @ distance)
        noises.append(simulated[:, rows] @ inverse.T)
        heights.append(height[rows].mean())
    count = len(centres)
    if count < 3:
        raise FitError(f"'{feature.name}': {count} sections; straightness needs three")
    q = np.linalg.qr(np.stack([np.ones(count), np.array(heights) - np.mean(heights)], 1))[0]

    def size(at: Array) -> Array:
        """Twice the largest distance of centres, (..., 2 s): all x, then all y."""
        return np.asarray(2 * np.hypot(at[..., :count], at[..., count:]).max(-1))

    def away(at: Array) -> Array:
        """Distances (..., 2 s) of centres (..., s, 2) from their least-squares line."""
        left = at - q @ (q.T @ at)
        return np.concatenate([left[..., 0], left[..., 1]], axis=-1)

    found = away(np.array(centres))
    noise = away(np.stack(noises, axis=1))
    text = f"centres of {count} sections, least-squares line"
    return _corrected(size, found, found, noise, len(feature.points), text)


def _between(a: Feature, b: Feature, kind: str) -> Measured:
    """Distance or angle of two features, by the parameters of their fits."""
    of_two, has_centre = (_distance, ("sphere",)) if kind == "distance" else (_angle, ())
    pair = (a, b)
    for feature in pair:
        _require(feature, kind, "plane", "cylinder", "cone", *has_centre)
    nominal = of_two(pair, [np.concatenate([one.frame[:3, 3], one.frame[:3, 2]]) for one in pair])
    own, random = [one.fit.parameters for one in pair], np.random.default_rng(0)
    drawn = [
        parameters + random.standard_normal((_DRAWS, one.spread.shape[1])) @ one.spread.T
        for one, parameters in zip(pair, own, strict=True)
    ]
    draws = np.array([of_two(pair, [each[row] for each in drawn]) for row in range(_DRAWS)])
    value = of_two(pair, own)
    return Measured(value, value, float(draws.std()), nominal, len(a.points) + len(b.points), "least squares")


def _middle(feature: Feature, parameters: Array) -> Array:
    """Centre of a sphere, centroid of a plane, or point (3,) of an axis amid the feature."""
    point = parameters[:3]
    if feature.kind in ("plane", "sphere"):
        return point
    direction, axis = parameters[3:6], feature.frame[:3, 2]
    return np.asarray(point + ((feature.frame[:3, 3] - point) @ axis) / (direction @ axis) * direction)


def _distance(pair: Sequence[Feature], parameters: Sequence[Array]) -> float:
    """Distance of two features: from a plane along its normal, of axes across their mean direction."""
    (a, b), (p, q) = pair, parameters
    if b.kind == "plane" and a.kind != "plane":
        a, b, p, q = b, a, q, p
    between = _middle(b, q) - _middle(a, p)
    if a.kind == "plane":
        return abs(float(between @ p[3:6]))
    axes = [own[3:6] for feature, own in ((a, p), (b, q)) if feature.kind != "sphere"]
    if axes:
        mean = np.sum([axis * np.sign(axis @ axes[0]) for axis in axes], axis=0)
        mean /= np.linalg.norm(mean)
        between = between - (between @ mean) * mean
    return float(np.linalg.norm(between))


def _angle(_: Sequence[Feature], parameters: Sequence[Array]) -> float:
    """Angle of normals or axes, 0 to pi."""
    p, q = (own[3:6] for own in parameters)
    return float(np.arctan2(np.linalg.norm(np.cross(p, q)), p @ q))


def _location(features: Sequence[Feature], datums: DatumSystem, free: Array) -> Measured:
    """Twice the largest distance of an axis, a centre or a median plane from its nominal place, within the feature.

    Parameters
    ----------
    free
        (f, 6) motions that are free beside those that the datums leave: the shifts, of an orientation.
    """
    moved, left, drawn = _datum_motions(datums)
    places, axes = _places(features[0], is_median=len(features) > 1)
    to_places = np.stack([np.hstack([-pose.skew(at), np.eye(3)]) for at in places])
    by_motion = np.concatenate(np.einsum("ij,pjk->pik", axes, to_places))
    u = _range(by_motion @ np.concatenate([free, left]).T)

    def size(found: Array) -> Array:
        """Twice the largest of displacements (..., p c) of the places."""
        return np.asarray(2 * np.linalg.norm(found.reshape(*found.shape[:-1], len(places), -1), axis=-1).max(-1))

    def away(parameters: Sequence[Array]) -> Array:
        found = [
            _displacements(feature, own, moved, places, axes) for feature, own in zip(features, parameters, strict=True)
        ]
        return np.asarray(np.mean(found, axis=0))

    own = [feature.fit.parameters for feature in features]
    at, random, noise = away(own), np.random.default_rng(0), drawn @ by_motion.T
    for number, feature in enumerate(features):
        derivatives = [
            away([*own[:number], own[number] + column, *own[number + 1 :]]) - at for column in feature.spread.T
        ]
        noise = noise + random.standard_normal((_DRAWS, len(derivatives))) @ np.array(derivatives)
    at, noise = at - u @ (u.T @ at), noise - noise @ u @ u.T
    points = sum(len(feature.points) for feature in features)
    return _corrected(size, at, at, noise, points, "least squares" + _datum_text(datums))


def _places(feature: Feature, *, is_median: bool) -> tuple[Array, Array]:
    """Places (p, 3) at which displacements count, and the directions (c, 3) along which they are measured."""
    x, y, z = feature.frame[:3, :3].T
    origin, (a, b, c) = feature.frame[:3, 3], feature.half_extent
    if is_median:
        return np.array([origin + i * a * x + j * b * y for i in (-1, 1) for j in (-1, 1)]), z[None]
    if feature.kind == "sphere":
        return origin[None], np.array([x, y, z])
    return np.array([origin - c * z, origin + c * z]), np.array([x, y])


def _displacements(feature: Feature, parameters: Array, moved: Array, places: Array, axes: Array) -> Array:
    """Displacements (p c,) of a fitted element at places, along the axes, when the points are moved onto the datums."""
    point = pose.transform_points(moved, parameters[None, :3])[0]
    if feature.kind == "sphere":
        return np.asarray(axes @ (point - places[0]))
    direction, nominal = moved[:3, :3] @ parameters[3:6], feature.frame
    if feature.kind == "plane":  # along the normal of the first plane, from the nominal plane there
        normal = axes[0]
        height = ((point - places) @ direction) / (normal @ direction)
        return np.asarray(height - ((nominal[:3, 3] - places) @ nominal[:3, 2]) / (normal @ nominal[:3, 2]))
    along = nominal[:3, 2]
    there = point + ((places - point) @ along / (direction @ along))[:, None] * direction
    return np.asarray(((there - places) @ axes.T).ravel())
