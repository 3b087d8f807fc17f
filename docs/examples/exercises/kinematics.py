"""Exercise 1: the arm's forward kinematics from its Denavit-Hartenberg parameters."""

import numpy as np

from scancell import Robot, deg, mm

A = np.array([75, 270, -90, 0, 0, 0]) * mm
D = np.array([335, 0, 0, 295, 0, 80]) * mm
ALPHA = np.array([-90, 0, 90, -90, 90, 0]) * deg

HOME = np.array([0, -60, 185, 0, 55, 0]) * deg
OTHERS = (HOME + np.array([20, 5, -10, 0, 10, 30]) * deg, HOME + np.array([-15, 10, -5, 40, -20, -60]) * deg)


def link(theta: float, a: float, d: float, alpha: float) -> np.ndarray:
    """Pose (4, 4) of a link in the frame of the one before: Rz(theta) T(a, 0, d) Rx(alpha)."""
    ct, st, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    return np.array([[ct, -st * ca, st * sa, a * ct], [st, ct * ca, -ct * sa, a * st], [0, sa, ca, d], [0, 0, 0, 1]])


def flange(q: np.ndarray) -> np.ndarray:
    """Pose (4, 4) of the flange in the base."""
    pose = np.eye(4)
    for theta, a, d, alpha in zip(q, A, D, ALPHA, strict=True):
        pose = pose @ link(theta, a, d, alpha)
    return pose


def main(robot: Robot) -> None:
    """The sensor sits at the same pose on the flange, wherever the arm is."""
    robot.move_joints(HOME)
    flange_from_sensor = np.linalg.inv(flange(robot.joints)) @ robot.world_from_tool()
    for q in OTHERS:
        robot.move_joints(q)
        error = flange(robot.joints) @ flange_from_sensor - robot.world_from_tool()
        print(f"error: {np.abs(error[:3, 3]).max() / mm:.6f} mm")
