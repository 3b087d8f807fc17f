"""Scans of a part with white, black and metal regions by exposure: ``PYTHONPATH=tests python -m bench.exposure_modes``.

Prints the table of ``docs/light.md``.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

import scancell
from scancell.config.loading import assets_dir

PART = assets_dir() / "parts" / "free_form.stl"
BORDERS = (-12.0, 12.0)  # mm, in x
MATERIALS = ("matt_white", "black_rubber", "machined_aluminium")
PROFILES = 240
REGIONS: dict[str, Any] = {
    "scan.max_profiles": PROFILES,
    "cell.part.material_region": [
        {"material": {"preset": preset}, "min_mm": [low, -1e3, -1e3], "max_mm": [high, 1e3, 1e3]}
        for preset, low, high in zip(MATERIALS, (-1e3, *BORDERS), (*BORDERS, 1e3), strict=True)
    ],
}
AUTOMATIC = {
    "sensor.exposure.mode": "automatic",
    "sensor.exposure.shortest_ms": 0.02,
    "sensor.exposure.longest_ms": 10.0,
}
MULTIPLE = {
    "sensor.detector.exposure_ms": 0.1,
    "sensor.exposure.mode": "multiple",
    "sensor.exposure.further_ms": [0.5, 5.0],
}
CASES: dict[str, dict[str, Any]] = {
    **{f"fixed, {ms:g} ms": {"sensor.detector.exposure_ms": ms} for ms in (0.1, 0.5, 5.0)},
    "automatic": AUTOMATIC,
    "automatic, percentile = 50": {**AUTOMATIC, "sensor.exposure.percentile": 50.0},
    "multiple: 0.1, 0.5, 5 ms": MULTIPLE,
}


def by_region(result: scancell.ScanResult) -> list[tuple[int, float]]:
    """Number of points and RMS deviation, um, of each region."""
    region = np.digitize(1e3 * result.cloud.points_in_part[:, 0], BORDERS)
    parts = [1e6 * result.deviation.distance[region == i] for i in range(len(MATERIALS))]
    return [(len(part), float(np.sqrt(np.mean(part**2))) if len(part) else float("nan")) for part in parts]


def main() -> None:
    print("| exposure | " + " | ".join(f"{name}: points, RMS µm" for name in MATERIALS) + " | processor time, s |")
    print("|---" * (len(MATERIALS) + 2) + "|")
    scancell.scan(PART, settings=REGIONS)  # what is imported and cached once
    for name, settings in CASES.items():
        begin = time.process_time()
        result = scancell.scan(PART, settings={**REGIONS, **settings})
        spent = time.process_time() - begin
        cells = [f"{count}, {rms:.2f}" for count, rms in by_region(result)]
        print(f"| {name} | {' | '.join(cells)} | {spent:.0f} |", flush=True)


if __name__ == "__main__":
    main()
