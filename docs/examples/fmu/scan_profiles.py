"""Steps the FMU of a cell and that of its sensor in FMPy: the arm moves over the part, the table turns under the sensor
with an exposure every 0.1 rad, and the profiles become a cloud in the frame of the part.

    scancell fmu build --fmi 3 --sensor --out fmus
    python scan_profiles.py fmus/RobotCell3.fmu fmus/ProfileSensor3.fmu cloud.csv
"""

import csv
import sys
from pathlib import Path

import fmpy
import numpy as np
from fmpy.fmi3 import FMU3Slave

STEP, END = 0.016, 12.0  # s: a communication step of one cycle of the controller
GET = {"Float64": "getFloat64", "Int32": "getInt32", "Boolean": "getBoolean", "Enumeration": "getInt64"}
SET = {"Float64": "setFloat64", "Int32": "setInt32", "Boolean": "setBoolean", "Enumeration": "setInt64"}


class Fmu:
    """An instance, whose variables have names."""

    def __init__(self, file):
        description = fmpy.read_model_description(file)
        self.variables = {variable.name: variable for variable in description.modelVariables}
        self.slave = FMU3Slave(
            guid=description.guid,
            unzipDirectory=fmpy.extract(file),
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName="one",
        )
        self.slave.instantiate()
        self.slave.enterInitializationMode()
        self.slave.exitInitializationMode()

    def get(self, name):
        variable = self.variables[name]
        size = int(variable.dimensions[0].start) if variable.dimensions else 1
        values = getattr(self.slave, GET[variable.type])([variable.valueReference], size)
        return np.array(values) if variable.dimensions else values[0]

    def set(self, name, value):
        variable = self.variables[name]
        kind = float if variable.type == "Float64" else int
        getattr(self.slave, SET[variable.type])([variable.valueReference], [kind(value)])


def frame(cell, name):
    """Rotation and position of a frame in the world, in the middle of the exposure."""
    w, x, y, z = (cell.get(f"trigger.truth.{name}.orientation[{i}]") for i in (1, 2, 3, 4))
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    return rotation, np.array([cell.get(f"trigger.truth.{name}.position[{i}]") for i in (1, 2, 3)])


cell, sensor = Fmu(sys.argv[1]), Fmu(sys.argv[2])
shared = [
    name for name, variable in sensor.variables.items() if variable.causality == "input" and name in cell.variables
]
with (Path(__file__).parent / "scan_inputs.csv").open() as file:
    commands = list(csv.DictReader(file))
points = []
for number in range(round(END / STEP)):
    time = number * STEP
    while commands and float(commands[0]["time"]) <= time + STEP / 2:
        for name, value in commands.pop(0).items():
            if name != "time":
                cell.set(name, float(value))
    cell.slave.doStep(time, STEP)
    for name in shared:
        sensor.set(name, cell.get(name))
    sensor.slave.doStep(time, STEP)
    if sensor.get("laser.on"):
        count = sensor.get("profile.count")
        in_sensor = np.column_stack([sensor.get(f"profile.{axis}")[:count] for axis in "xyz"])
        (turn, place), (turn_part, place_part) = frame(cell, "sensor"), frame(cell, "part[1]")
        points.append((in_sensor @ turn.T + place - place_part) @ turn_part)
np.savetxt(sys.argv[3], np.concatenate(points), delimiter=",", header="x,y,z", comments="")
print(f"{sys.argv[3]}: {len(points)} profiles, {sum(map(len, points))} points")
