"""Share of unknown bodies that a survey leaves unblocked: `PYTHONPATH=tests python -m bench.survey [trials [pitch]]`.

Bodies of random kind, size and place stand in the surveyed cylinder of the default cell; planning knows none of them.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
import trimesh

from scancell.config.loading import assets_dir, load_setup
from scancell.scanner import Scanner
from scancell.scanning.survey import SurveyResult

PART = assets_dir() / "parts" / "step_block.stl"
TABLE_MM = np.array([450.0, 0.0, 100.0])  # of the default cell
KINDS = ("rod of 3 mm", "rod of 6 mm", "post", "plate of 3 mm", "stick of 5 mm")
SAMPLES = 40_000


def random_body(kind: str, rng: np.random.Generator) -> trimesh.Trimesh:
    """A body beside the part, above the plane of the table, mm in the world."""
    radius, azimuth = rng.uniform(75.0, 165.0), rng.uniform(-np.pi, np.pi)
    place = TABLE_MM + radius * np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    while True:
        turn = np.eye(4)
        if kind.startswith("rod"):
            thick = float(kind.split()[2])
            size = np.array([thick, thick, rng.uniform(40.0, 180.0)])
            height = size[2] / 2 + 0.5
        elif kind == "post":
            size = rng.uniform([5.0, 5.0, 10.0], [40.0, 40.0, 180.0])
            turn = trimesh.transformations.rotation_matrix(rng.uniform(0.0, np.pi), [0.0, 0.0, 1.0])
            height = size[2] / 2 + 0.5
        else:
            plate = kind.startswith("plate")
            size = rng.uniform([20.0, 20.0, 3.0], [60.0, 60.0, 3.0]) if plate else rng.uniform([5, 5, 30], [5, 5, 80])
            turn = trimesh.transformations.random_rotation_matrix(rng.random(3))
            height = rng.uniform(30.0, 170.0)
        body = trimesh.creation.box(size, turn)
        body.apply_translation(place + np.array([0.0, 0.0, height]))
        if body.bounds[0, 2] > TABLE_MM[2] + 0.3:
            return body


def unblocked(body: trimesh.Trimesh, found: SurveyResult, rng: np.random.Generator) -> float:
    """Share of the body in the surveyed space that is not blocked, by samples of surface and inside."""
    surface = np.asarray(trimesh.sample.sample_surface(body, SAMPLES, seed=0)[0])
    middle = body.vertices.mean(0)
    inside = middle + (surface - middle) * rng.random((SAMPLES, 1))
    points = (np.concatenate([surface, inside]) - TABLE_MM) / 1e3
    grid = found.grids["fixed"]
    voxels = tuple(grid.index(points[grid.contains(points)]).T)
    surveyed = found.space.region[voxels]
    return float((~grid.occupied[voxels])[surveyed].mean()) if surveyed.any() else np.nan


def main(trials: int = 25, pitch_mm: float = 5.0) -> None:
    """Print a line per trial, then one per kind."""
    rng = np.random.default_rng(0)
    shares: dict[str, list[float]] = {kind: [] for kind in KINDS}
    with tempfile.TemporaryDirectory() as folder:
        for trial in range(trials):
            kind = KINDS[trial % len(KINDS)]
            body = random_body(kind, rng)
            file = Path(folder) / f"body_{trial}.stl"
            body.export(file)
            setup = load_setup(settings=[f'cell.obstacle=[{{ name = "unknown", mesh = "{file}", known = false }}]'])
            with Scanner(setup=setup) as scanner:
                found = scanner.survey(PART, pitch=pitch_mm / 1e3)
            shares[kind].append(unblocked(body, found, rng))
            print(f"{trial + 1:3} {kind:<14} {100 * shares[kind][-1]:6.2f} % unblocked", flush=True)
    for kind, found_shares in shares.items():
        whole = sum(share == 0.0 for share in found_shares)
        print(
            f"{kind:<14} {whole} of {len(found_shares)} blocked entirely, worst {100 * np.nanmax(found_shares):.2f} %"
        )


if __name__ == "__main__":
    main(*(int(word) if i == 0 else float(word) for i, word in enumerate(sys.argv[1:])))
