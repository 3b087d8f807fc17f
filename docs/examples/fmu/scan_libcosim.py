"""Runs the FMU of a cell in libcosim: moves the arm over the part, turns the table under the sensor with an exposure
every 0.1 rad, and writes the records of the exposures for `scancell render`.

    pip install libcosimpy
    python scan_libcosim.py RobotCell2.fmu recording.csv

Build the FMU with --integers: libcosim hides enumerations.
"""

import csv
import sys
from pathlib import Path

from libcosimpy.CosimEnums import CosimVariableType
from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
from libcosimpy.CosimManipulator import CosimManipulator
from libcosimpy.CosimObserver import CosimObserver
from libcosimpy.CosimSlave import CosimLocalSlave

ABOVE_PART = (0.0, -1.0278, 3.5967, 0.0, 0.5727, 0.5236)  # joints of the default cell, rad

fmu, output = sys.argv[1:]
log_output_level(CosimLogLevel.WARNING)
execution = CosimExecution.from_step_size(16_000_000)  # ns: one cycle of the controller
cell = execution.add_local_slave(CosimLocalSlave(fmu, "cell"))
manipulator, observer = CosimManipulator.create_override(), CosimObserver.create_last_value()
execution.add_manipulator(manipulator)
execution.add_observer(observer)
variables = {variable.name.decode(): variable for variable in execution.slave_variables(cell)}
record = [name for name in variables if name.startswith("trigger.")]
rows = []


def is_real(name):
    return variables[name].type == CosimVariableType.REAL.value


def set_value(name, value):
    write = manipulator.slave_real_values if is_real(name) else manipulator.slave_integer_values
    write(cell, [variables[name].reference], [value])


def get_integer(name):
    return observer.last_integer_values(cell, [variables[name].reference])[0]


def get_record():
    reals = [name for name in record if is_real(name)]
    found = observer.last_real_values(cell, [variables[name].reference for name in reals])
    values = dict(zip(reals, found, strict=True))
    return [values[name] if name in values else get_integer(name) for name in record]


def step():
    """After each step the FMU shows at most one new record."""
    if not execution.step():
        raise SystemExit("libcosim cannot step")
    if error := get_integer("controller.error"):
        raise SystemExit(f"the cell rejects the command: controller.error = {error}")
    if get_integer("trigger.index") > len(rows):
        rows.append(get_record())


def move(number):
    """Moves all axes to the commanded angles. Outputs show the command after two steps."""
    set_value("command.start", number)
    step()
    step()
    while not observer.last_boolean_values(cell, [variables["controller.at_destination"].reference])[0]:
        step()


for joint, angle in enumerate(ABOVE_PART, start=1):
    set_value(f"command.q[{joint}]", angle)
set_value("command.mode", 2)  # joint move
set_value("command.speed", 0.5)
move(1)
set_value("command.speed", 0.25)
set_value("command.table", 6.2832)
set_value("command.trigger.mode", 2)  # by table angle
set_value("command.trigger.angle", 0.1)
set_value("command.exposure", 0.0005)
set_value("command.segment", 1)
move(2)
set_value("command.trigger.mode", 0)
while len(rows) < get_integer("trigger.count"):
    step()
with Path(output).open("w", newline="") as file:
    csv.writer(file).writerows([record, *rows])
