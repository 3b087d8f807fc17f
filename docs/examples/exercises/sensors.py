"""Exercise 3: length and height of the part on the belt, from a light barrier and a distance sensor."""

from scancell import Robot, mm

SPEED = 50 * mm  # per second
BARRIER = 2 * mm  # thickness of the light barrier along the belt


def main(robot: Robot) -> None:
    """Let the part pass; the belt's encoder measures its length."""
    robot.wait(0.2)
    to_belt = robot.distance(1)
    nearest = to_belt
    robot.run_conveyor(1, SPEED)
    robot.wait_for_presence(1)
    front = robot.conveyor_travel(1)

    def has_passed() -> bool:
        nonlocal nearest
        seen = robot.distance(1)
        nearest = nearest if seen is None else min(nearest, seen)
        return not robot.presence(1)

    robot.wait_until(has_passed, "the part to have passed")
    length = robot.conveyor_travel(1) - front - BARRIER
    robot.run_conveyor(1, 0)
    print(f"length {length / mm:.1f} mm, height {(to_belt - nearest) / mm:.2f} mm")
