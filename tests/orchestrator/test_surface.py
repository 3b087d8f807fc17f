"""Surface reconstruction of clouds with known surface."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from cells import cloud_of

from scancell.errors import FitError, MeshError
from scancell.geometry.mesh import load_mesh
from scancell.reconstruction.cloud import Cloud, reconstruct_surface, write_surface

RADIUS = 0.025


def cap(count: int, lowest: float) -> Cloud:
    """Points on a sphere above z = `lowest` of its radius, every tenth without a normal."""
    rng = np.random.default_rng(1)
    z, turn = rng.uniform(lowest, 1, count), rng.uniform(0, 2 * np.pi, count)
    normal = np.stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z], 1)
    points = RADIUS * normal
    normal[::10] = np.nan
    return cloud_of(points, normals=normal)


@pytest.mark.parametrize(("method", "error"), [("poisson", 30e-6), ("ball-pivoting", 40e-6)])
def test_surface_of_half_a_sphere_is_accurate_and_ends_with_the_points(method: str, error: float) -> None:
    surface = reconstruct_surface(cap(20_000, 0.0), method, 1e-3)  # type: ignore[arg-type]
    middles = surface.vertices[surface.faces].mean(1)
    away = np.abs(np.linalg.norm(middles, axis=1) - RADIUS)
    inner = middles[:, 2] > 2e-3
    assert np.quantile(away[inner], 0.99) < error
    assert surface.areas.sum() == pytest.approx(2 * np.pi * RADIUS**2, rel=0.1)
    assert not surface.is_closed
    outward = np.einsum("ni,ni->n", surface.normals, middles) > 0
    assert outward[surface.areas > 0].mean() > 0.99


def test_poisson_closes_a_whole_sphere() -> None:
    surface = reconstruct_surface(cap(40_000, -1.0), "poisson", 1e-3)
    assert surface.is_closed
    assert surface.areas.sum() == pytest.approx(4 * np.pi * RADIUS**2, rel=0.01)


@pytest.mark.parametrize("suffix", ["stl", "ply", "obj"])
def test_written_surface_is_a_part(tmp_path: Path, suffix: str) -> None:
    surface = reconstruct_surface(cap(5000, -1.0), "poisson", 2e-3)
    write_surface(surface, tmp_path / f"surface.{suffix}")
    part = load_mesh(tmp_path / f"surface.{suffix}")
    assert part.is_closed
    assert part.bounds == pytest.approx(surface.bounds, abs=1e-7)


def test_too_few_points_and_other_files_are_rejected(tmp_path: Path) -> None:
    with pytest.raises(FitError, match="at least 100"):
        reconstruct_surface(cap(50, 0.0))
    with pytest.raises(FitError, match="farther apart"):
        reconstruct_surface(cap(150, 0.0), "ball-pivoting", 1e-5)
    with pytest.raises(MeshError, match=r"surface\.txt"):
        write_surface(reconstruct_surface(cap(5000, -1.0), "poisson", 3e-3), tmp_path / "surface.txt")
