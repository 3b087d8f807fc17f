"""Programs in V+, the language of Adept controllers: a subset that runs in the simulated cell (docs/programs.md).

Locations are in the frame of the robot, in mm; orientations are yaw, pitch and roll about Z, Y' and Z'', in degrees.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import ClassVar

import numpy as np
from lark import Token, Tree

from scancell.arrays import Array
from scancell.geometry import pose
from scancell.programs.robot import deg, mm
from scancell.programs.script import Fault, Frame, Halt, Node, Output, Script, Value

FIRST_INPUT = 1001
_UNITS = {"MMPS": mm, "IPS": 25.4 * mm}  # m/s
_FORMAT = re.compile(r"/(?:C\d*|X\d*|S|D|F\d+\.\d+|I\d+)", re.IGNORECASE)


def euler_location(x: float, y: float, z: float, yaw: float, pitch: float, roll: float) -> Array:
    """Pose (4, 4) of a position, mm, and yaw, pitch and roll, degrees."""
    angles = np.array([yaw, pitch, roll]) * deg
    return pose.from_rotation(pose.rotation_from_euler_zyz(angles), np.array([x, y, z]) * mm)


class VPlus(Script):
    """A program in V+; the first routine of the file is run."""

    grammar = "vplus.lark"
    ignores_case = True
    constants: ClassVar[dict[str, float]] = {"true": -1.0, "false": 0.0, "on": -1.0, "off": 0.0, "pi": math.pi}

    def start(self) -> None:
        """Run the first program; speeds are full ones."""
        first = next(iter(self._routines.values()))
        self._speeds, self._next_speeds = (1.0, 1.0), (1.0, 1.0)  # shares of joint moves, of straight ones
        self._is_moving = False
        self._timers: dict[int, float] = {}
        self._noted: set[str] = set()
        if first.parameters:
            raise Fault(f"the first program has parameters: {', '.join(first.parameters)}")
        self.enter(first, {})

    def truth(self, value: bool) -> Value:
        """-1 or 0."""
        return -1.0 if value else 0.0

    def check_formats(self, node: Tree[Token]) -> None:
        """Refuse formats of TYPE other than /Cn, /Xn, /S, /D, /Fw.d and /Iw."""
        for one in node.children:
            if isinstance(one, Token) and not _FORMAT.fullmatch(one):
                raise self.error(f"{one}: no format that is known")

    def slot(self, variable: Node) -> str:
        """Key of a variable."""
        if self._is_named_value(variable):
            raise Fault(f"{variable.children[0]} cannot be changed")
        return super().slot(variable)

    # Statements with a syntax of their own

    def do_auto(self, names: Tree[Token]) -> None:
        """Make variables local to the routine."""
        for name in names.children:
            self._frames[-1].setdefault(self.key(name), None)

    def do_call(self, name: Node, arguments: Node) -> None:
        """Call a routine; variables are passed by reference."""
        routine = self._routines[self.key(name)]
        given: list[Node] = [] if arguments is None else arguments.children
        variables = [one if one.data == "variable" and not self._is_named_value(one) else None for one in given]
        targets = [None if one is None else (self.frame_of(self.slot(one)), self.slot(one)) for one in variables]
        values = [
            self.value(one) if target is None or target[0].get(target[1]) is not None else None
            for one, target in zip(given, targets, strict=True)
        ]
        inner: Frame = dict(zip(routine.parameters, values, strict=True))
        self.enter(routine, inner)
        for target, name_ in zip(targets, routine.parameters, strict=True):
            if target is not None:
                frame, slot = target
                frame[slot] = inner[name_]

    def do_command(self, name: Node, arguments: Node) -> None:
        """Carry out an instruction."""
        method = self._method(Tree("command", [name, arguments]))
        assert method is not None  # checked before the run
        method(*([] if arguments is None else arguments.children))

    def do_speed(self, value: Node, turning: Node, *words: Node) -> None:
        """Speed of the next motion, of all following ones (ALWAYS), or monitor speed."""
        speed, names = self.number(value), {str(word).upper() for word in words if word is not None}
        unit = next(iter(names - {"ALWAYS"}), "")
        if speed <= 0:
            raise Fault(f"speed {speed:g}, expected more than 0")
        if unit == "MONITOR":
            return self._robot.set_monitor_speed(min(speed / 100, 1.0))
        of_joints, turns = self._speeds[0], 1.0 if turning is None else self.number(turning.children[0]) / 100
        if unit:
            share = speed * _UNITS[unit] / self._robot.line_speed
        else:
            share = of_joints = speed / 100
        shares = (min(of_joints, 1.0), min(share, turns, 1.0))
        if min(shares) <= 0:
            raise Fault("a speed of 0")
        self._next_speeds = shares
        if "ALWAYS" in names:
            self._speeds = shares
        return None

    def do_timer(self, number: Node, value: Node) -> None:
        """Set a timer, s."""
        self._timers[self.integer(number)] = self._robot.time - self.number(value)

    def do_pause(self, duration: Node) -> None:
        """Wait for a time, s; the robot may move on."""
        self._wait(duration)

    def do_print(self, *items: Node) -> None:
        """Print texts, numbers and locations."""
        text, form = "", ""
        for item in items:
            if isinstance(item, Token):
                kind, count = item[1].upper(), int(re.sub(r"\D.*", "", item[2:]) or 1)
                text += {"C": "\n", "X": " "}.get(kind, "") * min(count, 80)
                form = item[1:] if kind in "FI" else "" if kind == "D" else form
                continue
            text += self._printed(self.value(item), form)
        self._say(text)

    @staticmethod
    def _printed(value: Value, form: str) -> str:
        if isinstance(value, str):
            return value
        if isinstance(value, np.ndarray):
            return " ".join(f"{number:.3f}" for number in (euler_numbers(value) if value.ndim == 2 else value / deg))
        width, _, digits = form[1:].partition(".")
        return f"{value:{min(int(width), 80)}.{min(int(digits or 0), 15)}f}" if form else f"{value:g}"

    def do_until(self, block: Node, condition: Node) -> None:
        """Repeat until a condition holds."""
        while True:
            self.run_block(block)
            self._idle += 1
            self._require_time()
            if self.is_true(condition):
                return

    def do_for_(self, variable: Node, first: Node, last: Node, step: Node, block: Node) -> None:
        """Count a variable."""
        frame, at, end = self.frame_of(self.slot(variable)), self.number(first), self.number(last)
        by = 1.0 if step is None else self.number(step.children[0])
        if by == 0:
            raise Fault("a step of 0")
        while (at <= end) if by > 0 else (at >= end):
            self.assign(frame, variable, at)
            self.run_block(block)
            self._idle += 1
            self._require_time()
            at = self.number(variable) + by
        self.assign(frame, variable, at)

    def do_case(self, value: Node, *parts: Node) -> None:
        """Carry out the block of the first list that has the value, or that of ANY."""
        wanted = self.number(value)
        for listed, block in zip(parts[: len(parts) // 2 * 2 : 2], parts[1::2], strict=True):
            if any(self.number(one) == wanted for one in listed.children):
                return self.run_block(block)
        return self.run_block(parts[-1]) if len(parts) % 2 else None

    # Instructions of motion

    def _moves(self, is_straight: bool, move: Callable[[], None]) -> None:
        share, self._next_speeds = self._next_speeds[is_straight], self._speeds
        self._robot.set_speed(share)
        move()
        self._is_moving = True

    def _require_rest(self) -> None:
        if self._is_moving:
            raise Fault("the robot of a controller still moves here: expected BREAK before")

    def instruct_move(self, target: Node) -> None:
        """To a location or precision point, all joints together."""
        found = self.value(target)
        if isinstance(found, np.ndarray) and found.ndim == 1:
            return self._moves(False, lambda: self.move_axes(found))
        at = self.location(target)
        return self._moves(False, lambda: self._move_joints_to(at))

    def _move_joints_to(self, base_from_tool: Array) -> None:
        if self.output(Output.BY_PATH):
            raise Fault("joints move while exposures are triggered: expected a straight move")
        self._robot.move_tool(self._world_from_base @ base_from_tool)

    def instruct_moves(self, target: Node) -> None:
        """Straight to a location."""
        at = self.location(target)
        self._moves(True, lambda: self.move_straight(at))

    def instruct_appro(self, target: Node, distance: Node) -> None:
        """To a distance, mm, in front of a location."""
        at = self._before(target, distance)
        self._moves(False, lambda: self._move_joints_to(at))

    def instruct_appros(self, target: Node, distance: Node) -> None:
        """Straight to a distance, mm, in front of a location."""
        at = self._before(target, distance)
        self._moves(True, lambda: self.move_straight(at))

    def instruct_depart(self, distance: Node) -> None:
        """Back along the tool's z by a distance, mm, all joints together."""
        at = self.here() @ pose.translation((0.0, 0.0, -self.number(distance) * mm))
        self._moves(False, lambda: self._move_joints_to(at))

    def instruct_departs(self, distance: Node) -> None:
        """Straight back along the tool's z by a distance, mm."""
        at = self.here() @ pose.translation((0.0, 0.0, -self.number(distance) * mm))
        self._moves(True, lambda: self.move_straight(at))

    def _before(self, target: Node, distance: Node) -> Array:
        return np.asarray(self.location(target) @ pose.translation((0.0, 0.0, -self.number(distance) * mm)))

    def instruct_break(self) -> None:
        """Wait for the end of the motion."""
        self._is_moving = False

    def instruct_tool(self, flange_from_tool: Node) -> None:
        """Take a tool of the cell."""
        self._require_rest()
        self.choose_tool(self.location(flange_from_tool))

    def instruct_accel(self, *shares: Node) -> None:
        """Accelerations, percent."""
        if not 1 <= len(shares) <= 2 or min(map(self.number, shares)) <= 0:
            raise Fault("expected one or two shares above 0")
        self._note("ACCEL", "accelerations remain those of the cell's description")

    def _note(self, instruction: str, text: str) -> None:
        """Say once that an instruction has no effect."""
        if instruction not in self._noted:
            self._noted.add(instruction)
            self._say(f"line {self.line}: {instruction}: {text}")

    # Instructions of signals and time

    def instruct_signal(self, *numbers: Node) -> None:
        """Switch outputs, negative ones off."""
        self._require_rest()
        for number in map(self.integer, numbers):
            self.set_output(abs(number), number > 0)

    def instruct_wait(self, condition: Node = None) -> None:
        """Wait until a condition holds, or for a cycle."""
        if condition is None:
            return self._robot.wait(0.0)
        text = self._lines[self.line - 1].partition(";")[0].strip()
        return self._robot.wait_until(lambda: self.is_true(condition), text)

    def instruct_delay(self, duration: Node) -> None:
        """Keep the robot at rest for a time, s."""
        self._wait(duration)

    def _wait(self, duration: Node) -> None:
        self._robot.wait(self.number(duration))

    def instruct_here(self, variable: Node) -> None:
        """Store the measured location of the tool."""
        self._require_rest()
        if variable.data != "variable":
            raise Fault("expected a variable")
        self.assign(self.frame_of(self.slot(variable)), variable, self.here())

    def instruct_attach(self) -> None:
        """Take control of the robot, which the program has."""

    def instruct_detach(self) -> None:
        """Give the robot back at the end."""

    def instruct_halt(self) -> None:
        """End the program."""
        raise Halt

    # Values

    def get_variable(self, name: Node, index: Node = None) -> Value:
        """Value of a variable, a constant, or the location of the tool."""
        match self.key(name) if index is None else "":
            case "here":
                self._require_rest()
                return self.here()
            case "null":
                return np.eye(4)
            case key if key in self.constants:
                return self.constants[key]
        return super().get_variable(name, index)

    def _is_named_value(self, variable: Node) -> bool:
        return self.key(variable.children[0]) in (*self.constants, "here", "null")

    def get_differ(self, left: Node, right: Node) -> Value:
        """Whether exactly one of two holds."""
        return self.truth(self.is_true(left) != self.is_true(right))

    def get_compose(self, left: Node, right: Node) -> Value:
        """A location relative to another one."""
        return np.asarray(self.location(left) @ self.location(right))

    def get_shift(self, at: Node, *steps: Node) -> Value:
        """A location, shifted along the axes of the robot, mm."""
        return np.asarray(pose.translation([self.number(step) * mm for step in steps]) @ self.location(at))

    def call_trans(
        self, x: Node, y: Node = None, z: Node = None, yaw: Node = None, pitch: Node = None, roll: Node = None
    ) -> Value:
        """Location of position and angles."""
        return euler_location(*(0.0 if one is None else self.number(one) for one in (x, y, z, yaw, pitch, roll)))

    def call_precision_ppoint(self, *axes: Node) -> Value:
        """Precision point: joints, and the table, degrees."""
        return np.array([self.number(one) for one in axes]) * deg

    def call_inverse(self, at: Node) -> Value:
        """Inverse of a location."""
        return np.asarray(pose.inverse(self.location(at)))

    def call_rx(self, angle: Node) -> Value:
        """Rotation about x, degrees."""
        return pose.from_rotation(pose.rotation_about(0, self.number(angle) * deg))

    def call_ry(self, angle: Node) -> Value:
        """Rotation about y, degrees."""
        return pose.from_rotation(pose.rotation_about(1, self.number(angle) * deg))

    def call_rz(self, angle: Node) -> Value:
        """Rotation about z, degrees."""
        return pose.from_rotation(pose.rotation_about(2, self.number(angle) * deg))

    def call_dx(self, at: Node) -> Value:
        """X of a location, mm."""
        return float(self.location(at)[0, 3] / mm)

    def call_dy(self, at: Node) -> Value:
        """Y of a location, mm."""
        return float(self.location(at)[1, 3] / mm)

    def call_dz(self, at: Node) -> Value:
        """Z of a location, mm."""
        return float(self.location(at)[2, 3] / mm)

    def call_distance(self, left: Node, right: Node) -> Value:
        """Distance of two locations, mm."""
        return float(np.linalg.norm(self.location(left)[:3, 3] - self.location(right)[:3, 3]) / mm)

    def call_sig(self, *numbers: Node) -> Value:
        """Whether all signals are on, of negative numbers off; inputs from 1001 are the presence sensors."""
        return self.truth(all(self._signal(abs(one)) == (one > 0) for one in map(self.integer, numbers)))

    def _signal(self, number: int) -> bool:
        return self._robot.presence(number - FIRST_INPUT + 1) if number >= FIRST_INPUT else self.output(number)

    def call_timer(self, number: Node) -> Value:
        """Time of a timer, s."""
        return self._robot.time - self._timers.get(self.integer(number), 0.0)

    def call_abs(self, value: Node) -> Value:
        """Magnitude."""
        return abs(self.number(value))

    def call_sqrt(self, value: Node) -> Value:
        """Square root."""
        return math.sqrt(self.number(value))

    def call_sin(self, angle: Node) -> Value:
        """Sine of degrees."""
        return math.sin(self.number(angle) * deg)

    def call_cos(self, angle: Node) -> Value:
        """Cosine of degrees."""
        return math.cos(self.number(angle) * deg)

    def call_atan2(self, y: Node, x: Node) -> Value:
        """Angle, degrees."""
        return math.atan2(self.number(y), self.number(x)) / deg

    def call_int(self, value: Node) -> Value:
        """Whole part."""
        return float(math.trunc(self.number(value)))

    def call_min(self, *values: Node) -> Value:
        """Smallest."""
        return min(map(self.number, values))

    def call_max(self, *values: Node) -> Value:
        """Largest."""
        return max(map(self.number, values))

    def interval(self, unit: float) -> float:
        """Value of the global variable ``trigger.interval``, mm or degrees."""
        found = self._globals.get("trigger.interval")
        if not isinstance(found, int | float) or found <= 0:
            raise Fault("exposures are triggered, and trigger.interval has no value above 0 (mm or degrees)")
        return float(found) * unit


def euler_numbers(location: Array) -> Array:
    """Position, mm, and yaw, pitch and roll, degrees, (6,), of a pose (4, 4)."""
    angles = pose.euler_zyz_from_rotation(location[:3, :3])
    return np.concatenate([location[:3, 3] / mm, angles / deg])
