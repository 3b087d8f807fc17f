"""Materials by region of a part, and the stripe displacement at a reflectance step."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import norm

from scancell import sensor as sensor_rt
from scancell.config.cell import PartDescription
from scancell.config.loading import load_setup
from scancell.config.material import Material
from scancell.config.sensor import sensor_json
from scancell.errors import CellError
from scancell.geometry.mesh import Mesh
from scancell.nominal.parts import Body, part_patches
from scancell.scanning.world import build_scene

Z = 0.12
QUIET = ["sensor.render.noise=false", "sensor.laser.sheet_sigma_mm=0.15", "sensor.laser.divergence_mrad=0"]


def plate(edge: float) -> Mesh:
    """A flat strip whose faces meet at x = `edge`."""
    x, y = (-0.05, edge, 0.05), (-0.05, 0.05)
    corners = np.array([[a, b, 0.0] for a in x for b in y])
    return Mesh(corners, np.array([[0, 1, 2], [1, 3, 2], [2, 3, 4], [3, 5, 4]], np.int64))


def stripe(edge: float, ratio: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Centroid row and total light per column of the first camera, with reflectances 0.6 and 0.6 `ratio`."""
    step = {"min_mm": (edge * 1e3, -100, -1), "material": {"model": "lambert", "reflectance": 0.6 * ratio}}
    description = PartDescription.model_validate({"reflectance": 0.6, "material_region": [step]})
    mesh = plate(edge)
    scene = build_scene([Body("part", "part", mesh, Material(0.6), part_patches(mesh, description))])
    sensor = sensor_rt.Sensor(json.dumps(sensor_json(load_setup(settings=QUIET).sensor, seed=0)))
    part = np.eye(4)
    part[2, 3] = Z
    exposures = sensor_rt.Exposures(np.eye(4)[None, None], part[None, None, None], np.array([5e-4]), np.array([1]))
    image = np.asarray(sensor_rt.expected_electrons(scene, sensor, exposures)[0, 0], float)[:, 300:980]
    light = image.sum(axis=0)
    return (image * np.arange(len(image))[:, None]).sum(axis=0) / light, light


@pytest.mark.parametrize(("offset", "ratio"), [(0.0, 0.25), (0.5, 0.25), (-0.8, 0.5), (0.3, 0.0)])
def test_reflectance_step_shifts_stripe_by_closed_form(offset: float, ratio: float) -> None:
    """Step 1:r at e from the line centre: -sigma (1 - r) phi(e/sigma) / (Phi(e/sigma) + r (1 - Phi(e/sigma)))."""
    sigma = 0.15e-3
    even, light = stripe(offset * sigma, 1.0)
    pulled, rest = stripe(offset * sigma, ratio)
    share = norm.cdf(offset) + ratio * norm.sf(offset)
    shift = -sigma * (1 - ratio) * norm.pdf(offset) / share
    np.testing.assert_allclose(rest / light, share, rtol=5e-3)
    (camera, *_) = sensor_rt.Sensor(json.dumps(sensor_json(load_setup(settings=QUIET).sensor, seed=0))).cameras
    rows = camera.project(np.array([[shift, 0, Z], [0, 0, Z]]))[:, 1]
    np.testing.assert_allclose(np.mean(pulled - even), rows[0] - rows[1], rtol=0.02)


def test_patches_by_box_and_by_file(tmp_path: Path) -> None:
    paint, rubber = {"preset": "painted_plastic"}, {"preset": "black_rubber"}
    regions = [{"material": paint, "max_mm": (0, 100, 100)}, {"material": rubber}]
    file = tmp_path / "faces.csv"
    file.write_text("0\n0\n0\n2\n")
    description = PartDescription.model_validate({"material_region": regions, "face_materials": str(file)})
    first, second = part_patches(plate(0.0), description)
    assert first.faces.tolist() == [0, 1]
    assert second.faces.tolist() == [3]
    assert second.material.reflectance < first.material.reflectance


@pytest.mark.parametrize(("text", "message"), [("0\n1\n", "2 numbers"), ("0\n0\n0\n7\n", "1 to 0"), ("a", "numbers")])
def test_mismatched_patch_files_are_rejected(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "faces.csv"
    file.write_text(text)
    with pytest.raises(CellError, match=message):
        part_patches(plate(0.0), PartDescription(face_materials=str(file)))
