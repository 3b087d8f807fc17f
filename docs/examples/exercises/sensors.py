"""Exercise 3: length and height of the part on the belt, from a light barrier and a distance sensor."""

from scancell import Robot, mm

SPEED = 50 * mm  # per second
BARRIER = 2 * mm  # thickness of the light barrier along the belt


def main(robot: Robot) -> None:
    """Let the part pass; the belt's encoder measures its length."""
    robot.wait(0.2)
    to_belt = robot.distance()
    nearest = to_belt
    robot.run_belt(SPEED)
    robot.wait_signal(1)
    front = robot.belt_travel()

    def has_passed() -> bool:
        nonlocal nearest
        seen = robot.distance()
        nearest = nearest if seen is None else min(nearest, seen)
        return not robot.signal(1)

    robot.wait_until(has_passed, "the part to have passed")
    length = robot.belt_travel() - front - BARRIER
    robot.run_belt(0)
    print(f"length {length / mm:.1f} mm, height {(to_belt - nearest) / mm:.2f} mm")
