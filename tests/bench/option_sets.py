"""Scans with random options are repeated: ``PYTHONPATH=tests python -m bench.option_sets --sets 1000``.

Two properties are checked over option sets drawn at random (cells, sensors, engines, shutters, latencies, belts,
materials, perturbations, what is estimated of cell and sensor, units, frames and formats of clouds):

- a scan that ``scancell rerun`` repeats from its run folder has the same points, profiles, recording and figures;
- a scan in a `Scanner` that has made other scans before equals that of a new one.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from scancell import Scanner
from scancell.config.cell import EstimatedDescription
from scancell.config.choices import CloudFrame
from scancell.config.files import assets_dir
from scancell.config.loading import Setup, load_setup
from scancell.config.sensor import SensorDescription
from scancell.errors import ScancellError
from scancell.geometry.mesh import METRES_PER_UNIT, Mesh, load_mesh
from scancell.reconstruction.cloud_files import FORMATS
from scancell.reconstruction.cloud_files.read import read_cloud_file
from scancell.results import ScanResult
from system.commands import scancell_here

PARTS = ("free_form.stl", "step_block.stl", "machined.stl")
CELLS = ("default", "offset_wrist", "seven_axis", "pick_and_place")
SENSORS = ("two_camera_probe", "medium_range_80", "long_range_400")
MATERIALS = ("marble", "polished_steel", "black_rubber")
# Deviations by key: of the true cell, or of what is estimated, or of both.
DEVIATIONS = {"tool.x_mm": 0.4, "tool.rz_deg": 0.1, "table.x_mm": 0.8, "table.ry_deg": 0.05, "platter.y_mm": 0.1}
TRUE_ALONE = {"sensor.laser.turn_y_deg": 0.05, "sensor.camera[1].tilt_deg": 0.02}


@dataclass
class OptionSet:
    """Arguments of a scan, in words.

    Attributes
    ----------
    part, unit
        Name of the shipped part, and the unit of its file.
    cell, sensor, settings
        Names of shipped descriptions, and changes of them.
    engine, seed, as_built
        As in `Scanner.scan`.
    estimated, estimated_camera
        Deviations by key, and the tilt of the first camera that is estimated, degrees; None: none.
    formats, frame
        As in `ScanResult.save`.
    """

    part: str
    unit: str
    cell: str
    sensor: str
    settings: list[str]
    engine: str
    seed: int
    as_built: list[str]
    estimated: dict[str, float] = field(default_factory=dict)
    estimated_camera: float | None = None
    formats: tuple[str, ...] = ("ply",)
    frame: CloudFrame = "part"

    def setup(self) -> Setup:
        """Checked descriptions."""
        cell, sensor = assets_dir() / "cells" / f"{self.cell}.toml", assets_dir() / "sensors" / f"{self.sensor}.toml"
        scan = assets_dir() / "scans" / ("belt.toml" if self.cell == "pick_and_place" else "default.toml")
        return load_setup(cell, sensor, scan, settings=self.settings)

    def arguments(self, folder: Path, setup: Setup) -> dict[str, Any]:
        """Arguments of `Scanner.scan`; the file of the part lies in `folder`."""
        found: dict[str, Any] = {
            "part": part_file(folder, self.part, self.unit),
            "unit": self.unit,
            "engine": self.engine,
            "seed": self.seed,
            "as_built": self.as_built,
            "samples": False,
        }
        if self.estimated:
            groups: dict[str, dict[str, float]] = {}
            for key, value in self.estimated.items():
                group, name = key.split(".")
                groups.setdefault(group, {})[name] = value
            found["estimated"] = EstimatedDescription.model_validate(groups)
        if self.estimated_camera is not None:
            changed = setup.sensor.model_dump()
            changed["camera"][0]["tilt_deg"] += self.estimated_camera
            found["estimated_sensor"] = SensorDescription.model_validate(changed)
        return found


def draw(seed: int) -> OptionSet:
    """The option set with a number."""
    rng = np.random.default_rng([seed, 51])

    def some(share: float) -> bool:
        return bool(rng.random() < share)

    cell, engine = str(rng.choice(CELLS)), "ray-traced" if some(0.4) else "geometric"
    settings = [f"scan.max_profiles={rng.integers(40, 60)}", f"cell.part.rz_deg={rng.uniform(-180, 180):.2f}"]
    if some(0.4):
        settings.append(f"cell.part.x_mm={rng.uniform(-8, 8):.2f}")
    if some(0.3) and cell != "pick_and_place":
        settings.append('scan.mode="stop-and-look"')
    if some(0.5) and engine == "ray-traced":
        settings += ['sensor.detector.shutter="rolling"', f"sensor.detector.row_readout_us={rng.uniform(1, 20):.1f}"]
        settings.append("sensor.render.bounces=0")
    if some(0.3):
        settings.append(f'cell.part.material.preset="{rng.choice(MATERIALS)}"')
    if some(0.3):
        settings.append(f"scan.clearance_mm={rng.choice([0.0, 1.0, 3.0])}")
    if some(0.2):
        settings.append("scan.raster.enabled=false")
    deviations = {key: float(rng.uniform(-1, 1) * size) for key, size in DEVIATIONS.items()}
    chosen = [key for key in DEVIATIONS if some(0.3)]
    as_built = [f"{key}={deviations[key]}" for key in chosen if some(0.8)]
    as_built += [f"{key}={rng.uniform(-1, 1) * size}" for key, size in TRUE_ALONE.items() if some(0.2)]
    if some(0.2):
        as_built.append(f"trigger.latency_ms={rng.uniform(0, 0.5):.3f}")
    estimated = {key: deviations[key] for key in chosen if some(0.6)}
    if some(0.2):
        estimated["trigger.latency_ms"] = float(rng.uniform(0, 0.5))
    frames: tuple[CloudFrame, ...] = ("part", "belt" if cell == "pick_and_place" else "table", "base", "world")
    return OptionSet(
        part=str(rng.choice(PARTS)),
        unit=str(rng.choice(list(METRES_PER_UNIT))),
        cell=cell,
        sensor=str(rng.choice(SENSORS, p=(0.8, 0.1, 0.1))),
        settings=settings,
        engine=engine,
        seed=int(rng.integers(0, 1000)),
        as_built=as_built,
        estimated=estimated,
        estimated_camera=float(rng.uniform(-0.02, 0.02)) if some(0.2) else None,
        formats=tuple(str(word) for word in rng.permutation(FORMATS)[: rng.integers(1, 3)]),
        frame=frames[rng.integers(4)],
    )


@cache
def _mesh(name: str) -> Mesh:
    return load_mesh(assets_dir() / "parts" / name)


def part_file(folder: Path, name: str, unit: str) -> Path:
    """The shipped part in another unit, as text without rounding."""
    file = folder / f"{Path(name).stem}_{unit}.obj"
    if not file.exists():
        mesh = _mesh(name)
        lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in (mesh.vertices / METRES_PER_UNIT[unit]).tolist()]
        lines += [f"f {a} {b} {c}" for a, b, c in (mesh.faces + 1).tolist()]
        file.write_text("\n".join(lines) + "\n")
    return file


def differences(one: Path, other: Path) -> list[str]:
    """Names of the files of two run folders whose content differs, but manifests and descriptions."""
    left_out = {"manifest.json", "resolved.toml"}
    names = {file.name for folder in (one, other) for file in folder.iterdir() if file.is_file()} - left_out
    return [
        name
        for name in sorted(names)
        if not ((one / name).is_file() and (other / name).is_file()) or _content(one / name) != _content(other / name)
    ]


def _content(file: Path) -> Any:
    if file.suffix == ".npz":  # an archive with times
        with np.load(file) as arrays:
            return {name: arrays[name].tobytes() for name in arrays.files}
    if file.suffix in (".e57", ".laz"):  # they state when they were written
        return read_cloud_file(file).points.tobytes()
    return file.read_bytes()


def same(one: ScanResult, other: ScanResult) -> list[str]:
    """Names of what differs between two results."""
    pairs = {
        "points": (one.cloud.points_in_part, other.cloud.points_in_part),
        "profiles": (one.profiles.points_in_sensor, other.profiles.points_in_sensor),
        "joints": (one.recording.measured.q, other.recording.measured.q),
    }
    return [name for name, (a, b) in pairs.items() if not np.array_equal(a, b)]


def check(number: int, folder: Path, used: Scanner) -> tuple[str, list[str]]:
    """Outcome of an option set, and what its repetition or a `Scanner` that was `used` before makes different."""
    options = draw(number)
    setup = options.setup()
    arguments = options.arguments(folder, setup)
    with Scanner(setup=setup) as fresh:
        result = _scan(fresh, arguments)
    second = _scan(used, {**arguments, "setup": setup})
    if isinstance(result, str) or isinstance(second, str):
        reason = str(result)
        return f"refused: {reason[-60:]}", [] if reason == str(second) else [f"new: {reason}; used: {second}"]
    found = [f"used scanner: {name}" for name in same(result, second)]
    run, repeated = folder / f"run{number}", folder / f"rerun{number}"
    result.save(run, options.formats, frame=options.frame)
    done = scancell_here("rerun", run, "--out", repeated, cwd=folder)
    if done.code != 0:
        return "scanned", [*found, f"rerun: {done.err.strip()[-200:]}"]
    return "scanned", [*found, *(f"rerun: {name}" for name in differences(run, repeated))]


def _scan(scanner: Scanner, arguments: dict[str, Any]) -> ScanResult | str:
    """The scan, or why it is refused."""
    try:
        return scanner.scan(**arguments)
    except ScancellError as error:
        return str(error)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sets", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0)
    asked = parser.parse_args()
    outcomes: Counter[str] = Counter()
    faults = 0
    with tempfile.TemporaryDirectory() as folder, Scanner() as used:
        for number in range(asked.first, asked.first + asked.sets):
            outcome, found = check(number, Path(folder), used)
            outcomes[outcome] += 1
            faults += bool(found)
            if found:
                print(number, outcome, found, draw(number), flush=True)
    print(f"{asked.sets} option sets: {dict(outcomes)}, {faults} with a difference")
    raise SystemExit(faults > 0)


if __name__ == "__main__":
    main()
