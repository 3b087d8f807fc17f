"""Exercise 6: follow the right-hand edge of the part, where it falls off to the table."""

import numpy as np

from scancell import Robot, deg, location, mm

START = location(415 * mm, -15 * mm, 210 * mm, rx=180 * deg)
STANDOFF = 95 * mm  # of the sensor from the edge
STEP = 4 * mm
STEPS = 10
FALL = 5 * mm  # at an edge, at least


def edge(robot: Robot) -> np.ndarray:
    """Place (3,) in the base from where the profile falls, seen from its middle to smaller y."""
    points = robot.profile().points_in_base
    points = points[np.argsort(-points[:, 1])]
    falls = np.flatnonzero(points[:-1, 2] - points[1:, 2] > FALL)
    outermost = falls[points[falls, 1] < points[:, 1].max() - 10 * mm]
    if not len(outermost):
        raise RuntimeError("no edge in the profile")
    return points[outermost[-1]]


def main(robot: Robot) -> None:
    """Each edge point says where the next profile is measured."""
    robot.move_tool(START)
    robot.set_speed(0.2)
    places = [edge(robot)]
    heading = np.array([1.0, 0, 0])
    for _ in range(STEPS):
        x, y, _ = places[-1] + STEP * heading
        robot.move_line(location(x, y, places[-1][2] + STANDOFF, rx=180 * deg))
        places.append(edge(robot))
        heading = (places[-1] - places[0]) * [1, 1, 0]
        heading /= np.linalg.norm(heading)
    print(f"edge at {np.arctan2(heading[1], heading[0]) / deg:.2f} deg")
