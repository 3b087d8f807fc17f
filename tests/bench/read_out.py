"""Profile rate and noise by region of interest and binning: ``PYTHONPATH=tests python -m bench.read_out``.

Prints the table of ``docs/light.md``.
"""

from __future__ import annotations

from typing import Any

from scancell.config.loading import load_setup
from scancell.config.sensor import profile_time
from scancell.evaluation.plane_trial import PlaneTarget, measure_plane

EXPOSURES = 20
DISTANCE = 0.12
REGION: dict[str, Any] = {f"sensor.camera[{k}].region_rows_px": [512, 256] for k in (1, 2)}
BINNED = {"sensor.detector.binning": 2}
CHARGE = {**BINNED, "sensor.detector.binning_mode": "charge", "sensor.detector.exposure_ms": 0.125}
CASES: dict[str, dict[str, Any]] = {
    "the whole image, 1280 x 1024": {},
    "256 rows": REGION,
    "binning 2 x 2": BINNED,
    "binning 2 x 2, charge, 0.125 ms": CHARGE,
    "256 rows, binning 2 x 2": {**REGION, **BINNED},
    "256 rows, binning 2 x 2, charge, 0.125 ms": {**REGION, **CHARGE},
}


def main() -> None:
    print("| read | profiles/s | points per profile | noise, µm |\n|---|---|---|---|")
    for name, case in CASES.items():
        settings = {"sensor.detector.row_readout_us": 4.0, **case}
        sensor = load_setup(settings=settings).sensor
        figures = measure_plane(sensor, PlaneTarget(DISTANCE), EXPOSURES, "ray-traced").figures()
        rate = 1.0 / profile_time(sensor)
        points = figures.points / EXPOSURES
        print(f"| {name} | {rate:.0f} | {points:.0f} | {1e6 * figures.noise:.2f} |", flush=True)


if __name__ == "__main__":
    main()
