"""Study files for tests."""

from __future__ import annotations

from pathlib import Path

from scancell.config.loading import assets_dir

HEAD = f"""
name = "small"
part = "{assets_dir() / "parts" / "sphere_on_foot.stl"}"
set = ["scan.max_profiles=20", "scan.raster.enabled=false"]
coverage_samples = 0
"""
DESIGN = '[design]\nkind = "monte_carlo"\ntrials = 4\n'
OFFSET = '[[factor]]\npath = "as_built.tool.x_mm"\ndistribution = { kind = "normal", std = 0.05 }\n'
GLOSS = """
[[factor]]
path = "cell.part.reflectance"
mode = "relative"
distribution = { kind = "uniform", low = -0.2, high = 0.2 }
"""


def write_study(folder: Path, *parts: str) -> Path:
    path = folder / "small.toml"
    path.write_text("\n".join(parts))
    return path
