"""A cell in which a post beside the table forbids some of the poses along a spiral."""

from __future__ import annotations

from pathlib import Path

import trimesh

from scancell.config.loading import Setup, assets_dir, load_setup, with_path

PART = assets_dir() / "parts" / "sphere_on_foot.stl"
_SPIRAL = assets_dir() / "paths" / "spiral.toml"


def spiral_setup(folder: Path) -> Setup:
    """Ideal descriptions of the cell and the scan along the spiral; the mesh of the post is written to `folder`."""
    file = folder / "post.stl"
    trimesh.creation.box((20.0, 20.0, 300.0)).export(file)
    pose = "{ x_mm = 450.0, y_mm = 200.0, z_mm = 150.0 }"
    post = f'cell.obstacle=[{{ name = "post", mesh = "{file}", pose = {pose} }}]'
    return with_path(load_setup(ideal=True, settings=[post]), _SPIRAL)
