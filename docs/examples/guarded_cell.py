"""Jogs joint 3 of the simulated robot until its guard holds it: ``guarded_cell.py HOST PORT`` of a guard over UDP.

::

    scancell guard serve --port 4000 &
    python docs/examples/guarded_cell.py 127.0.0.1 4000
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

from scancell import (
    CellInstance,
    GuardedCell,
    GuardSettings,
    Link,
    Mode,
    Operation,
    UdpTransport,
    box_mesh,
    cell_json,
    load_setup,
    make_temporary_fmu,
    nominal_cell,
)

JOG = np.array([0.0, 0, 1, 0, 0, 0])  # towards the robot, full speed


def main(host: str, port: int) -> None:
    """Run the default cell by the wall clock."""
    max_age = GuardSettings().max_age
    setup = load_setup()
    described = cell_json(setup.cell, nominal_cell(setup.cell, box_mesh((0.01, 0.01, 0.01))), seed=0)
    with (
        tempfile.TemporaryDirectory() as folder,
        CellInstance(make_temporary_fmu(described, Path(folder) / "cell")) as cell,
    ):
        link = Link(UdpTransport(host, port), max_age)
        guarded = GuardedCell(cell, setup.cell.world.controller_cycle_us, link, max_age)
        cell.set_integer("command.operation", Operation.MANUAL)
        guarded.run(0.5, lambda: link.counts.total() > 0)  # until the guard answers
        cell.set(cell.real_group([f"command.jog[{i + 1}]" for i in range(6)]), JOG)
        cell.set_integer("command.mode", Mode.JOINT_JOG)
        said, moved = "", False

        def watch() -> bool:
            nonlocal said, moved
            if (text := cell.get_string("command.pendant.text")) != said:
                said = text
                print(f"{cell.time_us * 1e-6:6.3f} s  {text}")
            moving = cell.get_boolean("controller.moving")
            moved = moved or moving
            return moved and not moving

        guarded.run(10.0, watch)
        contacts = cell.get_integer("truth.collision.pairs")
        packets = ", ".join(f"{number} {outcome}" for outcome, number in link.counts.items())
        print(f"{cell.get_string('pendant.text')}; {contacts} contacts; packets: {packets}")
        link.close()


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
