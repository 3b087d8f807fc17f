"""The exercises; docs/exercises.md has the same texts (``python -m bench.exercise_page``)."""

from __future__ import annotations

import math

from scancell.errors import DescriptionError
from scancell.exercises import measures
from scancell.exercises.measures import Check, Exercise, Question

_ENDS = Check("The program runs to its end", measures.commands_of_run, "commands", least=2)
_NO_CONTACT = Check("No bodies touch from the opening of the cell on", measures.contacts, "contacts", most=0)
_DEVIATION = Check("The RMS deviation of the cloud from the part is small", measures.rms_deviation, "mm", most=0.05)


def _time(most: float) -> Check:
    return Check("The program is fast enough, in simulated time", measures.duration, "s", most=most)


EXERCISES = (
    Exercise(
        1,
        "kinematics",
        "Kinematics",
        "Compute the pose of the flange from robot.joints and the Denavit-Hartenberg parameters of the arm. "
        "robot.world_from_tool() is the pose of the sensor: show that the pose of the sensor relative to the "
        "flange is the same in every configuration. Bring the arm to a configuration of your choice, and enter the "
        "position of the flange there. The joints (0, -60, 185, 0, 55, 0)° are a good start.",
        (
            _ENDS,
            Check("All joints have moved away from the home position", measures.least_joint_motion, "deg", least=4),
            Question("x of the flange in the world", measures.flange_coordinate(0), "mm", 0.1),
            Question("y of the flange in the world", measures.flange_coordinate(1), "mm", 0.1),
            Question("z of the flange in the world", measures.flange_coordinate(2), "mm", 0.1),
            Question("distance of the sensor from the flange", measures.flange_to_sensor, "mm", 0.1),
        ),
    ),
    Exercise(
        2,
        "grasping",
        "Grasping",
        "The part stands in the middle of the table at (450, 0, 100) mm. Pick it up and put it down 40 mm further "
        "along y, turned by 90°. The fingers are 45 mm long and open up to 70 mm; the part is 50 mm wide. "
        'robot.set_tool("gripper") makes poses those of the point between the upper ends of the pads, with z along '
        "the fingers.",
        (
            _ENDS,
            _NO_CONTACT,
            Check("The part is 40 mm further along y", measures.part_displacement_error((0, 40e-3, 0)), "mm", most=1),
            Check("The part is turned by 90°", measures.part_turn_error(math.pi / 2), "deg", most=1),
            _time(20),
        ),
        part="step_block.stl",
        cell="gripper.toml",
    ),
    Exercise(
        3,
        "sensors",
        "Presence and distance sensors",
        "A belt brings the part past a light barrier (presence sensor 1, 2 mm thick along the belt) and below a "
        "distance sensor. Measure the length of the part along the belt with robot.conveyor_travel(1), and its "
        "height below the distance sensor. The controller reads sensors every 16 ms.",
        (
            _ENDS,
            _NO_CONTACT,
            Question("length of the part along the belt", measures.part_length, "mm", 0.5),
            Question("height of the part", measures.part_height, "mm", 0.1),
        ),
        part="step_block.stl",
        cell="belt.toml",
    ),
    Exercise(
        4,
        "conveyor",
        "Conveyor",
        "In the cell of exercise 3, stop the belt so that the front of the part is 60 mm past the middle of the "
        "barrier. The belt brakes at 1 m/s².",
        (
            _ENDS,
            _NO_CONTACT,
            Check("The belt is at rest", measures.belt_speed, "mm/s", most=0.01),
            Check("The front of the part is 60 mm past the barrier", measures.front_past_barrier, "mm", 58, 62),
            _time(15),
        ),
        part="step_block.stl",
        cell="belt.toml",
    ),
    Exercise(
        5,
        "scanning",
        "Scanning",
        "Scan the sphere from above and find its radius. Its centre is above the middle of the table, its top 70 "
        "mm above the table. The sensor measures at distances of about 75 to 165 mm.",
        (
            _ENDS,
            _NO_CONTACT,
            Check("The cloud has enough points", measures.points, "points", least=10_000),
            _DEVIATION,
            Question("radius of the sphere", measures.sphere_radius, "mm", 0.05),
            _time(10),
        ),
        part="sphere_on_foot.stl",
    ),
    Exercise(
        6,
        "seam",
        "Seam following",
        "The part lies on the table at an unknown angle of up to 10°. Follow its right-hand edge (smaller y), "
        "where the surface drops to the table: each profile determines the position of the next one. Find the "
        "angle of the edge.",
        (
            _ENDS,
            _NO_CONTACT,
            Check("The edge is followed", measures.length_of_edge, "mm", least=30),
            Check("The sensor is above the edge from the third profile on", measures.distance_from_edge, "mm", most=1),
            Question("angle of the edge from the world's x axis", measures.part_angle, "deg", 0.3),
        ),
        part="step_block.stl",
        unknown={"cell.part.rz_deg": (-10.0, 10.0)},
    ),
    Exercise(
        7,
        "taught",
        "Teach a program by hand",
        "Scan the sphere of exercise 5 again, without writing a program, in the tab Program, Teach. Bring the "
        "sensor above the part (tab Pose: 450, 0, 300 mm; 180, 0, 0°), and add a step of the kind joints. Bring it "
        "to 432, 0, 260 mm, and add a line; to 468, 0, 260 mm, and add a scan line. Copy the first step, and move "
        "the copy to the end. Run the program in the tab Run, first step by step.",
        (
            Check("The taught program runs to its end", measures.commands_of_taught_run, "commands", least=4),
            _NO_CONTACT,
            Check("The scan begins at 432, 0, 260 mm", measures.scan_end_error(0, (0.432, 0, 0.26)), "mm", most=0.5),
            Check("The scan ends at 468, 0, 260 mm", measures.scan_end_error(-1, (0.468, 0, 0.26)), "mm", most=0.5),
            Check("The sensor is raised after the scan", measures.rise_after_scan, "mm", least=30),
            _DEVIATION,
            _time(15),
        ),
        part="sphere_on_foot.stl",
    ),
)


def find_exercise(selected: str) -> Exercise:
    """The exercise with a number or name.

    Raises
    ------
    DescriptionError
        If there is none.
    """
    for exercise in EXERCISES:
        if selected in (str(exercise.number), exercise.name):
            return exercise
    names = ", ".join(exercise.name for exercise in EXERCISES)
    expected = f"a number from 1 to {len(EXERCISES)}, or {names}"
    raise DescriptionError(key="exercise", value=selected, expected=expected)
