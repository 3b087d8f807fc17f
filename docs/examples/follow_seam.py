"""Follows the groove of a part that the sensor sees.

::

    scancell run docs/examples/follow_seam.py --part assets/parts/step_block.stl

How the part lies on the table is not known to the program: it finds the groove in the first profile, and each further
profile says where to go next. All places are in the base frame. Try ``--set cell.part.rz_deg=15``.
"""

from __future__ import annotations

import numpy as np

from scancell import Robot, deg, location, mm, pose

START = location(420 * mm, 0, 207 * mm, rx=180 * deg)  # above one end of the groove
STANDOFF = 100 * mm  # of the sensor from the bottom of the groove
STEP = 4 * mm  # along the groove, from profile to profile
STEPS = 15
NEWEST = 4  # places that give the direction of the groove

WIDEST = 10 * mm  # grooves
DEEPEST, FLATTEST = 1.5 * mm, 0.2 * mm  # depth of a groove at least; points of its bottom are so near to its deepest


def main(robot: Robot) -> None:
    """Follow the groove step by step and print its places."""
    robot.move_tool(START)
    robot.set_speed(0.2)
    places = [groove(robot)]
    heading = np.array([1.0, 0.0, 0.0])
    for _ in range(STEPS):
        robot.move_line(above(places[-1] + STEP * heading))
        places.append(groove(robot))
        newest = np.array(places[-NEWEST:])
        heading = (newest[-1] - newest[0]) / np.linalg.norm(newest[-1] - newest[0])
    angle = np.arctan2(heading[1], heading[0])
    print(f"groove at {angle / deg:.2f} deg, from {text(places[0])} to {text(places[-1])} mm")


def groove(robot: Robot) -> np.ndarray:
    """Middle (3,) of the groove's bottom in the present profile, base frame, m."""
    result = robot.profile()
    along, distance = np.asarray(result.profile.points_in_sensor, float)[:, 1:].T
    order = np.argsort(along)
    along, distance, points = along[order], distance[order], result.points_in_base[order]
    # The bottom is farther from the sensor than the surface on both sides.
    left = np.minimum.accumulate(distance)
    right = np.minimum.accumulate(distance[::-1])[::-1]
    depth = distance - np.maximum(left, right)
    deepest = int(np.argmax(depth))
    if depth[deepest] < DEEPEST:
        raise RuntimeError(f"no groove in the profile at {text(robot.world_from_tool()[:3, 3])} mm")
    near = np.abs(along - along[deepest]) < WIDEST
    bottom = near & (np.abs(distance - distance[deepest]) < FLATTEST)
    ends = points[bottom][[0, -1]]
    return np.asarray(ends.mean(0))


def above(place: np.ndarray) -> np.ndarray:
    """Pose (4, 4) of the sensor at its stand-off above a place (3,)."""
    return pose.from_rotation(START[:3, :3], place + np.array([0.0, 0.0, STANDOFF]))


def text(place: np.ndarray) -> str:
    """A place in mm."""
    return ", ".join(f"{value / mm:.2f}" for value in place)
