"""Exercise 4: stop the belt so that the front of the part is 60 mm past the light barrier."""

from scancell import Robot, mm

SPEED = 50 * mm  # per second
DECELERATION = 1.0  # m/s2, of the belt
GOAL = 60 * mm
BARRIER = 2 * mm  # thickness of the light barrier along the belt: it sees the front 1 mm before its middle


def main(robot: Robot) -> None:
    """Brake so early that the belt stops at the goal."""
    robot.run_conveyor(1, SPEED)
    robot.wait_for_presence(1)
    front = robot.conveyor_travel(1) + BARRIER / 2
    braking = SPEED**2 / (2 * DECELERATION)
    robot.wait_until(lambda: robot.conveyor_travel(1) >= front + GOAL - braking, "the place to brake")
    robot.run_conveyor(1, 0)
    robot.wait(1.0)
    print(f"the front is {(robot.conveyor_travel(1) - front) / mm:.1f} mm past the barrier")
