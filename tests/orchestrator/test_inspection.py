"""Characteristics of parts with planted errors against closed forms and independent programs, and their decisions."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import linprog, minimize
from scipy.stats import binom

from inspection_parts import Change, cad_part, cloud_of
from scancell.arrays import Array
from scancell.config.inspection import InspectionDescription
from scancell.errors import DescriptionError, OutputError
from scancell.geometry import pose
from scancell.geometry.cad import Annotation, CadFace
from scancell.geometry.shapes import Box, PlacedShape, Ring, Sphere
from scancell.inspection.annotations import annotated
from scancell.inspection.features import Feature
from scancell.inspection.inspection import Decision, Effect, inspect_part
from scancell.studies.capability import Capability, CapabilityRow, read_effects

_TILT = pose.from_euler_xyz([0.012, -0.007, 0.02], [0.2, -0.1, 0.3])
_RADIUS, _HEIGHT, _OUTER = 5e-3, 12e-3, 9e-3
_PART = cad_part(
    [
        PlacedShape("block", Box(0.08, 0.05, 0.02), _TILT),
        PlacedShape("ring", Ring(_RADIUS, _OUTER, _HEIGHT), _TILT @ pose.translation([0.06, 0.004, 0.003])),
        PlacedShape("ball", Sphere(0.006), _TILT @ pose.translation([-0.06, 0.001, 0.002])),
    ]
)
_X, _MINUS_X, _Y, _MINUS_Y, _TOP, _BOTTOM, _BORE, _RIM, _FOOT, _OUTSIDE, _BALL = range(11)
_DATUMS = [
    {"name": "A", "faces": [_TOP]},
    {"name": "B", "faces": [_X]},
    {"name": "C", "faces": [_Y]},
    {"name": "D", "faces": [_BORE]},
]
_ALL = [
    {"kind": "diameter", "faces": [_BORE]},
    {"kind": "diameter", "faces": [_BORE], "criterion": "maximum inscribed"},
    {"kind": "diameter", "faces": [_OUTSIDE], "criterion": "minimum circumscribed"},
    {"kind": "diameter", "faces": [_BORE], "criterion": "minimum zone"},
    {"kind": "radius", "faces": [_BALL]},
    {"kind": "distance", "faces": [_TOP], "to": [_BOTTOM]},
    {"kind": "distance", "faces": [_BORE], "to": [_X]},
    {"kind": "distance", "faces": [_BORE], "to": [_BALL]},
    {"kind": "angle", "faces": [_X], "to": [_Y]},
    {"kind": "flatness", "faces": [_TOP]},
    {"kind": "roundness", "faces": [_BORE]},
    {"kind": "roundness", "faces": [_BALL]},
    {"kind": "cylindricity", "faces": [_OUTSIDE]},
    {"kind": "straightness", "faces": [_BORE]},
    {"kind": "parallelism", "faces": [_BOTTOM], "datums": ["A"]},
    {"kind": "parallelism", "faces": [_BORE], "datums": ["B"]},
    {"kind": "perpendicularity", "faces": [_X], "datums": ["A"]},
    {"kind": "perpendicularity", "faces": [_BORE], "datums": ["A"]},
    {"kind": "angularity", "faces": [_X], "datums": ["A", "C"]},
    {"kind": "position", "faces": [_BORE], "datums": ["A", "B", "C"]},
    {"kind": "position", "faces": [_BALL], "datums": ["A", "B", "C"]},
    {"kind": "position", "faces": [_BOTTOM], "datums": ["A", "B", "C"]},
    {"kind": "coaxiality", "faces": [_OUTSIDE], "datums": ["D"]},
    {"kind": "symmetry", "faces": [_Y], "to": [_MINUS_Y], "datums": ["A", "D", "B"]},
    {"kind": "circular_run_out", "faces": [_OUTSIDE], "datums": ["D"]},
    {"kind": "circular_run_out", "faces": [_RIM], "datums": ["D"]},
    {"kind": "total_run_out", "faces": [_OUTSIDE], "datums": ["D"]},
    {"kind": "surface_profile", "faces": [_X, _MINUS_X, _Y], "datums": ["A", "B", "C"]},
    {"kind": "surface_profile", "faces": [_X, _Y, _BORE]},
]


def _described(*characteristics: dict[str, Any], **keys: Any) -> InspectionDescription:
    listed = []
    for number, one in enumerate(characteristics):
        limits: dict[str, Any] = {"tolerance_mm": 0.02}
        if one["kind"] in ("diameter", "radius", "distance"):
            limits = {"upper_mm": 0.01, "lower_mm": -0.01}
        elif one["kind"] == "angle":
            limits = {"upper_deg": 0.01, "lower_deg": -0.01}
        listed.append({"name": f"{number} {one['kind']}", **limits, **one})
    return InspectionDescription(
        **{"filter_mm": 0.0, "edge_mm": 0.3, **keys, "datum": _DATUMS, "characteristic": listed}
    )


def _inspected(points: Array, *characteristics: dict[str, Any], **keys: Any) -> list[Decision]:
    return list(inspect_part(_PART, points, _described(*characteristics, **keys), align="none").decisions)


def _error(decision: Decision) -> float:
    assert decision.measured is not None, decision.reason
    return decision.measured.raw - decision.measured.nominal


@pytest.mark.parametrize("filter_mm", [0.0, 1.6])
def test_perfect_part_has_no_error_of_any_kind(filter_mm: float) -> None:
    moved = pose.from_euler_xyz([3e-5, -5e-5, 8e-5], [1e-3, -5e-4, 8e-4])
    points = pose.transform_points(moved, cloud_of(_PART, 9000, 1))
    for decision in _inspected(points, *_ALL, filter_mm=filter_mm):
        assert abs(_error(decision)) < 5e-9, decision.description
        assert decision.verdict == "conforms"


def _shift(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Change:
    return lambda local, _: local + np.array([x, y, z])


def _grow(size: float) -> Change:
    return lambda local, normal: local + size * normal


def _lobes(amplitude: float, count: int) -> Change:
    def changed(local: Array, normal: Array) -> Array:
        return np.asarray(local + amplitude * np.cos(count * np.arctan2(local[:, 1], local[:, 0]))[:, None] * normal)

    return changed


def _turn(rx: float = 0.0, ry: float = 0.0) -> Change:
    turned = pose.from_euler_xyz([0.0, 0.0, 0.0], [rx, ry, 0.0])
    return lambda local, _: pose.transform_points(turned, local)


_CLOSED: list[tuple[dict[str, Any], dict[int, Change], float, float]] = [
    ({"kind": "diameter", "faces": [_BORE]}, {_BORE: _grow(30e-6)}, 60e-6, 1e-9),
    ({"kind": "radius", "faces": [_BALL]}, {_BALL: _grow(-20e-6)}, -20e-6, 1e-9),
    (
        {"kind": "diameter", "faces": [_OUTSIDE], "criterion": "minimum circumscribed"},
        {_OUTSIDE: _lobes(10e-6, 3)},
        20e-6,
        0.1e-6,
    ),
    (
        {"kind": "diameter", "faces": [_BORE], "criterion": "maximum inscribed"},
        {_BORE: _lobes(10e-6, 3)},
        -20e-6,
        0.1e-6,
    ),
    ({"kind": "diameter", "faces": [_BORE], "criterion": "minimum zone"}, {_BORE: _lobes(10e-6, 3)}, 0.0, 0.1e-6),
    ({"kind": "distance", "faces": [_TOP], "to": [_BOTTOM]}, {_BOTTOM: _shift(z=15e-6)}, -15e-6, 1e-9),
    ({"kind": "distance", "faces": [_BORE], "to": [_X]}, {_BORE: _shift(x=25e-6)}, 25e-6, 1e-9),
    ({"kind": "angle", "faces": [_X], "to": [_Y]}, {_Y: _turn(ry=1e-4)}, 0.0, 1e-8),
    ({"kind": "roundness", "faces": [_BORE]}, {_BORE: _lobes(10e-6, 3)}, 20e-6, 0.4e-6),
    ({"kind": "cylindricity", "faces": [_BORE]}, {_BORE: _lobes(10e-6, 5)}, 20e-6, 0.1e-6),
    ({"kind": "perpendicularity", "faces": [_BORE], "datums": ["A"]}, {_BORE: _turn(rx=3e-4)}, 3e-4 * _HEIGHT, 5e-9),
    ({"kind": "parallelism", "faces": [_BORE], "datums": ["B"]}, {_BORE: _turn(ry=3e-4)}, 3e-4 * _HEIGHT, 5e-9),
    ({"kind": "parallelism", "faces": [_BORE], "datums": ["B"]}, {_BORE: _turn(rx=3e-4)}, 0.0, 5e-9),
    ({"kind": "position", "faces": [_BORE], "datums": ["A", "B", "C"]}, {_BORE: _shift(12e-6, 9e-6)}, 30e-6, 1e-9),
    (
        {"kind": "position", "faces": [_BALL], "datums": ["A", "B", "C"]},
        {_BALL: _shift(12e-6, 9e-6, 20e-6)},
        50e-6,
        1e-9,
    ),
    ({"kind": "position", "faces": [_BOTTOM], "datums": ["A", "B", "C"]}, {_BOTTOM: _shift(z=-7e-6)}, 14e-6, 1e-9),
    ({"kind": "coaxiality", "faces": [_OUTSIDE], "datums": ["D"]}, {_OUTSIDE: _shift(3e-6, 4e-6)}, 10e-6, 1e-9),
    ({"kind": "circular_run_out", "faces": [_OUTSIDE], "datums": ["D"]}, {_OUTSIDE: _shift(3e-6, 4e-6)}, 10e-6, 0.4e-6),
    ({"kind": "total_run_out", "faces": [_OUTSIDE], "datums": ["D"]}, {_OUTSIDE: _shift(3e-6, 4e-6)}, 10e-6, 0.1e-6),
    (
        {"kind": "symmetry", "faces": [_Y], "to": [_MINUS_Y], "datums": ["A", "D", "B"]},
        {_Y: _shift(z=8e-6), _MINUS_Y: _shift(z=8e-6)},
        16e-6,
        1e-7,
    ),
    (
        {"kind": "surface_profile", "faces": [_X, _MINUS_X], "datums": ["A", "B", "C"]},
        {_MINUS_X: _shift(z=6e-6)},
        12e-6,
        1e-9,
    ),
    ({"kind": "surface_profile", "faces": [_X]}, {_X: _shift(z=6e-6)}, 0.0, 1e-9),
]


@pytest.mark.parametrize(("one", "changes", "expected", "within"), _CLOSED)
def test_planted_errors_are_found(
    one: dict[str, Any], changes: dict[int, Change], expected: float, within: float
) -> None:
    decision = _inspected(cloud_of(_PART, 12_000, 2, changes=changes), one)[0]
    assert _error(decision) == pytest.approx(expected, abs=within)


def _bumpy(local: Array, normal: Array) -> Array:
    x, y = local[:, 0] / 0.04, local[:, 1] / 0.025
    return np.asarray(local + 1e-6 * (9 * x**2 - 5 * x * y + 4 * np.sin(5 * y))[:, None] * normal)


def _on_face(points: Array, face: int) -> Array:
    """Points of a box's face in its frame, without those near its edges."""
    frame = _PART.cad_faces[face].part_from_face
    local = pose.transform_points(pose.inverse(frame), points)
    corners = pose.transform_points(pose.inverse(frame), _PART.vertices[np.unique(_PART.faces[_PART.cad_face == face])])
    inside = (np.abs(local[:, :2]) < np.abs(corners[:, :2]).max(0) - 0.3e-3).all(1)
    return local[inside & (np.abs(local[:, 2]) < 0.2e-3)]


def test_flatness_is_that_of_a_linear_program() -> None:
    points = cloud_of(_PART, 9000, 3, changes={_TOP: _bumpy})
    local = _on_face(points, _TOP)
    # Least t with |z - a x - b y - c| <= t: vertical distances differ from perpendicular ones by the cosine of 1e-4.
    columns = np.column_stack([local[:, 0], local[:, 1], np.ones(len(local))])
    matrix = np.block([[columns, -np.ones((len(local), 1))], [-columns, -np.ones((len(local), 1))]])
    scaled = 1e6 * local[:, 2]
    solved = linprog([0, 0, 0, 1], matrix, np.concatenate([scaled, -scaled]), bounds=[(None, None)] * 3 + [(0, None)])
    found = _inspected(points, {"kind": "flatness", "faces": [_TOP]})[0]
    assert 1e6 * _error(found) == pytest.approx(2 * solved.x[3], abs=1e-3)


@pytest.mark.parametrize("kind", ["cylindricity", "minimum circumscribed", "maximum inscribed"])
def test_cylinders_are_those_of_a_general_minimax_program(kind: str) -> None:
    def changed(local: Array, normal: Array) -> Array:
        angle, height = np.arctan2(local[:, 1], local[:, 0]), local[:, 2] / _HEIGHT
        away = 6 * np.cos(2 * angle) + 4 * np.cos(3 * angle + 4 * height) + 7 * height**2
        return np.asarray(local + 1e-6 * away[:, None] * normal)

    points = cloud_of(_PART, 7000, 4, changes={_OUTSIDE: changed})
    frame = _PART.cad_faces[_OUTSIDE].part_from_face
    local = pose.transform_points(pose.inverse(frame), points)
    radial = np.hypot(local[:, 0], local[:, 1])
    own = local[(np.abs(radial - _OUTER) < 0.1e-3) & (np.abs(local[:, 2]) < _HEIGHT / 2 - 0.3e-3)]

    def radii(axis: Array) -> Array:
        direction = np.array([1e-3 * axis[2], 1e-3 * axis[3], 1.0])
        direction /= np.linalg.norm(direction)
        away = own - 1e-3 * np.array([axis[0], axis[1], 0.0])
        return np.asarray(1e6 * (np.linalg.norm(away - (away @ direction)[:, None] * direction, axis=1) - _OUTER))

    # Variables: axis (4), largest and least radius; SLSQP meets the constraints of all points.
    goals = {"cylindricity": [1, -1], "minimum circumscribed": [1, 0], "maximum inscribed": [0, -1]}
    goal = np.array(goals[kind], float)
    start = radii(np.zeros(4))
    solved = minimize(
        lambda v: goal @ v[4:],
        np.concatenate([np.zeros(4), [start.max(), start.min()]]),
        constraints={"type": "ineq", "fun": lambda v: np.concatenate([v[4] - radii(v[:4]), radii(v[:4]) - v[5]])},
        method="SLSQP",
        options={"ftol": 1e-7, "maxiter": 200},
    )
    one = {"kind": "cylindricity"} if kind == "cylindricity" else {"kind": "diameter", "criterion": kind}
    found = 1e6 * _error(_inspected(points, {**one, "faces": [_OUTSIDE]})[0])
    expected = {
        "cylindricity": solved.fun,
        "minimum circumscribed": 2 * solved.fun,
        "maximum inscribed": -2 * solved.fun,
    }
    assert found == pytest.approx(expected[kind], abs=0.02)


def test_parallelism_is_the_extent_along_the_normal_of_the_datum() -> None:
    points = cloud_of(_PART, 9000, 5, changes={_BOTTOM: _bumpy})
    local = _on_face(points, _BOTTOM)
    found = _inspected(points, {"kind": "parallelism", "faces": [_BOTTOM], "datums": ["A"]})[0]
    assert _error(found) == pytest.approx(float(np.ptp(local[:, 2])), abs=1e-9)


def test_straightness_is_that_of_a_bent_axis() -> None:
    def bent(local: Array, _: Array) -> Array:
        return np.asarray(local + 20e-6 * (local[:, 2:] / _HEIGHT) ** 2 * [1.0, 0.0, 0.0])

    found = _inspected(cloud_of(_PART, 40_000, 6, changes={_BORE: bent}), {"kind": "straightness", "faces": [_BORE]})[0]
    # Sections between 0.3 mm from either end; their least-squares line is the mean of the parabola.
    half = (_HEIGHT / 2 - 0.3e-3) / _HEIGHT
    assert _error(found) == pytest.approx(2 * 20e-6 * half**2 * 2 / 3, rel=0.15)


def test_datums_take_up_what_a_part_is_moved_by() -> None:
    away = pose.from_euler_xyz([50e-6, -40e-6, 60e-6], [1e-4, -2e-4, 1.5e-4])
    changes = {_BORE: _shift(12e-6, 9e-6), _BOTTOM: _bumpy}
    points = cloud_of(_PART, 9000, 7, changes=changes)
    chosen = [one for one in _ALL if one.get("datums") or one["kind"] == "distance"]
    still = _inspected(points, *chosen, reach_mm=1.0)
    moved = _inspected(pose.transform_points(away, points), *chosen, reach_mm=1.0)
    # Points near edges change their face with the motion, so that the two hold different points.
    for a, b in zip(still, moved, strict=True):
        assert _error(a) == pytest.approx(_error(b), abs=1.5e-6), a.description


def test_stated_uncertainties_are_the_spread_of_repeated_measurements() -> None:
    chosen = [
        _ALL[0],
        _ALL[4],
        _ALL[5],
        _ALL[6],
        _ALL[8],
        {"kind": "position", "faces": [_BORE], "datums": ["A", "B", "C"]},
    ]
    changes = {_BORE: _shift(12e-6, 9e-6)}
    truth = [0.0, 0.0, 0.0, None, 0.0, 30e-6]
    scores = []
    for seed in range(30):
        points = cloud_of(_PART, 9000, 100 + seed, 3e-6, changes)
        for decision, true in zip(_inspected(points, *chosen), truth, strict=True):
            m = decision.measured
            assert m is not None
            expected = m.nominal + (true if true is not None else 12e-6)
            scores.append((m.value - expected) / m.random)
    spread = np.reshape(scores, (30, -1)).std(0)
    # 99.9 % bounds of the spread of 30 values.
    assert ((spread > 0.6) & (spread < 1.45)).all(), spread
    assert np.mean(np.abs(scores) < 1.96) > 0.88


@pytest.mark.parametrize("common", [0.0, 3e-6])
def test_few_profiles_state_what_their_points_have_in_common(common: float) -> None:
    """Intervals of the place of a bore keep their share where the fit follows much of the noise of few profiles."""
    runs, profiles, each, inside = 160, 6, 25, 0
    for seed in range(runs):
        random = np.random.default_rng(seed)
        angle = (random.uniform(0, 2 * np.pi, profiles)[:, None] + random.uniform(-0.4, 0.4, (profiles, each))).ravel()
        profile = np.repeat(np.arange(profiles), each)
        radius = (
            _RADIUS + 1e-6 * random.standard_normal(len(angle)) + common * random.standard_normal(profiles)[profile]
        )
        local = [radius * np.cos(angle), radius * np.sin(angle), random.uniform(-0.4, 0.4, len(angle)) * _HEIGHT]
        points = pose.transform_points(_PART.cad_faces[_BORE].part_from_face, np.stack(local, 1))
        alone = replace(_PART, faces=_PART.faces[_PART.cad_face == _BORE], cad_face=np.full(2, _BORE))
        face = np.full(len(points), _BORE)
        bore = Feature("bore", (_BORE,), _PART.cad_faces[_BORE], points, profile, face, alone)
        across = _PART.cad_faces[_BORE].part_from_face[:3, 0]
        away = across @ (bore.fit.parameters[:3] - bore.frame[:3, 3])
        inside += abs(away) < 1.96 * np.linalg.norm(across @ bore.spread[:3])
    assert binom.cdf(inside, runs, 0.94) > 1e-3


def test_noise_is_no_form() -> None:
    forms = [{"kind": kind, "faces": [face]} for kind, face in (("flatness", _TOP), ("cylindricity", _OUTSIDE))]
    found = [
        (decision.measured.raw, decision.measured.value, decision.measured.random)
        for seed in range(6)
        for decision in _inspected(cloud_of(_PART, 9000, 200 + seed, 3e-6), *forms)
        if decision.measured is not None
    ]
    raw, value, random = np.mean(found, axis=0)
    assert raw > 15e-6 and abs(value) < 0.2 * raw and random < 0.2 * raw


def test_noise_hides_little_of_a_form() -> None:
    found = []
    for seed in range(6):
        points = cloud_of(_PART, 20_000, 300 + seed, 2e-6, {_OUTSIDE: _lobes(20e-6, 3)})
        decision = _inspected(points, {"kind": "cylindricity", "faces": [_OUTSIDE]}, filter_mm=2.5)[0]
        assert decision.measured is not None
        found.append((decision.measured.raw, decision.measured.value))
    raw, value = np.mean(found, axis=0) - 40e-6
    # What remains is in favour of nonconformance.
    assert 0 < value < 0.6 * raw


@pytest.mark.parametrize(
    ("grown", "effect", "verdict"),
    [
        (0.0, Effect(), "conforms"),
        (9e-6, Effect(), "does not conform"),
        (4.5e-6, Effect(deviation=2e-6), "cannot be decided"),
        (5.5e-6, Effect(deviation=2e-6), "cannot be decided"),
        (4.5e-6, Effect(bias=9e-6, deviation=1e-9), "conforms"),
        (0.0, Effect(deviation=50e-6), "cannot be decided"),
        (0.0, Effect(deviation=500e-6), "cannot be decided"),
    ],
)
def test_verdicts_keep_a_guard_band(grown: float, effect: Effect, verdict: str) -> None:
    description = _described({"kind": "diameter", "faces": [_BORE], "name": "bore"})
    points = cloud_of(_PART, 9000, 8, 0.2e-6, {_BORE: _grow(grown)})
    decided = inspect_part(_PART, points, description, align="none", effects={"bore": effect}).decisions[0]
    assert decided.verdict == verdict
    simple = inspect_part(
        _PART, points, description.replace(decision="simple"), align="none", effects={"bore": effect}
    ).decisions[0]
    assert simple.verdict == ("conforms" if 2 * grown - effect.bias < 10e-6 else "does not conform")


@pytest.mark.parametrize("effect", [Effect(bias=60e-6, deviation=1e-6), Effect(deviation=60e-6)])
def test_mean_error_of_a_zone_hides_no_deviation(effect: Effect) -> None:
    """A wall of 20 µm out of square, in a cell whose errors widen the zone of a perfect one to 60 µm."""
    wall = {"kind": "perpendicularity", "faces": [_X], "datums": ["A"], "tolerance_mm": 0.01, "name": "w"}
    points, description = cloud_of(_PART, 9000, 8, 0.2e-6, {_X: _turn(1e-3, 1e-3)}), _described(wall)
    decided = inspect_part(_PART, points, description, align="none", effects={"w": effect}).decisions[0]
    assert decided.verdict == "cannot be decided"
    assert decided.interval[1] > 20e-6 and decided.value > 15e-6


def test_sizes_are_those_at_the_reference_temperature() -> None:
    points = cloud_of(_PART, 9000, 9) * (1 + 11.5e-6 * 10)
    warm = {"part_c": 30.0, "part_uncertainty_k": 0.5}
    found = _inspected(points, {"kind": "distance", "faces": [_X], "to": [_MINUS_X]}, temperature=warm)[0]
    assert abs(_error(found)) < 1e-9
    assert found.temperature == pytest.approx(0.08 * 11.5e-6 * 0.5, rel=1e-3)


def test_what_cannot_be_evaluated_is_listed_with_its_reason() -> None:
    points = cloud_of(_PART, 9000, 10)
    bottom = _on_face(points, _BOTTOM)[:, 2].size
    assert bottom > 12
    frame = pose.inverse(_PART.cad_faces[_BOTTOM].part_from_face)
    seen = points[np.abs(pose.transform_points(frame, points)[:, 2]) > 1e-4]
    found = _inspected(
        seen,
        {"kind": "flatness", "faces": [_BOTTOM]},
        {"kind": "flatness", "faces": [_BORE]},
        {"kind": "coaxiality", "faces": [_BALL], "datums": ["D"]},
        {"kind": "circular_run_out", "faces": [_RIM], "datums": ["A"]},
        {"kind": "diameter", "faces": [_BORE, _OUTSIDE]},
        {"kind": "flatness", "faces": [_TOP]},
    )
    assert [one.verdict for one in found] == ["not evaluated"] * 5 + ["conforms"]
    expected = ["0 points", "needs a plane", "needs a cylinder or cone", "first datum", "cylinder or sphere"]
    for decision, words in zip(found, expected, strict=False):
        assert words in decision.reason, decision.reason
        assert decision.row()["verdict"] == "not evaluated"


@pytest.mark.parametrize(
    ("one", "words"),
    [
        ({"kind": "flatness", "faces": [99]}, r"characteristic\[1\].faces.*no face '99'"),
        ({"kind": "flatness", "faces": ["bore"]}, "no face 'bore'"),
        ({"kind": "flatness", "faces": []}, "faces"),
        ({"kind": "flatness", "faces": [1], "datums": ["A"]}, "flatness has no datums"),
        ({"kind": "flatness", "faces": [1], "upper_mm": 1.0}, "flatness has no upper_mm"),
        ({"kind": "position", "faces": [1]}, "position needs datums"),
        (
            {"kind": "position", "faces": [1], "datums": ["Z"]},
            r"characteristic\[1\].datums = 'Z': expected one of the datums: A, B, C, D",
        ),
        (
            {"kind": "distance", "faces": [1], "to": [1], "upper_mm": 1.0},
            r"characteristic\[1\].to = 1: .*another feature",
        ),
        ({"kind": "position", "faces": [1], "datums": ["A", "A"]}, "each once"),
        ({"kind": "distance", "faces": [1]}, "needs the faces of a second feature"),
        ({"kind": "diameter", "faces": [6], "tolerance_mm": 1.0}, "diameter has no tolerance_mm"),
        ({"kind": "diameter", "faces": [6], "upper_mm": -1.0, "lower_mm": 1.0}, "must be below upper_mm"),
        ({"kind": "flatness", "faces": [1], "tolerance_mm": 0.0}, "tolerance_mm"),
        ({"kind": "widget", "faces": [1]}, "kind"),
        ({"kind": "flatness", "faces": [4], "criterion": "minimum zone"}, "has no criterion"),
    ],
)
def test_wrong_descriptions_are_refused(one: dict[str, Any], words: str) -> None:
    with pytest.raises(DescriptionError, match=words):
        _inspected(cloud_of(_PART, 2000, 1), one)


def test_names_of_characteristics_differ() -> None:
    with pytest.raises(DescriptionError, match="'flat' is given twice"):
        _described(
            {"kind": "flatness", "faces": [1], "name": "flat"}, {"kind": "flatness", "faces": [2], "name": "flat"}
        )


def test_report_names_every_verdict(tmp_path: Path) -> None:
    description = _described(
        {"kind": "diameter", "faces": [_BORE], "name": "bore <1>"},
        {"kind": "flatness", "faces": [_BORE], "name": "odd"},
    )
    inspection = inspect_part(_PART, cloud_of(_PART, 9000, 11, 1e-6), description, align="none")
    inspection.save(tmp_path)
    page = (tmp_path / "inspection.html").read_text()
    assert "bore &lt;1&gt;" in page and "not evaluated" in page and page.count("data:image/png") == 3
    assert "http" not in page.replace("http-equiv", "")
    assert "bore <1>" in inspection.summary() and inspection.counts == {"not evaluated": 1, "conforms": 1}
    assert (tmp_path / "inspection.csv").read_text().count("\n") == 3


def _annotated(*annotations: Annotation) -> tuple[InspectionDescription | None, list[str]]:
    return annotated(replace(_PART, annotations=annotations))


def test_annotations_become_characteristics_one_for_each_surface() -> None:
    described, left = _annotated(
        Annotation("datum", "A", faces=(_TOP,)),
        Annotation("datum", "B", faces=(_X,)),
        Annotation("diameter", "bores", 0.01, -1e-5, 2e-5, (_BORE, _OUTSIDE)),
        Annotation("size", "height", 0.02, -1e-5, 1e-5, (_TOP, _BOTTOM)),
        Annotation("angle", "angle", np.pi / 2, -1e-3, 1e-3, (_X,), (_Y,)),
        Annotation("run_out", "run_out", 1e-5, faces=(_TOP,), datums=("A",)),
        Annotation("surface_profile", "all", 1e-4, faces=(_X, _Y), datums=("A",), modifiers=("all_around",)),
    )
    assert described is not None and not left
    assert [datum.name for datum in described.datum] == ["A"]
    rows = [(one.name, one.kind, one.faces, one.to) for one in described.characteristic]
    assert rows == [
        ("bores 1", "diameter", (_BORE,), ()),
        ("bores 2", "diameter", (_OUTSIDE,), ()),
        ("height", "distance", (_TOP,), (_BOTTOM,)),
        ("angle", "angle", (_X,), (_Y,)),
        ("run_out", "circular_run_out", (_TOP,), ()),
        ("all", "surface_profile", (_X, _Y), ()),
    ]
    bore, angle, profile = described.characteristic[0], described.characteristic[3], described.characteristic[5]
    assert (bore.nominal_mm, bore.lower_mm, bore.upper_mm) == (10.0, -0.01, 0.02)
    assert angle.upper_deg == pytest.approx(np.degrees(1e-3)) and profile.tolerance_mm == 0.1


@pytest.mark.parametrize(
    ("one", "reason"),
    [
        (Annotation("position", "hole", 1e-4, faces=(_BORE,), datums=("Z",)), "datum Z"),
        (Annotation("position", "hole", 1e-4, faces=(_BORE,), modifiers=("maximum_material_requirement",)), "maximum"),
        (Annotation("flatness", "flat", 1e-4), "no faces"),
        (Annotation("flatness", "flat", None, faces=(_TOP,)), "without width"),
        (Annotation("diameter", "basic", 0.01, None, None, (_BORE,)), "without tolerance"),
        (Annotation("diameter", "basic", 0.01, -1e-5, None, (_BORE,), modifiers=("theoretical",)), "without tolerance"),
        (Annotation("line_profile", "line", 1e-4, faces=(_TOP,)), "not evaluated"),
        (Annotation("other", "note", faces=(_TOP,)), "not evaluated"),
        (Annotation("size", "slot", 0.02, -1e-5, None, (_TOP,)), "neither cylinders nor two planes"),
        (Annotation("distance", "depth", 0.02, -1e-5, None, (_TOP,)), "two are needed"),
        (Annotation("datum", "A"), "no faces"),
    ],
)
def test_annotations_that_are_not_inspected_are_named(one: Annotation, reason: str) -> None:
    described, left = _annotated(one)
    assert described is None and len(left) == 1 and reason in left[0] and one.name in left[0]


def test_capability_is_read_from_its_file(tmp_path: Path) -> None:
    row = CapabilityRow("bore", "diameter", np.array([1e-6, 3e-6, 2e-6]), np.full(3, 0.5e-6), 20e-6, "")
    capability = Capability("part", (row,), 3, ("as_built.tool.x_mm",), 10.0)
    capability.save(tmp_path)
    effect = read_effects(tmp_path / "capability.json")["bore"]
    assert effect == capability.effects["bore"]
    assert effect.bias == pytest.approx(2e-6)
    of_three = 4.3027 / 1.96 * np.sqrt(4 / 3)  # Student's t, and the uncertainty of the mean
    assert effect.deviation == pytest.approx(of_three * np.sqrt(1 - 0.25) * 1e-6, rel=1e-4)
    assert row.share == pytest.approx(0.1) and row.answer == "can be decided"
    (tmp_path / "other.json").write_text('{"characteristics": [{"name": "bore"}], "format_version": 1}')
    with pytest.raises(DescriptionError, match=r"other.json.*capability"):
        read_effects(tmp_path / "other.json")
    (tmp_path / "run.json").write_text('{"format_version": 1}')
    with pytest.raises(DescriptionError, match=r"run.json.*capability"):
        read_effects(tmp_path / "run.json")
    (tmp_path / "newer.json").write_text('{"characteristics": [], "format_version": 99}')
    with pytest.raises(DescriptionError, match="99"):
        read_effects(tmp_path / "newer.json")


def test_capability_of_other_characteristics_is_said() -> None:
    described = _described({"kind": "flatness", "faces": [_TOP]}, {"kind": "flatness", "faces": [_X]})
    effects = {described.characteristic[0].name: Effect(), "other": Effect()}
    found = inspect_part(_PART, cloud_of(_PART, 2000, 1), described, align="none", effects=effects)
    assert "not inspected: other" in found.warnings[0]
    assert found.warnings[1].endswith(f"no capability: {described.characteristic[1].name}")


def test_report_that_fails_leaves_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fault(*_: Any, **__: Any) -> None:
        raise OutputError("No space left on device")

    found = inspect_part(_PART, cloud_of(_PART, 2000, 1), _described({"kind": "flatness", "faces": [_TOP]}))
    monkeypatch.setattr("scancell.inspection.report.write_filled", fault)
    with pytest.raises(OutputError, match="No space"):
        found.save(tmp_path / "results")
    assert not list(tmp_path.iterdir())


def test_datum_and_feature_without_area_are_not_evaluated() -> None:
    """Faces of zero area, as the kernel reads them, have no triangles and no points."""
    empty = len(_PART.cad_faces)
    part = replace(_PART, cad_faces=(*_PART.cad_faces, CadFace("empty", np.eye(4))))
    described = _described({"kind": "surface_profile", "faces": [empty]}, {"kind": "flatness", "faces": [_TOP]})
    found = inspect_part(part, cloud_of(_PART, 2000, 1), described, align="none")
    assert [one.verdict for one in found.decisions] == ["not evaluated", "conforms"]
    assert "0 points" in found.decisions[0].reason
