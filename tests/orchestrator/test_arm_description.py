"""Descriptions of arms of 4 to 8 joints: counts that must agree, held joints, frames of links that exist."""

from __future__ import annotations

from typing import Any

import pytest

from scancell.config.cell import CellDescription
from scancell.config.description import plain_data, validate
from scancell.config.robot import RobotDescription
from scancell.errors import DescriptionError


def arm_data(joints: int, **changes: Any) -> dict[str, Any]:
    """Plain data of the shipped arm with its first or further joints, without meshes."""
    data = plain_data(RobotDescription.default())
    rows = [{k: v for k, v in row.items() if k != "mesh"} for row in [*data["joint"], *data["joint"][4:]][:joints]]
    home = [*data["home_deg"], *data["home_deg"][4:]][:joints]
    return {"name": "arm", "joint": rows, "home_deg": home, **changes}


def cell_data(joints: int, **changes: Any) -> dict[str, Any]:
    held = [{"joint": k} for k in range(7, joints + 1)]
    return {**plain_data(CellDescription.default()), "robot": arm_data(joints, held=held), **changes}


@pytest.mark.parametrize("joints", [4, 5, 6, 7, 8])
def test_arms_of_four_to_eight_joints_are_accepted(joints: int) -> None:
    held = [{"joint": k, "values_deg": [-10, 0, 10]} for k in range(7, joints + 1)]
    robot = validate(RobotDescription, arm_data(joints, held=held), "arm.toml")
    assert len(robot.joint) == len(robot.home_deg) == joints
    last = {"name": "beam", "moves_with": f"link[{joints}]", "x_size_mm": 1, "y_size_mm": 1, "z_size_mm": 1}
    lamp = {"kind": "point", "frame": f"link[{joints}]", "power_mw": 1, "in_band": 1}
    cell = validate(CellDescription, cell_data(joints, light=[lamp], presence_sensor=[last]), "cell.toml")
    assert cell.light[0].frame == f"link[{joints}]"


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (arm_data(3), "joint: Tuple should have at least 4 items"),
        (arm_data(6, home_deg=[0.0] * 5), "home_deg has 5 angles: expected one for each of the 6 joints"),
        (arm_data(7), "held names 0 joints: expected 1 for an arm of 7"),
        (arm_data(6, held=[{"joint": 3}]), "held names 1 joints: expected 0 for an arm of 6"),
        (arm_data(7, held=[{"joint": 8}]), "held[1].joint = 8: expected another joint, 1 to 7"),
        (arm_data(8, held=[{"joint": 3}, {"joint": 3}]), "held[1].joint = 3: expected another joint, 1 to 8"),
        (
            arm_data(7, held=[{"joint": 5, "values_deg": [0, 121]}]),
            "held[1].values_deg[2] = 121: expected an angle between joint[5].min_deg (-120) and max_deg (120)",
        ),
    ],
)
def test_invalid_arm_names_key_and_expectation(data: dict[str, Any], expected: str) -> None:
    with pytest.raises(DescriptionError) as caught:
        validate(RobotDescription, data, "arm.toml")
    assert "arm.toml" in str(caught.value)
    assert expected in str(caught.value)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"light": [{"kind": "point", "frame": "link[6]", "power_mw": 1, "in_band": 1}]}, "light[1].frame = 'link[6]'"),
        (
            {"light_curtain": [{"name": "c", "moves_with": "link[8]", "width_mm": 9, "height_mm": 9}]},
            "light_curtain[1].moves_with = 'link[8]'",
        ),
    ],
)
def test_frame_of_missing_link_is_rejected(changes: dict[str, Any], expected: str) -> None:
    for curtain in changes.get("light_curtain", []):
        curtain["beam_spacing_mm"] = 1
    with pytest.raises(DescriptionError) as caught:
        validate(CellDescription, cell_data(5, **changes), "cell.toml")
    assert f"{expected}: expected link[1] to link[5]" in str(caught.value)
