"""Programs of the subset of URScript, and what they share with emulated ones: moves, cycle by cycle."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from scancell.errors import CommandError, DescriptionError, ProgramError
from scancell.wire.ur.script import Argument, PoseLiteral, Statement
from scancell.wire.ur.variables import pose_of

if TYPE_CHECKING:
    from scancell.arrays import Array
    from scancell.wire.ur.controller import UrController

Task = Iterator[None]  # goes on once in every cycle of the controller

_BIT_WORD = 32


def run(controller: UrController, program: Sequence[Statement]) -> Task:
    """Run statements one after another.

    Raises
    ------
    ProgramError
        If a move is refused or stopped.
    """
    for statement in program:
        yield from _perform(controller, statement)


def move_joints(controller: UrController, target: Sequence[float] | PoseLiteral, speed: float) -> Task:
    """Move all joints together to joint angles (6,), or those of a pose, and wait for the end."""
    start_move_joints(controller, target, speed)
    yield from wait_for_end(controller)


def start_move_joints(controller: UrController, target: Sequence[float] | PoseLiteral, speed: float) -> None:
    """Start `move_joints`."""
    robot = controller.robot
    try:
        joints: Array = (
            robot.joints_for(pose_of(target.values)) if isinstance(target, PoseLiteral) else np.asarray(target, float)
        )
        robot.move_joints(joints, speed)
    except (CommandError, DescriptionError) as error:
        raise ProgramError(str(error)) from None


def move_line(controller: UrController, target: Sequence[float] | PoseLiteral, speed: float) -> Task:
    """Move the TCP straight to a pose, or that of joint angles (6,), and wait for the end."""
    start_move_line(controller, target, speed)
    yield from wait_for_end(controller)


def start_move_line(controller: UrController, target: Sequence[float] | PoseLiteral, speed: float) -> None:
    """Start `move_line`."""
    robot = controller.robot
    try:
        base_from_tcp = (
            pose_of(target.values) if isinstance(target, PoseLiteral) else robot.base_from_tcp(np.asarray(target))
        )
        robot.move_line(base_from_tcp, speed)
    except (CommandError, DescriptionError) as error:
        raise ProgramError(str(error)) from None


def wait_for_end(controller: UrController) -> Task:
    """Wait until a move has ended."""
    yield
    while not controller.robot.is_at_end:
        yield
    check(controller)


def check(controller: UrController) -> None:
    """Raise `ProgramError` if the controller of the cell refused or ended a motion."""
    if controller.robot.fault:
        raise ProgramError(controller.robot.fault)


def stop(controller: UrController) -> Task:
    """End all motion and wait until the robot rests."""
    controller.robot.hold()
    yield
    while controller.robot.is_moving:
        yield


def _perform(controller: UrController, statement: Statement) -> Task:
    name, arguments = statement.name, statement.arguments
    if name in ("movej", "movel"):
        target: Argument = arguments["q" if name == "movej" else "pose"]
        assert isinstance(target, tuple | PoseLiteral)
        move = move_joints if name == "movej" else move_line
        yield from move(controller, target, statement.number("v"))
    elif name in ("stopj", "stopl"):
        yield from stop(controller)
    elif name == "sleep":
        until = controller.robot.time + statement.number("t")
        while controller.robot.time < until - 1e-9:
            yield
    elif name == "sync":
        yield
    elif name == "textmsg":
        controller.log(f"textmsg: {arguments['s1']}{arguments['s2']}")
    elif name == "set_tcp":
        assert isinstance(arguments["pose"], PoseLiteral)
        controller.robot.flange_from_tcp = pose_of(arguments["pose"].values)
    elif name == "rtde_set_watchdog":
        register, action = str(arguments["variable_name"]), str(arguments["action"])
        controller.set_watchdog(register, statement.number("min_frequency"), action)
    elif name.endswith("digital_out"):
        _set_output(controller, statement)
    elif name.startswith("write_output"):
        _write_register(controller, statement)


def _set_output(controller: UrController, statement: Statement) -> None:
    first, count = (8, 8) if "configurable" in statement.name else (0, 8)
    bit = 1 << (first + _address(statement, "n", count))
    outputs = controller.robot.outputs
    controller.robot.outputs = outputs | bit if statement.arguments["b"] else outputs & ~bit


def _write_register(controller: UrController, statement: Statement) -> None:
    value = statement.number("value")
    if "boolean" not in statement.name:
        kind = "int" if "integer" in statement.name else "double"
        controller.registers[f"output_{kind}_register_{_address(statement, 'address', 48)}"] = value
        return
    address = _address(statement, "address", 128)
    if address >= 64:
        controller.registers[f"output_bit_register_{address}"] = value
        return
    low = address // _BIT_WORD * _BIT_WORD
    name, bit = f"output_bit_registers{low}_to_{low + 31}", 1 << (address - low)
    word = int(controller.registers.get(name, 0))
    controller.registers[name] = word | bit if value else word & ~bit


def _address(statement: Statement, key: str, count: int) -> int:
    number = statement.number(key)
    if not 0 <= number < count or number != int(number):
        raise ProgramError(f"line {statement.line}: {key} = {number:g}: expected 0 to {count - 1}")
    return int(number)
