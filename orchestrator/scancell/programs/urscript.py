"""Programs in URScript, the language of Universal Robots: a subset that runs in the simulated cell (docs/programs.md).

Lengths are in metres, angles in radians; poses ``p[x, y, z, rx, ry, rz]`` have a rotation vector and are in the frame
of the robot's base.
"""

from __future__ import annotations

import math

import numpy as np

from scancell.arrays import Array
from scancell.geometry import pose
from scancell.programs.script import Fault, Halt, Node, Output, Script, Value

TABLE_ANGLE, TABLE_SPEED, INTERVAL = 0, 1, 2  # float registers
_AT_TARGET = 0  # digital input: the table is where it was sent


def vector_pose(numbers: Array) -> Array:
    """Pose (4, 4) of a position, m, and a rotation vector, rad, (6,)."""
    return pose.from_rotation(pose.exp_rotation(numbers[3:]), numbers[:3])


def pose_vector(base_from_tool: Array) -> Array:
    """Position, m, and rotation vector, rad, (6,), of a pose (4, 4)."""
    return np.concatenate([base_from_tool[:3, 3], pose.log_rotation(base_from_tool[:3, :3])])


class UrScript(Script):
    """A program in URScript: its statements at top level; without any, its last function that has no parameters."""

    grammar = "urscript.lark"

    def start(self) -> None:
        """Run the statements at top level, or the last function."""
        self._registers: dict[int, float] = {}
        nodes: list[Node] = self.tree.children
        if any(node.data != "routine" for node in nodes):
            return self.run_block(self.tree)
        names = [str(node.children[0]) for node in nodes if node.children[1] is None]
        if not names:
            raise Fault("no function without parameters")
        return self.run_block(self._routines[names[-1]].block)

    # Statements

    def do_routine(self, *children: Node) -> None:
        """A function is known before the run."""

    def do_assign(self, target: Node, value: Node) -> None:
        """Give a variable a value: a known one, or a new one of the function."""
        slot = self.slot(target)
        known = slot in self.frame_of(slot)
        self.assign(self.frame_of(slot) if known or not self._frames else self._frames[-1], target, self.value(value))

    def do_share(self, target: Node, value: Node) -> None:
        """Give a global variable a value."""
        self.assign(self._globals, target, self.value(value))

    def slot(self, variable: Node) -> str:
        """Key of a variable; elements are not changed."""
        name, *index = variable.children
        if index:
            raise Fault("elements of lists cannot be changed")
        return self.key(name)

    def do_call_statement(self, function: Node) -> None:
        """Call a function for what it does."""
        self._called(*function.children)

    def _called(self, name: Node, arguments: Node) -> Value | None:
        routine = self._routines.get(str(name))
        if routine is None:
            found: Value | None = super().get_function(name, arguments)
            return found
        given = [] if arguments is None else arguments.children
        return self.enter(routine, dict(zip(routine.parameters, map(self.value, given), strict=True)))

    # Values

    def get_function(self, *children: Node) -> Value:
        """Value of a function."""
        name, arguments = children
        found = self._called(name, arguments)
        if found is None:
            raise Fault(f"{name} has no value")
        return found

    def get_variable(self, name: Node, index: Node = None) -> Value:
        """Value of a variable, or one number of a list or pose."""
        found = super().get_variable(name)
        if index is None:
            return found
        if not isinstance(found, np.ndarray):
            raise Fault(f"{name} is no list")
        numbers, at = pose_vector(found) if found.ndim == 2 else found, self.integer(index)
        if not 0 <= at < len(numbers):
            raise Fault(f"{name}[{at}]: expected 0 to {len(numbers) - 1}")
        return float(numbers[at])

    def get_truth(self, word: Node) -> Value:
        """A literal truth value."""
        return str(word) == "True"

    def get_list(self, arguments: Node) -> Value:
        """A list of numbers."""
        return np.array([self.number(one) for one in arguments.children])

    def get_pose(self, arguments: Node) -> Value:
        """A literal pose."""
        if len(arguments.children) != 6:
            raise Fault(f"a pose of {len(arguments.children)} numbers, expected 6")
        return vector_pose(np.array([self.number(one) for one in arguments.children]))

    def _row(self, node: Node) -> Array:
        found = self.value(node)
        if not isinstance(found, np.ndarray) or found.ndim != 1:
            raise Fault("expected a list of numbers")
        return found

    # Motion

    def call_movej(self, target: Node, a: Node = None, v: Node = None, t: Node = None, r: Node = None) -> None:
        """All joints together, to joints or a pose; `v` is the speed of the axis with the longest way, rad/s."""
        self._check_motion(a, t, r)
        found, speeds = self.value(target), self._robot.axis_speeds[: len(self._robot.joints)]
        if isinstance(found, np.ndarray) and found.ndim == 1:
            if len(found) != len(speeds):
                raise Fault(f"{len(found)} joints, expected {len(speeds)}")
            travel = np.abs(found - self._robot.joints)
            full = float(travel.max() / max((travel / speeds).max(), 1e-9))
            self._pace(v, max(full, float(speeds.min())), 1.05)
            return self.move_axes(found)
        at = self.location(target)
        if self.output(Output.BY_PATH):
            raise Fault("joints move while exposures are triggered: expected movel")
        self._pace(v, float(speeds.min()), 1.05)
        return self._robot.move_tool(self._world_from_base @ at)

    def call_movel(self, target: Node, a: Node = None, v: Node = None, t: Node = None, r: Node = None) -> None:
        """The tool straight to a pose; `v` in m/s."""
        self._check_motion(a, t, r)
        at = self.location(target)
        self._pace(v, self._robot.line_speed, 0.25)
        self.move_straight(at)

    def _pace(self, speed: Node, full: float, usual: float) -> None:
        wanted = usual if speed is None else self.number(speed)
        if wanted <= 0:
            raise Fault(f"v = {wanted:g}, expected more than 0")
        self._robot.set_speed(min(wanted / full, 1.0))

    def _check_motion(self, a: Node, t: Node, r: Node) -> None:
        if t is not None and self.number(t) != 0:
            raise Fault("t: the duration of a motion cannot be prescribed, expected 0")
        for name, node in (("a", a), ("r", r)):
            if node is not None and self.number(node) < 0:
                raise Fault(f"{name} is negative")

    def call_stopj(self, a: Node = None) -> None:
        """Come to rest: motions end at rest here."""

    def call_stopl(self, a: Node = None) -> None:
        """Come to rest: motions end at rest here."""

    def call_set_tcp(self, flange_from_tool: Node) -> None:
        """Take a tool of the cell."""
        self.choose_tool(self.location(flange_from_tool))

    # Signals, registers, time, text

    def call_set_standard_digital_out(self, n: Node, b: Node) -> None:
        """Switch an output."""
        number, on = self.integer(n), self.is_true(b)
        rises = on and not self.output(number + 1)
        self.set_output(number + 1, on)
        if rises and number + 1 == Output.TURN_TABLE:
            self._turn_table()

    call_set_digital_out = call_set_standard_digital_out

    def _turn_table(self) -> None:
        robot, angle = self._robot, self._register(TABLE_ANGLE, "the angle of the table")
        speed = self._register(TABLE_SPEED, "the speed of the table")
        if speed <= 0:
            raise Fault(f"a speed of the table of {speed:g} rad/s")
        robot.set_speed(min(speed / float(robot.axis_speeds[len(robot.joints)]), 1.0))
        self.turn_table(angle)

    def call_get_standard_digital_in(self, n: Node) -> Value:
        """State of an input: 0 that the table has arrived, from 1 the presence sensors."""
        number = self.integer(n)
        return self.output(Output.TURN_TABLE) if number == _AT_TARGET else self._robot.presence(number)

    call_get_digital_in = call_get_standard_digital_in

    def call_get_standard_digital_out(self, n: Node) -> Value:
        """State of an output."""
        return self.output(self.integer(n) + 1)

    call_get_digital_out = call_get_standard_digital_out

    def call_write_output_float_register(self, n: Node, value: Node) -> None:
        """Write a register."""
        self._registers[self.integer(n)] = self.number(value)

    def _register(self, number: int, what: str) -> float:
        if number not in self._registers:
            raise Fault(f"{what}: float register {number} has no value")
        return self._registers[number]

    def interval(self, unit: float) -> float:
        """Value of a float register, m or rad."""
        found = self._register(INTERVAL, "the interval of exposures")
        if found <= 0:
            raise Fault(f"an interval of exposures of {found:g}")
        return found

    def call_sleep(self, t: Node) -> None:
        """Wait for a time, s."""
        self._robot.wait(self.number(t))

    def call_sync(self) -> None:
        """Wait for a cycle."""
        self._robot.wait(0.0)

    def call_textmsg(self, s1: Node, s2: Node = None) -> None:
        """Print."""
        self._say(" ".join(_shown(self.value(one)) for one in (s1, s2) if one is not None))

    def call_halt(self) -> None:
        """End the program."""
        raise Halt

    # Functions

    def call_pose_trans(self, p_from: Node, p_from_to: Node) -> Value:
        """A pose relative to another one."""
        return np.asarray(self.location(p_from) @ self.location(p_from_to))

    def call_pose_inv(self, p: Node) -> Value:
        """Inverse of a pose."""
        return np.asarray(pose.inverse(self.location(p)))

    def call_get_actual_tcp_pose(self) -> Value:
        """Measured pose of the tool."""
        return self.here()

    def call_get_actual_joint_positions(self) -> Value:
        """Measured joints, rad."""
        return self._robot.joints

    def call_d2r(self, d: Node) -> Value:
        """Degrees in radians."""
        return math.radians(self.number(d))

    def call_r2d(self, r: Node) -> Value:
        """Radians in degrees."""
        return math.degrees(self.number(r))


def _shown(value: Value) -> str:
    if isinstance(value, np.ndarray):
        numbers = pose_vector(value) if value.ndim == 2 else value
        return f"{'p' if value.ndim == 2 else ''}[{', '.join(f'{number:g}' for number in numbers)}]"
    return value if isinstance(value, str) else str(value)
