"""Pictures of configuration maps: cells are where they belong, in the plane and on the cylinder."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from scancell.output import pictures
from scancell.planning.path_map.configuration_map import CLEARANCE, ConfigurationMap
from scancell.planning.path_map.table_motion import TableMotion

COLUMNS, ROWS = 40, 360


class KnownMap(ConfigurationMap):
    """All cells are free but those within 20 degrees of one table angle."""

    def __init__(self, forbidden: float) -> None:
        self.quality = np.full((COLUMNS, ROWS), 0.5, np.float32)
        near = np.abs((np.arange(ROWS) - forbidden + 180) % 360 - 180) < 20
        self.quality[:, near] = 0.0
        self.cause = np.where(self.quality > 0, 0, CLEARANCE).astype(np.int8)


def drawn(forbidden: float, motion: TableMotion | None, folder: Path) -> np.ndarray:
    pictures.map_picture(KnownMap(forbidden), "path", "a", 4.0, motion).write(folder / "map.png")
    return np.asarray(Image.open(folder / "map.png"))


def is_red(pixel: np.ndarray) -> bool:
    red, green, blue = (int(c) for c in pixel)
    return red > 2 * green and red > 2 * blue


# Places (x, y) of table angles in the plane, and in the middle of either cylinder.
def plane(angle: float) -> tuple[int, int]:
    return 584, int(64 + 440 * (1 - angle / 360))


def cylinder(number: int, from_middle: float) -> tuple[int, int]:
    left = 84 + number * (1000 - 440 - 52)
    return left + 220, int(600 + 105 * (1 - np.sin(np.radians(from_middle))))


def is_blue(pixels: np.ndarray) -> np.ndarray:
    """Pixels of the line of the motion."""
    return np.asarray((pixels[..., 2] > 180) & (pixels[..., 0] < 90))


@pytest.mark.parametrize("angle", [60.0, 90.0, 120.0, 240.0, 300.0])
def test_a_forbidden_angle_is_red_where_it_is_seen_from(angle: float, tmp_path: Path) -> None:
    picture = drawn(angle, None, tmp_path)
    x, y = plane(angle)
    assert is_red(picture[y, x])
    x, y = plane((angle + 90) % 360)
    assert not is_red(picture[y, x])
    number = int(angle > 180)
    x, y = cylinder(number, angle - (90, 270)[number])
    assert is_red(picture[y, x])
    x, y = cylinder(1 - number, 0.0)
    assert not is_red(picture[y, x])


def test_a_motion_is_drawn_on_the_side_where_the_table_is(tmp_path: Path) -> None:
    rest = TableMotion(0, np.zeros(4, int), np.full(COLUMNS, np.radians(90.0)), np.zeros(COLUMNS), 0.1)
    picture = drawn(270.0, rest, tmp_path)
    for x, y in (plane(90.0), cylinder(0, 0.0)):
        assert is_blue(picture[y - 2 : y + 3, x]).any()
    x, y = cylinder(1, 30.0)
    assert not is_blue(picture[y - 2 : y + 3, x]).any()
