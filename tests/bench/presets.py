"""Draws docs/pictures/materials.png: the stripe on a cylinder of every preset, as the default sensor sees it."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np

from scancell import sensor as sensor_rt
from scancell.config.material import PRESETS
from scancell.geometry import pose
from scancell.scanning.world import native_material

from .scenes import make_sensor, still_exposure

SENSOR = ("sensor.speckle.contrast=0.7", "sensor.render.bounces=1")
ROWS, COLUMNS = slice(600, 870), slice(240, 1040)


def stripe(material: sensor_rt.Material) -> np.ndarray:
    """Grey levels of the first camera on a cylinder across the sheet, and a floor below it."""
    scene = sensor_rt.Scene()
    lying = pose.from_euler_xyz((0, 0, 0.13), (0, np.pi / 2, 0))
    scene.add_cylinder("cylinder", lying, 0.012, 0.1, material)
    scene.add_plane("floor", pose.from_euler_xyz((0, 0, 0.142), (0, 0, 0)), [0.3, 0.3], material)
    return np.asarray(sensor_rt.render(scene, make_sensor(SENSOR), still_exposure(2, 5e-4))[0, 0])


def main() -> None:
    """Render and write the picture."""
    plt.style.use("scancell.plots")
    figure, axes = plt.subplots(1, len(PRESETS), figsize=(12, 1.2))
    for axis, (name, m) in zip(axes, PRESETS.items(), strict=True):
        image = stripe(native_material(m))[ROWS, COLUMNS]
        # Brightest of each 3 x 3 pixels, so that the stripe survives the small picture; square root for the eye.
        coarse = image.reshape(len(image) // 3, 3, -1).max(axis=1)[:, : image.shape[1] // 3 * 3]
        coarse = coarse.reshape(len(coarse), -1, 3).max(axis=2)
        axis.imshow(np.sqrt(coarse), cmap="gray", vmin=0, vmax=16)
        axis.set_title(f"{name.replace('_', ' ')}, up to {image.max()} DN", fontsize=8)
        axis.axis("off")
    figure.savefig("docs/pictures/materials.png")


if __name__ == "__main__":
    main()
