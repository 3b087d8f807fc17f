"""Which parts of a described cell a belt or a gripper can move."""

from __future__ import annotations

import pytest
from cells import GRIPPER

from scancell.config.loading import assets_dir, load_setup
from scancell.guard.parts import movable_parts

BELT = 'cell.conveyor=[{ name = "belt", pose = { x_mm = 450, y_mm = -350 }, length_mm = 400, width_mm = 100 }]'


def further(fixture: str, stands_on: str = "table") -> str:
    mesh = assets_dir() / "parts" / "step_block.stl"
    entry = f'name = "other", mesh = "{mesh}", fixture = "{fixture}", stands_on = "{stands_on}"'
    return f"cell.further_part=[{{ {entry}, pose = {{ y_mm = 60.0 }} }}]"


@pytest.mark.parametrize(
    ("words", "moving"),
    [
        ([], []),
        (["cell.part.fixture=free"], []),  # nothing can move it
        (GRIPPER, []),  # clamped
        (["cell.part.fixture=free", *GRIPPER], [1]),
        ([further("free")], []),
        ([further("clamped"), *GRIPPER], []),
        ([further("free"), *GRIPPER], [2]),
        ([BELT, further("free", "conveyor[1]")], [2]),
        ([further("free"), "cell.part.fixture=free", *GRIPPER], [1, 2]),
    ],
)
def test_free_parts_move_where_a_belt_or_a_gripper_can_move_them(words: list[str], moving: list[int]) -> None:
    assert movable_parts(load_setup(settings=words).cell) == moving
