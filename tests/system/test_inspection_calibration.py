"""Uncertainty of characteristics by the covariance of a calibration, against scans of cells with the same errors."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import scancell
from inspection_parts import cad_part
from scancell.arrays import Array
from scancell.config.inspection import InspectionDescription
from scancell.geometry import pose
from scancell.geometry.cad import CadMesh
from scancell.geometry.shapes import Box, PlacedShape, Ring
from scancell.inspection.inspection import Inspection

_STD = {"tool.x": 2e-5, "tool.ry": 2e-4}  # m, rad
_AS_BUILT = {"tool.x": ("tool.x_mm", 1e3), "tool.ry": ("tool.ry_deg", 180 / np.pi)}
_CORRELATION = np.array([[1.0, -0.6], [-0.6, 1.0]])
_SIZE = {"upper_mm": 0.1, "lower_mm": -0.1}


def _part() -> CadMesh:
    return cad_part(
        [
            PlacedShape("block", Box(0.05, 0.03, 0.02), pose.from_euler_xyz([-0.02, 0.0, 0.01], [0.0, 0.0, 0.2])),
            PlacedShape("ring", Ring(8e-3, 12e-3, 0.012), pose.translation([0.03, 0.012, 0.006])),
        ]
    )


def _description() -> InspectionDescription:
    listed: list[dict[str, Any]] = [
        {"name": "outside", "kind": "diameter", "faces": [9], **_SIZE},
        {"name": "step", "kind": "distance", "faces": [4], "to": [7], **_SIZE},
        {"name": "ring to end", "kind": "distance", "faces": [9], "to": [0], **_SIZE},
        {"name": "corner", "kind": "angle", "faces": [0], "to": [4], "upper_deg": 1.0, "lower_deg": -1.0},
        {"name": "place", "kind": "position", "faces": [9], "datums": ["A", "B", "C"], "tolerance_mm": 0.1},
    ]
    datums = [{"name": name, "faces": [face]} for name, face in (("A", 4), ("B", 0), ("C", 2))]
    return InspectionDescription.model_validate({"datum": datums, "characteristic": listed, "filter_mm": 0.0})


def _covariance() -> Array:
    std = np.array(list(_STD.values()))
    return np.asarray(_CORRELATION * np.outer(std, std))


def _values(found: Inspection) -> Array:
    return np.array([one.measured.raw if one.measured is not None else np.nan for one in found.decisions])


@pytest.fixture(scope="module")
def scanned(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Array]:
    """Run folder of the nominal cell, and the RMS errors of the values in cells with the errors of the calibration."""
    folder = tmp_path_factory.mktemp("calibrated")
    content = {"deviations": [{"name": name} for name in _STD], "covariance_si": _covariance().tolist()}
    (folder / "calibration.json").write_text(json.dumps(content))
    part, described = _part(), _description()
    squares = np.zeros(len(described.characteristic))
    with scancell.Scanner(ideal=True, settings={"scan.max_profiles": 60}) as scanner:
        run = scanner.scan(part, engine="geometric", normals=False, samples=False)
        run.save(folder / "run")
        plain = _values(scancell.inspect(run, part, described))
        # The errors of the cells are points whose covariance is exactly that of the calibration.
        for column in np.linalg.cholesky(_covariance()).T:
            for sign in (1, -1):
                named = zip(_STD, sign * column, strict=True)
                as_built = {_AS_BUILT[name][0]: _AS_BUILT[name][1] * float(value) for name, value in named}
                options = {"engine": "geometric", "normals": False, "samples": False, "plan": run.plan}
                moved = scanner.scan(part, as_built=as_built, **options)
                squares += (_values(scancell.inspect(moved, part, described)) - plain) ** 2 / 2
    return folder, np.sqrt(squares)


def test_uncertainty_by_a_calibration_is_that_of_cells_with_its_errors(scanned: tuple[Path, Array]) -> None:
    folder, simulated = scanned
    found = scancell.inspect(folder / "run", _part(), _description(), calibration=folder / "calibration.json")
    stated = np.array([one.calibration for one in found.decisions])
    for one, own, other in zip(found.decisions, stated, simulated, strict=True):
        print(f"{one.description.name:12} {1e6 * own:8.3f} stated {1e6 * other:8.3f} simulated (um, urad)")
    seen = np.isfinite(simulated)
    assert seen.sum() >= 4 and stated[seen] == pytest.approx(simulated[seen], rel=0.1, abs=2e-8)
    assert max(stated) > 5e-6
    row = found.decisions[0].row()
    assert row["uncertainty_um"] == pytest.approx(np.hypot(row["by_noise_um"], row["by_calibration_um"]))
    assert not any("noise alone" in warning for warning in found.warnings)


def test_correlations_of_a_calibration_count(scanned: tuple[Path, Array], tmp_path: Path) -> None:
    folder, _ = scanned
    found = []
    for sign in (1, -1):
        off = sign * np.array([[1, -1], [-1, 1]])
        content = {
            "deviations": [{"name": name} for name in _STD],
            "covariance_si": (_covariance() * np.where(np.eye(2) > 0, 1, off)).tolist(),
        }
        (tmp_path / "calibration.json").write_text(json.dumps(content))
        made = scancell.inspect(folder / "run", _part(), _description(), calibration=tmp_path)
        found.append([one.calibration for one in made.decisions])
    assert not np.allclose(*found, rtol=0.05, atol=1e-7)


@pytest.mark.parametrize(
    ("cloud", "calibration", "message"),
    [
        ("run/cloud.ply", "calibration.json", "run folder"),
        ("run", "missing", "missing: no such file"),
        ("run", "empty.json", "empty.json: covariance_si"),
    ],
)
def test_what_lacks_for_a_calibration_is_named(
    scanned: tuple[Path, Array], cloud: str, calibration: str, message: str
) -> None:
    folder, _ = scanned
    (folder / "empty.json").write_text("{}")
    with pytest.raises(scancell.DescriptionError, match=message):
        scancell.inspect(folder / cloud, _part(), _description(), calibration=folder / calibration)
