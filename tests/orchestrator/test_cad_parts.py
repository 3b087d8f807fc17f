"""Sample parts with names of faces and tolerances: the files of the repository, and variants with deviations."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import scancell
from bench.cad_variants import ASSETS, DEVIATIONS, write_variant
from scancell.geometry.cad import CadMesh, find_faces
from scancell.geometry.mesh import sample_surface
from scancell.geometry.shapes import PartSurface

pytest.importorskip("OCP")


def _part(file: Path) -> CadMesh:
    part = scancell.load_part(file)
    assert isinstance(part, CadMesh)
    return part


def _deviations(variant: CadMesh, nominal: CadMesh, label: str) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) on the face of a label of a variant, m, and their distances (n,) from the nominal part."""
    points, _ = sample_surface(variant, 40_000, 3)
    _, triangle = PartSurface(variant).distances(points)
    points = points[np.isin(variant.cad_face[triangle], find_faces(variant, [label]))]
    return points, PartSurface(nominal).distances(points)[0]


@pytest.mark.parametrize("name", DEVIATIONS)
def test_sample_part_is_what_the_script_writes(name: str, tmp_path: Path) -> None:
    file = ASSETS / "parts" / f"{name}.step"
    part = _part(file)
    assert file.stat().st_size < 300_000
    assert part.is_closed
    assert not part.warnings
    assert np.ptp(part.bounds, axis=0).max() <= 0.12
    assert part.bounds[0, 2] == pytest.approx(0.0, abs=1e-9)
    labels = [face.label for face in part.cad_faces]
    assert "" not in labels
    assert len(set(labels)) == len(labels)
    stated = [one for one in part.annotations if one.kind not in ("datum", "other")]
    letters = {one.name for one in part.annotations if one.kind == "datum"}
    assert len(stated) >= 3
    assert all(one.faces and one.value for one in stated)
    assert {letter for one in stated for letter in one.datums} <= letters
    # The bytes are those of one version of the kernel; the part is the same with any.
    anew = _part(write_variant(name, 0.0, tmp_path / "part.step"))
    assert anew.annotations == part.annotations
    assert [face.label for face in anew.cad_faces] == labels
    np.testing.assert_allclose(
        [face.radius for face in anew.cad_faces], [face.radius for face in part.cad_faces], atol=1e-9
    )


def test_variants_have_the_planted_deviations(tmp_path: Path) -> None:
    nominal, made = {}, {}
    for name in ("drilled_block", "bracket", "lobed_ring"):
        nominal[name] = _part(ASSETS / "parts" / f"{name}.step")
        made[name] = _part(write_variant(name, DEVIATIONS[name], tmp_path / f"{name}.step"))
        assert [face.label for face in made[name].cad_faces] == [face.label for face in nominal[name].cad_faces]
    bores = [find_faces(parts["drilled_block"], ["bore_b"])[0] for parts in (nominal, made)]
    axes = [
        parts["drilled_block"].cad_faces[number].part_from_face[:3, 3]
        for parts, number in zip((nominal, made), bores, strict=True)
    ]
    np.testing.assert_allclose((axes[1] - axes[0])[:2], [30e-6, 0.0], atol=1e-9)
    points, distance = _deviations(made["bracket"], nominal["bracket"], "wall")
    expected = (points[:, 2] - 10e-3) * np.tan(np.radians(0.02))
    inside = points[:, 2] > 11e-3
    np.testing.assert_allclose(distance[inside], expected[inside], atol=1e-8)
    points, distance = _deviations(made["lobed_ring"], nominal["lobed_ring"], "bore")
    lobes = -5e-6 * np.cos(3 * np.arctan2(points[:, 1], points[:, 0]))
    assert len(points) > 1000
    np.testing.assert_allclose(distance, lobes, atol=1.2e-6)  # chords of the free form
    assert np.ptp(distance) == pytest.approx(10e-6, abs=1.5e-6)
