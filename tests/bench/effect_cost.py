"""`PYTHONPATH=tests python -m bench.effect_cost`: what each effect of light and optics costs, for docs/light.md."""

from __future__ import annotations

from pathlib import Path

from scancell import sensor as sensor_rt
from scancell.config.loading import assets_dir

from .scenes import PART_TRIANGLES, both_cameras, make_sensor, part_on_table, turning_exposures
from .table import cpu_model, replace_paragraphs
from .timing import measure

PAGE = Path(__file__).resolve().parents[2] / "docs/light.md"
FRAMES = 32
REALISTIC = assets_dir() / "sensors/realistic/two_camera_probe.toml"


EFFECTS: dict[str, tuple[Path | None, tuple[str, ...]]] = {
    "none: the default probe": (None, ()),
    "point spread of 0.5 px": (None, both_cameras("psf_sigma_px=0.5")),
    "point spread of 5 px": (None, both_cameras("psf_sigma_px=5.0")),
    "aperture, focus at 95 mm": (None, both_cameras("focus_mm=95.0")),
    "aperture, focus at 173 mm": (None, both_cameras("focus_mm=173.0")),
    "point spread of 0.3 px, by samples": (None, both_cameras("psf_sigma_px=0.3")),
    "distortion": (None, both_cameras("distortion=[-0.05,0,0,0,0]")),
    "speckle, contrast 0.1": (None, ("sensor.speckle.contrast=0.1",)),
    "speckle, contrast 1": (None, ("sensor.speckle.contrast=1.0",)),
    "smile of the sheet": (None, ("sensor.laser.straightness_mrad=[-0.027,0,0.08]",)),
    "line source of 5 mm": (None, ("sensor.laser.source_length_mm=5.0",)),
    "rolling shutter": (None, ("sensor.detector.shutter=rolling", "sensor.detector.row_readout_us=1.0")),
    "ambient light": (None, ("sensor.ambient.irradiance_w_m2=1.0",)),
    "two reflections": (None, ("sensor.render.bounces=2",)),
    "realistic probe": (REALISTIC, ()),
    "realistic probe without speckle": (REALISTIC, ("sensor.speckle.contrast=0.0",)),
}


def main() -> None:
    """Measure all effects on one thread, each beside the default probe, and write the table."""
    scene, exposures = part_on_table(PART_TRIANGLES), turning_exposures(FRAMES)

    def pair_ms(sensor: sensor_rt.Sensor) -> float:
        timing = measure(lambda: sensor_rt.scan(scene, sensor, exposures, threads=1), repeats=3)
        return 1e3 * timing.processor / FRAMES

    lines = ["| effect | ms per pair | ratio |", "|---|---|---|"]
    plain = make_sensor()
    for name, (path, settings) in EFFECTS.items():
        beside, with_effect = pair_ms(plain), pair_ms(make_sensor(settings, path))
        lines.append(f"| {name} | {with_effect:.1f} | {with_effect / beside:.2f} |")
        print(lines[-1], flush=True)
    text = (
        "Processor time of a pair of images, rendered, exposed and evaluated, on one thread, and its ratio to that of",
        "the default probe measured beside it. The part has 70,000 triangles and moves",
        f"({cpu_model()}; `python -m bench.effect_cost`).",
        "The ratio of the first row, of the same sensor twice, tells the scatter of the others.",
    )
    replace_paragraphs(PAGE, {"| effect | ms per pair": lines, "Processor time of a pair": text})


if __name__ == "__main__":
    main()
